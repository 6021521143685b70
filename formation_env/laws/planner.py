"""The trajectory planner of section II: a virtual unicycle per follower keeps the leader at `d`.

The plane is the complex plane, so that the equations read as printed: `R(theta)` is `exp(j theta)`,
`R^T a` is `exp(-j theta) a`, and `S(omega) a` is `j omega a`. Height is separate (II-E). `spin` and
`scaled` are such products too: with a whole complex number the compiler would multiply by its zeros.

    p_F_dot = R i u,  R_dot = R S(omega),  u_dot = T,  omega_dot = tau           (2)-(5)
    e1 = R^T (p_L - p_F) - d                                                     (6)-(7)
    e2 = sigma(e1) + (-S(omega) d + R^T p_L_dot - u i) / k1                      (11)
    xi_dot = e2                                                                  (18)

All angles in radians, lengths in metres, time in seconds; the plane is (north, east), `z` is down.
"""

from __future__ import annotations

from math import atan2
from typing import NamedTuple

from formation_env._jit import device
from formation_env.maths.elementary import phase, tanh
from formation_env.maths.runge_kutta import runge_kutta
from formation_env.maths.so3 import Vector
from formation_env.paths.references import TrajectoryPoint


class PlannerLaw(NamedTuple):
    """Gains of the planner, as the kernels take them (`PlannerGains` checks them first)."""

    k1: float  # 1/s, > 0
    k2: float  # > 1 (theorem 1)
    k3: float  # >= 0 (0 switches the integral action off, as in II-D)
    kz1: float  # 1/s^2, > 0
    kz2: float  # 1/s, > 0
    p_max: float  # m, level of the saturation (10)
    z_max: float  # m/s^2, level of the saturation (34)


class Virtual(NamedTuple):
    """State of a virtual follower."""

    p: complex  # position in the plane, m
    theta: float  # heading, rad, not wrapped
    u: float  # forward speed, m/s
    omega: float  # turning rate, rad/s
    xi: complex  # integral of e2, m s
    z: float  # height coordinate, m, down
    w: float  # its rate, m/s


class PlanarMotion(NamedTuple):
    """How leader and errors move in the frame {F} of the virtual follower."""

    V: complex  # R^T p_L_dot, m/s
    delta: complex  # its rate (16), m/s^2
    e1: complex  # (7), m
    e1_dot: complex  # m/s
    sigma_dot: complex  # rate of sigma(e1), m/s
    e2: complex  # (11), m


class PlanarErrors(NamedTuple):
    """Errors of the planner in the frame {F} of the virtual follower, m."""

    e1: complex  # (7)
    e2: complex  # (11)


@device
def plane(a: Vector) -> complex:
    """The horizontal part of a vector as a complex number."""
    return complex(a[0], a[1])


@device
def spin(omega: float, a: complex) -> complex:
    """`S(omega) a`, which is `j omega a`."""
    return complex(-omega * a.imag, omega * a.real)


@device
def scaled(s: float, a: complex) -> complex:
    """`s a` with a real number `s`."""
    return complex(s * a.real, s * a.imag)


@device
def saturation(x: complex, p_max: float) -> complex:
    """`sigma(x) = p_max tanh(x / p_max)`, element by element (10), as corrected in the errata."""
    return complex(p_max * tanh(x.real / p_max), p_max * tanh(x.imag / p_max))


@device
def saturation_slope(x: complex, p_max: float) -> complex:
    """`sigma'(x)`, element by element: `1 - tanh^2`."""
    a, b = tanh(x.real / p_max), tanh(x.imag / p_max)
    return complex(1.0 - a * a, 1.0 - b * b)


@device
def each(a: complex, b: complex) -> complex:
    """Product element by element, `diag(a) b`."""
    return complex(a.real * b.real, a.imag * b.imag)


@device
def gamma_solve(nu: complex, d: complex) -> tuple[float, float]:
    """`Gamma^-1 nu` with `Gamma = [[1, -d_y], [0, d_x]]` (14); needs `d_x != 0`."""
    tau = nu.imag / d.real
    return nu.real + d.imag * tau, tau


@device
def errors(f: Virtual, p_L: complex, v_L: complex, d: complex, law: PlannerLaw) -> PlanarErrors:
    """The position error (7) and the backstepping error (11), m, in {F}.

    With them, `e1_dot = -S(omega) e1 - k1 sigma(e1) + k1 e2`.
    """
    Rt = phase(f.theta).conjugate()
    e1 = Rt * (p_L - f.p) - d
    # Not divided by k1: a quotient of complex numbers branches, which no vector code can.
    e2 = saturation(e1, law.p_max) + scaled(1.0 / law.k1, -spin(f.omega, d) + Rt * v_L - f.u)
    return PlanarErrors(e1, e2)


@device
def in_motion(
    f: Virtual, p_L: complex, v_L: complex, a_L: complex, d: complex, law: PlannerLaw
) -> PlanarMotion:
    """The leader's velocity and the errors, all in {F}, with their rates (16) along the motion (2)-(5).

    Components in a frame that turns at `omega` change as `d/dt (R^T a) = -S(omega) R^T a + R^T a_dot`.
    """
    Rt = phase(f.theta).conjugate()
    e1, e2 = errors(f, p_L, v_L, d, law)
    V = Rt * v_L
    delta = -spin(f.omega, V) + Rt * a_L
    e1_dot = -spin(f.omega, e1 + d) + V - f.u
    sigma_dot = each(saturation_slope(e1, law.p_max), e1_dot)
    return PlanarMotion(V, delta, e1, e1_dot, sigma_dot, e2)


