"""The third and fourth derivatives of a virtual follower's trajectory, in closed form.

The tracker wants a reference of class C4; (35) gives two derivatives. The other two follow from
differentiating the law (21) along its own motion, once and twice, given the leader's jerk and snap.
The paper's experiment set them to zero instead, which is `planner.reference`.
"""

from __future__ import annotations

from typing import NamedTuple

from formation_env._jit import device
from formation_env.elementary import phase, pick, tanh
from formation_env.planner import (
    Leader,
    PlannerLaw,
    Virtual,
    climb,
    each,
    errors,
    gamma_solve,
    plane,
)
from formation_env.so3 import Vector
from formation_env.trajectories import Reference


class Actuation(NamedTuple):
    """`(T, tau)` of (4)-(5) with their first two time derivatives."""

    T: float  # m/s^2
    tau: float  # rad/s^2
    T_dot: float
    tau_dot: float
    T_ddot: float
    tau_ddot: float


@device
def _slopes(x: float, p_max: float) -> tuple[float, float, float]:
    """First three derivatives of `p_max tanh(x / p_max)` (10)."""
    t = tanh(x / p_max)
    s1 = 1.0 - t * t
    s2 = -2.0 * t * s1 / p_max
    return s1, s2, -2.0 / p_max * (s1 * s1 / p_max + t * s2)


@device
def actuation(f: Virtual, leader: Leader, d: Vector, law: PlannerLaw) -> Actuation:
    """`mu` of (21) and its derivatives along the closed loop.

    With `V = R^T p_L_dot`, so that `delta = V_dot` (16), and primes for time derivatives:

        Gamma mu   = V'   + k1 sigma'   + k1^2 k2 e2   + k1 k3 xi
        Gamma mu'  = V''  + k1 sigma''  + k1^2 k2 e2'  + k1 k3 e2
        Gamma mu'' = V''' + k1 sigma''' + k1^2 k2 e2'' + k1 k3 e2'

    where `e2' = -k1 k2 e2 - k3 xi`. Each line's right side needs the actuation of the lines above.
    """
    w, dc = f.omega, plane(d)
    Rt = phase(f.theta).conjugate()
    V, A = Rt * plane(leader.v), Rt * plane(leader.a)
    J, S = Rt * plane(leader.j), Rt * plane(leader.s)
    k1, k2, k3 = law.k1, law.k2, law.k3
    e1, e2 = errors(f, plane(leader.p), plane(leader.v), dc, law)
    x1, x2, x3 = _slopes(e1.real, law.p_max)
    y1, y2, y3 = _slopes(e1.imag, law.p_max)
    s1, s2, s3 = complex(x1, y1), complex(x2, y2), complex(x3, y3)
    e2_1 = -k1 * k2 * e2 - k3 * f.xi
    e2_2 = -k1 * k2 * e2_1 - k3 * e2

    V1 = -1j * w * V + A
    e1_1 = -1j * w * (e1 + dc) + V - f.u
    T, tau = gamma_solve(V1 + k1 * each(s1, e1_1) + k1 * k1 * k2 * e2 + k1 * k3 * f.xi, dc)

    A1 = -1j * w * A + J
    V2 = -1j * tau * V - 1j * w * V1 + A1
    e1_2 = -1j * tau * (e1 + dc) - 1j * w * e1_1 + V1 - T
    sigma_2 = each(s2, each(e1_1, e1_1)) + each(s1, e1_2)
    T1, tau1 = gamma_solve(V2 + k1 * sigma_2 + k1 * k1 * k2 * e2_1 + k1 * k3 * e2, dc)

    A2 = -1j * tau * A - 1j * w * A1 - 1j * w * J + S
    V3 = -1j * tau1 * V - 2j * tau * V1 - 1j * w * V2 + A2
    e1_3 = -1j * tau1 * (e1 + dc) - 2j * tau * e1_1 - 1j * w * e1_2 + V2 - T1
    sigma_3 = (
        each(s3, each(e1_1, each(e1_1, e1_1))) + 3.0 * each(s2, each(e1_1, e1_2)) + each(s1, e1_3)
    )
    T2, tau2 = gamma_solve(V3 + k1 * sigma_3 + k1 * k1 * k2 * e2_2 + k1 * k3 * e2_1, dc)
    return Actuation(T, tau, T1, tau1, T2, tau2)


@device
def full_reference(f: Virtual, leader: Leader, d: Vector, law: PlannerLaw) -> Reference:
    """The trajectory of a virtual follower with four derivatives, all in closed form.

    The leader's jerk and snap enter; the vertical ones are zero while (34) saturates.
    """
    m = actuation(f, leader, d, law)
    w, u = f.omega, f.u
    R = phase(f.theta)
    third = complex(m.T_dot - w * w * u, 2.0 * w * m.T + m.tau * u)
    fourth = 1j * w * third + complex(
        m.T_ddot - 2.0 * w * m.tau * u - w * w * m.T,
        3.0 * m.tau * m.T + 2.0 * w * m.T_dot + m.tau_dot * u,
    )
    v = R * u
    a = R * complex(m.T, w * u)
    j = R * third
    s = R * fourth
    a_z = climb(f, leader, d[2], law)
    free = abs(a_z) < law.z_max
    e_a = leader.a[2] - a_z
    j_z = pick(free, leader.j[2] + law.kz1 * (leader.v[2] - f.w) + law.kz2 * e_a, 0.0)
    s_z = pick(free, leader.s[2] + law.kz1 * e_a + law.kz2 * (leader.j[2] - j_z), 0.0)
    return Reference(
        (f.p.real, f.p.imag, f.z),
        (v.real, v.imag, f.w),
        (a.real, a.imag, a_z),
        (j.real, j.imag, j_z),
        (s.real, s.imag, s_z),
    )
