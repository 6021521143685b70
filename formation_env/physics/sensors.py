"""What is measured of a vehicle: white noise, sampling, and section IV's estimator chain.

A measurement is taken at its own rate, delayed by a number of samples, and held until the next.
Two ways to know the velocities:

- direct: position, velocity, acceleration, attitude and angular velocity are all measured, each with
  white noise (section III-C);
- differenced: only position and attitude are; velocity and angular velocity are single differences,
  the acceleration a double difference smoothed by a moving average (section IV).
"""

from __future__ import annotations

from math import atan2, pi, sqrt
from typing import Annotated, NamedTuple

from formation_env._jit import device
from formation_env.maths.rng import MEASUREMENT, Four, normals
from formation_env.maths.so3 import (
    Quaternion,
    Vector,
    exponential,
    multiply,
    scale,
    sub,
)
from formation_env.physics.quadrotor import Airframe, Body, Wrench, acceleration
from formation_env.validation.checks import Within

# Bounds of what is observed: m, m; m/s, m/s^2 or rad/s; 1.
NEAR, ANYWHERE, RATE_BOUND, UNIT = 1e3, 1e4, 100.0, 1.0
# Noise above the bound of what is observed would leave nothing but the bound.
_OF_POINTS, _OF_RATES = Within(0.0, NEAR, unit="m"), Within(0.0, RATE_BOUND)


class Noise(NamedTuple):
    """Standard deviations of the white noise on each measured component."""

    position: Annotated[float, _OF_POINTS] = 0.0
    velocity: Annotated[float, _OF_RATES._replace(unit="m/s")] = 0.0
    acceleration: Annotated[float, _OF_RATES._replace(unit="m/s^2")] = 0.0
    # Of a small rotation vector, per axis.
    attitude: Annotated[float, Within(0.0, pi, unit="rad")] = 0.0
    angular_velocity: Annotated[float, _OF_RATES._replace(unit="rad/s")] = 0.0


class Measured(NamedTuple):
    """One measurement of a vehicle. Only this module makes one, so that a field can be added here."""

    p: Vector  # m, inertial
    v: Vector  # m/s, inertial
    a: Vector  # m/s^2, inertial
    q: Quaternion  # attitude, body to inertial
    w: Vector  # rad/s, body


class Sensed(NamedTuple):
    """What exact sensors read beside the state itself: the fields of `Measured` that `Body` has not."""

    a: Vector  # m/s^2, inertial


# Whether exact sensors are computed for followers: no observation holds a follower's acceleration, but with
# another sensor one may hold what that reads.
FOLLOWERS_SENSE = len(Sensed._fields) > 1


@device
def sensed(body: Body, a: Vector) -> Sensed:
    """What exact sensors read of a vehicle of acceleration `a` (m/s^2, inertial)."""
    return Sensed(a)


@device
def exact(body: Body, a: Vector) -> Measured:
    """The measurement by exact sensors of a vehicle of acceleration `a` (m/s^2, inertial)."""
    return Measured(body.p, body.v, a, body.q, body.w)


@device
def accelerating(
    body: Body, applied: Wrench, push: Vector, touching: bool, airframe: Airframe
) -> Vector:
    """The acceleration under the thrust now applied, m/s^2, inertial; none on the floor."""
    a = (0.0, 0.0, 0.0)
    if not touching:
        a = acceleration(body.q, applied.thrust, push, airframe)
    return a


@device
def truth(
    body: Body, applied: Wrench, push: Vector, touching: bool, airframe: Airframe
) -> Measured:
    """What exact sensors would read. The acceleration is the one under the thrust now applied."""
    return exact(body, accelerating(body, applied, push, touching, airframe))


@device
def silent(noise: Noise) -> bool:
    """Whether there is no noise at all."""
    return (
        noise.position == 0.0
        and noise.velocity == 0.0
        and noise.acceleration == 0.0
        and noise.attitude == 0.0
        and noise.angular_velocity == 0.0
    )


@device
def _perturb(a: Vector, deviation: float, x: float, y: float, z: float) -> Vector:
    return (a[0] + deviation * x, a[1] + deviation * y, a[2] + deviation * z)


@device
def perturb(truth: Measured, noise: Noise, n0: Four, n1: Four, n2: Four, n3: Four) -> Measured:
    """The truth with white Gaussian noise from standard normal numbers."""
    s = noise.attitude
    turn = exponential((s * n2[1], s * n2[2], s * n2[3]))
    return Measured(
        _perturb(truth.p, noise.position, n0[0], n0[1], n0[2]),
        _perturb(truth.v, noise.velocity, n0[3], n1[0], n1[1]),
        _perturb(truth.a, noise.acceleration, n1[2], n1[3], n2[0]),
        multiply(truth.q, turn),  # of unit quaternions: a unit quaternion to rounding
        _perturb(truth.w, noise.angular_velocity, n3[0], n3[1], n3[2]),
    )


@device
def corrupt(truth: Measured, noise: Noise, key: int, who: int, when: int) -> Measured:
    """The truth with white Gaussian noise; `who` is the vehicle, `when` the number of the sample."""
    return perturb(
        truth,
        noise,
        normals(key, MEASUREMENT, who, when, 0),
        normals(key, MEASUREMENT, who, when, 1),
        normals(key, MEASUREMENT, who, when, 2),
        normals(key, MEASUREMENT, who, when, 3),
    )


@device
def difference(now: Vector, before: Vector, period: float) -> Vector:
    """Single difference: the mean rate over one sampling period. It lags by half of it."""
    return scale(1.0 / period, sub(now, before))


@device
def angular_difference(now: Quaternion, before: Quaternion, period: float) -> Vector:
    """The constant angular velocity (rad/s, body) that turns `before` into `now` in one period."""
    w, x, y, z = multiply((before[0], -before[1], -before[2], -before[3]), now)
    if w < 0.0:  # the two signs of a quaternion are one attitude: take the short way
        w, x, y, z = -w, -x, -y, -z
    s = sqrt(x * x + y * y + z * z)
    # angle / sin(angle/2) tends to 2 where both vanish.
    gain = (2.0 if s < 1e-9 else 2.0 * atan2(s, w) / s) / period
    return (gain * x, gain * y, gain * z)


@device
def averaged_acceleration(v_now: Vector, v_then: Vector, window: int, period: float) -> Vector:
    """Moving average of the last `window` differences of velocity; m/s^2.

    The sum of differences telescopes: `mean_k (v_k - v_{k-1}) / h = (v_now - v_then) / (window h)` with
    `v_then` the velocity `window` samples ago. It is late by `window h / 2`, 1 s for section IV's 100
    samples at 50 Hz.
    """
    return scale(1.0 / (window * period), sub(v_now, v_then))


@device
def with_rates(raw: Measured, v: Vector, a: Vector, w: Vector) -> Measured:
    """A measurement whose velocities and acceleration are differenced."""
    return Measured(raw.p, v, a, raw.q, w)
