"""Fly policies and write what flew as one HTML file: `python -m baselines.replay`, or `formation-replay`."""

from __future__ import annotations

import argparse
import traceback
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

from baselines.files import SUFFIX
from baselines.own import PolicyError
from baselines.registry import METHODS, POLICIES
from baselines.replay import archive, table
from baselines.replay.episode import Episode
from baselines.replay.flights import Replay, fly_all
from baselines.scoring import tasks
from baselines.scoring.options import add_task, read_policies
from baselines.system import console
from baselines.system.arguments import Parser, reader, seconds, whole
from baselines.system.text import wrapped

EXAMPLES = """\
  formation-replay --policies expert,dagger --scenario swarm --seed 3
  formation-replay --policies mine.py:MyPolicy --action rates
  formation-replay --set followers=6 --set duration=20
  formation-replay --record flight.npz --csv flight.csv
      a flight of your own loop, recorded as `baselines.replay.Recorder` does
"""


def parser() -> Parser:
    """The options of the command, none of them read yet."""
    own = Parser(
        "formation-replay",
        "Fly policies on one scenario and seed, and write one HTML file that shows the flights side by side: "
        "in 3-D, with plots, without a server or any other file.",
        EXAMPLES,
    )
    add = own.add_argument
    add("--policies", type=reader(read_policies), metavar="NAMES",
        help=f"Policies to fly, separated by commas: {', '.join(POLICIES)}; learned ones that are shipped, "
        f"{', '.join(METHODS)}; paths of *{SUFFIX} files; your own code as module:Name or file.py:Name. "
        "(default: expert; with --record none)")  # fmt: skip
    add_task(own)
    add("--duration", type=seconds, metavar="S",
        help="Length of the episode in seconds. (default: the scenario's own)")  # fmt: skip
    add("--seed", type=whole(0, 2**32), default=0, metavar="N",
        help="Seed of the episode. (default: %(default)s)")  # fmt: skip
    add("--record", type=Path, action="append", default=[], metavar="FILE",
        help="Recorded episode (*.npz) to show, beside the policies if any are named; may be repeated. "
        "(default: none)")  # fmt: skip
    add("--output", type=Path, default=Path("replay.html"), metavar="FILE",
        help="HTML file to write. (default: %(default)s)")  # fmt: skip
    add("--save", type=Path, metavar="FILE",
        help="Also write the episode as a NumPy archive; of several each one's policy is added to the file's "
        "name. (default: not written)")  # fmt: skip
    add("--csv", type=Path, metavar="FILE",
        help="Also write the episode as a table, a row for each instant and vehicle; several as for --save. "
        "(default: not written)")  # fmt: skip
    return own


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    own = parser()
    given = own.parse_args(arguments)
    try:
        _check_files(given)
        episodes = _episodes(given)
    except ValueError as problem:
        own.error(str(problem))
    except PolicyError as problem:
        if problem.__cause__ is not None:
            console.complain("".join(traceback.format_exception(problem.__cause__)).rstrip())
        console.complain(f"{own.prog}: error: {problem}; nothing was written")
        return 1
    except KeyboardInterrupt:
        console.complain("interrupted: nothing was written")
        return 130
    try:
        written = _write(given, episodes)
    except OSError as problem:
        reason = problem.strerror or problem
        console.complain(f"{own.prog}: error: {problem.filename or given.output}: {reason}")
        return 1
    for episode in episodes:
        console.say(
            wrapped(f"{episode.policy}: score {episode.metrics['score']:.2f}, {episode.end()}")
        )
    console.say(wrapped(f"written: {', '.join(map(str, written))}"))
    return 0


def _check_files(given: argparse.Namespace) -> None:
    """Raises `ValueError` where one file would be written over another."""
    named = {"--output": given.output, "--save": given.save, "--csv": given.csv}
    for (one, path), (other, again) in combinations(named.items(), 2):
        if path is not None and again is not None and path.resolve() == again.resolve():
            raise ValueError(
                f"{one} and {other}: expected files of different names, both are {path}"
            )


def _episodes(given: argparse.Namespace) -> list[Episode]:
    """What is to be shown: recorded episodes, then the policies' flights.

    Raises `ValueError`, `PolicyError`.
    """
    recorded = [archive.read(path) for path in given.record]
    names = given.policies or ([] if recorded else ["expert"])
    if not names:
        return recorded
    found = tasks.tasks([given.scenario], (), given.settings, (), given.action, given.duration)
    (config,) = found.values()
    return recorded + fly_all({name: name for name in names}, config, given.seed)


def _write(given: argparse.Namespace, episodes: Sequence[Episode]) -> list[Path]:
    """The files asked for. Raises `OSError`."""
    for path in filter(None, (given.output, given.save, given.csv)):
        path.parent.mkdir(parents=True, exist_ok=True)
    written = [Replay(episodes).write(given.output)]
    for number, episode in enumerate(episodes):
        if given.save is not None:
            written.append(
                archive.write(episode, _named(given.save, archive.SUFFIX, episodes, number))
            )
        if given.csv is not None:
            written.append(table.write(episode, _named(given.csv, ".csv", episodes, number)))
    return written


def _named(path: Path, suffix: str, episodes: Sequence[Episode], number: int) -> Path:
    """The file for one of several episodes: `flight.npz`, or `flight-expert.npz` and so on."""
    if len(episodes) == 1:
        return path
    stem = path.name.removesuffix(suffix)
    kept = "".join(c if c.isalnum() or c in "-_." else "-" for c in episodes[number].policy)
    alike = [each.policy for each in episodes[:number]].count(episodes[number].policy)
    again = f"-{alike + 1}" if alike else ""
    return path.with_name(f"{stem}-{kept.strip('.')}{again}{suffix}")
