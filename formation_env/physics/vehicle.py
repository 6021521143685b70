"""The quadrotor as a user describes it."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, final

from formation_env.maths.so3 import Vector
from formation_env.physics.quadrotor import GRAVITY, Airframe
from formation_env.validation.checks import Unit, boolean, number, require, vector

MOST_LIFT = 100.0  # of `thrust_max`, in weights


@final
@dataclass(frozen=True)
class Vehicle:
    """A quadrotor; the defaults are section III-C's, with limits of a vehicle of that size.

    `thrust_max` defaults to twice the weight, so that action 0 hovers. `limited=False` lets the
    actuators give anything, negative thrust included, as the paper's own simulations do.

    By itself another `mass` changes next to nothing: the default `thrust_max` follows it, actions are
    in shares of `thrust_max`, and the laws know the mass. For a vehicle whose mass differs from what a
    policy was trained or tuned for, fix `thrust_max` in N, the same for both masses: at 10 % more mass,
    `Vehicle(mass=0.11, thrust_max=1.962)`, action 0 gives 10 % too little thrust to hover. The leader is
    flown with the true mass always, followers by the policy alone.

    Every number is stored as a plain `float`. Raises `ValueError` naming the field if the mass is not
    from 1e-6 to 1e6 kg, an inertia not from 1e-12 to 1e9 kg m^2, the three not those of a rigid body,
    or `thrust_max` not above the weight and up to 100 weights. What a substep can follow is for the
    configuration to check, which knows it.
    """

    mass: Annotated[float, Unit("kg")] = 0.1
    inertia: Annotated[Vector, Unit("kg m^2")] = (1e-3, 1e-3, 2e-3)  # diagonal of J
    thrust_max: Annotated[float | None, Unit("N")] = None  # None: twice the weight
    moment_max: Annotated[Vector, Unit("N m")] = (0.05, 0.05, 0.02)  # per body axis
    rate_max: Annotated[Vector, Unit("rad/s")] = (10.0, 10.0, 5.0)  # per body axis
    rate_lag: Annotated[float, Unit("s")] = 0.05  # time constant of the onboard rate loop
    limited: bool = True

    def __post_init__(self) -> None:
        self._store("mass", number("vehicle.mass", self.mass, 1e-6, 1e6, strict=False))
        self._store("rate_lag", number("vehicle.rate_lag", self.rate_lag, 0.0, 1e6))
        least = {"inertia": 1e-12, "moment_max": 0.0, "rate_max": 0.0}
        for name, low in least.items():
            value = vector3(f"vehicle.{name}", getattr(self, name), low, 1e9, strict=low == 0.0)
            self._store(name, value)
        a, b, c = sorted(self.inertia)
        require(
            c <= (a + b) * (1.0 + 1e-9),
            "vehicle.inertia",
            self.inertia,
            "moments of inertia of a rigid body: none above the sum of the other two",
        )
        if self.thrust_max is not None:
            weight = self.mass * GRAVITY
            thrust = number("vehicle.thrust_max", self.thrust_max, weight, MOST_LIFT * weight)
            self._store("thrust_max", thrust)
        self._store("limited", boolean("vehicle.limited", self.limited))

    def _store(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    @property
    def full_thrust(self) -> float:
        """`thrust_max`, or twice the weight, N."""
        return 2.0 * self.mass * GRAVITY if self.thrust_max is None else self.thrust_max

    def airframe(self) -> Airframe:
        """The vehicle as the kernels take it."""
        if self.limited:
            limits = (0.0, self.full_thrust, self.moment_max, self.rate_max)
        else:
            limits = (-inf, inf, (inf, inf, inf), (inf, inf, inf))
        return Airframe(self.mass, self.inertia, *limits, self.rate_lag)


def vector3(
    name: str, value: Any, low: float = -inf, high: float = inf, *, strict: bool = True
) -> Vector:
    """Three finite numbers within bounds, as `checks.number` has them."""
    x, y, z = vector(name, value, 3, low, high, strict=strict).tolist()
    return (x, y, z)
