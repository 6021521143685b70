"""A recorded episode as CSV: a row for every instant and vehicle, its columns in `COLUMNS`.

An entry that does not exist is empty: a leader has no slot, and at the last
instant nothing is commanded any more. Numbers are written so that reading them gives the same floats.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from baselines.replay.episode import Episode
from baselines.replay.lyapunov import NAMES
from baselines.system.reading import file_name
from baselines.system.writing import write_text


class Column(NamedTuple):
    """One column, or one for each axis."""

    unit: str
    meaning: str
    axes: str = ""


def _law(unit: str, meaning: str) -> Column:
    return Column(unit, f"Lyapunov function {meaning}, as the paper's expert measures it")


# All but the action's entries, `action_0` and so on, as many as the level has.
COLUMNS = {
    "time": Column("s", "time since reset"),
    "vehicle": Column("-", "`leader`, `follower_0`, `follower_1`, ..."),
    "started": Column("-", "1 once the trigger (40) has fired, else 0"),
    "position": Column("m", "true position, inertial (north, east, down)", "xyz"),
    "velocity": Column("m/s", "true velocity, inertial", "xyz"),
    "attitude": Column("1", "true attitude, unit quaternion, body to inertial", "wxyz"),
    "angular_velocity": Column("rad/s", "true angular velocity, body", "xyz"),
    "slot": Column("m", "where the follower should be, inertial", "xyz"),
    "slot_error": Column("m", "distance from the slot"),
    "reward": Column("1", "of the tick that begins at this instant"),
    "V1": _law("m^2", "(8) of the planner"),
    "V2": _law("m^2", "(12) of the planner"),
    "V3": _law("1", "(63) of the tracker"),
    "V4": _law("1", "(66) of the tracker"),
}
ACTION = Column("1", "entry of the action in [-1, 1] that is executed from this instant on")


def _names(name: str, column: Column) -> list[str]:
    return [f"{name}_{axis}" for axis in column.axes] or [name]


def columns(episode: Episode) -> tuple[str, ...]:
    """The names of the columns, in order."""
    fixed = (each for name, column in COLUMNS.items() for each in _names(name, column))
    return (*fixed, *(f"action_{i}" for i in range(episode.config.action_size)))


def rows(episode: Episode) -> Iterator[list[Any]]:
    """The rows, one list of entries each: by time, leader first."""
    e, empty = episode, ""
    errors, ticks, laws = e.errors, len(e.actions), len(e.lyapunov)
    for j, time in enumerate(e.time.tolist()):
        for i in range(e.config.followers + 1):
            own = i - 1  # the follower's number
            yield [
                time,
                "leader" if i == 0 else f"follower_{own}",
                int(e.started[j]),
                *e.positions[j, i].tolist(),
                *e.velocities[j, i].tolist(),
                *e.attitudes[j, i].tolist(),
                *e.angular_velocities[j, i].tolist(),
                *(e.slots[j, own].tolist() if i else [empty] * 3),
                float(errors[j, own]) if i else empty,
                float(e.rewards[j, own]) if i and j < ticks else empty,
                *(e.lyapunov[j, own].tolist() if i and j < laws else [empty] * len(NAMES)),
                *(e.actions[j, own].tolist() if i and j < ticks else [empty] * e.actions.shape[2]),
            ]


def write(episode: Episode, path: str | os.PathLike[str]) -> Path:
    """Write the table as CSV in UTF-8. Returns the file's path. Raises `OSError`."""
    file, text = Path(file_name(path)), io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns(episode))
    table.writerows(rows(episode))
    write_text(file, text.getvalue())
    return file


def described() -> str:
    """The columns as a Markdown table, for the manual."""
    lines = ["| column | unit | meaning |", "|---|---|---|"]
    for name, column in {**COLUMNS, "action_0, ...": ACTION}.items():
        names = ", ".join(f"`{each}`" for each in _names(name, column))
        lines.append(f"| {names} | {column.unit} | {column.meaning} |")
    return "\n".join(lines)
