"""Score policies on scenarios: `python -m baselines.evaluate`, or `formation-evaluate`.

Policies are named, or are files (see `baselines.files`). Each flies the same episodes: world i of a
scenario has the seed `seed + i`, as `gym.make(...).reset(seed=seed + i)` has. Hover and the expert always
fly, because they are the 0 and the 1 of the score. Results do not depend on the number of threads, nor
on whether the episodes are shared out over a Ray cluster (`--ray`).

Prints a table and writes `results.json` (layout: see `baselines.report`) and `results.md` into the
output folder. `--leaderboard` also writes `LEADERBOARD.md` and the README's extract of it.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any, NoReturn, final

import formation_env
from baselines import cluster, report
from baselines.explanations import explanations
from baselines.files import SUFFIX
from baselines.registry import METHODS, POLICIES, available, is_policy
from baselines.scoring import EPISODES, Fleet, Report, enlist, evaluate
from baselines.writing import write_text
from formation_env import SCENARIOS, FormationConfig, configure
from formation_env.config import LEVELS

# Of the leaderboard: the tasks at their own action level, and those with policies at the others.
SHOWN = (*SCENARIOS, "nominal:rates", "nominal:reference", "paper:rates", "paper:reference")
BEGIN, END = "<!-- leaderboard:begin -->", "<!-- leaderboard:end -->"


# -- files ----------------------------------------------------------------------------------------


def leaderboard(result: Report, command: str) -> str:
    """The text of LEADERBOARD.md."""
    layout = next(iter(result.scenarios.values())).config.layout.version
    last = result.seed + result.episodes - 1
    return (
        "# Leaderboard\n\n"
        "Written by the command below; do not edit.\n\n"
        f"```bash\n{command}\n```\n\n"
        f"`Formation-v0`, observation layout {layout}, package {formation_env.__version__}. "
        f"{result.episodes} episodes for each scenario and policy, seeds {result.seed} to {last}, the same "
        f"for every policy.\n\n{report.markdown(result)}"
    )


def with_extract(readme: str, extract: str) -> str:
    """README text with the part between the leaderboard's markers replaced.

    Raises `ValueError` unless each marker stands there once, in order.
    """
    once = readme.count(BEGIN) == readme.count(END) == 1
    if not once or readme.index(END) < readme.index(BEGIN):
        raise ValueError(f"expected the lines {BEGIN} and {END} once each, in this order")
    before, rest = readme.split(BEGIN)
    return f"{before}{BEGIN}\n{extract}\n{END}{rest.split(END)[1]}"


# -- command line ---------------------------------------------------------------------------------


@final
class _Parser(argparse.ArgumentParser):
    """Says in one line what is wrong."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}\n")


def _whole(low: int, high: int) -> Any:
    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(
                f"{text!r}: expected a whole number from {low} to {high}"
            )
        return value

    return read


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not (isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text!r}: expected a time in seconds above 0")
    return value


def _scenarios(text: str) -> list[str]:
    """Names, each perhaps with an action level after a colon."""
    names = [name for name in text.replace(",", " ").split() if name]
    for name in names or [text]:
        scenario, colon, level = name.partition(":")
        if scenario not in SCENARIOS:
            raise argparse.ArgumentTypeError(f"{name!r}: expected some of {', '.join(SCENARIOS)}")
        if colon and level not in LEVELS:
            raise argparse.ArgumentTypeError(
                f"{name!r}: expected after the colon one of {', '.join(LEVELS)}"
            )
    return list(dict.fromkeys(names))


def _policies(text: str) -> list[str]:
    """Names and paths; only commas divide them, since a path may have spaces."""
    names = [name for name in map(str.strip, text.split(",")) if name]
    for name in names or [text]:
        if not is_policy(name):
            known = ", ".join((*POLICIES, *METHODS))
            raise argparse.ArgumentTypeError(
                f"{name!r}: expected some of {known}, or paths of *{SUFFIX} files"
            )
    return list(dict.fromkeys(names))


def _parser() -> _Parser:
    parser = _Parser(
        prog="formation-evaluate",
        description="Score policies on scenarios, on the same seeds for every policy.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--policies", type=_policies, default=argparse.SUPPRESS, metavar="NAMES",
        help=f"comma-separated, of {', '.join((*POLICIES, *METHODS))} (learned ones from the files that "
        f"are shipped) and paths of your own *{SUFFIX} files (default: all but the latter)")  # fmt: skip
    add("--scenarios", type=_scenarios, metavar="NAMES",
        help=f"comma-separated, of {', '.join(SCENARIOS)} (all; with --leaderboard also those that "
        "policies are shipped for); NAME:LEVEL at another action level")  # fmt: skip
    add("--episodes", type=_whole(1, 1_000_000), default=EPISODES, metavar="N",
        help="for each scenario and policy")  # fmt: skip
    add("--seed", type=_whole(0, 2**32), default=0, metavar="N", help="of the first episode")
    add("--action", choices=tuple(LEVELS), help="action level instead of the scenarios' own")
    add("--duration", type=_seconds, metavar="S", help="episode length instead of the scenario's")
    add(
        "--output", type=Path, default=Path("results"), metavar="DIR", help="folder for the results"
    )
    add("--threads", type=_whole(1, 1024), default=os.cpu_count() or 1, metavar="N", help="workers")
    add("--ray", action="store_true",
        help="share the episodes out over a Ray cluster, by default one of this machine's cores")  # fmt: skip
    add("--address", metavar="HOST:PORT", help="with --ray: of a cluster that runs already")
    add("--leaderboard", type=Path, nargs="?", const=Path(), metavar="DIR",
        help="also write LEADERBOARD.md and README.md's extract of it in this checkout "
        "(by default the current folder)")  # fmt: skip
    return parser


