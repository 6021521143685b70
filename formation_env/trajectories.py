"""Where the leader is asked to fly: the trajectories a user chooses from.

`figure_eight` (31), `lemniscate` (70), `circle`, `line`, `hover`, `random_smooth`; paths through
points and a user's own function or table are in `splines`. All have derivatives up to the fourth;
the mathematics is in `references`. Inertial frame (north, east, down): metres, seconds, radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, inf, pi, sin, sqrt
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from formation_env import rng
from formation_env._jit import device, kernel
from formation_env.checks import number, require, vector
from formation_env.references import (
    LEMNISCATE,
    SINES,
    SPLINE,
    Floats,
    Reference,
    evaluate,
    start_direction,
)

__all__ = [
    "LEMNISCATE",
    "SINES",
    "SPLINE",
    "RandomSmooth",
    "Reference",
    "Trajectory",
    "circle",
    "draw",
    "evaluate",
    "figure_eight",
    "hover",
    "lemniscate",
    "line",
    "random_smooth",
    "start_direction",
]


FASTEST = 4.0  # rad/s, of a random smooth trajectory: its jerk is at most this times acceleration


class RandomSmooth(NamedTuple):
    """Bounds of a random smooth trajectory; each holds for every draw and all times."""

    speed: float  # m/s, of the drift
    variation: float  # m/s, the speed stays within speed -+ variation
    acceleration: float  # m/s^2, bound of its norm
    height: float  # m
    climb: float  # m, the height stays within height -+ climb
    harmonics: int  # sines per axis

    @property
    def speed_min(self) -> float:
        """Least speed, in the plane as in space, m/s."""
        return self.speed - self.variation

    @property
    def speed_max(self) -> float:
        """Largest speed, m/s."""
        return self.speed + self.variation

    @property
    def acceleration_max(self) -> float:
        """Largest norm of the acceleration, m/s^2."""
        return self.acceleration

    @property
    def curvature_max(self) -> float:
        """Bound of the path's curvature in the plane, 1/m: `|v x a| / |v|^3 <= a / v_min^2`."""
        return self.acceleration / self.speed_min**2


@device
def _draw_axis(key: int, axis: int, fastest: float, bounds: Floats, table: Floats) -> None:
    """Sines with random rates and phases; each contributes speed (amplitude x rate) up to 1 m/s."""
    harmonics = int(bounds[5])
    for k in range(harmonics):
        a, b, c, _ = rng.uniforms(key, rng.TRAJECTORY, axis, k, 0)
        rate = fastest * (0.2 + 0.8 * a)
        i = 7 + 3 * (axis * harmonics + k)
        table[i] = b / rate
        table[i + 1] = rate
        table[i + 2] = 2.0 * pi * c


@device
def _reach(table: Floats, axis: int, power: int) -> float:
    """`sum |amplitude| rate^power` of an axis: bound of its derivative of that order."""
    harmonics = int(table[0])
    total = 0.0
    for k in range(harmonics):
        i = 7 + 3 * (axis * harmonics + k)
        total += abs(table[i]) * table[i + 1] ** power
    return total


@device
def _reach_norm(table: Floats, power: int) -> float:
    x, y, z = _reach(table, 0, power), _reach(table, 1, power), _reach(table, 2, power)
    return sqrt(x * x + y * y + z * z)


@device
def _shrink(table: Floats, axis: int, factor: float) -> None:
    harmonics = int(table[0])
    for k in range(harmonics):
        table[7 + 3 * (axis * harmonics + k)] *= factor


