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
from formation_env.laws.gains import PlannerGains, TrackerGains
from formation_env.laws.planner import PlanarErrors, PlannerLaw, Virtual, plane
from formation_env.laws.planner import derivative as planner_derivative
from formation_env.laws.planner import errors as planner_errors
from formation_env.laws.tracker import Motion, TrackerLaw, certificate, pointing, torque
from formation_env.laws.tracker import errors as tracker_errors
from formation_env.laws.tracker import outer as tracker_outer
from formation_env.maths.so3 import ZERO, Vector, dot, normalise, rotation
from formation_env.memory.records import flatten, line_loader, line_storer, size, slices
from formation_env.paths.references import Floats, TrajectoryPoint, by_name, evaluate
from formation_env.physics.quadrotor import MOMENT, Airframe, Body, Wrench, moment
from formation_env.physics.quadrotor import derivative as body_derivative
from formation_env.trajectories import Trajectory, figure_eight

TOLERANCE = 1e-9

# Trajectory (31): at h = -1.5 m in III-C, in the plane in II-D, where the height plays no part.
EIGHT = figure_eight()

# III-C's vehicle; thrust and moment without limits, the thrust negative while upside down.
AIRFRAME = Airframe(0.1, (1e-3, 1e-3, 2e-3), -inf, inf, (inf, inf, inf), (inf, inf, inf), 0.05)


class PlanarState(NamedTuple):
    """State of a virtual follower without its height; fields as in `Virtual`."""

    p: complex  # m
    theta: float  # rad, not wrapped
    u: float  # m/s
    omega: float  # rad/s
    xi: complex  # m s


# II-D: gains, offsets (no height) and initial states.
PLANNER = PlannerGains(k1=0.2, k2=2.0, k3=0.0, p_max=5.0)
OFFSETS = ((0.35, 0.35, 0.0), (0.35, -0.35, 0.0))
STARTS = (
    PlanarState(3.0 + 3.0j, 1.5 * pi, 0.5, -0.5, 0j),
    PlanarState(3.0 + 1.0j, 0.0, 0.0, 0.5, 0j),
)

# III-C: upside down (phi = pi), at rest.
TRACKER = TrackerGains()
UPSIDE_DOWN = Body((-5.0, 10.0, -10.0), ZERO, (0.0, 1.0, 0.0, 0.0), ZERO)


class FlightErrors(NamedTuple):
    """What figures 4 and 5 show at one instant; as in `Flight`."""

    thrust: float
    alignment: float
    lyapunov: float
    lyapunov_rate: float
    e1: Vector
    e2: Vector
    e3: Vector
    e4: Vector


_read_planar, _write_planar = line_loader(PlanarState), line_storer(PlanarState)
_PLANAR = size(PlanarState)
_write_planar_errors, _PLANAR_ERRORS = line_storer(PlanarErrors), size(PlanarErrors)
_read_body, put_body, BODY = line_loader(Body), line_storer(Body), size(Body)
_write_flight_errors, _FLIGHT_ERRORS = line_storer(FlightErrors), size(FlightErrors)


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


def fields_of(kind: type, lines: Floats) -> dict[str, Floats]:
    """The numbers of records, which lie along the last axis, by field: `(...)` for a single number."""
    named = {name: lines[..., where] for name, where in slices(kind).items()}
    return {name: x[..., 0] if x.shape[-1] == 1 else x for name, x in named.items()}


@device
def vector(x: Any) -> Vector:
    """The three components `x` of a vector."""
    return (x[0], x[1], x[2])


# -- figures 2 and 3 --------------------------------------------------------------------------------


@device
def _virtual(y: Any, height: float) -> Virtual:
    """A virtual follower in the plane, waiting at its height (`d_z = 0`)."""
    s = _read_planar(y)
    return Virtual(s.p, s.theta, s.u, s.omega, s.xi, height, 0.0)


