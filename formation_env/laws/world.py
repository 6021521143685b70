"""One vehicle at one instant: the constants of a world, and what joins the laws to each other.

Nothing here touches memory; `tick` says in which order things happen, `task` what a policy is shown and
what it is paid for.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import NamedTuple

from formation_env._jit import device
from formation_env.laws.slots import Slot
from formation_env.laws.tracker import (
    Motion,
    TrackerLaw,
    rate_command,
    rate_command_through_lag,
    torque,
)
from formation_env.maths.rng import START, normals, uniforms
from formation_env.maths.so3 import (
    Quaternion,
    Vector,
    add_scaled,
    dot,
    multiply,
    norm,
    rotation,
    scale,
    shortest_arc,
    sub,
)
from formation_env.paths.course import Courses
from formation_env.physics.disturbances import Parameters
from formation_env.physics.quadrotor import (
    GRAVITY,
    MOMENT,
    Airframe,
    Body,
    Wrench,
    moment,
    saturate,
)
from formation_env.physics.sensors import ANYWHERE as ANYWHERE  # bounds of what is observed
from formation_env.physics.sensors import NEAR as NEAR
from formation_env.physics.sensors import RATE_BOUND as RATE_BOUND
from formation_env.physics.sensors import UNIT as UNIT
from formation_env.physics.sensors import Measured, Noise
from formation_env.trajectories import TrajectoryPoint

Action = tuple[float, float, float, float]

# Most ticks in an episode: a float counts them exactly, and a random draw's counter holds the number of the
# sample with up to 1,000 substeps, and measurements, in each. At 50 Hz it is 700 years.
MAX_TICKS = 2**40


class Clock(NamedTuple):
    """The rhythms of a world, all whole numbers of substeps."""

    period: float  # s, one control tick
    substeps: int  # Runge-Kutta steps in it
    sample_every: int  # substeps between two measurements
    delay: int  # samples by which measurements are late
    window: int  # samples in the moving average of the acceleration; 0: velocities are measured


@device
def every_tick(clock: Clock) -> bool:
    """Whether every tick ends with a measurement that is at once in hand."""
    return clock.window == 0 and clock.delay == 0 and clock.sample_every == clock.substeps


class Reach(NamedTuple):
    """What the actions +-1 mean."""

    thrust: float  # N at +1; -1 is no thrust
    turn: Vector  # N m or rad/s at +1
    acceleration: Vector  # m/s^2 at +1, formation frame


class World(NamedTuple):
    """Everything that is constant during an episode, for the kernels."""

    airframe: Airframe
    tracker: TrackerLaw  # of vehicles driven by moments
    rates_tracker: TrackerLaw  # of vehicles driven by rates
    noise: Noise
    clock: Clock
    reach: Reach
    disturbances: Parameters
    leader_actuation: int
    follower_actuation: int
    level: int  # an index into `levels.LEVELS`
    trigger: float  # m, e_max of (40)
    on_ground: int  # whether an episode starts on the floor
    start_offset: float  # m, radius of the ball a follower starts in, around its slot
    courses: Courses  # how the leader's path may lie


@device
def motion(m: Measured) -> Motion:
    """What the tracker wants to know, from a measurement."""
    return Motion(m.p, m.v, rotation(m.q), m.w)


@device
def track(m: Motion, ref: TrajectoryPoint, actuation: int, world: World) -> Wrench:
    """The tracker's command for the given actuation, not yet limited: (54) with (67)+(46), or rates."""
    airframe = world.airframe
    if actuation == MOMENT:
        t = torque(m, ref, airframe.mass, world.tracker)
        return Wrench(t.thrust, moment(t.tau, m.w, airframe.inertia))
    r = rate_command_through_lag(m, ref, airframe.mass, world.rates_tracker, airframe.rate_lag)
    return Wrench(r.thrust, r.w)


@device
def follow(ref: TrajectoryPoint, own: Measured, world: World, actuation: int) -> Wrench:
    """What the actuators of a vehicle do that the tracker flies along a reference, from its measurement."""
    return saturate(track(motion(own), ref, actuation, world), actuation, world.airframe)


@device
def hold_at(p: Vector) -> TrajectoryPoint:
    """A reference that waits at a point: before the trigger (40)."""
    o = (0.0, 0.0, 0.0)
    return TrajectoryPoint(p, o, o, o, o)


@device
def start_yaw(key: int, who: int, world: World) -> float:
    """The angle about its own third axis that a vehicle begins with, rad: uniform, or zero (`Courses`)."""
    if world.courses.drawn == 0:
        return 0.0
    return pi * (2.0 * uniforms(key, START, who, 0, 1)[1] - 1.0)


@device
def yawed(q: Quaternion, angle: float) -> Quaternion:
    """An attitude turned by `angle` (rad) about its own third axis."""
    if angle == 0.0:
        return q
    return multiply(q, (cos(0.5 * angle), 0.0, 0.0, sin(0.5 * angle)))


@device
def resting(p: Vector, yaw: float) -> Body:
    """A vehicle at rest and level, at a yaw angle (rad)."""
    return Body(p, (0.0, 0.0, 0.0), yawed((1.0, 0.0, 0.0, 0.0), yaw), (0.0, 0.0, 0.0))


@device
def trimmed(ref: TrajectoryPoint, yaw: float, world: World) -> Body:
    """A vehicle that already flies along `ref` with null tracker errors `e1` to `e4`.

    Turned by `yaw` (rad) about its third axis from the attitude nearest to the level one of yaw zero.
    """
    b = (-ref.a[0], -ref.a[1], GRAVITY - ref.a[2])
    q = yawed(shortest_arc(scale(1.0 / norm(b), b)), yaw)
    m = Motion(ref.p, ref.v, rotation(q), (0.0, 0.0, 0.0))
    return Body(ref.p, ref.v, q, rate_command(m, ref, world.airframe.mass, world.tracker).w)


@device
def near(slot: Slot, key: int, who: int, world: World) -> Body:
    """A level vehicle moving along with its slot, somewhere in a ball around it (uniform)."""
    n = normals(key, START, who, 0, 0)
    u = uniforms(key, START, who, 0, 1)
    a = (n[0], n[1], n[2])
    radius = world.start_offset * u[0] ** (1.0 / 3.0) / norm(a)
    q = yawed((1.0, 0.0, 0.0, 0.0), start_yaw(key, who, world))
    return Body(add_scaled(slot.p, radius, a), slot.v, q, (0.0, 0.0, 0.0))


@device
def within(p: Vector, target: Vector, radius: float) -> bool:
    """One term of the trigger (40): `|e1| < e_max`."""
    e = sub(p, target)
    return dot(e, e) < radius * radius
