"""One world, one tick: the paper's block diagram as code.

    leader's reference --> tracker --> actuators --> leader's body --> sensors --+
                                                                                 |
    +----------------------------------------------------------------------------+
    |  what the followers know of the leader
    v
    action --> (virtual follower --> tracker) --> actuators --> follower's body --> sensors
                                                                                 |
    slots: where the followers should be, from the leader's true motion <--------+

Everything here concerns one vehicle at one instant and touches no memory; `simulation` holds the
arrays and the loops, `task` says what a policy sees and what it is paid for.
"""

from __future__ import annotations

from typing import NamedTuple

from formation_env._jit import device
from formation_env.quadrotor import (
    GRAVITY,
    MOMENT,
    Airframe,
    Body,
    Wrench,
    acceleration,
    moment,
)
from formation_env.rng import GUST, START, normals, uniforms
from formation_env.sensors import Measured, Noise
from formation_env.slots import Slot, out_of_frame
from formation_env.so3 import (
    Vector,
    add_scaled,
    dot,
    norm,
    rotation,
    scale,
    shortest_arc,
    sub,
)
from formation_env.tracker import Motion, TrackerLaw, rate_command, rate_command_through_lag, torque
from formation_env.trajectories import Reference

Action = tuple[float, float, float, float]

WRENCH, RATE, REFERENCE = 0, 1, 2  # what a policy commands

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


class Gusts(NamedTuple):
    """A random acceleration from outside: a first-order Gauss-Markov process per vehicle."""

    keep: float  # share kept from one tick to the next, exp(-period / correlation time)
    kick: float  # m/s^2, standard deviation of what is added


class Guide(NamedTuple):
    """The virtual follower of the `reference` action level: a point that the action accelerates."""

    p: Vector  # m, inertial
    v: Vector  # m/s, inertial


class World(NamedTuple):
    """Everything that is constant during an episode, for the kernels."""

    airframe: Airframe
    tracker: TrackerLaw  # of vehicles driven by moments
    rates_tracker: TrackerLaw  # of vehicles driven by rates
    noise: Noise
    clock: Clock
    reach: Reach
    gusts: Gusts
    leader_actuation: int
    follower_actuation: int
    level: int  # WRENCH, RATE or REFERENCE
    trigger: float  # m, e_max of (40)
    on_ground: int  # whether an episode starts on the floor
    start_offset: float  # m, radius of the ball a follower starts in, around its slot


@device
def motion(m: Measured) -> Motion:
    """What the tracker wants to know, from a measurement."""
    return Motion(m.p, m.v, rotation(m.q), m.w)


@device
def track(m: Motion, ref: Reference, actuation: int, world: World) -> Wrench:
    """The tracker's command for the given actuation, not yet limited: (54) with (67)+(46), or rates."""
    airframe = world.airframe
    if actuation == MOMENT:
        t = torque(m, ref, airframe.mass, world.tracker)
        return Wrench(t.thrust, moment(t.tau, m.w, airframe.inertia))
    r = rate_command_through_lag(m, ref, airframe.mass, world.rates_tracker, airframe.rate_lag)
    return Wrench(r.thrust, r.w)


@device
def guided(action: Action, guide: Guide, R: complex, world: World) -> Reference:
    """The trajectory of a virtual follower that the action accelerates; no jerk, no snap.

    `R` is the heading that the follower estimates: the action is in its formation frame.
    """
    s = world.reach.acceleration
    a = out_of_frame(R, (s[0] * action[0], s[1] * action[1], s[2] * action[2]))
    return Reference(guide.p, guide.v, a, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@device
def driven(action: Action, world: World) -> Wrench:
    """What an action in [-1, 1] asks of the actuators at the levels WRENCH and RATE."""
    r = world.reach
    turn = (r.turn[0] * action[1], r.turn[1] * action[2], r.turn[2] * action[3])
    return Wrench(0.5 * r.thrust * (action[0] + 1.0), turn)


@device
def guide_on(guide: Guide, a: Vector, h: float) -> Guide:
    """A virtual follower `h` seconds later at constant acceleration `a`, exactly."""
    p = add_scaled(add_scaled(guide.p, h, guide.v), 0.5 * h * h, a)
    return Guide(p, add_scaled(guide.v, h, a))


@device
def gust(before: Vector, gusts: Gusts, key: int, who: int, tick: int) -> Vector:
    """The next sample of the gust on one vehicle, m/s^2, held during a tick."""
    if gusts.kick == 0.0:
        return before
    n = normals(key, GUST, who, tick, 0)
    return (
        gusts.keep * before[0] + gusts.kick * n[0],
        gusts.keep * before[1] + gusts.kick * n[1],
        gusts.keep * before[2] + gusts.kick * n[2],
    )


@device
def truth(
    body: Body, applied: Wrench, push: Vector, touching: bool, airframe: Airframe
) -> Measured:
    """What perfect sensors would read. The acceleration is the one under the thrust now applied."""
    a = (0.0, 0.0, 0.0)
    if not touching:
        a = acceleration(body.q, applied.thrust, push, airframe)
    return Measured(body.p, body.v, a, body.q, body.w)


@device
def hold_at(p: Vector) -> Reference:
    """A reference that waits at a point: before the trigger (40)."""
    o = (0.0, 0.0, 0.0)
    return Reference(p, o, o, o, o)


@device
def resting(p: Vector) -> Body:
    """A vehicle at rest and level, yaw zero."""
    return Body(p, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@device
def trimmed(ref: Reference, world: World) -> Body:
    """A vehicle that already flies along `ref` with null tracker errors `e1` to `e4`."""
    b = (-ref.a[0], -ref.a[1], GRAVITY - ref.a[2])
    q = shortest_arc(scale(1.0 / norm(b), b))
    m = Motion(ref.p, ref.v, rotation(q), (0.0, 0.0, 0.0))
    return Body(ref.p, ref.v, q, rate_command(m, ref, world.airframe.mass, world.tracker).w)


@device
def near(slot: Slot, key: int, who: int, world: World) -> Body:
    """A level vehicle moving along with its slot, somewhere in a ball around it (uniform)."""
    n = normals(key, START, who, 0, 0)
    u = uniforms(key, START, who, 0, 1)
    a = (n[0], n[1], n[2])
    radius = world.start_offset * u[0] ** (1.0 / 3.0) / norm(a)
    return Body(add_scaled(slot.p, radius, a), slot.v, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@device
def within(p: Vector, target: Vector, radius: float) -> bool:
    """One term of the trigger (40): `|e1| < e_max`."""
    e = sub(p, target)
    return dot(e, e) < radius * radius
