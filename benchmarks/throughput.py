"""The benchmark: `python -m benchmarks.throughput`, about ten minutes; `--quick` in about one.

Steps of the vector environment over worlds, followers, action levels and threads, beside a bare kernel
that does only the rigid-body substeps (`floor`) and beside the neighbours that are installed
(`peers`), all in one run. Writes `throughput.json`, `throughput.md` and, with Matplotlib,
`throughput.png` to the folder of `--output`. Run it on a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import sys
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numba
import numpy as np

import formation_env
from baselines.system import console
from baselines.system.arguments import Parser, above_zero, whole
from benchmarks import grid, report, single, startup
from formation_env.formations import MAX_FOLLOWERS
from formation_env.laws.levels import NAMES as LEVEL_NAMES

Figures = dict[str, Any]
Say = Callable[[str], None]


def _numbers(text: str, most: int = 10**7) -> list[int]:
    try:
        values = [int(word) for word in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(1 <= value <= most for value in values):
        raise argparse.ArgumentTypeError(
            f"{text!r}: expected whole numbers from 1 to {most}, as 1,16"
        )
    return sorted(set(values))


def _followers(text: str) -> list[int]:
    return _numbers(text, MAX_FOLLOWERS)


def _names(allowed: Sequence[str]) -> Callable[[str], list[str]]:
    def read(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in allowed:
                raise argparse.ArgumentTypeError(f"{name!r}: expected some of {','.join(allowed)}")
        return names

    return read


# Defaults of the options, and of those that `--quick` has others for.
FULL: dict[str, Any] = {
    "worlds": [1, 16, 256, 4096, 65536],
    "followers": [2, 16, 256],
    "actions": list(LEVEL_NAMES),
    "rounds": 7,
    "seconds": 0.05,
    "peers": True,
    "startup": True,
}
QUICK: dict[str, Any] = {
    "worlds": [1, 256, 4096],
    "followers": [2, 16],
    "actions": ["wrench"],
    "rounds": 3,
    "seconds": 0.02,
    "peers": True,
    "startup": False,
}


def _default(name: str) -> str:
    """The default of an option for its help."""
    full, quick = (_text(defaults[name]) for defaults in (FULL, QUICK))
    return f"(default: {full})" if full == quick else f"(default: {full}; with --quick {quick})"


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


def parser() -> Parser:
    """The options of the command, none of them read yet."""
    own = Parser(
        "benchmarks.throughput",
        "Time the environment beside its neighbours and beside a bare kernel that only flies the rigid "
        "bodies.",
    )
    _add_points(own)
    _add_samples(own)
    return own


def _add_points(own: Parser) -> None:
    """Options that decide what is timed."""
    add = own.add_argument
    add("--quick", action="store_true",
        help="Time fewer combinations in fewer rounds, without start-up times. "
        "(default: off)")  # fmt: skip
    add("--worlds", type=_numbers, metavar="N,N",
        help=f"Numbers of worlds, separated by commas. {_default('worlds')}")  # fmt: skip
    add("--followers", type=_followers, metavar="N,N",
        help=f"Numbers of followers, separated by commas. {_default('followers')}")  # fmt: skip
    add("--threads", type=_numbers, default=[1, 2], metavar="N,N",
        help="Numbers of threads, separated by commas. (default: 1,2)")  # fmt: skip
    add("--scenarios", type=_names(("nominal", "paper")), default=["nominal", "paper"],
        metavar="NAMES",
        help="Scenarios to time, separated by commas. (default: nominal,paper)")  # fmt: skip
    add("--actions", type=_names(tuple(LEVEL_NAMES)), metavar="NAMES",
        help="Action levels, separated by commas; all but the first are timed at the first number of "
        f"followers only. {_default('actions')}")  # fmt: skip
    add("--peers", action=argparse.BooleanOptionalAction,
        help=f"Time the neighbours that are installed, too. {_default('peers')}")  # fmt: skip
    add("--startup", action=argparse.BooleanOptionalAction,
        help="Measure import, first compile and growth of memory, too. "
        f"{_default('startup')}")  # fmt: skip


def _add_samples(own: Parser) -> None:
    """Options that decide how it is timed, and where the figures go."""
    add = own.add_argument
    add("--rounds", type=whole(1, 10**7), metavar="N",
        help=f"Number of samples of each figure, of which the median is taken. "
        f"{_default('rounds')}")  # fmt: skip
    add("--seconds", type=above_zero("a number above 0"), metavar="S",
        help=f"Length of a sample in seconds. {_default('seconds')}")  # fmt: skip
    add("--memory", type=above_zero("a number above 0"), default=8.0, metavar="GIB",
        help="Memory in GiB that a combination may need; what needs more is left out. "
        "(default: %(default)s)")  # fmt: skip
    add("--output", type=Path, default=Path("results/benchmarks"), metavar="DIR",
        help="Folder that throughput.json, throughput.md and throughput.png are written to. "
        "(default: %(default)s)")  # fmt: skip


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options; `--quick` changes the defaults of those not given."""
    options = parser().parse_args(arguments)
    for name, value in (QUICK if options.quick else FULL).items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    return options


