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
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from formation_env._jit import device, kernel
from formation_env.gains import PlannerGains, TrackerGains
from formation_env.planner import Leader, PlannerLaw, Virtual, plane
from formation_env.planner import derivative as planner_derivative
from formation_env.planner import errors as planner_errors
from formation_env.quadrotor import MOMENT, Airframe, Body, Wrench, moment
from formation_env.quadrotor import derivative as body_derivative
from formation_env.records import flatten, line_loader, line_storer, size, slices
from formation_env.references import Floats, Reference, evaluate
from formation_env.so3 import ZERO, Vector, dot, normalise, rotation
from formation_env.tracker import Motion, TrackerLaw, certificate, pointing, torque
from formation_env.tracker import errors as tracker_errors
from formation_env.tracker import outer as tracker_outer
from formation_env.trajectories import Trajectory, figure_eight

TOLERANCE = 1e-9

# Trajectory (31): at h = -1.5 m in III-C, in the plane in II-D, where the height plays no part.
EIGHT = figure_eight()

# III-C's vehicle; thrust and moment without limits, the thrust negative while upside down.
AIRFRAME = Airframe(0.1, (1e-3, 1e-3, 2e-3), -inf, inf, (inf, inf, inf), (inf, inf, inf), 0.05)


class InPlane(NamedTuple):
    """State of a virtual follower without its height; fields as in `Virtual`."""

    p: complex  # m
    theta: float  # rad, not wrapped
    u: float  # m/s
    omega: float  # rad/s
    xi: complex  # m s


# II-D: gains, offsets (no height) and initial states.
PLANNER = PlannerGains(k1=0.2, k2=2.0, k3=0.0, p_max=5.0)
OFFSETS = ((0.35, 0.35, 0.0), (0.35, -0.35, 0.0))
STARTS = (InPlane(3.0 + 3.0j, 1.5 * pi, 0.5, -0.5, 0j), InPlane(3.0 + 1.0j, 0.0, 0.0, 0.5, 0j))

# III-C: upside down (phi = pi), at rest.
TRACKER = TrackerGains()
UPSIDE_DOWN = Body((-5.0, 10.0, -10.0), ZERO, (0.0, 1.0, 0.0, 0.0), ZERO)

_IN_PLANE = size(InPlane)  # numbers per virtual follower
_load_in_plane, _store_in_plane = line_loader(InPlane), line_storer(InPlane)
_load_body, _store_body = line_loader(Body), line_storer(Body)


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
    """A leader that is the trajectory itself, at time `t`, s."""
    r = evaluate(kind, table, t)
    return Leader(r.p, r.v, r.a, r.j, r.s)


@device
def vector(x: Any) -> Vector:
    """The three components `x` of a vector."""
    return (x[0], x[1], x[2])


def columns(kind: Any, x: Floats) -> dict[str, Floats]:
    """The fields, by name, of records that lie along the last axis of `x`; numbers lose that axis."""
    return {
        name: x[..., where] if where.stop - where.start > 1 else x[..., where.start]
        for name, where in slices(kind).items()
    }


def pairs(z: NDArray[np.complex128]) -> Floats:
    """Vectors of the plane as pairs of components, a new last axis."""
    return np.stack([z.real, z.imag], axis=-1)


# -- figures 2 and 3 --------------------------------------------------------------------------------


@device
def _virtual(y: Any, height: float) -> Virtual:
    """A virtual follower in the plane, waiting at its height (`d_z = 0`)."""
    f = _load_in_plane(y)
    return Virtual(f.p, f.theta, f.u, f.omega, f.xi, height, 0.0)


@kernel
def _planar_rate(
    t: float, y: Floats, kind: int, table: Floats, offsets: Floats, law: PlannerLaw
) -> Floats:
    """Virtual followers behind a leader that is the trajectory itself: (2)-(5), (18) under (21)."""
    leader = leader_at(kind, table, t)
    rate = np.empty_like(y)
    for i in range(len(offsets)):
        k = _IN_PLANE * i
        f = _virtual(y[k:], leader.p[2])
        r = planner_derivative(f, leader, vector(offsets[i]), law)
        _store_in_plane(rate[k:], InPlane(r.p, r.theta, r.u, r.omega, r.xi))
    return rate


