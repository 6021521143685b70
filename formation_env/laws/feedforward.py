"""The third and fourth derivatives of a virtual follower's trajectory, in closed form.

The tracker wants a reference of class C4; (35) gives two derivatives. The other two follow from
differentiating the law (21) along its own motion, once and twice, given the leader's jerk and snap.
The paper's experiment set them to zero instead, which is `planner.trajectory_point`.
"""

from __future__ import annotations

from typing import NamedTuple

from formation_env._jit import device
from formation_env.laws.planner import (
    PlannerLaw,
    Virtual,
    each,
    in_motion,
    mu,
    plane,
    saturation,
    saturation_slope,
    scaled,
    spin,
    trajectory_point,
)
from formation_env.maths.elementary import phase, pick
from formation_env.maths.so3 import Vector
from formation_env.paths.references import TrajectoryPoint


class Actuation(NamedTuple):
    """`(T, tau)` of (4)-(5) with their first two time derivatives."""

    T: float  # m/s^2
    tau: float  # rad/s^2
    T_dot: float
    tau_dot: float
    T_ddot: float
    tau_ddot: float


@device
def _spin_dot(w: float, w1: float, a: complex, a1: complex) -> complex:
    """First time derivative of `S(w) a`; a figure behind a name counts its derivatives."""
    return spin(w1, a) + spin(w, a1)


@device
def _spin_ddot(w: float, w1: float, w2: float, a: complex, a1: complex, a2: complex) -> complex:
    """Second time derivative of `S(w) a`."""
    return spin(w2, a) + scaled(2.0, spin(w1, a1)) + spin(w, a2)


@device
def actuation(f: Virtual, leader: TrajectoryPoint, d: Vector, law: PlannerLaw) -> Actuation:
    """`mu` of (21) and its derivatives along the closed loop.

    The law is linear in its terms: with their time derivatives in their places it gives those of `mu`.
    In {F}, with `V = R^T p_L_dot`, `A = R^T p_L_ddot`, `J` and `S` alike and `y = e1 + d`,

        V_dot = delta = A - S(omega) V,   A_dot = J - S(omega) A,   J_dot = S - S(omega) J
        e1_dot = V - u i - S(omega) y,    e2_dot = -k1 k2 e2 - k3 xi,    xi_dot = e2

    and `sigma_dot = sigma' e1_dot` where `sigma'` of (10) is `1 - sigma^2 / p_max^2`. Their further
    derivatives need `omega_dot = tau` and `u_dot = T`, which the derivative before has given.
    """
    w, dc = f.omega, plane(d)
    m = in_motion(f, plane(leader.p), plane(leader.v), plane(leader.a), dc, law)
    T, tau = mu(m.delta, m.sigma_dot, m.e2, f.xi, dc, law)

    Rt = phase(f.theta).conjugate()
    A, J, S = Rt * plane(leader.a), Rt * plane(leader.j), Rt * plane(leader.s)
    A1, J1 = J - spin(w, A), S - spin(w, J)
    V, V1 = m.V, m.delta
    V2 = A1 - _spin_dot(w, tau, V, V1)
    y, y1 = m.e1 + dc, m.e1_dot
    y2 = V1 - T - _spin_dot(w, tau, y, y1)
    bend = -2.0 / law.p_max**2
    sigma, sigma1 = saturation(m.e1, law.p_max), m.sigma_dot
    slope = saturation_slope(m.e1, law.p_max)
    slope1 = scaled(bend, each(sigma, sigma1))
    sigma2 = each(slope1, y1) + each(slope, y2)
    e2_dot = scaled(-law.k1 * law.k2, m.e2) - scaled(law.k3, f.xi)
    T1, tau1 = mu(V2, sigma2, e2_dot, m.e2, dc, law)

    A2 = J1 - _spin_dot(w, tau, A, A1)
    V3 = A2 - _spin_ddot(w, tau, tau1, V, V1, V2)
    y3 = V2 - T1 - _spin_ddot(w, tau, tau1, y, y1, y2)
    slope2 = scaled(bend, each(sigma1, sigma1) + each(sigma, sigma2))
    sigma3 = each(slope2, y1) + scaled(2.0, each(slope1, y2)) + each(slope, y3)
    e2_ddot = scaled(-law.k1 * law.k2, e2_dot) - scaled(law.k3, m.e2)
    T2, tau2 = mu(V3, sigma3, e2_ddot, e2_dot, dc, law)
    return Actuation(T, tau, T1, tau1, T2, tau2)


@device
def full_trajectory_point(
    f: Virtual, leader: TrajectoryPoint, d: Vector, law: PlannerLaw
) -> TrajectoryPoint:
    """`planner.trajectory_point` with the third and fourth derivatives, all in closed form.

    The leader's jerk and snap enter; the vertical ones are zero while (34) saturates.
    """
    r, m = trajectory_point(f, leader, d, law), actuation(f, leader, d, law)
    w, u, R = f.omega, f.u, phase(f.theta)
    # R^T times the third and the fourth, from (35): R^T times the first is u i.
    third = complex(m.T_dot - w * w * u, 2.0 * w * m.T + m.tau * u)
    fourth = spin(w, third) + complex(
        m.T_ddot - 2.0 * w * m.tau * u - w * w * m.T,
        3.0 * m.tau * m.T + 2.0 * w * m.T_dot + m.tau_dot * u,
    )
    j, s, a_z = R * third, R * fourth, r.a[2]
    free = abs(a_z) < law.z_max
    e_a = leader.a[2] - a_z
    j_z = pick(free, leader.j[2] + law.kz1 * (leader.v[2] - f.w) + law.kz2 * e_a, 0.0)
    s_z = pick(free, leader.s[2] + law.kz1 * e_a + law.kz2 * (leader.j[2] - j_z), 0.0)
    return TrajectoryPoint(r.p, r.v, r.a, (j.real, j.imag, j_z), (s.real, s.imag, s_z))
