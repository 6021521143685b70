"""The expert's decision for a tile of followers, side by side in vector code.

As `formation_env.core.flight` does it for worlds: the mathematics is that of `planner`, `feedforward` and
`tracker`, inlined, in loops over the `LANES` followers of a tile; nothing in them is called or
branches. A tile holds number after number, each in all lanes, whatever worlds the followers are in.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.policies.actions import clipped_or_zero
from baselines.policies.base import Rows
from formation_env._compiling import announced
from formation_env._jit import device, kernel, loop
from formation_env.laws.feedforward import full_trajectory_point
from formation_env.laws.levels import REFERENCE, Guide, acceleration_action, wrench_action
from formation_env.laws.planner import PlannerLaw, Virtual, advance, place, scaled, trajectory_point
from formation_env.laws.slots import in_frame, out_of_frame
from formation_env.laws.tracker import Motion
from formation_env.laws.world import Action, Reach, World, track
from formation_env.maths.elementary import phase, pick
from formation_env.maths.so3 import ZERO, Vector, add, cross, pick_vector, scale, sub
from formation_env.memory.records import (
    LANES,
    at,
    define,
    keeper,
    line_loader,
    loader,
    parts,
    size,
    storer,
)
from formation_env.memory.shuffles import carve, gather, reinterpret
from formation_env.paths.references import TrajectoryPoint
from formation_env.physics.quadrotor import MOMENT, RATES
from formation_env.task import Observation

Floats = NDArray[np.float64]

_LANES = np.uint64(LANES)


class Guided(NamedTuple):
    """A follower's row at level REFERENCE, without its neighbours."""

    observation: Observation
    guide: Guide  # the environment's virtual follower, relative to the vehicle, {F}


class Measurements(NamedTuple):
    """What an observation was made of, in the inertial frame."""

    motion: Motion  # of the vehicle itself
    leader: TrajectoryPoint  # jerk and snap, which nothing measures, are zero
    heading: complex  # exp(j theta) of the estimated theta
    offset: Vector  # d, m, {F}
    started: bool  # whether the trigger (40) has fired


load_observation, load_guided = loader(Observation), loader(Guided)
load_virtual, keep_virtual = loader(Virtual), keeper(Virtual)
load_point, _store_point = loader(TrajectoryPoint), storer(TrajectoryPoint)
_store_action, _store_vector = storer(Action), storer(Vector)
planner_law, read_world = line_loader(PlannerLaw), line_loader(World)

# Rows of a tile: of virtual followers, of their trajectories, of actions, of what is read of observations.
VIRTUAL, _TRAJECTORY, _ACTION = size(Virtual), size(TrajectoryPoint), size(Action)
OBSERVED, _GUIDED = size(Observation), size(Guided)
# Where in a tile of virtual followers it says, by NaN, that one waits for its start.
WAITS = np.uint64(at(Virtual, "p") * LANES)
# Where a virtual follower counts as lost: m, rad, m/s, rad/s, m s. Flights stay far below, and the powers
# of it that the laws take stay far from where float64 ends.
FAR = 1e6
# Numbers of room for one tile of each but the first, the observations and a square of them in float32.
ROOM = (_TRAJECTORY + _ACTION + 1) * LANES + _GUIDED * LANES // 2


class Room(NamedTuple):
    """Where one tile is worked on."""

    points: Floats  # (_TRAJECTORY L,)
    actions: Floats  # (_ACTION L,)
    rows: Rows  # (_GUIDED L,)
    starts: NDArray[np.int64]  # (L,): where a piece of each row begins


@device
def measurements(o: Observation) -> Measurements:
    """The measurements behind an observation, which is a change of frame that is undone here."""
    R = complex(o.heading[0], o.heading[1])
    v_L = out_of_frame(R, o.leader_velocity)
    v = sub(v_L, out_of_frame(R, o.relative_velocity))
    p_L = add(o.position, out_of_frame(R, add(o.slot_error, o.offset)))
    r1, r3 = out_of_frame(R, o.body_x), out_of_frame(R, o.body_z)
    leader = TrajectoryPoint(p_L, v_L, out_of_frame(R, o.leader_acceleration), ZERO, ZERO)
    motion = Motion(o.position, v, (r1, cross(r3, r1), r3), o.angular_velocity)
    return Measurements(motion, leader, R, o.offset, o.started > 0.5)


