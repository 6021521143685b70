"""Figures 2 to 5: each closed loop as one continuous differential equation.

The control laws are evaluated at every stage of the integrator, so that the figures show the laws and
not their sampling. The right-hand sides only put the package's own functions together. The
integrator is SciPy's DOP853 with relative and absolute tolerances of 1e-9.

Lengths in metres, times in seconds, angles in radians; inertial frame north-east-down.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, pi
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from formation_env._jit import device, kernel
from formation_env.gains import PlannerGains, TrackerGains
from formation_env.planner import Leader, PlannerLaw, Virtual, plane
from formation_env.planner import derivative as planner_derivative
from formation_env.planner import errors as planner_errors
from formation_env.quadrotor import MOMENT, Airframe, Body, Wrench, moment
from formation_env.quadrotor import derivative as body_derivative
from formation_env.references import Floats, Reference, evaluate
from formation_env.so3 import ZERO, Quaternion, Vector, dot, normalise, rotation
from formation_env.tracker import Motion, TrackerLaw, certificate, pointing, torque
from formation_env.tracker import errors as tracker_errors
from formation_env.tracker import outer as tracker_outer
from formation_env.trajectories import Trajectory, figure_eight

TOLERANCE = 1e-9

# Trajectory (31): at h = -1.5 m in III-C, in the plane in II-D, where the height plays no part.
EIGHT = figure_eight()

# III-C's vehicle; thrust and moment without limits, the thrust negative while upside down.
AIRFRAME = Airframe(0.1, (1e-3, 1e-3, 2e-3), -inf, inf, (inf, inf, inf), (inf, inf, inf), 0.05)

# II-D: gains, offsets (no height) and initial states p_x, p_y, theta, u, omega, xi_x, xi_y.
PLANNER = PlannerGains(k1=0.2, k2=2.0, k3=0.0, p_max=5.0)
OFFSETS = ((0.35, 0.35, 0.0), (0.35, -0.35, 0.0))
STARTS = (
    (3.0, 3.0, 1.5 * pi, 0.5, -0.5, 0.0, 0.0),
    (3.0, 1.0, 0.0, 0.0, 0.5, 0.0, 0.0),
)
_PLANAR = 7  # numbers per virtual follower

# III-C: upside down (phi = pi), at rest: p, v, quaternion (w, x, y, z), omega.
TRACKER = TrackerGains()
UPSIDE_DOWN = (-5.0, 10.0, -10.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
BODY = 13  # numbers of a vehicle's state


class Planar(NamedTuple):
    """Motion of figures 2 and 3: T times, n followers."""

    t: Floats  # (T,) s
    leader: Floats  # (T, 2) m
    p: Floats  # (T, n, 2) m
    theta: Floats  # (T, n) rad, not wrapped
    u: Floats  # (T, n) m/s
    omega: Floats  # (T, n) rad/s
    e1: Floats  # (T, n, 2) m, {F} (7)
    e2: Floats  # (T, n, 2) m, {F} (11)


class Flight(NamedTuple):
    """Motion of figures 4 and 5."""

    t: Floats  # (T,) s
    p: Floats  # (T, 3) m
    q: Floats  # (T, 4) body to inertial
    reference: Floats  # (T, 3) m
    thrust: Floats  # (T,) N
    e1: Floats  # (T, 3) m (48)
    e2: Floats  # (T, 3) m/s (49)
    e3: Floats  # (T, 3) (62)
    e4: Floats  # (T, 3) rad/s (65)
    lyapunov: Floats  # (T,) V4 (66)
    lyapunov_rate: Floats  # (T,) V4_dot (69)
    alignment: Floats  # (T,) r3 . r3d; -1 is the unstable equilibrium


def integrate(rate: Callable[..., Floats], start: Floats, t: Floats, *fixed: Any) -> Floats:
    """Solution of `y_dot = rate(t, y, *fixed)` at the times `t`, `(T, len(start))`."""
    s = solve_ivp(
        rate, (t[0], t[-1]), start, "DOP853", t, args=fixed, rtol=TOLERANCE, atol=TOLERANCE
    )
    if not s.success:
        raise RuntimeError(f"the integration stopped at t = {s.t[-1]:g} s: {s.message}")
    return np.ascontiguousarray(s.y.T)


def grid(duration: float, step: float) -> Floats:
    """Times from 0 to `duration` at equal steps, s."""
    return np.linspace(0.0, duration, round(duration / step) + 1)


@device
def leader_at(kind: int, table: Floats, t: float) -> Leader:
    r = evaluate(kind, table, t)
    return Leader(r.p, r.v, r.a, r.j, r.s)


@device
def vector(x: Any) -> Vector:
    return (x[0], x[1], x[2])


# -- figures 2 and 3 --------------------------------------------------------------------------------


@device
def _virtual(y: Any, height: float) -> Virtual:
    """A virtual follower in the plane, waiting at its height (`d_z = 0`)."""
    return Virtual(complex(y[0], y[1]), y[2], y[3], y[4], complex(y[5], y[6]), height, 0.0)


@kernel
def _planar_rate(
    t: float, y: Floats, kind: int, table: Floats, offsets: Floats, law: PlannerLaw
) -> Floats:
    """Virtual followers behind a leader that is the trajectory itself: (2)-(5), (18) under (21)."""
    leader = leader_at(kind, table, t)
    rate = np.empty_like(y)
    for i in range(len(offsets)):
        k = _PLANAR * i
        f = _virtual(y[k : k + _PLANAR], leader.p[2])
        r = planner_derivative(f, leader, vector(offsets[i]), law)
        rate[k], rate[k + 1], rate[k + 2] = r.p.real, r.p.imag, r.theta
        rate[k + 3], rate[k + 4] = r.u, r.omega
        rate[k + 5], rate[k + 6] = r.xi.real, r.xi.imag
    return rate


@kernel
def _planar_errors(
    t: Floats, y: Floats, kind: int, table: Floats, offsets: Floats, law: PlannerLaw
) -> Floats:
    """`e1`, `e2` of each follower at each time, `(T, n, 4)`."""
    out = np.empty((len(t), len(offsets), 4))
    for k in range(len(t)):
        leader = leader_at(kind, table, t[k])
        for i in range(len(offsets)):
            f = _virtual(y[k, _PLANAR * i : _PLANAR * (i + 1)], leader.p[2])
            e = planner_errors(f, plane(leader.p), plane(leader.v), plane(vector(offsets[i])), law)
            out[k, i, 0], out[k, i, 1] = e.e1.real, e.e1.imag
            out[k, i, 2], out[k, i, 3] = e.e2.real, e.e2.imag
    return out


def planar(duration: float = 60.0, step: float = 0.02, path: Trajectory = EIGHT) -> Planar:
    """II-D: two virtual followers behind a leader on (31), from their printed initial states.

    `path` is another trajectory for the leader.
    """
    t = grid(duration, step)
    fixed = (path.kind, path.table, np.array(OFFSETS), PLANNER.law())
    y = integrate(_planar_rate, np.ravel(STARTS), t, *fixed)
    e = _planar_errors(t, y, *fixed)
    x = y.reshape(len(t), len(OFFSETS), _PLANAR)
    leader = path(t)[:, 0, :2]
    return Planar(t, leader, x[..., :2], x[..., 2], x[..., 3], x[..., 4], e[..., :2], e[..., 2:])


# -- figures 4 and 5 --------------------------------------------------------------------------------


@device
def _attitude(y: Any) -> Quaternion:
    """The exact flow keeps the quaternion's length; this takes off what the integrator adds."""
    return normalise((y[6], y[7], y[8], y[9]))