@device
def draw(key: int, bounds: Floats, table: Floats) -> None:
    """A random smooth trajectory for the episode `key` (64 bits), written into `table` (`SINES`).

    A drift in a random direction plus sines, scaled so that the sum of their amplitudes times their
    rates stays below `variation` and times the squared rates below `acceleration`, in the norm over
    the axes. Hence bounds that hold for all times, not only on average. It starts at
    `(0, 0, -height)`. `bounds` is a `RandomSmooth` as an array.
    """
    speed, variation, acceleration = bounds[0], bounds[1], bounds[2]
    height, climb = bounds[3], bounds[4]
    table[0] = bounds[5]
    # Rates up to twice the one at which both bounds are met together, so that either may bind.
    fastest = min(2.0 * acceleration / max(variation, 1e-9), FASTEST)
    for axis in range(3):
        _draw_axis(key, axis, fastest, bounds, table)
    factor = min(variation / _reach_norm(table, 1), acceleration / _reach_norm(table, 2))
    for axis in range(3):
        _shrink(table, axis, factor)
    # Half of `climb`, because the path starts at `height` wherever its sines begin.
    _shrink(table, 2, min(1.0, 0.5 * climb / max(_reach(table, 2, 0), 1e-12)))
    angle = 2.0 * pi * rng.uniforms(key, rng.TRAJECTORY, 3, 0, 0)[0]
    table[4], table[5], table[6] = speed * cos(angle), speed * sin(angle), 0.0
    table[1] = table[2] = table[3] = 0.0
    at_zero = evaluate(SINES, table, 0.0).p
    table[1], table[2], table[3] = -at_zero[0], -at_zero[1], -height - at_zero[2]


@kernel
def path_start(kind: int, table: Floats) -> tuple[complex, tuple[float, float, float]]:
    """`start_direction` and the first point, for Python: from the cache, as compiling takes seconds."""
    return start_direction(kind, table), evaluate(kind, table, 0.0).p


@kernel
def _draw_one(key: int, bounds: Floats, table: Floats) -> None:
    draw(key, bounds, table)


@kernel
def _sample(kind: int, table: Floats, times: Floats, out: Floats) -> None:
    for i in range(times.shape[0]):
        r = evaluate(kind, table, times[i])
        for axis in range(3):
            out[i, 0, axis] = r.p[axis]
            out[i, 1, axis] = r.v[axis]
            out[i, 2, axis] = r.a[axis]
            out[i, 3, axis] = r.j[axis]
            out[i, 4, axis] = r.s[axis]