def _machine() -> dict[str, Any]:
    return {
        "cores": os.cpu_count(),
        "processor": platform.machine(),
        "Python": platform.python_version(),
        "NumPy": np.__version__,
        "Numba": numba.__version__,
        "formation-env": formation_env.__version__,
    }


def points(options: argparse.Namespace) -> list[grid.Point]:
    """The combinations asked for, small ones first."""
    return [
        grid.Point(scenario, action, followers, worlds)
        for scenario, action, followers, worlds in product(
            options.scenarios, options.actions, options.followers, options.worlds
        )
        if action == options.actions[0] or followers == options.followers[0]
    ]


def _grid(options: argparse.Namespace, figures: Figures, say: Say) -> None:
    limit = options.memory * 2**30
    for point in points(options):
        needed = point.reckoned_bytes(len(options.threads))
        where = f"{point.scenario} {point.action} {point.worlds} worlds x {point.followers}"
        if needed > limit:
            say(f"skipped {where}: needs about {needed / 2**30:.1f} GiB, see --memory")
            continue
        rows = grid.measure(point, options.threads, options.rounds, options.seconds)
        figures["grid"] += rows
        write(figures, options.output, draw=False)
        for row in rows:
            print(
                f"{where}, threads {row['threads']}: {row['step_us']:,.1f} us, "
                f"{1e-6 * row['agent_steps_per_s']:.3g} M agent steps/s, "
                f"{row['share_of_floor']:.2f} of the floor, x{row['speedup']:.2f}",
                flush=True,
            )


def _memory(options: argparse.Namespace, figures: Figures) -> None:
    # Many vehicles, so that what belongs to none of them does not count.
    for scenario, followers in product(options.scenarios, options.followers):
        worlds = max(64, 50_000 // (followers + 1))
        figures["memory"].append(
            {
                "scenario": scenario,
                "followers": followers,
                "worlds": worlds,
                **startup.memory(scenario, followers, worlds, max(options.threads)),
            }
        )


def _singles(options: argparse.Namespace, figures: Figures, say: Say) -> None:
    rounds, seconds = options.rounds, options.seconds
    figures["one_world"] = single.one_world(rounds, seconds, options.peers, say)
    figures["frame_ms"] = single.frame(rounds, seconds, say)
    most, threads = max(options.worlds), max(options.threads)
    if options.peers:
        figures["batches"] = single.batches(threads, rounds, seconds, most, say)
    flight = 1.0 if options.quick else 10.0
    figures["expert"] = [
        single.expert(scenario, min(4096, most), threads, rounds, seconds, flight)
        for scenario in options.scenarios
    ]


def _startup(options: argparse.Namespace) -> Figures:
    steps = 20_000 if options.quick else 1_000_000
    return {
        "import": startup.imported(3),
        "first_steps": startup.first_steps(),
        "growth": startup.growth(steps),
        "growth_steps": steps,
    }


def write(figures: Figures, folder: Path, draw: bool = True) -> None:
    """The three files, or all but the plot. An interrupted run leaves what it had finished."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(figures, indent=1)
    (folder / "throughput.json").write_text(text + "\n", encoding="utf-8")
    (folder / "throughput.md").write_text(report.markdown(figures), encoding="utf-8")
    if figures["grid"] and draw:
        report.plot(figures["grid"], folder / "throughput.png")


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; returns the exit status."""
    options = parse(arguments)
    words = sys.argv[1:] if arguments is None else arguments
    figures: Figures = {
        "command": shlex.join(["python", "-m", "benchmarks.throughput", *words]),
        "machine": _machine(),
        "notes": [],
        "grid": [],
        "memory": [],
    }

    def say(note: str) -> None:
        print(note, flush=True)
        figures["notes"].append(note)

    try:
        write(figures, options.output)  # before the work, not after it
    except OSError as problem:
        print(f"argument --output: {options.output}: {problem.strerror}", file=sys.stderr)
        return 2
    _singles(options, figures, say)
    write(figures, options.output)
    _memory(options, figures)
    if options.startup:
        figures["startup"] = _startup(options)
    write(figures, options.output)
    _grid(options, figures, say)
    write(figures, options.output)
    print("\n" + report.bars_table(figures) + f"\n\nWritten to {options.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