@device
def body_of(y: Any) -> Body:
    return Body(vector(y), (y[3], y[4], y[5]), _attitude(y), (y[10], y[11], y[12]))


@device
def _motion(b: Body) -> Motion:
    return Motion(b.p, b.v, rotation(b.q), b.w)


@device
def flown(b: Body, ref: Reference, airframe: Airframe, law: TrackerLaw) -> Body:
    """Rate of a vehicle's state under the tracker: (41)-(46) with (54), (67)-(68)."""
    c = torque(_motion(b), ref, airframe.mass, law)
    applied = Wrench(c.thrust, moment(c.tau, b.w, airframe.inertia))
    return body_derivative(b, applied, ZERO, MOMENT, airframe)


@device
def put_body(out: Any, r: Body) -> None:
    for k in range(3):
        out[k], out[3 + k], out[10 + k] = r.p[k], r.v[k], r.w[k]
    for k in range(4):
        out[6 + k] = r.q[k]


@kernel
def _flight_rate(
    t: float, y: Floats, kind: int, table: Floats, airframe: Airframe, law: TrackerLaw
) -> Floats:
    """A quadrotor flown along the trajectory, whose four derivatives are exact."""
    rate = np.empty_like(y)
    put_body(rate, flown(body_of(y), evaluate(kind, table, t), airframe, law))
    return rate


@kernel
def _flight_history(
    t: Floats, y: Floats, kind: int, table: Floats, airframe: Airframe, law: TrackerLaw
) -> Floats:
    """Thrust, `r3 . r3d`, `V4`, `V4_dot` and the four errors at each time, `(T, 16)`."""
    out = np.empty((len(t), 16))
    for k in range(len(t)):
        ref = evaluate(kind, table, t[k])
        m = _motion(body_of(y[k]))
        v = certificate(m, ref, law)
        e = tracker_errors(m, ref, law)
        out[k, 0] = torque(m, ref, airframe.mass, law).thrust
        out[k, 1] = dot(m.R[2], pointing(m, tracker_outer(m, ref, law), law).r3d)
        out[k, 2], out[k, 3] = v.V4, v.V4_dot
        for i in range(3):
            out[k, 4 + i], out[k, 7 + i] = e.e1[i], e.e2[i]
            out[k, 10 + i], out[k, 13 + i] = e.e3[i], e.e4[i]
    return out


def flight(duration: float = 30.0, step: float = 0.01) -> Flight:
    """III-C, controller test: a vehicle released upside down, far from the trajectory (31)."""
    t = grid(duration, step)
    fixed = (EIGHT.kind, EIGHT.table, AIRFRAME, TRACKER.law())
    y = integrate(_flight_rate, np.array(UPSIDE_DOWN), t, *fixed)
    h = _flight_history(t, y, *fixed)
    q = y[:, 6:10] / np.linalg.norm(y[:, 6:10], axis=1, keepdims=True)
    e1, e2, e3, e4 = np.split(h[:, 4:], 4, axis=1)
    path = EIGHT(t)[:, 0]
    return Flight(t, y[:, :3], q, path, h[:, 0], e1, e2, e3, e4, h[:, 2], h[:, 3], h[:, 1])
