"""Where the leader is asked to fly: the trajectories a user chooses from.

`figure_eight` (31), `lemniscate` (70), `circle`, `line`, `hover`, `random_smooth`; paths through
points and a user's own function or table are in `splines`. All have derivatives up to the fourth;
the mathematics is in `references`. Inertial frame (north, east, down): metres, seconds, radians.

All raise `ValueError` naming the argument at fault. `as_trajectory` makes them from names and numbers.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from math import cos, inf, pi, sin
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from formation_env.paths.random_paths import FASTEST, RandomSmooth, checked_bounds, draw
from formation_env.paths.references import (
    LEMNISCATE,
    SINES,
    SPLINE,
    TrajectoryPoint,
    evaluate,
    start_direction,
)
from formation_env.paths.tables import ABOVE_FLOOR, LARGEST
from formation_env.paths.trajectory import Trajectory, path_start
from formation_env.splines import from_samples, waypoints
from formation_env.validation.checks import choice, number, refuse, require, shortened, vector

__all__ = [
    "FACTORIES",
    "FASTEST",
    "LEMNISCATE",
    "SINES",
    "SPLINE",
    "RandomSmooth",
    "Trajectory",
    "TrajectoryPoint",
    "as_trajectory",
    "circle",
    "draw",
    "evaluate",
    "figure_eight",
    "hover",
    "lemniscate",
    "line",
    "path_start",
    "random_smooth",
    "start_direction",
]


def _sum_of_sines(
    name: str, centre: ArrayLike, drift: ArrayLike, waves: Sequence[tuple[float, float, float]]
) -> Trajectory:
    """A trajectory with one sine (amplitude, rate, phase) per axis."""
    return Trajectory(name, SINES, np.concatenate([[1.0], centre, drift, np.ravel(waves)]))


def _above(name: str, value: Any) -> float:
    """A length, speed or rate above 0."""
    return number(name, value, 0.0, LARGEST)


def _either(name: str, value: Any) -> float:
    """A number of either sign."""
    return number(name, value, -LARGEST, LARGEST)


def _pair(name: str, value: Any) -> Any:
    """Two of them: north, east."""
    return vector(name, value, 2, -LARGEST, LARGEST)


_STILL = (0.0, 0.0, 0.0)


def figure_eight(
    amplitude: tuple[float, float] = (2.0, 1.0), rate: float = 0.25, height: float = 1.5
) -> Trajectory:
    """(31): `[A cos(rate t), B sin(2 rate t), -height]`; amplitudes, height in m, rate in rad/s."""
    a, b = _pair("amplitude", amplitude)
    rate = _above("rate", rate)
    waves = [(a, rate, 0.5 * pi), (b, 2.0 * rate, 0.0), _STILL]
    return _sum_of_sines("figure-eight", (0.0, 0.0, -_above("height", height)), _STILL, waves)


def lemniscate(
    size: float = 1.5, speed: float = 0.5, height: float = 1.6, turn: float = 0.25 * pi
) -> Trajectory:
    """(70) as corrected: Bernoulli's lemniscate of half width `size` (m) at a constant speed (m/s).

    `turn` (rad) rotates it in the plane from north towards east, the paper's counter-clockwise
    (drawn with x to the right and y up). It starts at its tip, `size` from the centre.
    """
    a, V = _above("size", size), _above("speed", speed)
    h, angle = _above("height", height), _either("turn", turn)
    _above("speed / size", V / a)
    return Trajectory("lemniscate", LEMNISCATE, np.array([a, V, h, cos(angle), sin(angle)]))


def circle(
    radius: float = 1.5,
    speed: float = 0.5,
    height: float = 1.5,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Trajectory:
    """A circle from its north point at a constant speed (m/s; positive: from north to east)."""
    r, V = _above("radius", radius), _either("speed", speed)
    require(V != 0.0, "speed", speed, "a speed other than 0 (hover stands still)")
    x, y = _pair("centre", centre)
    rate = _either("speed / radius", V / r)
    waves = [(r, rate, 0.5 * pi), (r, rate, 0.0), _STILL]
    return _sum_of_sines("circle", (x, y, -_above("height", height)), _STILL, waves)


def line(
    velocity: tuple[float, float] = (0.5, 0.0),
    height: float = 1.5,
    start: tuple[float, float] = (0.0, 0.0),
) -> Trajectory:
    """A straight line at a constant height; planar velocity in m/s and start in m (north, east)."""
    (vx, vy), (x, y) = _pair("velocity", velocity), _pair("start", start)
    waves = [_STILL, _STILL, _STILL]
    return _sum_of_sines("line", (x, y, -_above("height", height)), (vx, vy, 0.0), waves)


def hover(position: tuple[float, float, float] = (0.0, 0.0, -1.5)) -> Trajectory:
    """A point, m, north-east-down, above the floor (`p_z < 0`)."""
    p = vector("position", position, 3, -LARGEST, LARGEST)
    require(p[2] < 0.0, "position", position, ABOVE_FLOOR)
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
    given = (speed, variation, acceleration, height, climb, harmonics)
    bounds = checked_bounds("", given)
    table = np.zeros(7 + 9 * bounds.harmonics)
    table[0], table[3] = bounds.harmonics, -bounds.height
    return Trajectory("random-smooth", SINES, table, inf, bounds)


FACTORIES: dict[str, Callable[..., Trajectory]] = {
    maker.__name__: maker
    for maker in (
        *(figure_eight, lemniscate, circle, line, hover, random_smooth),
        *(waypoints, from_samples),
    )
}


def as_trajectory(name: str, value: Any) -> Trajectory:
    """`value` as a trajectory: one, or what describes one in numbers, lists and names.

    - `"circle"`: one of `FACTORIES` by name, with its defaults;
    - `{"path": "circle", "radius": 2.0}`: the same with arguments;
    - `{"name": ..., "kind": ..., "table": ...}`: what `Trajectory.to_dict` gives.

    `name` is what messages call it. Raises `ValueError` for anything else, naming the argument.
    """
    if isinstance(value, Trajectory):
        return value
    if isinstance(value, str):
        value = {"path": value}
    if not isinstance(value, Mapping) or not {"path", "kind"} & set(value):
        known = ", ".join(map(repr, FACTORIES))
        refuse(name, value, f"a Trajectory, one of {known}, or a dictionary with 'path' or 'kind'")
    try:
        return _made(value) if "path" in value else Trajectory.from_dict(value)
    except ValueError as error:
        raise ValueError(shortened(f"{name}.{error}")) from None


def _made(value: Mapping[str, Any]) -> Trajectory:
    """The trajectory of a factory's name, at `path`, and its arguments."""
    path = choice("path", value["path"], FACTORIES)
    given = {key: item for key, item in value.items() if key != "path"}
    known = inspect.signature(FACTORIES[path]).parameters
    for key in given:
        require(key in known, str(key), given[key], f"one of {path}'s {', '.join(known)}")
    for key, parameter in known.items():
        if parameter.default is parameter.empty:
            require(key in given, key, None, f"an argument of {path}")
    return FACTORIES[path](**given)