@device
def mu(
    delta: complex, sigma_dot: complex, e2: complex, xi: complex, d: complex, law: PlannerLaw
) -> tuple[float, float]:
    """The law (21): `mu = (T, tau)`, m/s^2 and rad/s^2, from the four terms that it adds.

        mu = Gamma^-1 (delta + k1 sigma_dot(e1) + k1^2 k2 e2 + k1 k3 xi)

    It is linear with constant coefficients: of the terms' time derivatives it makes those of `mu`.
    """
    nu = delta + scaled(law.k1, sigma_dot)
    nu += scaled(law.k1**2 * law.k2, e2) + scaled(law.k1 * law.k3, xi)
    return gamma_solve(nu, d)


@device
def control(
    f: Virtual, p_L: complex, v_L: complex, a_L: complex, d: complex, law: PlannerLaw
) -> tuple[float, float]:
    """The actuation `(T, tau)` of a virtual follower (21), (39); m/s^2 and rad/s^2.

    `mu` of the follower's own motion, with `delta = -S(omega) R^T p_L_dot + R^T p_L_ddot` (16) and
    `sigma_dot(e1) = sigma'(e1) e1_dot`. The terms cancel everything in `e2_dot` but a linear system:

        e2_dot = -k1 k2 e2 - k3 xi

    (the paper prints `k1 k3 xi`; with (11) and (21) the factor is `k3`, see the errata). So `e2` and
    `xi` go to zero exponentially and `e1` follows, from any start (theorem 1, with `k1 > 0`, `k2 > 1`,
    `k3 > 0`). It fails for `d_x = 0`, where turning no longer moves the leader sideways in {F}.
    """
    m = in_motion(f, p_L, v_L, a_L, d, law)
    return mu(m.delta, m.sigma_dot, m.e2, f.xi, d, law)


@device
def climb(f: Virtual, leader: TrajectoryPoint, d_z: float, law: PlannerLaw) -> float:
    """Vertical acceleration of a virtual follower (33)-(34), m/s^2, down.

    `sigma_z(p_L_ddot_z + k_z1 e_z + k_z2 e_z_dot)` with `e_z = p_Lz - p_Fz - d_z` (32). Away from the
    saturation `e_z_ddot = -k_z1 e_z - k_z2 e_z_dot`.
    """
    e_z = leader.p[2] - f.z - d_z
    x = leader.a[2] + law.kz1 * e_z + law.kz2 * (leader.v[2] - f.w)
    return min(max(x, -law.z_max), law.z_max)


@device
def derivative(f: Virtual, leader: TrajectoryPoint, d: Vector, law: PlannerLaw) -> Virtual:
    """Time derivative of a virtual follower's state under its law (2)-(5), (18), (33)."""
    p_L, v_L, a_L = plane(leader.p), plane(leader.v), plane(leader.a)
    T, tau = control(f, p_L, v_L, a_L, plane(d), law)
    e2 = errors(f, p_L, v_L, plane(d), law).e2
    return Virtual(
        scaled(f.u, phase(f.theta)), f.omega, T, tau, e2, f.w, climb(f, leader, d[2], law)
    )


@device
def _coast(leader: TrajectoryPoint, h: float) -> TrajectoryPoint:
    """The leader `h` seconds on, its acceleration held."""
    p, v, a = leader.p, leader.v, leader.a
    k = 0.5 * h * h
    return TrajectoryPoint(
        (p[0] + h * v[0] + k * a[0], p[1] + h * v[1] + k * a[1], p[2] + h * v[2] + k * a[2]),
        (v[0] + h * a[0], v[1] + h * a[1], v[2] + h * a[2]),
        a,
        leader.j,
        leader.s,
    )


_step = runge_kutta(derivative, Virtual)


@device
def advance(f: Virtual, leader: TrajectoryPoint, d: Vector, h: float, law: PlannerLaw) -> Virtual:
    """A virtual follower `h` seconds later, from one sample of the leader.

    A Runge-Kutta step in which the leader coasts at the sampled acceleration: between samples nothing
    newer is known.
    """
    middle, end = _coast(leader, 0.5 * h), _coast(leader, h)
    after: Virtual = _step(f, h, leader, middle, end, d, law)
    return after


@device
def place(p_L: Vector, v_L: Vector, d: Vector, direction: complex, moving: bool) -> Virtual:
    """A virtual follower with null errors, heading along `direction` (II-E).

    `p_F = p_L - R d`, so `e1 = 0` (7) and `e_z = 0` (32). If `moving`, its speed and turning rate are
    those of the zero dynamics (23), so `e2 = 0` too; otherwise it is at rest, as before the trigger.
    `direction` is the unit vector of the leader's planar velocity, as a complex number.
    """
    from_leader = direction * plane(d)
    V = plane(v_L) * direction.conjugate()
    u, omega = gamma_solve(V, plane(d)) if moving else (0.0, 0.0)
    return Virtual(
        plane(p_L) - from_leader,
        atan2(direction.imag, direction.real),
        u,
        omega,
        0j,
        p_L[2] - d[2],
        v_L[2] if moving else 0.0,
    )


@device
def trajectory_point(
    f: Virtual, leader: TrajectoryPoint, d: Vector, law: PlannerLaw
) -> TrajectoryPoint:
    """The trajectory a virtual follower draws, and its derivatives up to the second (35).

    Jerk and snap are zero, as in the paper's experiment. See `full_trajectory_point`.
    """
    T, _ = control(f, plane(leader.p), plane(leader.v), plane(leader.a), plane(d), law)
    R = phase(f.theta)
    v = scaled(f.u, R)
    a = R * complex(T, f.omega * f.u)
    return TrajectoryPoint(
        (f.p.real, f.p.imag, f.z),
        (v.real, v.imag, f.w),
        (a.real, a.imag, climb(f, leader, d[2], law)),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
    )