# Whether a virtual follower can be computed with; false for what is not a number, too.
in_reach = device(
    define(
        "in_reach",
        "def in_reach(f):\n    return "
        + " & ".join(f"(abs(f{path}) <= {FAR!r})" for path, _ in parts(Virtual)),
        {},
    )
)


# -- loops over the lanes of a tile ---------------------------------------------------------------


@device
def waiting(x: Any) -> bool:
    """Does a virtual follower of the tile wait for its start? Its position is NaN then."""
    any_waits = False
    for lane in range(_LANES):
        any_waits = any_waits or x[WAITS + lane] != x[WAITS + lane]
    return any_waits


@loop
def start(rows: Any, x: Any) -> None:
    """Put those that wait for it where their errors are null (II-E). Once an episode, so the arc
    tangent may be called."""
    for lane in range(_LANES):
        m = measurements(load_observation(rows, lane))
        f = place(m.leader.p, m.leader.v, m.offset, m.heading, m.started)
        keep_virtual(x, lane, x[WAITS + lane] != x[WAITS + lane], f)


@device
def point_of(
    f: Virtual,
    leader: TrajectoryPoint,
    offset: Vector,
    started: bool,
    law: PlannerLaw,
    derived: bool,
) -> TrajectoryPoint:
    """The trajectory of a virtual follower: at rest before the trigger, and then as in (35)."""
    r = trajectory_point(f, leader, offset, law)
    if derived:
        r = full_trajectory_point(f, leader, offset, law)
    return TrajectoryPoint(
        r.p,
        pick_vector(started, r.v, ZERO),
        pick_vector(started, r.a, ZERO),
        pick_vector(started, r.j, ZERO),
        pick_vector(started, r.s, ZERO),
    )


@device
def _plan(
    rows: Any, x: Any, lane: Any, h: float, law: PlannerLaw, derived: bool, points: Any
) -> None:
    m, f = measurements(load_observation(rows, lane)), load_virtual(x, lane)
    _store_point(points, lane, point_of(f, m.leader, m.offset, m.started, law, derived))
    keep_virtual(x, lane, m.started, advance(f, m.leader, m.offset, h, law))
    x[WAITS + lane] = pick(in_reach(load_virtual(x, lane)), x[WAITS + lane], np.nan)


@loop
def plan(rows: Any, x: Any, h: float, law: PlannerLaw, points: Any) -> None:
    """The trajectories of the virtual followers now, which then go on by `h` seconds.

    They are at rest before the trigger, and then as in (35). One that the observations have driven
    further than can be computed, as a leader at 90 m/s does, waits for a start again.
    """
    for lane in range(_LANES):
        _plan(rows, x, lane, h, law, False, points)


@loop
def plan_derived(rows: Any, x: Any, h: float, law: PlannerLaw, points: Any) -> None:
    """As `plan`, with the third and fourth derivatives."""
    for lane in range(_LANES):
        _plan(rows, x, lane, h, law, True, points)


@device
def plan_tile(room: Room, x: Any, h: float, law: PlannerLaw, derived: bool) -> None:
    """`plan` or `plan_derived` for the tile in the room."""
    if derived:
        plan_derived(room.rows, x, h, law, room.points)
    else:
        plan(room.rows, x, h, law, room.points)


@device
def _act(rows: Any, points: Any, lane: Any, actuation: int, world: World, actions: Any) -> None:
    """The tracker's command in units of the action."""
    motion = measurements(load_observation(rows, lane)).motion
    wanted = track(motion, load_point(points, lane), actuation, world)
    a = wrench_action(wanted, world.reach)
    _store_action(
        actions,
        lane,
        (
            clipped_or_zero(a[0]),
            clipped_or_zero(a[1]),
            clipped_or_zero(a[2]),
            clipped_or_zero(a[3]),
        ),
    )


@loop
def act_by_moment(rows: Any, points: Any, world: World, actions: Any) -> None:
    """Actions of a level whose followers are turned by moments, `wrench`."""
    for lane in range(_LANES):
        _act(rows, points, lane, MOMENT, world, actions)