def _configs(options: argparse.Namespace) -> dict[str, FormationConfig]:
    """The chosen scenarios with the overrides. Raises `ValueError` naming scenario and field."""
    configs = {}
    for name in options.scenarios:
        scenario, _, level = name.partition(":")
        given = {"action": level or options.action, "duration": options.duration}
        try:
            configs[name] = configure(scenario, **{k: v for k, v in given.items() if v is not None})
        except ValueError as problem:
            raise ValueError(f"scenario {name}: {problem}") from None
    return configs


def _prepare(folder: Path, names: Sequence[str]) -> None:
    """Make sure that these files can be written. Raises `ValueError` naming what cannot."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as problem:
        reason = problem.strerror or problem
        raise ValueError(
            f"cannot write into {folder}: {reason}; expected a writable folder"
        ) from None
    for name in names:
        if (folder / name).is_dir():
            raise ValueError(f"{folder / name} is a folder: expected a file or nothing")


def _check_readme(checkout: Path) -> None:
    """Make sure that the README can take the extract."""
    path = checkout / "README.md"
    try:
        with_extract(path.read_text(encoding="utf-8"), "")
    except (OSError, ValueError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else problem
        raise ValueError(f"argument --leaderboard: {path}: {reason}") from None


def _command(options: argparse.Namespace, everybody: list[str]) -> str:
    """The command that repeats the figures: without what does not change them."""
    words = ["python -m baselines.evaluate"]
    chosen = {"policies": everybody, "scenarios": list(SHOWN)}
    for name, everything in chosen.items():
        if getattr(options, name) != everything:
            words.append(f"--{name} {shlex.quote(','.join(getattr(options, name)))}")
    for name, usual in {"episodes": EPISODES, "seed": 0, "action": None, "duration": None}.items():
        if getattr(options, name) != usual:
            words.append(f"--{name} {getattr(options, name)}")
    return " ".join([*words, "--leaderboard"])


@contextmanager
def _fleet(options: argparse.Namespace) -> Iterator[Fleet | None]:
    """What flies the episodes, while it is there. Raises `ClusterError`."""
    if not options.ray:
        yield None
        return
    with cluster.joined(options.address, options.threads) as ray:
        yield partial(cluster.fly_all, ray)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.scenarios is None:
        options.scenarios = list(SCENARIOS if options.leaderboard is None else SHOWN)
    try:
        configs = _configs(options)
        everybody = available(configs.values())
        options.policies = getattr(options, "policies", everybody)
        enlist(configs, options.policies)
        if options.address is not None and not options.ray:
            raise ValueError("argument --address: only with --ray")
        if options.leaderboard is not None:
            _check_readme(options.leaderboard)
            _prepare(options.leaderboard, ["LEADERBOARD.md"])
        _prepare(options.output, ["results.json", "results.md"])
    except ValueError as problem:
        parser.error(str(problem))
    try:
        with _fleet(options) as fleet:
            o = options
            result = evaluate(configs, o.policies, o.episodes, o.seed, o.threads, False, fleet)
    except cluster.Unreachable as problem:
        parser.error(str(problem))
    except cluster.ClusterError as problem:
        print(f"{parser.prog}: error: {problem}; nothing was written", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted: nothing was written", file=sys.stderr)
        return 130
    print(report.table(result))
    for remark in explanations(result):
        print(f"\n{remark}")
    try:
        _write(result, options, _command(options, everybody))
    except OSError as problem:
        print(f"{parser.prog}: error: {problem}; earlier results are kept", file=sys.stderr)
        return 1
    return 0


def _write(result: Report, options: argparse.Namespace, command: str) -> None:
    folder: Path = options.output
    write_text(folder / "results.json", report.to_json(result))
    write_text(folder / "results.md", "# Results\n\n" + report.markdown(result))
    print(f"\nwritten: {folder / 'results.json'}, {folder / 'results.md'}")
    if options.leaderboard is not None:
        readme = options.leaderboard / "README.md"
        write_text(options.leaderboard / "LEADERBOARD.md", leaderboard(result, command))
        text = with_extract(readme.read_text(encoding="utf-8"), report.extract(result))
        write_text(readme, text)
        print(f"written: {options.leaderboard / 'LEADERBOARD.md'}, {readme}")


if __name__ == "__main__":
    sys.exit(main())
