"""Random smooth trajectories: sines drawn from an episode's key, within bounds that hold always."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import cos, pi, sin, sqrt
from typing import Any, NamedTuple

from formation_env._jit import device
from formation_env.maths import rng
from formation_env.paths.references import SINES, Floats, evaluate
from formation_env.paths.tables import LARGEST, MOST_HARMONICS
from formation_env.validation.checks import integer, number, refuse, require

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


def checked_bounds(name: str, value: Any) -> RandomSmooth:
    """`value`, six numbers in order or by name, as bounds that can be drawn from.

    `variation` is below `speed`, so that the leader keeps moving and its curvature is bounded (II-C),
    and `climb` below `height`, so that it stays above the floor. Raises `ValueError` that names the
    bound after `name`, which is empty or ends in a point.
    """
    fields = RandomSmooth._fields
    if isinstance(value, Mapping):
        for key in value:
            require(key in fields, f"{name}{key}", value[key], "one of " + ", ".join(fields))
        value = [value.get(key) for key in fields]
    if not isinstance(value, (tuple, list)) or len(value) != len(fields):
        refuse(name.rstrip("."), value, "the six numbers " + ", ".join(fields))
    speed = number(f"{name}speed", value[0], 0.0, LARGEST)
    variation = number(f"{name}variation", value[1])
    below = f"from 0 to below the speed of {speed:g} m/s"
    require(0.0 <= variation < speed, f"{name}variation", variation, below)
    acceleration = number(f"{name}acceleration", value[2], 0.0, LARGEST)
    height = number(f"{name}height", value[3], 0.0, LARGEST)
    climb = number(f"{name}climb", value[4])
    below = f"from 0 to below the height of {height:g} m"
    require(0.0 <= climb < height, f"{name}climb", climb, below)
    harmonics = integer(f"{name}harmonics", value[5], 1, MOST_HARMONICS)
    bounds = RandomSmooth(speed, variation, acceleration, height, climb, harmonics)
    _check_reach(name, bounds)
    return bounds


def _check_reach(name: str, bounds: RandomSmooth) -> None:
    """Refuse bounds whose quotients leave the range of the numbers."""
    slowest = bounds.speed_min
    curved = slowest * slowest * LARGEST >= bounds.acceleration
    require(curved, f"{name}speed - variation", slowest, "a faster leader for that acceleration")
    swing = bounds.variation * bounds.variation <= 0.1 * LARGEST * bounds.acceleration
    require(
        swing, f"{name}acceleration", bounds.acceleration, "more for that variation of the speed"
    )


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


@partial(device, literal=False)
def _reach(table: Floats, axis: int, power: int) -> float:
    """`sum |amplitude| rate^power` of an axis: bound of its derivative of that order."""
    harmonics = int(table[0])
    total = 0.0
    for k in range(harmonics):
        i = 7 + 3 * (axis * harmonics + k)
        total += abs(table[i]) * table[i + 1] ** power
    return total


@partial(device, literal=False)
def _reach_norm(table: Floats, power: int) -> float:
    x, y, z = _reach(table, 0, power), _reach(table, 1, power), _reach(table, 2, power)
    return sqrt(x * x + y * y + z * z)


@partial(device, literal=False)
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
