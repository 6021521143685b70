"""The backstepping tracker of section III-B: thrust and torque that fly a quadrotor along a trajectory.

    e1 = p - p_d                                                       (48)
    e2 = v - p_d_dot                                                   (49), v inertial
    e3 = r3 - r3d                                                      (62)
    e4 = S(k)(omega - R^T S(r3d) r3d_dot)
         - S(k)^2 R^T (k3 r3d + (T_d/m) delta)                         (65)

The time derivatives in the torque law (67) are closed-form: the errors' own derivatives follow from
the model under the thrust law (54), the reference's from its first four derivatives.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from formation_env._jit import device
from formation_env.maths.so3 import (
    Rotation,
    Vector,
    add,
    add_scaled,
    cross,
    dot,
    norm,
    scale,
    sub,
    times,
    to_body,
    to_inertial,
)
from formation_env.paths.references import TrajectoryPoint
from formation_env.physics.quadrotor import GRAVITY


class TrackerLaw(NamedTuple):
    """Gains of the tracker, as the kernels take them (`TrackerGains` checks them first)."""

    k1: float
    k2: float
    k3: float
    k4: float
    kz: float
    sigma_max: float  # m/s^2, level of the saturation (50)
    c: float  # its softness: the slope at zero is sigma_max / sqrt(c)
    p11: float
    p12: float
    p22: float


class Motion(NamedTuple):
    """What the tracker measures of the vehicle it flies."""

    p: Vector  # m, inertial
    v: Vector  # m/s, inertial
    R: Rotation  # columns r1, r2, r3
    w: Vector  # omega, rad/s, body


class Outer(NamedTuple):
    """The position loop: errors, saturation and wanted thrust vector, with their time derivatives.

    `b = g k - p_d_ddot + sigma_e`, so `T_d = m |b|` (51) and `r3d = b / |b|` (52).
    """

    e1: Vector  # m
    e2: Vector  # m/s
    e2_dot: Vector
    sigma: Vector  # (50), m/s^2
    sigma_dot: Vector
    b: Vector  # m/s^2
    b_dot: Vector
    b_ddot: Vector
    delta: Vector  # (58)
    delta_dot: Vector


class Pointing(NamedTuple):
    """The wanted thrust direction and what the attitude loop needs of it, body axes for A and B."""

    n: float  # T_d / m, m/s^2
    r3d: Vector
    A: Vector  # R^T S(r3d) r3d_dot, rad/s
    A_dot: Vector
    B: Vector  # R^T (k3 r3d + (T_d/m) delta), rad/s
    B_dot: Vector


class TrackerErrors(NamedTuple):
    """(48), (49), (62), (65)."""

    e1: Vector
    e2: Vector
    e3: Vector
    e4: Vector


class Torque(NamedTuple):
    """Output of the tracker: thrust (54) and angular acceleration (67)-(68)."""

    thrust: float  # N, along -r3; negative while upside down
    tau: Vector  # rad/s^2, body; (46) turns it into a moment


class RateCommand(NamedTuple):
    """Output of the variant for thrust-and-rates actuation."""

    thrust: float  # N
    w: Vector  # rad/s, body


@device
def saturation(x: Vector, law: TrackerLaw) -> Vector:
    """`sigma_e(x) = sigma_max x / sqrt(c + x^2)`, element by element (50)."""
    s, c = law.sigma_max, law.c
    return (
        s * x[0] / sqrt(c + x[0] * x[0]),
        s * x[1] / sqrt(c + x[1] * x[1]),
        s * x[2] / sqrt(c + x[2] * x[2]),
    )


@device
def _slope(x: float, law: TrackerLaw) -> float:
    root = sqrt(law.c + x * x)
    return law.sigma_max * law.c / (root * root * root)


@device
def saturation_slope(x: Vector, law: TrackerLaw) -> Vector:
    """`sigma_e'`, the diagonal: `sigma_max c / (c + x^2)^(3/2)`."""
    return (_slope(x[0], law), _slope(x[1], law), _slope(x[2], law))


@device
def _curvature(x: float, law: TrackerLaw) -> float:
    return -3.0 * x / (law.c + x * x) * _slope(x, law)


@device
def saturation_curvature(x: Vector, law: TrackerLaw) -> Vector:
    """`sigma_e''`, element by element: `-3 x sigma_e' / (c + x^2)`."""
    return (_curvature(x[0], law), _curvature(x[1], law), _curvature(x[2], law))


@device
def outer(m: Motion, ref: TrajectoryPoint, law: TrackerLaw) -> Outer:
    """The position loop (48)-(52), (58) along the model's motion under the thrust law (54).

    With `x = k1 e1 + k2 e2` and the thrust `T/m = b . r3`:

        e2_dot  = b - sigma_e - (b . r3) r3
        e2_ddot = b_dot - sigma_e_dot - (b . r3)_dot r3 - (b . r3) r3_dot,   r3_dot = R S(omega) k

    so nothing is differenced numerically.
    """
    k1, k2, r3 = law.k1, law.k2, m.R[2]
    e1, e2 = sub(m.p, ref.p), sub(m.v, ref.v)
    x = add_scaled(scale(k1, e1), k2, e2)
    s, s1, s2 = saturation(x, law), saturation_slope(x, law), saturation_curvature(x, law)
    b = add((-ref.a[0], -ref.a[1], GRAVITY - ref.a[2]), s)
    lift = dot(b, r3)
    e2_dot = add_scaled(sub(b, s), -lift, r3)

    x_dot = add_scaled(scale(k1, e2), k2, e2_dot)
    s_dot = times(s1, x_dot)
    b_dot = sub(s_dot, ref.j)
    r3_dot = to_inertial(m.R, (m.w[1], -m.w[0], 0.0))
    lift_dot = dot(b_dot, r3) + dot(b, r3_dot)
    e2_ddot = add_scaled(add_scaled(sub(b_dot, s_dot), -lift_dot, r3), -lift, r3_dot)

    x_ddot = add_scaled(scale(k1, e2_dot), k2, e2_ddot)
    s_ddot = add(times(s2, times(x_dot, x_dot)), times(s1, x_ddot))
    b_ddot = sub(s_ddot, ref.s)

    p11, p12, p22 = law.p11, law.p12, law.p22
    inner = add_scaled(scale(p11, s), -p12, e2)
    inner_dot = add_scaled(scale(p11, s_dot), -p12, e2_dot)
    delta = add_scaled(add_scaled(scale(k2, times(s1, inner)), k2 - p12, s), p22, e2)
    slope_change = add(times(times(s2, x_dot), inner), times(s1, inner_dot))
    delta_dot = add_scaled(add_scaled(scale(k2, slope_change), k2 - p12, s_dot), p22, e2_dot)
    return Outer(e1, e2, e2_dot, s, s_dot, b, b_dot, b_ddot, delta, delta_dot)


@device
def pointing(m: Motion, o: Outer, law: TrackerLaw) -> Pointing:
    """The wanted thrust direction (52), and `A`, `B` of (65) with their exact time derivatives.

    With `n = |b|`: `b_dot = n_dot r3d + n r3d_dot` and once more for the second derivatives. A body
    component changes as `d/dt (R^T y) = R^T y_dot - S(omega) R^T y`.
    """
    n = norm(o.b)
    r3d = scale(1.0 / n, o.b)
    n_dot = dot(r3d, o.b_dot)
    r3d_dot = scale(1.0 / n, add_scaled(o.b_dot, -n_dot, r3d))
    # S(r3d) r3d_ddot: r3d_ddot has n_ddot only along r3d, where the product does not see it.
    bend = cross(r3d, scale(1.0 / n, add_scaled(o.b_ddot, -2.0 * n_dot, r3d_dot)))
    y = add_scaled(scale(law.k3, r3d), n, o.delta)
    y_dot = add(scale(law.k3, r3d_dot), add_scaled(scale(n_dot, o.delta), n, o.delta_dot))
    A = to_body(m.R, cross(r3d, r3d_dot))
    A_dot = sub(to_body(m.R, bend), cross(m.w, A))
    B = to_body(m.R, y)
    B_dot = sub(to_body(m.R, y_dot), cross(m.w, B))
    return Pointing(n, r3d, A, A_dot, B, B_dot)


@device
def rate_error(w: Vector, p: Pointing) -> Vector:
    """`e4 = S(k)(omega - A) - S(k)^2 B` (65), rad/s; no component along `k`."""
    return (-(w[1] - p.A[1]) + p.B[0], (w[0] - p.A[0]) + p.B[1], 0.0)


@device
def errors(m: Motion, ref: TrajectoryPoint, law: TrackerLaw) -> TrackerErrors:
    """The four errors of the backstepping (48), (49), (62), (65)."""
    o = outer(m, ref, law)
    p = pointing(m, o, law)
    return TrackerErrors(o.e1, o.e2, sub(m.R[2], p.r3d), rate_error(m.w, p))


@device
def torque(m: Motion, ref: TrajectoryPoint, mass: float, law: TrackerLaw) -> Torque:
    """Thrust (54) and torque (67)-(68) that fly the vehicle along `ref`.

        T   = T_d r3d . r3
        tau = S(k)(k4 e4 + R^T r3d) + A_dot + S(k) B_dot   along i and j
        tau_z = -k_z omega_z                                along k (68)

    with `A = R^T S(r3d) r3d_dot` and `B = R^T (k3 r3d + (T_d/m) delta)`.

    The thrust cancels gravity, the reference's acceleration and a saturated pull `sigma_e`; the
    torque turns `r3` onto `r3d` and pays for what the misalignment feeds into the position loop.
    It makes `e4_dot = -k4 e4 - (R^T r3d)_xy`, and the Lyapunov function (66) fall as (69):

        V4_dot = -W_sigma - k3 |S(r3) r3d|^2 - k4 |e4|^2

    so every error goes to zero, from any start but the unstable equilibrium `r3 = -r3d`, which the
    theorem's "global" leaves out. While `r3 . r3d < 0` the thrust is negative: a real rotor cannot
    follow, and the theorem does not cover what an actuator limit makes of it. With `T_d = 0` the
    direction is undefined; the bound (53) excludes it.
    """
    o = outer(m, ref, law)
    p = pointing(m, o, law)
    e4 = rate_error(m.w, p)
    r3d_body = to_body(m.R, p.r3d)
    g = (law.k4 * e4[0] + r3d_body[0], law.k4 * e4[1] + r3d_body[1])
    return Torque(
        mass * dot(o.b, m.R[2]),
        (
            -g[1] + p.A_dot[0] - p.B_dot[1],
            g[0] + p.A_dot[1] + p.B_dot[0],
            -law.kz * m.w[2],
        ),
    )


@device
def rate_command(m: Motion, ref: TrajectoryPoint, mass: float, law: TrackerLaw) -> RateCommand:
    """Thrust (54) and the angular velocity that makes `e4 = 0` (65), for vehicles driven by rates.

        omega_d = A + S(k) B   along i and j,  omega_z = 0

    With `e4 = 0` the backstepping stops one step earlier: `V3` (63) falls as
    `-W_sigma - k3 |S(r3) r3d|^2` (64). It needs neither `omega` nor the reference's snap.
    """
    still = Motion(m.p, m.v, m.R, (0.0, 0.0, 0.0))
    return rate_command_through_lag(still, ref, mass, law, 0.0)


@device
def rate_command_through_lag(
    m: Motion, ref: TrajectoryPoint, mass: float, law: TrackerLaw, lag: float
) -> RateCommand:
    """The command to a rate loop with a first-order lag (s) that makes `e4` go to zero; not the paper's law.

        omega_c = omega_d + lag omega_d_dot,   omega_d = A + S(k) B as in `rate_command`

    With `omega_dot = (omega_c - omega) / lag` the difference `omega - omega_d` decays with the time
    constant `lag`, whatever `omega_d` does. Sending `omega_d` alone is not enough for the paper's gains:
    near the origin they ask for `lag s^3 + s^2 + k3 s + 24 k3 = 0`, unstable from a lag of 0.04 s on. What
    gains suit is derived at `gains.RATES_GAINS`.
    """
    o = outer(m, ref, law)
    p = pointing(m, o, law)
    return RateCommand(
        mass * dot(o.b, m.R[2]),
        (
            p.A[0] - p.B[1] + lag * (p.A_dot[0] - p.B_dot[1]),
            p.A[1] + p.B[0] + lag * (p.A_dot[1] + p.B_dot[0]),
            0.0,
        ),
    )


class Certificate(NamedTuple):
    """The tracker's Lyapunov function and its rate, as theorem 2 states them."""

    V_sigma: float  # (55)
    V3: float  # (63)
    V4: float  # (66)
    W: float  # W_sigma (60)
    V4_dot: float  # (69)


