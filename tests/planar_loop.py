"""The planner's closed loop in the plane, written from section II with matrices.

Of the package it takes the laws (21) and (34) alone; the errors and the motion are the paper's.
"""

from __future__ import annotations

import numpy as np
from closed_loop import numbers
from hypothesis import strategies as st

from formation_env.laws import planner
from formation_env.laws.planner import PlannerLaw, Virtual
from formation_env.maths.so3 import Vector
from formation_env.paths.references import TrajectoryPoint

PAPER = PlannerLaw(k1=0.2, k2=2.0, k3=0.0, kz1=0.2, kz2=2.0, p_max=5.0, z_max=4.0)
GENERIC = PlannerLaw(k1=0.6, k2=1.7, k3=0.4, kz1=0.35, kz2=1.1, p_max=1.3, z_max=2.0)
D = (0.45, -0.6, -0.3)  # m


def planar(theta: float) -> np.ndarray:
    """The rotation matrix (1)."""
    return np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])


def skew(omega: float) -> np.ndarray:
    return np.array([[0.0, -omega], [omega, 0.0]])


def gamma(d: Vector) -> np.ndarray:
    """The matrix (14)."""
    return np.array([[1.0, -d[1]], [0.0, d[0]]])


def virtual(x: np.ndarray) -> Virtual:
    """From the state vector `p_F (2), theta, u, omega, xi (2), z, w, t`."""
    x = np.array(x, dtype=float)
    return Virtual(
        complex(x[0], x[1]),
        float(x[2]),
        float(x[3]),
        float(x[4]),
        complex(x[5], x[6]),
        float(x[7]),
        float(x[8]),
    )


def control(
    x: np.ndarray, leader: TrajectoryPoint, d: Vector, law: PlannerLaw
) -> tuple[float, float]:
    c = planner.plane
    return planner.control(virtual(x), c(leader.p), c(leader.v), c(leader.a), c(d), law)


def paper_errors(x: np.ndarray, leader: TrajectoryPoint, d: Vector, law: PlannerLaw) -> np.ndarray:
    """`(e1, e2)` of (7) and (11) in matrices, 4 numbers."""
    R, p_F, u, omega = planar(x[2]), x[0:2], x[3], x[4]
    e1 = R.T @ (np.array(leader.p[:2]) - p_F) - d[:2]
    V = R.T @ np.array(leader.v[:2])
    sigma = law.p_max * np.tanh(e1 / law.p_max)
    e2 = sigma + (-skew(omega) @ d[:2] + V - u * np.array([1.0, 0.0])) / law.k1
    return np.concatenate([e1, e2])


def flow(
    x: np.ndarray,
    leader: TrajectoryPoint,
    d: Vector,
    law: PlannerLaw,
    bias: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """(2)-(5), (18), (33) with the law's actuation, to which `bias` is added; and `t_dot = 1`."""
    T, tau = control(x, leader, d, law)
    e2 = paper_errors(x, leader, d, law)[2:]
    a_z = planner.climb(virtual(x), leader, d[2], law)
    p_dot = x[3] * planar(x[2])[:, 0]
    return np.array([*p_dot, x[4], T + bias[0], tau + bias[1], *e2, x[8], a_z, 1.0])


SPREAD = (2.0, 2.0, 3.0, 1.5, 1.5, 1.0, 1.0, 2.0, 1.0, 5.0)
STATES = st.tuples(*(numbers(s) for s in SPREAD)).map(lambda x: np.array(x))
SEEDS = st.integers(0, 20)
LAWS = st.sampled_from([PAPER, GENERIC])