@loop
def act_by_rates(rows: Any, points: Any, world: World, actions: Any) -> None:
    """Actions of a level whose followers are turned by rates, `rates`."""
    for lane in range(_LANES):
        _act(rows, points, lane, RATES, world, actions)


@loop
def accelerate(rows: Any, x: Any, points: Any, h: float, reach: Reach, actions: Any) -> None:
    """Actions of level REFERENCE: they take the environment's virtual follower along with ours.

    A constant acceleration that makes its velocity at the end of the tick ours and twice the difference in
    position (1/s), which so vanishes with a time constant of half a second.
    """
    for lane in range(_LANES):
        o, after = load_guided(rows, lane), load_virtual(x, lane)
        m = measurements(o.observation)
        guide_p = add(m.motion.p, out_of_frame(m.heading, o.guide.p))
        guide_v = add(m.motion.v, out_of_frame(m.heading, o.guide.v))
        v = scaled(after.u, phase(after.theta))
        wanted = sub((v.real, v.imag, after.w), guide_v)
        behind = sub(load_point(points, lane).p, guide_p)
        a = in_frame(m.heading, scale(1.0 / h, add(wanted, scale(2.0, behind))))
        b = acceleration_action(a, reach)
        action = (clipped_or_zero(b[0]), clipped_or_zero(b[1]), clipped_or_zero(b[2]))
        _store_vector(actions, lane, action)


# -- tiles ----------------------------------------------------------------------------------------


@device
def open_room(room: Floats) -> Room:
    """The parts of `ROOM` numbers."""
    a = _TRAJECTORY * LANES
    b = a + _ACTION * LANES
    c = b + LANES
    return Room(
        carve(room, 0, (a,)),
        carve(room, a, (_ACTION * LANES,)),
        reinterpret(carve(room, c, (_GUIDED * LANES // 2,)), np.float32),
        reinterpret(carve(room, b, (LANES,)), np.int64),
    )


@device
def take_rows(rows: Rows, t: int, entries: int, room: Room) -> None:
    """The first `entries` columns of the rows of tile `t`; past the end the last row again.

    Whole squares are turned; what is left goes number by number.
    """
    count, size = rows.shape
    flat, squares = carve(rows, 0, (count * size,)), entries // LANES
    left = np.uint64(squares * LANES)
    for k in range(squares):
        for lane in range(LANES):
            room.starts[lane] = min(t * LANES + lane, count - 1) * size + k * LANES
        gather(flat, room.starts, carve(room.rows, k * LANES * LANES, (LANES * LANES,)))
    for lane in range(_LANES):
        a = np.uint64(min(t * LANES + np.int64(lane), count - 1) * size)
        for j in range(left, np.uint64(entries)):
            room.rows[j * _LANES + lane] = flat[a + j]


@announced("the expert")
@kernel
def decide(
    rows: Rows,
    memory: Floats,
    settings: Floats,
    gains: Floats,
    derived: bool,
    fresh: bool,
    space: Floats,
    actions: Rows,
) -> bool:
    """One decision for every row `(N, entries)`; `fresh` if a virtual follower may wait for its start.
    Returns whether one does for the next decision.

    `memory` `(tiles, VIRTUAL L)` are the virtual followers, position NaN where an episode begins; `space`
    of `ROOM` numbers is overwritten.
    """
    world, room = read_world(settings), open_room(space)
    law = planner_law(gains)
    h, level = world.clock.period, world.level
    entries = _GUIDED if level == REFERENCE else OBSERVED
    any_waits = False
    for t in range(len(memory)):
        x = carve(memory, t * VIRTUAL * LANES, (VIRTUAL * LANES,))
        take_rows(rows, t, entries, room)
        if fresh and waiting(x):
            start(room.rows, x)
        plan_tile(room, x, h, law, derived)
        any_waits = waiting(x) or any_waits
        if level == REFERENCE:
            accelerate(room.rows, x, room.points, h, world.reach, room.actions)
        elif world.follower_actuation == MOMENT:
            act_by_moment(room.rows, room.points, world, room.actions)
        else:
            act_by_rates(room.rows, room.points, world, room.actions)
        for lane in range(min(LANES, len(rows) - t * LANES)):
            for k in range(actions.shape[1]):
                actions[t * LANES + lane, k] = room.actions[k * LANES + lane]
    return any_waits
