"""The paper's simulations redone: `formation-paper --out DIR`, or `python -m baselines.paper`.

Writes `figNN.png` and `figNN.csv` for figures 2 to 9 and 11 to 14 and `summary.json`, and prints each
claim of the text beside what was measured. Figures 2 to 5 integrate the closed loop as one
continuous differential equation; 6 to 9 fly scenario `paper` and 11 to 14 scenario `experiment` in
the environment's sampled loop. Figures 1 and 10 are drawings without numbers.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from baselines.reproduction import continuous, sampled, tables
from baselines.reproduction.claims import Claim, Cost, claim_table, cost_table
from baselines.reproduction.claims_continuous import flight_claims, planar_claims
from baselines.reproduction.claims_experiment import experiment_claims
from baselines.reproduction.claims_formation import formation_claims
from baselines.reproduction.costs import feedforward_costs
from baselines.system import console, pictures
from baselines.system.arguments import Parser, whole
from baselines.system.writing import claim, write_text
from formation_env.config import NO_NOISE
from formation_env.laws.feasibility import FeasibilityWarning

FIGURES = (2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14)
PLANAR, FLIGHT, FORMATION, EXPERIMENT = (2, 3), (4, 5), (6, 7, 8, 9), (11, 12, 13, 14)

# m/s^2: pushes the leader about where a claim needs it to move by itself. Small, because the trigger
# (40) has to find every vehicle within 0.25 m of where it should be.
_GUST = 0.03
# Of vehicles driven by rates, whose gains the paper does not print: those that the figures of section IV have
# always been drawn with, another than the environment's own.
_RATES = {"k3": 20.0}

Outcome = tuple[list[Claim], dict[int, tables.Table], dict[int, Any]]


def _planar(seed: int, worlds: int) -> Outcome:
    motion = continuous.planar()
    columns = {2: tables.figure_2(motion), 3: tables.figure_3(motion)}
    return planar_claims(motion), columns, dict.fromkeys(PLANAR, motion)


def _flight(seed: int, worlds: int) -> Outcome:
    motion = continuous.flight()
    table = tables.figure_4(motion)
    return flight_claims(motion), {4: table, 5: table}, dict.fromkeys(FLIGHT, motion)


def _formation(seed: int, worlds: int) -> Outcome:
    noisy = sampled.fly("paper", seed, worlds)
    clean = sampled.fly("paper", noise=NO_NOISE)
    gusty = sampled.fly("paper", seed, worlds, noise=NO_NOISE, gust=_GUST)
    table = tables.formation(noisy)
    claims = formation_claims(noisy, clean, gusty)
    return claims, dict.fromkeys(FORMATION, table), dict.fromkeys(FORMATION, noisy)


def _experiment(seed: int, worlds: int) -> Outcome:
    run = sampled.fly("experiment", seed, worlds, rates_tracker=_RATES)
    prompt = sampled.fly("experiment", seed, worlds, rates_tracker=_RATES, window=1)
    table = tables.formation(run)
    claims = experiment_claims(run, prompt)
    return claims, dict.fromkeys(EXPERIMENT, table), dict.fromkeys(EXPERIMENT, run)


GROUPS: dict[tuple[int, ...], Callable[[int, int], Outcome]] = {
    PLANAR: _planar,
    FLIGHT: _flight,
    FORMATION: _formation,
    EXPERIMENT: _experiment,
}


def _version() -> str:
    try:
        return version("formation-env")
    except PackageNotFoundError:
        return "not installed"


def write_summary(
    path: Path, claims: Sequence[Claim], costs: Sequence[Cost], seed: int, worlds: int
) -> None:
    """Write `summary.json`. Claims' values are in SI units and radians."""
    content = {
        "package": _version(),
        "seed": seed,
        "seeds": worlds,
        "tolerance": continuous.TOLERANCE,
        "claims": [c._asdict() for c in claims],
        "feedforward": {"default": "zero", "costs": [c._asdict() for c in costs]},
    }
    write_text(path, json.dumps(content, indent=2, default=float) + "\n")


