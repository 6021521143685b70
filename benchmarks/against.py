"""This checkout against another one, in turn: `python -m benchmarks.against CHECKOUT`, some minutes.

Two runs minutes apart cannot be compared on a machine that does other work too: what else runs there
changes a figure by a third. So the two checkouts take turns (this, other, other, this, ...), each turn a
process of its own, and what counts is the ratio of two neighbouring turns. Within a turn every point is
sampled several times and the least is kept: other work only ever adds time, so the least is nearest to
what the code itself costs, where a mean is a figure of the machine's load. Over the turns medians are
taken, because a turn may have had no quiet sample at all; the least and the greatest ratio show how far to
trust the median. A difference smaller than that spread is none: take more turns.

On a virtual machine of two cores with one of them busy, a checkout against itself gave medians from 0.986
to 1.038 in three turns; one first compile differed by a tenth between runs, so judge that by several
(`--compile 3`).

Both are timed by the same code, this checkout's `turn`, `steps` and `timing`, and each imports its own
package and keeps its own compiled kernels, in a temporary folder.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

from baselines.system.arguments import Parser, above_zero, seconds, whole
from baselines.system.console import command, complain, say
from baselines.system.writing import write_text
from benchmarks import startup
from benchmarks.timing import ratio
from formation_env.formations import MAX_FOLLOWERS

POINTS = (
    "gym.make",
    "pettingzoo",
    "vector-1",
    "vector-256",
    "vector-4096",
    "vector-65536",
    "expert-4096",
)
FIRST_COMPILE = "first compile"
SIDES = ("this", "other")
_NEEDED = ("formation_env/__init__.py", "baselines/__init__.py")
_MOST_WORLDS = 1_000_000

# Seconds a step of each point, one figure a turn.
Times = dict[str, list[float]]


class Failed(Exception):
    """A checkout's process failed; the message is one line."""


class Row(NamedTuple):
    """A point: seconds of each checkout (medians) and how many times faster this one is."""

    point: str
    this: float
    other: float
    speed: float  # median over the turns
    least: float
    greatest: float


def rows(this: Mapping[str, list[float]], other: Mapping[str, list[float]]) -> list[Row]:
    """One for each point, from the seconds of both, turn by turn."""
    made = []
    for point, own in this.items():
        speeds = [b / a for a, b in zip(own, other[point], strict=True)]
        speed = ratio(other[point], own)
        made.append(Row(point, median(own), median(other[point]), speed, min(speeds), max(speeds)))
    return made


def below(compared: Iterable[Row], least: float) -> list[str]:
    """Points whose median speed is below `least`."""
    return [row.point for row in compared if row.speed < least]


def _time(value: float) -> str:
    return f"{value:,.2f} s" if value >= 0.1 else f"{1e6 * value:,.1f} us"


def table(compared: Sequence[Row]) -> str:
    """The points under a header, then the worst one; at most 80 columns."""
    lines = [
        f"{'point':16}{'this':>13}{'other':>13}{'speed':>9}{'least':>9}{'greatest':>10}",
        *(
            f"{row.point:16}{_time(row.this):>13}{_time(row.other):>13}"
            f"{row.speed:>9.3f}{row.least:>9.3f}{row.greatest:>10.3f}"
            for row in compared
        ),
    ]
    worst = min(compared, key=lambda row: row.speed)
    lines += [
        "speed: time of the other / time of this, above 1 where this is faster",
        f"worst point: {worst.point}, {worst.speed:.3f} times as fast as the other",
    ]
    return "\n".join(lines)


def _points(text: str) -> list[str]:
    names = list(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        kind, _, worlds = name.partition("-")
        most = {"vector": _MOST_WORLDS, "expert": _MOST_WORLDS, "frame": MAX_FOLLOWERS}.get(kind, 0)
        whole_number = worlds.isascii() and worlds.isdigit()
        if name not in POINTS and not (whole_number and 1 <= int(worlds) <= most):
            raise argparse.ArgumentTypeError(
                f"{name!r}: expected gym.make, pettingzoo, vector-WORLDS, expert-WORLDS or "
                "frame-FOLLOWERS"
            )
    return names


def _checkout(text: str) -> Path:
    folder = Path(text).resolve()
    for needed in _NEEDED:
        if not (folder / needed).is_file():
            raise argparse.ArgumentTypeError(
                f"{text!r}: expected a checkout of this package, but it has no {needed}"
            )
    return folder


def _file(text: str) -> Path:
    path = Path(text)
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r}: expected a file in a folder that exists")
    return path


