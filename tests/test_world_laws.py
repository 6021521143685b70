"""The laws of one vehicle at one instant, each alone, against mechanics and the paper's theorems."""

from __future__ import annotations

import numpy as np
import pytest
from closed_loop import (
    PROPERTY,
    Array,
    Sines,
    agree,
    hat,
    numbers,
    quaternions,
    rate,
    vector,
    vectors,
)
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from formation_env import Vehicle, configure
from formation_env.laws import levels, tracker, world
from formation_env.laws.levels import Guide
from formation_env.laws.slots import Slot
from formation_env.laws.world import Clock, Reach, World
from formation_env.maths import so3
from formation_env.maths.so3 import Quaternion, Vector
from formation_env.paths.course import Courses
from formation_env.physics import quadrotor, sensors
from formation_env.physics.quadrotor import GRAVITY, MOMENT, RATES, Body, Wrench
from formation_env.physics.sensors import Measured
from formation_env.trajectories import TrajectoryPoint

# No two numbers alike and none special, so that none can stand for another.
FRAME = Vehicle(mass=0.13, inertia=(1.1e-3, 0.9e-3, 1.7e-3), rate_lag=0.07).airframe()
WORLD: World = configure().world._replace(
    airframe=FRAME,
    tracker=configure().tracker.law()._replace(k3=4.0, k4=0.9),
    rates_tracker=configure().rates_tracker.law(),
    reach=Reach(2.9, (0.05, 0.04, 0.02), (4.0, 3.0, 2.0)),
    start_offset=0.4,
)
ACTIONS = st.tuples(*[numbers(1.0)] * 4)
SEEDS = st.integers(0, 20)


def matrix(q: Quaternion) -> Array:
    return np.asarray(Rotation.from_quat([q[1], q[2], q[3], q[0]]).as_matrix())


def turned(angle: float, a: Vector) -> Array:
    """`R a` with the rotation (1) in the plane, height unchanged."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ a


# -- what an action asks for ----------------------------------------------------------------------------


@PROPERTY
@given(ACTIONS)
def test_a_driven_action_spans_what_the_actuators_reach(action: world.Action) -> None:
    """-1 is no thrust, 0 half of it and +1 all, in proportion; turns are in proportion too."""
    found = levels.driven(action, WORLD)
    agree(found.thrust, np.interp(action[0], [-1.0, 0.0, 1.0], [0.0, 1.45, 2.9]), 1e-14)
    agree(found.turn, np.diag([0.05, 0.04, 0.02]) @ action[1:], 1e-15)


@PROPERTY
@given(ACTIONS, vectors(3.0), vectors(3.0), numbers(3.0))
def test_a_guided_action_accelerates_in_the_formation_frame(
    action: world.Action, p: Vector, v: Vector, heading: float
) -> None:
    R = complex(np.cos(heading), np.sin(heading))
    ref = levels.guided(action, Guide(p, v), R, WORLD)
    assert (ref.p, ref.v) == (p, v)
    agree(ref.a, turned(heading, vector(np.diag([4.0, 3.0, 2.0]) @ action[:3])), 1e-14)
    assert ref.j == ref.s == so3.ZERO


@PROPERTY
@given(vectors(3.0), vectors(3.0), vectors(4.0), st.floats(0.01, 2.0))
def test_a_guide_falls_as_a_stone_does(p: Vector, v: Vector, a: Vector, h: float) -> None:
    """Under a constant acceleration its energy `|v|^2 / 2 - a . p` stays, and `v` grows by `h a`."""
    after = levels.guide_on(Guide(p, v), a, h)
    agree(np.subtract(after.v, v), h * np.array(a), 1e-13)
    for axis in range(3):
        before = 0.5 * v[axis] ** 2 - a[axis] * p[axis]
        agree(0.5 * after.v[axis] ** 2 - a[axis] * after.p[axis], before, 1e-12)


@PROPERTY
@given(vectors(3.0), vectors(3.0), vectors(4.0), st.floats(0.01, 2.0), st.floats(0.01, 2.0))
def test_two_steps_of_a_guide_are_one(p: Vector, v: Vector, a: Vector, h: float, k: float) -> None:
    twice = levels.guide_on(levels.guide_on(Guide(p, v), a, h), a, k)
    once = levels.guide_on(Guide(p, v), a, h + k)
    agree([*twice.p, *twice.v], [*once.p, *once.v], 1e-13)


# -- the tracker at its actuators -----------------------------------------------------------------------

STATES = st.tuples(vectors(4.0), vectors(2.0), quaternions(), vectors(2.0))


@PROPERTY
@given(STATES)
def test_motion_holds_the_rotation_matrix(x: tuple[Vector, Vector, Quaternion, Vector]) -> None:
    p, v, q, w = x
    m = world.motion(Measured(p, v, (9.0, 9.0, 9.0), q, w))
    assert (m.p, m.v, m.w) == (p, v, w)
    agree(np.array(m.R).T, matrix(q), 1e-13)


@PROPERTY
@given(STATES, SEEDS)
def test_a_moment_brings_about_the_torque(
    x: tuple[Vector, Vector, Quaternion, Vector], seed: int
) -> None:
    """(46) cancels the gyroscopic moment of (44): `omega_dot` is the tracker's (67)."""
    m = world.motion(Measured(x[0], x[1], so3.ZERO, x[2], x[3]))
    ref = TrajectoryPoint(*Sines(seed).at(0.3))
    command = world.track(m, ref, MOMENT, WORLD)
    wanted = tracker.torque(m, ref, FRAME.mass, WORLD.tracker)
    assert command.thrust == wanted.thrust
    J, w = np.diag(FRAME.inertia), np.array(m.w)
    w_dot = np.linalg.solve(J, np.array(command.turn) - hat(w) @ J @ w)
    agree(w_dot, wanted.tau, 1e-10)


