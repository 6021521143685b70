"""The expert's decision for a tile of followers, side by side in vector code.

As `formation_env.lanes` does it for worlds: the mathematics is that of `planner`, `feedforward` and
`tracker`, inlined, in loops over the `LANES` followers of a tile; nothing in them is called or
branches. A tile holds number after number, each in all lanes, whatever worlds the followers are in.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.policies.base import Rows
from formation_env._jit import device, kernel, loop
from formation_env.blocks import LANES, carve, gather, reinterpret
from formation_env.elementary import phase, pick
from formation_env.feedforward import full_reference
from formation_env.lanes import at, load_reference, load_vector, put_vector
from formation_env.memory import unpack
from formation_env.planner import Leader, PlannerLaw, Virtual, advance, place, reference, scaled
from formation_env.quadrotor import MOMENT, RATES
from formation_env.slots import in_frame, out_of_frame
from formation_env.so3 import Vector, add, cross, pick_vector, scale, sub
from formation_env.task import CORE, GUIDE
from formation_env.tracker import Motion
from formation_env.world import REFERENCE, Reach, World, track

Floats = NDArray[np.float64]

_LANES = np.uint64(LANES)

# Rows of a tile: of virtual followers, of their trajectories, of actions, of what is read of rows.
VIRTUAL, _TRAJECTORY, _ACTION, _READ = 9, 15, 4, CORE + GUIDE
# Where a virtual follower counts as lost: m, rad, m/s, rad/s, m s. Flights stay far below, and the powers
# of it that the laws take stay far from where float64 ends.
FAR = 1e6
# Numbers of room for one tile of each but the first, the rows and a square of them in float32.
ROOM = (_TRAJECTORY + _ACTION + 1) * LANES + _READ * LANES // 2


class Room(NamedTuple):
    """Where one tile is worked on."""

    refs: Floats  # (15 L,)
    actions: Floats  # (4 L,)
    rows: Rows  # (40 L,)
    starts: NDArray[np.int64]  # (L,): where a piece of each row begins


class Seen(NamedTuple):
    """What an observation row says, back in the inertial frame."""

    motion: Motion  # of the vehicle itself
    leader: Leader
    heading: complex  # the estimated one
    offset: Vector
    started: bool


@device
def _heading(rows: Any, lane: Any) -> complex:
    return complex(np.float64(rows[at(21, lane)]), np.float64(rows[at(22, lane)]))


@device
def seen(rows: Any, lane: Any) -> Seen:
    """The measurements behind a row: the observation is a change of frame, undone here."""
    R = _heading(rows, lane)
    d = load_vector(rows, 23, lane)
    p = load_vector(rows, 31, lane)
    v_L = out_of_frame(R, load_vector(rows, 6, lane))
    v = sub(v_L, out_of_frame(R, load_vector(rows, 3, lane)))
    p_L = add(p, out_of_frame(R, add(load_vector(rows, 0, lane), d)))
    r1 = out_of_frame(R, load_vector(rows, 12, lane))
    r3 = out_of_frame(R, load_vector(rows, 15, lane))
    o = (0.0, 0.0, 0.0)
    leader = Leader(p_L, v_L, out_of_frame(R, load_vector(rows, 9, lane)), o, o)
    motion = Motion(p, v, (r1, cross(r3, r1), r3), load_vector(rows, 18, lane))
    return Seen(motion, leader, R, d, rows[at(30, lane)] > 0.5)


@device
def recall(x: Any, lane: Any) -> Virtual:
    """The virtual follower of a lane."""
    p, xi = complex(x[lane], x[at(1, lane)]), complex(x[at(5, lane)], x[at(6, lane)])
    u = load_vector(x, 2, lane)
    return Virtual(p, u[0], u[1], u[2], xi, x[at(7, lane)], x[at(8, lane)])


@device
def _remember(x: Any, lane: Any, on: bool, f: Virtual) -> None:
    """Keep a virtual follower, where wanted."""
    before = recall(x, lane)
    x[lane] = pick(on, f.p.real, before.p.real)
    x[at(1, lane)] = pick(on, f.p.imag, before.p.imag)
    x[at(2, lane)] = pick(on, f.theta, before.theta)
    x[at(3, lane)] = pick(on, f.u, before.u)
    x[at(4, lane)] = pick(on, f.omega, before.omega)
    x[at(5, lane)] = pick(on, f.xi.real, before.xi.real)
    x[at(6, lane)] = pick(on, f.xi.imag, before.xi.imag)
    x[at(7, lane)] = pick(on, f.z, before.z)
    x[at(8, lane)] = pick(on, f.w, before.w)


@device
def _in_reach(f: Virtual) -> bool:
    """Whether a virtual follower can be computed with; false for what is not a number, too."""
    planar = (abs(f.p.real) <= FAR) & (abs(f.p.imag) <= FAR) & (abs(f.theta) <= FAR)
    moving = (abs(f.u) <= FAR) & (abs(f.omega) <= FAR)
    summed = (abs(f.xi.real) <= FAR) & (abs(f.xi.imag) <= FAR)
    return planar & moving & summed & (abs(f.z) <= FAR) & (abs(f.w) <= FAR)


# -- loops over the lanes of a tile ---------------------------------------------------------------


@device
def waiting(x: Any) -> bool:
    """Does a virtual follower of the tile wait for its start? Its first number is NaN then."""
    any_waits = False
    for lane in range(LANES):
        any_waits = any_waits or x[lane] != x[lane]
    return any_waits


@loop
def start(rows: Any, x: Any) -> None:
    """Put those that wait for it where their errors are null (II-E). Once an episode, so the arc
    tangent may be called."""
    for lane in range(_LANES):
        s = seen(rows, lane)
        f = place(s.leader.p, s.leader.v, s.offset, s.heading, s.started)
        _remember(x, lane, x[lane] != x[lane], f)


@device
def _plan(
    rows: Any, x: Any, lane: Any, h: float, law: PlannerLaw, derived: bool, refs: Any
) -> None:
    s, f = seen(rows, lane), recall(x, lane)
    r = reference(f, s.leader, s.offset, law)
    if derived:
        r = full_reference(f, s.leader, s.offset, law)
    o = (0.0, 0.0, 0.0)
    put_vector(refs, 0, lane, r.p)
    put_vector(refs, 3, lane, pick_vector(s.started, r.v, o))
    put_vector(refs, 6, lane, pick_vector(s.started, r.a, o))
    put_vector(refs, 9, lane, pick_vector(s.started, r.j, o))
    put_vector(refs, 12, lane, pick_vector(s.started, r.s, o))
    _remember(x, lane, s.started, advance(f, s.leader, s.offset, h, law))
    x[lane] = pick(_in_reach(recall(x, lane)), x[lane], np.nan)


@loop
def plan(rows: Any, x: Any, h: float, law: PlannerLaw, refs: Any) -> None:
    """The trajectories of the virtual followers now, which then go on by `h` seconds.

    They are at rest before the trigger, and then as in (35). One that the observations have driven
    further than can be computed, as a leader at 90 m/s does, waits for a start again.
    """
    for lane in range(_LANES):
        _plan(rows, x, lane, h, law, False, refs)


@loop
def plan_derived(rows: Any, x: Any, h: float, law: PlannerLaw, refs: Any) -> None:
    """As `plan`, with the third and fourth derivatives."""
    for lane in range(_LANES):
        _plan(rows, x, lane, h, law, True, refs)


@device
def plan_tile(room: Room, x: Any, h: float, law: PlannerLaw, derived: bool) -> None:
    """`plan` or `plan_derived` for the tile in the room."""
    if derived:
        plan_derived(room.rows, x, h, law, room.refs)
    else:
        plan(room.rows, x, h, law, room.refs)


@device
def planner_law(gains: Any) -> PlannerLaw:
    """The law from its numbers in a row."""
    return PlannerLaw(gains[0], gains[1], gains[2], gains[3], gains[4], gains[5], gains[6])


@device
def _act(rows: Any, refs: Any, lane: Any, actuation: int, world: World, actions: Any) -> None:
    """The tracker's command in units of the action."""
    w = track(seen(rows, lane).motion, load_reference(refs, lane), actuation, world)
    reach = world.reach
    actions[lane] = _unit(2.0 * w.thrust / reach.thrust - 1.0)
    actions[at(1, lane)] = _unit(w.turn[0] / reach.turn[0])
    actions[at(2, lane)] = _unit(w.turn[1] / reach.turn[1])
    actions[at(3, lane)] = _unit(w.turn[2] / reach.turn[2])


