"""The quadrotor (41)-(47): a rigid body pushed by a thrust along `-r3` and turned by a moment.

    p_dot = v                                   (42), v kept in the inertial frame
    v_dot = g k - (T/m) r3                      (43) with (45)
    R_dot = R S(omega)                          (41)
    omega_dot = J^-1 (m_ext - omega x J omega)  (44)

North-east-down: `z` points down, gravity is `+g k`, the floor is `p_z = 0`, a flying vehicle has
`p_z < 0`. The paper's `v` is in the body frame and its errors use `R v`; here `v` is `R v` from the
start. Attitude is a unit quaternion, normalised after every substep, which keeps `R` on the group
to rounding for any length of flight.

The body can be turned in two ways. In `MOMENT` actuation the command is a moment (46). In `RATES`
actuation, the paper's experiment, it is an angular velocity that an onboard loop follows with a
first-order lag, `omega_dot = (omega_c - omega) / rate_lag`.
"""

from __future__ import annotations

from typing import NamedTuple

from formation_env._jit import device
from formation_env.maths.runge_kutta import runge_kutta
from formation_env.maths.so3 import (
    ZERO,
    Quaternion,
    Vector,
    add_scaled,
    cross,
    level,
    normalise,
    pick,
    pick_vector,
    rotation,
    times,
)

GRAVITY = 9.81  # m/s^2

MOMENT, RATES = 0, 1  # actuation


class Airframe(NamedTuple):
    """What a vehicle is and can do. The limits may be `inf`."""

    mass: float  # kg
    inertia: Vector  # diagonal of J, kg m^2
    thrust_min: float  # N; 0 for a real rotor, -inf for the paper's own figures
    thrust_max: float  # N
    moment_max: Vector  # N m, per body axis
    rate_max: Vector  # rad/s, per body axis
    rate_lag: float  # s, time constant of the onboard rate loop


class Body(NamedTuple):
    """State of one vehicle."""

    p: Vector  # position, m, inertial
    v: Vector  # velocity, m/s, inertial
    q: Quaternion  # attitude, body to inertial
    w: Vector  # angular velocity omega, rad/s, body


class Wrench(NamedTuple):
    """What the actuators are asked for: a thrust, and a moment or an angular velocity."""

    thrust: float  # N, along -r3
    turn: Vector  # N m in MOMENT, rad/s in RATES actuation, body


class Contact(NamedTuple):
    """What touching the floor did to a vehicle."""

    touching: bool
    speed: float  # downward speed at touch-down, m/s; 0 in the air
    uprightness: float  # r3 . k at touch-down: 1 level, 0 on its side, -1 upside down


@device
def clip(x: float, low: float, high: float) -> float:
    return min(max(x, low), high)


@device
def clip_each(a: Vector, limit: Vector) -> Vector:
    return (
        clip(a[0], -limit[0], limit[0]),
        clip(a[1], -limit[1], limit[1]),
        clip(a[2], -limit[2], limit[2]),
    )


@device
def saturate(command: Wrench, actuation: int, airframe: Airframe) -> Wrench:
    """What the actuators can deliver of `command`."""
    limit = airframe.moment_max if actuation == MOMENT else airframe.rate_max
    return Wrench(
        clip(command.thrust, airframe.thrust_min, airframe.thrust_max),
        clip_each(command.turn, limit),
    )


@device
def moment(torque: Vector, w: Vector, inertia: Vector) -> Vector:
    """Input transformation (46), `m_ext = J tau + S(omega) J omega`, which makes `omega_dot = tau` (47)."""
    return add_scaled(times(inertia, torque), 1.0, cross(w, times(inertia, w)))


@device
def angular_acceleration(w: Vector, turn: Vector, actuation: int, airframe: Airframe) -> Vector:
    """Euler's equation (44), or the rate loop; rad/s^2, body."""
    if actuation == MOMENT:
        J = airframe.inertia
        gyroscopic = cross(w, times(J, w))
        return (
            (turn[0] - gyroscopic[0]) / J[0],
            (turn[1] - gyroscopic[1]) / J[1],
            (turn[2] - gyroscopic[2]) / J[2],
        )
    rate = 1.0 / airframe.rate_lag
    return (rate * (turn[0] - w[0]), rate * (turn[1] - w[1]), rate * (turn[2] - w[2]))


@device
def acceleration(q: Quaternion, thrust: float, push: Vector, airframe: Airframe) -> Vector:
    """`g k - (T/m) r3 + push` (43), (45); m/s^2, inertial."""
    a = thrust / airframe.mass
    r3 = rotation(q)[2]
    return (push[0] - a * r3[0], push[1] - a * r3[1], push[2] + GRAVITY - a * r3[2])


@device
def derivative(
    body: Body, applied: Wrench, push: Vector, actuation: int, airframe: Airframe
) -> Body:
    """Time derivative of the state (41)-(44).

    `push` is an acceleration from outside (a gust), m/s^2, inertial. The quaternion's derivative is
    `q_dot = q (0, omega) / 2`, which is (41).
    """
    w = body.w
    qw, qx, qy, qz = body.q
    return Body(
        body.v,
        acceleration(body.q, applied.thrust, push, airframe),
        (
            0.5 * (-qx * w[0] - qy * w[1] - qz * w[2]),
            0.5 * (qw * w[0] + qy * w[2] - qz * w[1]),
            0.5 * (qw * w[1] + qz * w[0] - qx * w[2]),
            0.5 * (qw * w[2] + qx * w[1] - qy * w[0]),
        ),
        angular_acceleration(w, applied.turn, actuation, airframe),
    )


_step = runge_kutta(derivative, Body)


@device
def fly(
    body: Body, applied: Wrench, push: Vector, h: float, actuation: int, airframe: Airframe
) -> Body:
    """The vehicle `h` seconds later, the actuators held: a Runge-Kutta step, its quaternion normalised."""
    after = _step(body, h, applied, applied, applied, push, actuation, airframe)
    return Body(after.p, after.v, normalise(after.q), after.w)


@device
def touch_floor(body: Body, before: Body) -> tuple[Body, Contact]:
    """Keep the vehicle above the floor: an inelastic contact with feet that do not slide.

    A vehicle found below `p_z = 0` is put on it, at rest and level, where and with the yaw that it
    had a substep `before`: then neither a moment nor a gust can make it creep. A resting vehicle is
    one that this happens to after every substep, with a touch-down speed of at most `g h`; it takes
    off as soon as its thrust exceeds its weight. Whether a touch-down was a crash is for the task to
    say, from the speed and uprightness reported.
    """
    r3z = 1.0 - 2.0 * (body.q[1] * body.q[1] + body.q[2] * body.q[2])
    below = (body.p[2] > 0.0) | ((body.p[2] == 0.0) & (body.v[2] >= 0.0))
    rest = Body((before.p[0], before.p[1], 0.0), ZERO, level(before.q), ZERO)
    kept = Body(
        pick_vector(below, rest.p, body.p),
        pick_vector(below, rest.v, body.v),
        (
            pick(below, rest.q[0], body.q[0]),
            pick(below, rest.q[1], body.q[1]),
            pick(below, rest.q[2], body.q[2]),
            pick(below, rest.q[3], body.q[3]),
        ),
        pick_vector(below, rest.w, body.w),
    )
    return kept, Contact(below, pick(below, max(body.v[2], 0.0), 0.0), r3z)