def parser() -> Parser:
    """The options of the command, none of them read yet."""
    own = Parser(
        "benchmarks.against",
        "Time this checkout against another one, in turn, and print the ratios. With the defaults: two "
        "compilations of about a minute each, then half a minute a turn.",
    )
    add = own.add_argument
    add("checkout", type=_checkout, metavar="CHECKOUT",
        help="Folder of the other checkout of this package. (required)")  # fmt: skip
    add("--turns", type=whole(1, 1000), default=5, metavar="N",
        help="Number of turns of each checkout. (default: %(default)s)")  # fmt: skip
    add("--points", type=_points, default=list(POINTS), metavar="NAMES",
        help="Points to time, separated by commas: gym.make and pettingzoo (one world), vector-WORLDS "
        "(random actions), expert-WORLDS (flown by the expert), frame-FOLLOWERS (pictures of one world). "
        f"(default: {', '.join(POINTS)})")  # fmt: skip
    add("--scenario", choices=("nominal", "paper"), default="nominal", metavar="NAME",
        help="Scenario that is flown, nominal or paper. (default: %(default)s)")  # fmt: skip
    add("--threads", type=whole(1, 1024), default=1, metavar="N",
        help="Number of threads of the vector environments. (default: %(default)s)")  # fmt: skip
    add("--compile", type=whole(0, 100), default=1, metavar="N",
        help="Number of times that the first step of gym.make is timed with an empty cache, about a "
        "minute for each checkout; once is needed anyway, and 0 only hides its time. "
        "(default: %(default)s)")  # fmt: skip
    add("--rounds", type=whole(1, 1000), default=15, metavar="N",
        help="Number of samples of a point in a turn, of which the least is kept. "
        "(default: %(default)s)")  # fmt: skip
    add("--seconds", type=seconds, default=0.05, metavar="S",
        help="Length of a sample in seconds. (default: %(default)s)")  # fmt: skip
    add("--least", type=above_zero("a ratio above 0"), metavar="RATIO",
        help="Exit with status 1 if the speed of a point is below this ratio. "
        "(default: none; status 0 whatever the ratios)")  # fmt: skip
    add("--output", type=_file, metavar="FILE",
        help="JSON file that the figures of every turn, in seconds, are also written to. "
        "(default: no file)")  # fmt: skip
    return own


def _turns(count: int) -> Iterable[tuple[str, str]]:
    """The order within each pair: this, other, other, this, this, ..."""
    return (SIDES if turn % 2 == 0 else SIDES[::-1] for turn in range(count))


def _failed(root: Path, problem: subprocess.CalledProcessError) -> Failed:
    lines = [line for line in problem.stderr.splitlines() if line.strip()]
    last = lines[-1] if lines else f"it ended with status {problem.returncode}"
    return Failed(f"a process of {root} failed: {last}")


def _compiled(roots: Mapping[str, Path], folder: Path, count: int) -> dict[str, list[float]]:
    """Seconds to the first step with an empty cache; the caches in `folder` are full afterwards."""
    taken: dict[str, list[float]] = {side: [] for side in SIDES}
    for turn, order in enumerate(_turns(count), 1):
        for side in order:
            complain(f"first compile {turn} of {count}: {side}")
            cache = folder / side
            shutil.rmtree(cache, ignore_errors=True)
            try:
                until = startup.until_first_step("gym.make", cache=cache, root=roots[side])
            except subprocess.CalledProcessError as problem:
                raise _failed(roots[side], problem) from None
            taken[side].append(until["gym.make"])
    return taken


def _turn(root: Path, folder: Path, cache: Path, request: str) -> dict[str, float]:
    """Seconds a step of each point of the checkout `root`, timed by the `benchmarks` in `folder`."""
    try:
        figures = startup.printed(
            startup.python("-m", "benchmarks.turn", request, path=[folder, root], cache=cache)
        )
    except subprocess.CalledProcessError as problem:
        raise _failed(root, problem) from None
    if root not in Path(figures["package"]).resolve().parents:
        raise Failed(f"a process of {root} imported {figures['package']} instead")
    return dict(figures["seconds"])


def measure(options: argparse.Namespace) -> dict[str, Times]:
    """Seconds of each checkout, point and turn. Raises `Failed`."""
    roots = {"this": startup.ROOT, "other": options.checkout}
    names = ("points", "scenario", "threads", "rounds", "seconds")
    request = json.dumps({name: getattr(options, name) for name in names})
    times: dict[str, Times] = {side: {point: [] for point in options.points} for side in SIDES}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        # A copy, so that the package beside it is not imported with it.
        shutil.copytree(Path(__file__).parent, folder / "benchmarks")
        compiled = _compiled(roots, folder, options.compile)
        for turn, order in enumerate(_turns(options.turns), 1):
            complain(f"turn {turn} of {options.turns}: {', '.join(order)}")
            for side in order:
                for point, value in _turn(roots[side], folder, folder / side, request).items():
                    times[side][point].append(value)
    if options.compile:
        for side in SIDES:
            times[side][FIRST_COMPILE] = compiled[side]
    return times


def _write(options: argparse.Namespace, times: dict[str, Times]) -> None:
    figures = {"scenario": options.scenario, "threads": options.threads, "seconds": times}
    write_text(options.output, json.dumps(figures, indent=1) + "\n")


@command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns 0, 1 if a point is below `--least`, or 2 if it failed."""
    options = parser().parse_args(arguments)
    status = 0
    try:
        times = measure(options)
    except Failed as problem:
        complain(f"error: {problem}")
        return 2
    compared = rows(times["this"], times["other"])
    if options.least is not None and (slow := below(compared, options.least)):
        complain(f"error: speed below {options.least:g}: {', '.join(slow)}")
        status = 1
    try:
        if options.output is not None:
            _write(options, times)
    except OSError as problem:
        complain(f"error: argument --output: {options.output}: {problem.strerror}")
        status = 2
    say(table(compared))
    return status


if __name__ == "__main__":
    sys.exit(main())