@device
def _quadratic(a: Vector, m11: Vector, m12: Vector, m22: Vector, b: Vector) -> float:
    """`[a b] [[m11, m12], [m12, m22]] [a b]^T` with diagonal blocks."""
    return dot(a, times(m11, a)) + 2.0 * dot(a, times(m12, b)) + dot(b, times(m22, b))


@device
def _each(x: float) -> Vector:
    return (x, x, x)


@device
def certificate(m: Motion, ref: TrajectoryPoint, law: TrackerLaw) -> Certificate:
    """Lyapunov function of the tracker (55)+(63)+(66), `W_sigma` (60) with `Q`, and (69).

    The integral in (55) is `sigma_max (sqrt(c + x^2) - sqrt(c))` per axis, `x = k1 e1 + k2 e2`.
    `V4_dot` here is the closed form; that it is the derivative of `V4` along the motion is the test.
    """
    k1, k2, p11, p12, p22 = law.k1, law.k2, law.p11, law.p12, law.p22
    o = outer(m, ref, law)
    p = pointing(m, o, law)
    e4 = rate_error(m.w, p)
    x = add_scaled(scale(k1, o.e1), k2, o.e2)
    stored = 0.0
    for i in range(3):
        stored += law.sigma_max * (sqrt(law.c + x[i] * x[i]) - sqrt(law.c))
    V_sigma = 0.5 * _quadratic(o.sigma, _each(p11), _each(-p12), _each(p22), o.e2) + stored
    V3 = V_sigma + 1.0 - dot(m.R[2], p.r3d)

    s1 = saturation_slope(x, law)
    Q11 = add(_each(k2 - p12), scale(p11 * k2, s1))
    Q12 = add(scale(-0.5 * (k1 * p11 + k2 * p12), s1), _each(-0.5 * (k1 - p22)))
    Q22 = scale(p12 * k1, s1)
    W = _quadratic(o.sigma, Q11, Q12, Q22, o.e2)
    tilt = cross(m.R[2], p.r3d)
    V4_dot = -W - law.k3 * dot(tilt, tilt) - law.k4 * dot(e4, e4)
    return Certificate(V_sigma, V3, V3 + 0.5 * dot(e4, e4), W, V4_dot)