@device
def _unit(a: float) -> float:
    """Within [-1, 1]; zero, which hovers, for what cannot be computed."""
    return pick(a == a, min(max(a, -1.0), 1.0), 0.0)


@loop
def act_by_moment(rows: Any, refs: Any, world: World, actions: Any) -> None:
    """Actions of level WRENCH."""
    for lane in range(_LANES):
        _act(rows, refs, lane, MOMENT, world, actions)


@loop
def act_by_rates(rows: Any, refs: Any, world: World, actions: Any) -> None:
    """Actions of level RATE."""
    for lane in range(_LANES):
        _act(rows, refs, lane, RATES, world, actions)


@loop
def accelerate(rows: Any, x: Any, refs: Any, h: float, reach: Reach, actions: Any) -> None:
    """Actions of level REFERENCE: they take the environment's virtual follower along with ours.

    A constant acceleration that matches our velocity at the end of the tick, and removes what is left
    of a difference in position (after a saturated action) with a time constant of half a second.
    """
    for lane in range(_LANES):
        s, after = seen(rows, lane), recall(x, lane)
        guide_p = add(s.motion.p, out_of_frame(s.heading, load_vector(rows, CORE, lane)))
        guide_v = add(s.motion.v, out_of_frame(s.heading, load_vector(rows, CORE + 3, lane)))
        v = scaled(after.u, phase(after.theta))
        wanted = sub((v.real, v.imag, after.w), guide_v)
        a = add(scale(1.0 / h, wanted), scale(2.0, sub(load_vector(refs, 0, lane), guide_p)))
        b = in_frame(s.heading, a)
        actions[lane] = _unit(b[0] / reach.acceleration[0])
        actions[at(1, lane)] = _unit(b[1] / reach.acceleration[1])
        actions[at(2, lane)] = _unit(b[2] / reach.acceleration[2])


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
        reinterpret(carve(room, c, (_READ * LANES // 2,)), np.float32),
        reinterpret(carve(room, b, (LANES,)), np.int64),
    )


@device
def take(rows: Rows, t: int, entries: int, room: Room) -> None:
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
            room.rows[at(j, lane)] = flat[a + j]


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

    `memory` `(tiles, 9 L)` are the virtual followers, first number NaN where an episode begins; `space`
    of `ROOM` numbers is overwritten.
    """
    s, room = unpack(settings), open_room(space)
    law = planner_law(gains)
    h, level = s.world.clock.period, s.world.level
    entries = CORE + GUIDE if level == REFERENCE else CORE
    any_waits = False
    for t in range(len(memory)):
        x = carve(memory, t * VIRTUAL * LANES, (VIRTUAL * LANES,))
        take(rows, t, entries, room)
        if fresh and waiting(x):
            start(room.rows, x)
        plan_tile(room, x, h, law, derived)
        any_waits = waiting(x) or any_waits
        if level == REFERENCE:
            accelerate(room.rows, x, room.refs, h, s.world.reach, room.actions)
        elif s.world.follower_actuation == MOMENT:
            act_by_moment(room.rows, room.refs, s.world, room.actions)
        else:
            act_by_rates(room.rows, room.refs, s.world, room.actions)
        for lane in range(min(LANES, len(rows) - t * LANES)):
            for k in range(actions.shape[1]):
                actions[t * LANES + lane, k] = room.actions[k * LANES + lane]
    return any_waits