def reproduce(
    out: Path,
    figures: Iterable[int] = FIGURES,
    seed: int = 0,
    worlds: int = 20,
    plots: bool = True,
) -> tuple[list[Claim], list[Cost]]:
    """Write the wanted figures and `summary.json` into `out`; returns what it holds.

    `seed` is drawn, the claims about noise are measured over `worlds` seeds from it on. A claim is
    measured with the figures of its own simulation. Raises `OSError` where `out` cannot be written.
    """
    wanted = set(figures)
    out.mkdir(parents=True, exist_ok=True)
    claims: list[Claim] = []
    for numbers, simulate in GROUPS.items():
        drawn = sorted(wanted.intersection(numbers))
        if drawn:
            console.complain(f"figures {', '.join(map(str, drawn))} ...")
            found, columns, motions = simulate(seed, worlds)
            claims += found
            digits = 9 if numbers in (PLANAR, FLIGHT) else 6
            for number in drawn:
                tables.write_csv(out / f"fig{number:02d}.csv", columns[number], digits)
                if plots:
                    _draw(number, motions[number], out / f"fig{number:02d}.png")
    costs = []
    if wanted.intersection(FORMATION):
        console.complain("third and fourth derivatives ...")
        costs = feedforward_costs(seed, worlds)
    write_summary(out / "summary.json", claims, costs, seed, worlds)
    return claims, costs


def _draw(number: int, motion: Any, path: Path) -> None:
    # Imported here: everything but the pictures works without Matplotlib.
    from baselines.reproduction import plots

    plots.draw(number, motion, path)


def parser() -> Parser:
    """The options of the command, none of them read yet."""
    own = Parser("formation-paper", "Redo the paper's figures and measure the claims of its text.")
    add = own.add_argument
    add("--out", type=Path, default=Path("results/paper"), metavar="DIR",
        help="Folder that pictures, CSV files and summary.json are written to. "
        "(default: %(default)s)")  # fmt: skip
    add("--figures", type=int, nargs="+", choices=FIGURES, default=FIGURES, metavar="N",
        help="Numbers of the paper's figures to redo, of 2 to 9 and 11 to 14. "
        "(default: all of them)")  # fmt: skip
    add("--seed", type=whole(0, 2**32), default=0, metavar="N",
        help="Seed of the run that is drawn. (default: %(default)s)")  # fmt: skip
    add("--seeds", type=whole(1, 100_000), default=20, metavar="N",
        help="Number of runs, with seeds from --seed on, that claims about noise are measured on. "
        "(default: %(default)s)")  # fmt: skip
    add("--no-plots", action="store_true",
        help="Write no pictures, which alone need Matplotlib. (default: off)")  # fmt: skip
    return own


@console.command
def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `formation-paper`; returns the exit status, or raises `SystemExit` with one line on
    the standard error for a wrong option. The files are written before anything is printed."""
    own = parser()
    args = own.parse_args(argv)
    if not args.no_plots and not pictures.installed():
        own.error(f"{pictures.MISSING} (or leave them out with --no-plots)")
    with warnings.catch_warnings():
        # The paper's own trajectory breaks the sufficient bound (29)-(30); no follower inverts on it.
        warnings.simplefilter("ignore", FeasibilityWarning)
        try:
            with claim(args.out):
                claims, costs = reproduce(
                    args.out, args.figures, args.seed, args.seeds, not args.no_plots
                )
        except OSError as problem:
            reason = problem.strerror or problem
            console.complain(f"{own.prog}: error: cannot write to {args.out}: {reason}")
            return 1
        except KeyboardInterrupt:
            console.complain(f"interrupted: what is in {args.out} may be incomplete")
            return 130
    console.say(claim_table(claims, console.width()))
    if costs:
        console.say("\n" + cost_table(costs))
    console.say(f"\nWritten to {args.out}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