@PROPERTY
@given(STATES, SEEDS)
def test_a_rate_command_drives_e4_to_zero_through_the_lag(
    x: tuple[Vector, Vector, Quaternion, Vector], seed: int
) -> None:
    """With the rates' own gains and the vehicle's lag: `e4_dot = -e4 / rate_lag` (65)."""
    leader, law = Sines(seed), WORLD.rates_tracker
    start = np.array([*x[0], *x[1], *x[2], *x[3], 0.3])

    def at(y: Array) -> tuple[tracker.Motion, TrajectoryPoint]:
        q = so3.normalise(vector(y[6:10]))
        m = Measured(vector(y[:3]), vector(y[3:6]), so3.ZERO, q, vector(y[10:13]))
        return world.motion(m), TrajectoryPoint(*leader.at(y[13]))

    command = world.track(*at(start), RATES, WORLD)
    body = Body(x[0], x[1], x[2], x[3])
    x_dot = quadrotor.derivative(body, command, so3.ZERO, RATES, FRAME)
    flow = np.array([*x_dot.p, *x_dot.v, *x_dot.q, *x_dot.w, 1.0])

    def e4(y: Array) -> Array:
        return np.array(tracker.errors(*at(y), law).e4)

    agree(rate(e4, start, flow, 1e-4), -e4(start) / FRAME.rate_lag, 1e-6)


# -- the start ------------------------------------------------------------------------------------------


@PROPERTY
@given(SEEDS, st.floats(0.0, 5.0), numbers(np.pi))
def test_a_trimmed_vehicle_has_no_tracker_error(seed: int, t: float, yaw: float) -> None:
    """All of (48), (49), (62), (65) are zero, and the thrust (54) gives the path's acceleration."""
    ref = TrajectoryPoint(*Sines(seed).at(t))
    body = world.trimmed(ref, yaw, WORLD)
    m = world.motion(Measured(body.p, body.v, so3.ZERO, body.q, body.w))
    agree(np.concatenate(tracker.errors(m, ref, WORLD.tracker)), np.zeros(12), 1e-12)
    thrust = tracker.torque(m, ref, FRAME.mass, WORLD.tracker).thrust
    agree(GRAVITY * np.array([0.0, 0.0, 1.0]) - thrust / FRAME.mass * matrix(body.q)[:, 2], ref.a)
    straight = matrix(world.trimmed(ref, 0.0, WORLD).q)
    agree(straight[1, 0], straight[0, 1], 1e-12)  # the nearest to level turns about no third axis
    agree(matrix(body.q), straight @ Rotation.from_rotvec([0.0, 0.0, yaw]).as_matrix(), 1e-12)


