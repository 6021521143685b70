"""A trajectory of the leader as an object: checked, compared by content, with a JSON form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from formation_env._compiling import announced
from formation_env._jit import kernel
from formation_env.maths.so3 import Vector
from formation_env.memory.records import line_storer, size
from formation_env.memory.shuffles import carve
from formation_env.paths import tables
from formation_env.paths.random_paths import RandomSmooth, checked_bounds, draw
from formation_env.paths.references import (
    FAMILIES,
    SINES,
    Floats,
    TrajectoryPoint,
    evaluate,
    start_direction,
)
from formation_env.paths.tables import KINDS, LARGEST
from formation_env.validation.checks import array, integer, number, refuse, require, shown

_NAMES = {number: name for name, number in KINDS.items()}
_write = line_storer(TrajectoryPoint)
_FIELDS = ("name", "kind", "table", "duration", "random")


@kernel
def _draw_one(key: int, bounds: Floats, table: Floats) -> None:
    draw(key, bounds, table)


@announced("the paths")
@kernel
def _sample(kind: int, table: Floats, times: Floats, rows: Floats) -> complex:
    """Fill `rows`, `(N, size(TrajectoryPoint))`, with the path at `times`; its direction at the start.

    The one kernel that Python asks about a path: each takes about half a second to compile.
    """
    table = carve(table, 0, (len(table),))
    for i in range(times.shape[0]):
        _write(rows[i], evaluate(kind, table, times[i]))
    return start_direction(kind, table, 0.0)


def sample(kind: int, table: Floats, times: Floats) -> Floats:
    """The path of a table at `times` (s, `(N,)`): `(N, 15)`, position and four derivatives, unchecked."""
    rows = np.empty((len(times), size(TrajectoryPoint)))
    _sample(kind, table, times, rows)
    return rows


def path_start(kind: int, table: Floats) -> tuple[complex, Vector]:
    """`start_direction` and the first point, m."""
    rows = np.empty((1, size(TrajectoryPoint)))
    direction = _sample(kind, table, np.zeros(1), rows)
    x, y, z = rows[0, :3].tolist()
    return direction, (x, y, z)


@final
@dataclass(frozen=True, eq=False)
class Trajectory:
    """A trajectory of the leader. Compares, hashes and pickles by content.

    Made by the functions of `trajectories` and of `splines`; its table is read-only. `random` is set
    for a trajectory that is drawn anew each episode: it has no path of its own until `drawn`.

    Checked when it is made, from a pickle too: raises `ValueError` naming the field for an unknown
    `kind`, a `table` that is not what `references` says of that kind, a path that does not stay
    finite (`tables.LARGEST`), or bounds in `random` that cannot be drawn from.
    """

    name: str
    kind: int  # SINES, LEMNISCATE or SPLINE; by name as well
    table: Floats
    duration: float = inf  # s, after which it stands still
    random: RandomSmooth | None = None

    def __post_init__(self) -> None:
        short = isinstance(self.name, str) and len(self.name) <= 64
        require(short, "name", self.name, "the trajectory's name, of at most 64 characters")
        kind = tables.checked_kind("kind", self.kind)
        table = tables.checked("table", kind, self.table)
        tables.require_finite(shown(self.name), kind, table)
        # Over bytes, which nothing can be made to write into: kernels read it without looking again.
        table = np.frombuffer(table.tobytes())
        endless = isinstance(self.duration, (float, np.floating)) and self.duration == inf
        duration = inf if endless else number("duration", self.duration, 0.0)
        random = None if self.random is None else checked_bounds("random.", self.random)
        if random is not None:
            fits = kind == SINES and int(table[0]) == random.harmonics
            expected = f"those of the table, of kind {SINES}"
            require(fits, "random.harmonics", random.harmonics, expected)
        for field, value in zip(_FIELDS, (self.name, kind, table, duration, random), strict=True):
            object.__setattr__(self, field, value)

    def to_dict(self) -> dict[str, Any]:
        """The trajectory in numbers, lists and names that JSON has; `from_dict` gives it back exactly.

        `duration` is None where the path never ends.
        """
        return {
            "name": self.name,
            "kind": _NAMES[self.kind],
            "table": self.table.tolist(),
            "duration": None if self.duration == inf else self.duration,
            "random": None if self.random is None else self.random._asdict(),
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Trajectory:
        """The trajectory that `to_dict` described; `duration` and `random` may be left out.

        Raises `ValueError` for an entry that is missing, unknown or not what `Trajectory` takes.
        """
        if not isinstance(data, Mapping):
            refuse("data", data, "what to_dict gives")
        for name in data:
            require(name in _FIELDS, f"{name}", data[name], "one of " + ", ".join(_FIELDS))
        for name in _FIELDS[:3]:
            require(name in data, name, None, "an entry of a trajectory's dictionary")
        given = dict(data)
        if given.get("duration") is None:
            given["duration"] = inf
        return Trajectory(**given)

    @property
    def period(self) -> float:
        """Seconds after which the path repeats itself; infinite where it does not, ends, or is drawn."""
        endless = self.random is None and self.duration == inf
        return FAMILIES[self.kind].period(self.table) if endless else inf

    def _content(self) -> tuple[Any, ...]:
        return (self.name, self.kind, self.duration, self.random, self.table.tobytes())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Trajectory) and self._content() == other._content()

    def __hash__(self) -> int:
        return hash(self._content())

    def __reduce__(self) -> tuple[Any, ...]:
        # NumPy's own pickle would give back a writable table.
        return (Trajectory, (self.name, self.kind, self.table, self.duration, self.random))

    def __call__(self, t: ArrayLike) -> Floats:
        """Position and its derivatives up to the fourth at `t` (s, any shape): `(..., 5, 3)`.

        Raises `ValueError` for times that are not finite or beyond `tables.LARGEST`, and for a random
        trajectory, which has to be `drawn` first.
        """
        require(self.random is None, "trajectory", self.name, "a drawn one; call drawn(key)")
        times = array("t", t, None, -LARGEST, LARGEST, strict=False)
        return sample(self.kind, self.table, times.ravel()).reshape(*times.shape, 5, 3)

    def drawn(self, key: int) -> Trajectory:
        """The trajectory itself, or for a random one the path of the episode `key` (64 bits)."""
        whole = integer("key", key, 0, 2**64 - 1)
        if self.random is None:
            return self
        word: Any = np.uint64(whole)
        table = np.empty_like(self.table)
        _draw_one(word, np.array(self.random, dtype=np.float64), table)
        return Trajectory(self.name, self.kind, table, self.duration)
