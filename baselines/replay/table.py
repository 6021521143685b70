"""A recorded episode as CSV: a row for every instant and vehicle.

`COLUMNS` says what they are. An entry that does not exist is empty: a leader has no slot, and at the last
instant nothing is commanded any more. Numbers are written so that reading them gives the same floats.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from baselines.replay.episode import Episode
from baselines.replay.lyapunov import NAMES
from baselines.system.reading import file_name
from baselines.system.writing import write_text


def _axes(name: str, unit: str, meaning: str, axes: str = "xyz") -> dict[str, tuple[str, str]]:
    return {f"{name}_{axis}": (unit, f"{meaning}, {axis}") for axis in axes}


# Unit and meaning of each column; `action_0` and so on follow, as many as the action level has.
COLUMNS: dict[str, tuple[str, str]] = {
    "time": ("s", "time since reset"),
    "vehicle": ("-", "`leader`, `follower_0`, `follower_1`, ..."),
    "started": ("-", "1 once the trigger (40) has fired, else 0"),
    **_axes("position", "m", "true position, inertial (north, east, down)"),
    **_axes("velocity", "m/s", "true velocity, inertial"),
    **_axes("attitude", "1", "true attitude, unit quaternion, body to inertial", "wxyz"),
    **_axes("angular_velocity", "rad/s", "true angular velocity, body"),
    **_axes("slot", "m", "where the follower should be, inertial"),
    "slot_error": ("m", "distance from the slot"),
    "reward": ("1", "of the tick that begins at this instant"),
    **{
        name: (unit, f"Lyapunov function {meaning}, as the paper's expert measures it")
        for name, unit, meaning in zip(
            NAMES,
            ("m^2", "m^2", "1", "1"),
            (
                "(8) of the planner",
                "(12) of the planner",
                "(63) of the tracker",
                "(66) of the tracker",
            ),
            strict=True,
        )
    },
}
ACTION = ("1", "entry of the action in [-1, 1] that is executed from this instant on")


def columns(episode: Episode) -> tuple[str, ...]:
    """The names of the columns, in order."""
    return (*COLUMNS, *(f"action_{i}" for i in range(episode.config.action_size)))


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
    listed = {**COLUMNS, "action_0, ...": ACTION}
    lines = [f"| `{name}` | {unit} | {meaning} |" for name, (unit, meaning) in listed.items()]
    return "\n".join(["| column | unit | meaning |", "|---|---|---|", *lines])
