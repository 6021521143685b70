"""Learning curves as they are checked in: the log of a run, shortened, under the run's name.

`train/curves/{method}-{scenario}-{action}-{seed}.csv` begins with the command that made the run, as a
comment, and goes on as the `log.csv` of the run's folder (see `train.log.LogRow`).
"""

from __future__ import annotations

import re
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import NamedTuple

import numpy as np

from baselines.registry import METHODS
from formation_env import SCENARIOS
from formation_env.laws.levels import NAMES as LEVEL_NAMES
from train.log import HEADER, LogRow

LARGEST_COUNT = 60  # of rows in a curve
_COMMENT = "# "


class Key(NamedTuple):
    """The task and the method of a run."""

    scenario: str
    action: str  # level
    method: str


class Curve(NamedTuple):
    """The log of one run."""

    key: Key
    seed: int
    command: str  # empty if it is not known
    rows: tuple[LogRow, ...]  # at least one

    @property
    def name(self) -> str:
        """Name of its file."""
        return f"{self.key.method}-{self.key.scenario}-{self.key.action}-{self.seed}.csv"

    @property
    def best(self) -> LogRow:
        """The row with the best score, the first of equals."""
        return max(self.rows, key=lambda row: row.score)


def order(key: Key) -> tuple[int, int, int, str]:
    """Key for sorting by scenario, level and method, each in the order in which they are listed elsewhere."""
    place = METHODS.index(key.method) if key.method in METHODS else len(METHODS)
    return (
        list(SCENARIOS).index(key.scenario),
        list(LEVEL_NAMES).index(key.action),
        place,
        key.method,
    )


# -- reading --------------------------------------------------------------------------------------


def read_log(text: str) -> tuple[str, tuple[LogRow, ...]]:
    """The command in the first line, empty if there is none, and the rows.

    Raises `ValueError` naming the line that is wrong.
    """
    lines = text.splitlines()
    command = lines.pop(0).removeprefix(_COMMENT) if text.startswith(_COMMENT) else ""
    if not lines or lines[0] != HEADER.strip():
        raise ValueError(f"expected a log that begins with {HEADER.strip()}")
    rows = tuple(_row(line) for line in lines[1:])
    if not rows:
        raise ValueError("no evaluation in the log: expected at least one")
    if any(a.steps >= b.steps for a, b in pairwise(rows)):
        raise ValueError("steps do not grow from line to line")
    return command, rows


def _row(line: str) -> LogRow:
    words = line.split(",")
    if len(words) == len(LogRow._fields):
        steps, *figures, seed = words
        try:
            row = LogRow._make([int(steps), *map(float, figures), int(seed)])
        except ValueError:
            row = None
        if row is not None and all(map(isfinite, (row.steps, row.minutes, row.score))):
            return row
    raise ValueError(f"line {line!r}: expected {len(LogRow._fields)} numbers")


def read_curve(path: Path) -> Curve:
    """A curve from its file. Raises `ValueError` naming the file, `OSError`."""
    found = re.fullmatch(r"(.+)-(\w+)-(\w+)-(\d+)", path.stem, re.ASCII)
    if found is None or found[2] not in SCENARIOS or found[3] not in LEVEL_NAMES:
        raise ValueError(f"{path}: expected a name such as ppo-nominal-wrench-0.csv")
    try:
        command, rows = read_log(path.read_text(encoding="utf-8"))
    except ValueError as problem:
        raise ValueError(f"{path}: {problem}") from None
    return Curve(Key(found[2], found[3], found[1]), int(found[4]), command, rows)


# -- writing --------------------------------------------------------------------------------------


def thinned(rows: tuple[LogRow, ...], most: int = LARGEST_COUNT) -> tuple[LogRow, ...]:
    """At most `most` (three or more) of the rows, evenly, with the first, the last and the best."""
    if len(rows) <= most:
        return rows
    best = max(range(len(rows)), key=lambda i: rows[i].score)
    evenly = np.linspace(0, len(rows) - 1, most - 1).round().astype(int)
    return tuple(rows[i] for i in sorted({best, *evenly.tolist()}))


def to_text(curve: Curve) -> str:
    """The text of a curve's file, with as many digits as a figure needs."""
    return "".join(
        [
            f"{_COMMENT}{curve.command}\n" if curve.command else "",
            HEADER,
            *(
                f"{r.steps},{r.minutes:.2f},{r.score:.4f},{r.low:.4f},{r.high:.4f},"
                f"{r.mean_return:.4f},{r.slot_error:.4f},{r.failed:.3f},{r.seed}\n"
                for r in curve.rows
            ),
        ]
    )