@final
@dataclass(frozen=True, eq=False)
class Trajectory:
    """A trajectory of the leader. Compares, hashes and pickles by content.

    Made by the functions of this module and of `splines`; its table is read-only. `random` is set
    for a trajectory that is drawn anew each episode: it has no path of its own until `drawn`.
    """

    name: str
    kind: int
    table: Floats
    duration: float = inf  # s, after which it stands still
    random: RandomSmooth | None = None

    def __post_init__(self) -> None:
        table = np.array(self.table, dtype=np.float64)
        table.setflags(write=False)
        object.__setattr__(self, "table", table)

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

        Raises `ValueError` for times that are not finite and for a random trajectory, which has
        to be `drawn` first.
        """
        require(self.random is None, "trajectory", self.name, "a drawn one; call drawn(key)")
        times = np.asarray(t, dtype=np.float64)
        require(bool(np.isfinite(times).all()), "t", t, "finite times in seconds")
        out = np.empty((times.size, 5, 3))
        _sample(self.kind, self.table, times.ravel(), out)
        return out.reshape(*times.shape, 5, 3)

    def drawn(self, key: int) -> Trajectory:
        """The trajectory itself, or for a random one the path of the episode `key` (64 bits)."""
        if self.random is None:
            return self
        require(0 <= key < 2**64, "key", key, "an unsigned number of 64 bits")
        word: Any = np.uint64(key)
        table = np.empty_like(self.table)
        _draw_one(word, np.array(self.random, dtype=np.float64), table)
        return Trajectory(self.name, self.kind, table, self.duration)


def _sum_of_sines(
    name: str, centre: ArrayLike, drift: ArrayLike, waves: Sequence[tuple[float, float, float]]
) -> Trajectory:
    """A trajectory with one sine (amplitude, rate, phase) per axis."""
    return Trajectory(name, SINES, np.concatenate([[1.0], centre, drift, np.ravel(waves)]))


_STILL = (0.0, 0.0, 0.0)


def figure_eight(
    amplitude: tuple[float, float] = (2.0, 1.0), rate: float = 0.25, height: float = 1.5
) -> Trajectory:
    """(31): `[A cos(rate t), B sin(2 rate t), -height]`; amplitudes, height in m, rate in rad/s."""
    a, b = vector("amplitude", amplitude, 2)
    rate = number("rate", rate, 0.0)
    waves = [(a, rate, 0.5 * pi), (b, 2.0 * rate, 0.0), _STILL]
    return _sum_of_sines("figure-eight", (0.0, 0.0, -number("height", height, 0.0)), _STILL, waves)


def lemniscate(
    size: float = 1.5, speed: float = 0.5, height: float = 1.6, turn: float = 0.25 * pi
) -> Trajectory:
    """(70) as corrected: Bernoulli's lemniscate of half width `size` (m) at a constant speed (m/s).

    `turn` (rad) rotates it in the plane from north towards east, the paper's counter-clockwise
    (drawn with x to the right and y up). It starts at its tip, `size` from the centre.
    """
    a, V = number("size", size, 0.0), number("speed", speed, 0.0)
    h, angle = number("height", height, 0.0), number("turn", turn)
    return Trajectory("lemniscate", LEMNISCATE, np.array([a, V, h, cos(angle), sin(angle)]))


def circle(
    radius: float = 1.5,
    speed: float = 0.5,
    height: float = 1.5,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Trajectory:
    """A circle from its north point at a constant speed (m/s; positive: from north to east)."""
    r, V = number("radius", radius, 0.0), number("speed", speed)
    require(V != 0.0, "speed", speed, "a speed other than 0 (hover stands still)")
    x, y = vector("centre", centre, 2)
    waves = [(r, V / r, 0.5 * pi), (r, V / r, 0.0), _STILL]
    return _sum_of_sines("circle", (x, y, -number("height", height, 0.0)), _STILL, waves)


def line(
    velocity: tuple[float, float] = (0.5, 0.0),
    height: float = 1.5,
    start: tuple[float, float] = (0.0, 0.0),
) -> Trajectory:
    """A straight line at a constant height; planar velocity in m/s and start in m (north, east)."""
    (vx, vy), (x, y) = vector("velocity", velocity, 2), vector("start", start, 2)
    waves = [_STILL, _STILL, _STILL]
    return _sum_of_sines("line", (x, y, -number("height", height, 0.0)), (vx, vy, 0.0), waves)


def hover(position: tuple[float, float, float] = (0.0, 0.0, -1.5)) -> Trajectory:
    """A point, m, north-east-down, above the floor (`p_z < 0`)."""
    p = vector("position", position, 3)
    require(p[2] < 0.0, "position", position, "a point above the floor (p_z < 0)")
    return _sum_of_sines("hover", p, _STILL, [_STILL, _STILL, _STILL])


def random_smooth(
    speed: float = 1.5,
    variation: float = 0.75,
    acceleration: float = 1.0,
    height: float = 1.5,
    climb: float = 0.5,
    harmonics: int = 3,
) -> Trajectory:
    """A new smooth path each episode, within bounds that hold always; see `RandomSmooth`, `draw`.

    `variation` below `speed` keeps the leader moving, so that its curvature is bounded (II-C), and
    `climb` below `height` keeps it above the floor.
    """
    v0, limit, h = (
        number("speed", speed, 0.0),
        number("acceleration", acceleration, 0.0),
        number("height", height, 0.0),
    )
    dv, dh = number("variation", variation), number("climb", climb)
    require(0.0 <= dv < v0, "variation", variation, f"from 0 to below the speed {v0} m/s")
    require(0.0 <= dh < h, "climb", climb, f"from 0 to below the height {h} m")
    whole = isinstance(harmonics, (int, np.integer))
    require(whole and harmonics >= 1, "harmonics", harmonics, "a whole number from 1")
    bounds = RandomSmooth(v0, dv, limit, h, dh, int(harmonics))
    table = np.zeros(7 + 9 * bounds.harmonics)
    table[0], table[3] = harmonics, -h
    return Trajectory("random-smooth", SINES, table, inf, bounds)