@kernel
def _planar_rate(
    t: float, y: Floats, kind: int, table: Floats, offsets: Floats, law: PlannerLaw
) -> Floats:
    """Virtual followers behind a leader that is the trajectory itself: (2)-(5), (18) under (21)."""
    leader = evaluate(kind, table, t)
    rate = np.empty_like(y)
    for i in range(len(offsets)):
        k = _PLANAR * i
        f = _virtual(y[k : k + _PLANAR], leader.p[2])
        r = planner_derivative(f, leader, vector(offsets[i]), law)
        _write_planar(rate[k : k + _PLANAR], PlanarState(r.p, r.theta, r.u, r.omega, r.xi))
    return rate


@kernel
def _planar_errors(
    t: Floats, y: Floats, kind: int, table: Floats, offsets: Floats, law: PlannerLaw
) -> Floats:
    """`PlanarErrors` of each follower at each time, `(T, n, 4)`."""
    out = np.empty((len(t), len(offsets), _PLANAR_ERRORS))
    for k in range(len(t)):
        leader = evaluate(kind, table, t[k])
        for i in range(len(offsets)):
            f = _virtual(y[k, _PLANAR * i : _PLANAR * (i + 1)], leader.p[2])
            e = planner_errors(f, plane(leader.p), plane(leader.v), plane(vector(offsets[i])), law)
            _write_planar_errors(out[k, i], e)
    return out


def planar(duration: float = 60.0, step: float = 0.02, path: Trajectory = EIGHT) -> Planar:
    """II-D: two virtual followers behind a leader on (31), from their printed initial states.

    `path` is another trajectory for the leader.
    """
    t = grid(duration, step)
    fixed = (path.kind, path.table, np.array(OFFSETS), PLANNER.law())
    y = integrate(_planar_rate, np.array(flatten(STARTS)), t, *fixed)
    errors = fields_of(PlanarErrors, _planar_errors(t, y, *fixed))
    x = fields_of(PlanarState, y.reshape(len(t), len(OFFSETS), _PLANAR))
    leader = by_name(path(t))["p"][:, :2]
    return Planar(t, leader, x["p"], x["theta"], x["u"], x["omega"], **errors)


# -- figures 4 and 5 --------------------------------------------------------------------------------


@device
def body_of(y: Any) -> Body:
    """The vehicle of a line of numbers; normalising takes off what the integrator adds to `|q| = 1`."""
    b = _read_body(y)
    return Body(b.p, b.v, normalise(b.q), b.w)


@device
def _motion(b: Body) -> Motion:
    return Motion(b.p, b.v, rotation(b.q), b.w)


@device
def flown(b: Body, ref: TrajectoryPoint, airframe: Airframe, law: TrackerLaw) -> Body:
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
    put_body(rate, flown(body_of(y), evaluate(kind, table, t), airframe, law))
    return rate


@kernel
def _flight_history(
    t: Floats, y: Floats, kind: int, table: Floats, airframe: Airframe, law: TrackerLaw
) -> Floats:
    """`FlightErrors` at each time, `(T, 16)`."""
    out = np.empty((len(t), _FLIGHT_ERRORS))
    for k in range(len(t)):
        ref = evaluate(kind, table, t[k])
        m = _motion(body_of(y[k]))
        v = certificate(m, ref, law)
        e = tracker_errors(m, ref, law)
        thrust = torque(m, ref, airframe.mass, law).thrust
        alignment = dot(m.R[2], pointing(m, tracker_outer(m, ref, law), law).r3d)
        now = FlightErrors(thrust, alignment, v.V4, v.V4_dot, e.e1, e.e2, e.e3, e.e4)
        _write_flight_errors(out[k], now)
    return out


def flight(duration: float = 30.0, step: float = 0.01) -> Flight:
    """III-C, controller test: a vehicle released upside down, far from the trajectory (31)."""
    t = grid(duration, step)
    fixed = (EIGHT.kind, EIGHT.table, AIRFRAME, TRACKER.law())
    y = integrate(_flight_rate, np.array(flatten(UPSIDE_DOWN)), t, *fixed)
    errors = fields_of(FlightErrors, _flight_history(t, y, *fixed))
    x = fields_of(Body, y)
    q = x["q"] / np.linalg.norm(x["q"], axis=1, keepdims=True)
    return Flight(t, x["p"], q, by_name(EIGHT(t))["p"], **errors)