def test_starts_fill_a_ball_evenly() -> None:
    """`(r / radius)^3` is uniform, every direction and yaw alike, at the slot's velocity, level and calm."""
    slot = Slot((1.0, 2.0, -3.0), (0.3, -0.2, 0.1))
    bodies = [world.near(slot, key, 3, WORLD) for key in range(3000)]
    away = np.array([body.p for body in bodies]) - slot.p
    r = np.linalg.norm(away, axis=1)
    assert stats.kstest((r / WORLD.start_offset) ** 3, "uniform").pvalue > 1e-3
    for axis in range(3):  # Archimedes: each component of a random direction is uniform
        assert stats.kstest(away[:, axis] / r, "uniform", (-1.0, 2.0)).pvalue > 1e-3
    assert np.abs(np.corrcoef(away.T) - np.eye(3)).max() < 0.08
    assert abs(np.corrcoef(r, away[:, 2] / r)[0, 1]) < 0.08
    assert {(body.v, *body.q[1:3], body.w) for body in bodies} == {(slot.v, 0.0, 0.0, so3.ZERO)}
    yaw = 2.0 * np.arctan2([body.q[3] for body in bodies], [body.q[0] for body in bodies])
    yaw = (yaw + np.pi) % (2.0 * np.pi) - np.pi
    assert stats.kstest(yaw, "uniform", (-np.pi, 2.0 * np.pi)).pvalue > 1e-3
    assert np.abs(np.corrcoef([yaw, r, *away.T])[0, 1:]).max() < 0.08
    assert world.near(slot, 5, 1, WORLD) != world.near(slot, 5, 2, WORLD)
    assert len({world.start_yaw(key, who, WORLD) for key in range(4) for who in range(4)}) == 16
    straight = world.near(slot, 5, 1, WORLD._replace(courses=Courses(0, 0, 0)))
    assert straight == world.near(slot, 5, 1, WORLD)._replace(q=so3.IDENTITY)


@PROPERTY
@given(vectors(3.0), numbers(np.pi))
def test_waiting_and_resting_are_without_motion(p: Vector, yaw: float) -> None:
    assert world.hold_at(p) == TrajectoryPoint(p, so3.ZERO, so3.ZERO, so3.ZERO, so3.ZERO)
    assert world.resting(p, 0.0) == Body(p, so3.ZERO, so3.IDENTITY, so3.ZERO)
    turned_body = world.resting(p, yaw)
    assert turned_body._replace(q=so3.IDENTITY) == world.resting(p, 0.0)
    agree(matrix(turned_body.q) @ (1.0, 2.0, 3.0), turned(yaw, (1.0, 2.0, 3.0)), 1e-14)


@PROPERTY
@given(vectors(3.0), vectors(1.0), st.floats(0.1, 2.0), st.floats(0.5, 1.5))
def test_a_vehicle_is_within_a_ball(p: Vector, d: Vector, radius: float, part: float) -> None:
    """One term of (40): `|e1| < e_max`, not the same along each axis."""
    size = np.linalg.norm(d)
    if size < 1e-3 or abs(part - 1.0) < 1e-9:
        return
    target = vector(np.array(p) + part * radius / size * np.array(d))
    assert world.within(p, target, radius) == (part < 1.0)
    assert not world.within((0.0, 0.0, 0.0), (radius, 0.0, 0.0), radius)


# -- what perfect sensors read ----------------------------------------------------------------------


@PROPERTY
@given(STATES, st.floats(0.0, 3.0), vectors(1.0))
def test_perfect_sensors_read_the_rate_of_the_velocity(
    x: tuple[Vector, Vector, Quaternion, Vector], thrust: float, push: Vector
) -> None:
    """Within an instant of flight, `v` changes by the acceleration measured; on the floor by none."""
    body, applied = Body(*x), Wrench(thrust, so3.ZERO)
    read = sensors.truth(body, applied, push, False, FRAME)
    assert (read.p, read.v, read.q, read.w) == x
    h = 1e-6
    after = quadrotor.fly(body, applied, push, h, MOMENT, FRAME)
    agree(read.a, np.subtract(after.v, body.v) / h, 1e-3)
    assert sensors.truth(body, applied, push, True, FRAME).a == so3.ZERO


@pytest.mark.parametrize(
    ("changed", "every"),
    [({}, True), ({"window": 3}, False), ({"delay": 1}, False), ({"sample_every": 3}, False)],
)
def test_every_tick_is_measured_at_once(changed: dict[str, int], every: bool) -> None:
    """Only without an average, without a delay, and with as many measurements as ticks."""
    assert world.every_tick(Clock(0.02, 4, 4, 0, 0)._replace(**changed)) == every
