"""The quadrotor as a user describes it."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any, final

from formation_env.checks import number, require, vector
from formation_env.quadrotor import GRAVITY, Airframe
from formation_env.so3 import Vector


@final
@dataclass(frozen=True)
class Vehicle:
    """A quadrotor; the defaults are section III-C's, with limits of a vehicle of that size.

    `thrust_max` defaults to twice the weight, so that action 0 hovers. `limited=False` lets the
    actuators give anything, negative thrust included, as the paper's own simulations do.
    """

    mass: float = 0.1  # kg
    inertia: Vector = (1e-3, 1e-3, 2e-3)  # kg m^2, diagonal of J
    thrust_max: float | None = None  # N; None: twice the weight
    moment_max: Vector = (0.05, 0.05, 0.02)  # N m, per body axis
    rate_max: Vector = (10.0, 10.0, 5.0)  # rad/s, per body axis
    rate_lag: float = 0.05  # s, time constant of the onboard rate loop
    limited: bool = True

    def __post_init__(self) -> None:
        number("vehicle.mass", self.mass, 0.0)
        number("vehicle.rate_lag", self.rate_lag, 0.0)
        for name in ("inertia", "moment_max", "rate_max"):
            object.__setattr__(self, name, vector3(f"vehicle.{name}", getattr(self, name), 0.0))
        a, b, c = sorted(self.inertia)
        require(
            c <= (a + b) * (1.0 + 1e-9),
            "vehicle.inertia",
            self.inertia,
            "moments of inertia of a rigid body: none above the sum of the other two",
        )
        if self.thrust_max is not None:
            number("vehicle.thrust_max", self.thrust_max, self.mass * GRAVITY)
        require(isinstance(self.limited, bool), "vehicle.limited", self.limited, "True or False")

    @property
    def full_thrust(self) -> float:
        """`thrust_max`, or twice the weight, N."""
        return float(2.0 * self.mass * GRAVITY if self.thrust_max is None else self.thrust_max)

    def airframe(self) -> Airframe:
        """The vehicle as the kernels take it."""
        if self.limited:
            limits = (0.0, self.full_thrust, self.moment_max, self.rate_max)
        else:
            limits = (-inf, inf, (inf, inf, inf), (inf, inf, inf))
        return Airframe(float(self.mass), self.inertia, *limits, float(self.rate_lag))


def vector3(name: str, value: Any, low: float = -inf) -> Vector:
    """Three finite numbers above `low`."""
    x, y, z = (number(name, float(v), low) for v in vector(name, value, 3))
    return (x, y, z)