@kernel
def _planar_errors(
    t: Floats, y: Floats, kind: int, table: Floats, offsets: Floats, law: PlannerLaw
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """`e1`, `e2` of each follower at each time, `(T, n)` each."""
    e1 = np.empty((len(t), len(offsets)), dtype=np.complex128)
    e2 = np.empty_like(e1)
    for k in range(len(t)):
        leader = leader_at(kind, table, t[k])
        for i in range(len(offsets)):
            f = _virtual(y[k, _IN_PLANE * i :], leader.p[2])
            e = planner_errors(f, plane(leader.p), plane(leader.v), plane(vector(offsets[i])), law)
            e1[k, i], e2[k, i] = e.e1, e.e2
    return e1, e2


def planar(duration: float = 60.0, step: float = 0.02, path: Trajectory = EIGHT) -> Planar:
    """II-D: two virtual followers behind a leader on (31), from their printed initial states.

    `path` is another trajectory for the leader.
    """
    t = grid(duration, step)
    fixed = (path.kind, path.table, np.array(OFFSETS), PLANNER.law())
    y = integrate(_planar_rate, np.array(flatten(STARTS)), t, *fixed)
    e1, e2 = _planar_errors(t, y, *fixed)
    x = columns(InPlane, y.reshape(len(t), len(OFFSETS), _IN_PLANE))
    leader = path(t)[:, 0, :2]
    return Planar(t, leader, x["p"], x["theta"], x["u"], x["omega"], pairs(e1), pairs(e2))


# -- figures 4 and 5 --------------------------------------------------------------------------------


@device
def unit_attitude(b: Body) -> Body:
    """The exact flow keeps the quaternion's length; this takes off what the integrator adds."""
    return Body(b.p, b.v, normalise(b.q), b.w)


@device
def _motion(b: Body) -> Motion:
    return Motion(b.p, b.v, rotation(b.q), b.w)


@device
def flown(b: Body, ref: Reference, airframe: Airframe, law: TrackerLaw) -> Body:
    """Rate of a vehicle's state under the tracker: (41)-(46) with (54), (67)-(68)."""
    c = torque(_motion(b), ref, airframe.mass, law)
    applied = Wrench(c.thrust, moment(c.tau, b.w, airframe.inertia))
    return body_derivative(b, applied, ZERO, MOMENT, airframe)


@kernel
def _flight_rate(
    t: float, y: Floats, kind: int, table: Floats, airframe: Airframe, law: TrackerLaw
) -> Floats:
    """A quadrotor flown along the trajectory, whose four derivatives are exact."""
    rate = np.empty_like(y)
    b = unit_attitude(_load_body(y))
    _store_body(rate, flown(b, evaluate(kind, table, t), airframe, law))
    return rate


class History(NamedTuple):
    """What the tracker computes along a flight, at T times."""

    thrust: Floats  # (T,) N
    alignment: Floats  # (T,) r3 . r3d
    lyapunov: Floats  # (T,) V4
    lyapunov_rate: Floats  # (T,) V4_dot
    e1: Floats  # (T, 3) m
    e2: Floats  # (T, 3) m/s
    e3: Floats  # (T, 3)
    e4: Floats  # (T, 3) rad/s


@kernel
def _fill_history(
    t: Floats,
    y: Floats,
    kind: int,
    table: Floats,
    airframe: Airframe,
    law: TrackerLaw,
    history: History,
) -> None:
    """Fill in the history of the states `y` `(T, 13)`."""
    for k in range(len(t)):
        ref = evaluate(kind, table, t[k])
        m = _motion(unit_attitude(_load_body(y[k])))
        v = certificate(m, ref, law)
        e = tracker_errors(m, ref, law)
        history.thrust[k] = torque(m, ref, airframe.mass, law).thrust
        history.alignment[k] = dot(m.R[2], pointing(m, tracker_outer(m, ref, law), law).r3d)
        history.lyapunov[k], history.lyapunov_rate[k] = v.V4, v.V4_dot
        for i in range(3):
            history.e1[k, i], history.e2[k, i] = e.e1[i], e.e2[i]
            history.e3[k, i], history.e4[k, i] = e.e3[i], e.e4[i]


def flight(duration: float = 30.0, step: float = 0.01) -> Flight:
    """III-C, controller test: a vehicle released upside down, far from the trajectory (31)."""
    t = grid(duration, step)
    fixed = (EIGHT.kind, EIGHT.table, AIRFRAME, TRACKER.law())
    y = integrate(_flight_rate, np.array(flatten(UPSIDE_DOWN)), t, *fixed)
    n = len(t)
    h = History(*(np.empty(n) for _ in range(4)), *(np.empty((n, 3)) for _ in range(4)))
    _fill_history(t, y, *fixed, h)
    body = columns(Body, y)
    q = body["q"] / np.linalg.norm(body["q"], axis=1, keepdims=True)
    path = EIGHT(t)[:, 0]
    return Flight(t, body["p"], q, path, **h._asdict())
