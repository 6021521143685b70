"""The loops that the compiler vectorises: one vehicle in all worlds of a tile at once.

The mathematics is that of `world`, inlined. A loop becomes vector code only if nothing in it is called
or branches, if its row stride is a constant, and if its indices are unsigned; a test looks at the
machine code. Each loop is a function of its own, so that every caller runs the same code.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formation_env._jit import device, loop
from formation_env.blocks import LANES
from formation_env.memory import (
    ATTITUDE,
    ERROR,
    ERROR_SQUARED,
    ESTIMATE,
    FAILED,
    GUIDE_P,
    GUIDE_V,
    HEADING,
    PREVIOUS,
    RATE_OF_TURN,
    REWARD,
    SEPARATION,
    SEPARATION_SQUARED,
    SLOT,
    TERMS,
)
from formation_env.quadrotor import (
    MOMENT,
    RATES,
    Airframe,
    Body,
    Wrench,
    fly,
    saturate,
    touch_floor,
)
from formation_env.rng import MEASUREMENT, Four, as_single, normal_pair, words
from formation_env.sensors import Measured, Noise, perturb
from formation_env.slots import advance_heading, slot
from formation_env.so3 import Vector, dot, pick, pick_vector, sub
from formation_env.task import (
    ANYWHERE,
    LEADER,
    NEAR,
    NO_FAILURE,
    RATE_BOUND,
    UNIT,
    Limits,
    Rewards,
    failure,
    observe,
    observe_guide,
    observe_neighbour,
    reward,
)
from formation_env.trajectories import Reference
from formation_env.turning import Turning, slow_by_moment, slow_by_rates, stays_up
from formation_env.world import (
    Action,
    Guide,
    World,
    driven,
    guide_on,
    guided,
    motion,
    track,
    truth,
)

_LANES = np.uint64(LANES)
_PAIRS = np.uint64(8 * LANES)


@device
def at(row: int, lane: Any) -> Any:
    """Where row `row` of a tile has its entry for a lane."""
    return np.uint64(row) * _LANES + lane


@device
def load_vector(x: Any, row: int, lane: Any) -> Vector:
    """Three rows of a tile from `row` on, in double precision."""
    return (
        np.float64(x[at(row, lane)]),
        np.float64(x[at(row + 1, lane)]),
        np.float64(x[at(row + 2, lane)]),
    )


@device
def _keep(x: Any, row: int, lane: Any, on: bool, a: float) -> None:
    """Store where the world is active."""
    x[at(row, lane)] = pick(on, a, x[at(row, lane)])


@device
def _body(x: Any, lane: Any) -> Body:
    return Body(
        load_vector(x, 0, lane),
        load_vector(x, 3, lane),
        _four(x, ATTITUDE, lane),
        load_vector(x, RATE_OF_TURN, lane),
    )


@device
def _put_body(x: Any, lane: Any, b: Body) -> None:
    put_vector(x, 0, lane, b.p)
    put_vector(x, 3, lane, b.v)
    _put_four(x, ATTITUDE, lane, b.q)
    put_vector(x, RATE_OF_TURN, lane, b.w)


@device
def _flown(
    x: Any, command: Any, push: Any, lane: Any, h: float, actuation: int, frame: Airframe
) -> Body:
    applied = Wrench(command[lane], load_vector(command, 1, lane))
    return fly(_body(x, lane), applied, load_vector(push, 0, lane), h, actuation, frame)


@loop
def fly_by_moment(x: Any, command: Any, push: Any, h: float, frame: Airframe) -> None:
    """One substep in the air of a vehicle driven by moments, in all lanes."""
    for lane in range(_LANES):
        _put_body(x, lane, _flown(x, command, push, lane, h, MOMENT, frame))


@loop
def fly_by_rates(x: Any, command: Any, push: Any, h: float, frame: Airframe) -> None:
    """One substep in the air of a vehicle driven by rates, in all lanes."""
    for lane in range(_LANES):
        _put_body(x, lane, _flown(x, command, push, lane, h, RATES, frame))


@loop
def fly_low_by_moment(
    x: Any, command: Any, push: Any, h: float, frame: Airframe, touch: Any
) -> None:
    """The same close to the floor: in the air bit for bit the same."""
    for lane in range(_LANES):
        _land(x, _flown(x, command, push, lane, h, MOMENT, frame), touch, lane)


@loop
def fly_low_by_rates(
    x: Any, command: Any, push: Any, h: float, frame: Airframe, touch: Any
) -> None:
    """The same close to the floor: in the air bit for bit the same."""
    for lane in range(_LANES):
        _land(x, _flown(x, command, push, lane, h, RATES, frame), touch, lane)


@device
def _land(x: Any, flown: Body, touch: Any, lane: Any) -> None:
    """Keep a vehicle that has flown for a substep from `x` above the floor and note the contact."""
    kept, contact = touch_floor(flown, _body(x, lane))
    _put_body(x, lane, kept)
    harder = contact.touching & (contact.speed > touch[lane])
    touch[at(1, lane)] = pick(harder, contact.uprightness, touch[at(1, lane)])
    touch[lane] = max(touch[lane], pick(contact.speed < np.inf, contact.speed, np.inf))
    touch[at(2, lane)] = pick(contact.touching, 1.0, 0.0)


@device
def _stays_up(x: Any, command: Any, push: Any, lane: Any, period: float, mass: float) -> bool:
    z, v, down = x[at(2, lane)], x[at(5, lane)], push[at(2, lane)]
    return stays_up(z, v, command[lane], down, period, mass)


@loop
def doubtful_by_moment(
    x: Any, command: Any, push: Any, active: Any, period: float, mass: float, turning: Turning
) -> int:
    """In how many active lanes a vehicle driven by moments may meet the floor in a tick of `period` seconds.

    0 is certain, as `turning` proves.
    """
    count = 0
    for lane in range(_LANES):
        w, moment = load_vector(x, RATE_OF_TURN, lane), load_vector(command, 1, lane)
        safe = _stays_up(x, command, push, lane, period, mass)
        safe = safe & slow_by_moment(w, moment, turning)
        count += (active[lane] > 0.0) & (not safe)
    return count


@loop
def doubtful_by_rates(
    x: Any, command: Any, push: Any, active: Any, period: float, substep: float, frame: Airframe
) -> int:
    """The same for a vehicle driven by rates, in substeps of `substep` seconds."""
    count = 0
    for lane in range(_LANES):
        w, rates = load_vector(x, RATE_OF_TURN, lane), load_vector(command, 1, lane)
        safe = _stays_up(x, command, push, lane, period, frame.mass)
        safe = safe & slow_by_rates(w, rates, substep, frame.rate_lag)
        count += (active[lane] > 0.0) & (not safe)
    return count


@loop
def note_unsound(x: Any, touch: Any) -> None:
    """An infinite speed into `touch` where a vehicle's state has left what can be computed.

    So `_land` has done where it put such a one to rest on the floor.
    """
    for lane in range(_LANES):
        p, v = load_vector(x, 0, lane), load_vector(x, 3, lane)
        w, q = load_vector(x, RATE_OF_TURN, lane), _four(x, ATTITUDE, lane)
        unit = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
        sound = (dot(p, p) + dot(v, v) + dot(w, w) < np.inf) & (unit > 0.5)
        touch[lane] = pick(sound, touch[lane], np.inf)


@loop
def clear_touch(touch: Any) -> None:
    """Nothing has touched the floor yet."""
    for lane in range(_LANES):
        put_vector(touch, 0, lane, (0.0, 1.0, 0.0))


@loop
def count_finite(numbers: Any) -> int:
    """How many are neither infinite nor NaN."""
    count = 0
    for k in range(np.uint64(len(numbers))):
        count += abs(numbers[k]) < np.inf
    return count


@loop
def copy(source: Any, first: int, sink: Any, to: int, rows: int) -> None:
    """`rows` rows from `first` on, to `to` on."""
    a, b = np.uint64(first) * _LANES, np.uint64(to) * _LANES
    for k in range(np.uint64(rows) * _LANES):
        sink[b + k] = source[a + k]


@loop
def copy_on(source: Any, sink: Any, to: int, count: int) -> None:
    """The first `count` numbers, to `sink[to]`, ..."""
    a = np.uint64(to)
    for k in range(np.uint64(count)):
        sink[a + k] = source[k]


@loop
def sort_out(named: Any, over: Any, started: Any, anew: int, active: Any, moving: Any) -> Any:
    """Which of the worlds named step (`active`), and which of these have started (`moving`).

    `anew` is 2 where all are reset instead, 1 where those are whose episode is over, or 0. Returns how
    many step, how many are to be reset and how many lanes wait for their start.
    """
    flying = waiting = standing = 0
    for lane in range(_LANES):
        fresh = named[lane] & ((anew == 2) | ((anew == 1) & (over[lane] != 0)))
        on = named[lane] & (not fresh)
        active[lane] = pick(on, 1.0, 0.0)
        moving[lane] = pick(on & (started[lane] != 0), 1.0, 0.0)
        flying += on
        waiting += fresh
        standing += started[lane] == 0
    return flying, waiting, standing


@loop
def find_rows(clock: Any, rows: int, length: int, starts: Any) -> int:
    """Where each world's row of a table of `rows` rows of that length begins; how many lie beyond it."""
    beyond = 0
    for lane in range(_LANES):
        starts[lane] = clock[lane] * length
        beyond += clock[lane] >= rows
    return beyond


@loop
def move_on(active: Any, moving: Any, tick: Any, clock: Any) -> None:
    """A tick later in the worlds that step, on the reference's clock in those that have started."""
    for lane in range(_LANES):
        tick[lane] += np.int64(active[lane])
        clock[lane] += np.int64(moving[lane])


@loop
def number_samples(tick: Any, counts: Any) -> None:
    """The number of the measurement at the end of each world's tick."""
    for lane in range(_LANES):
        counts[lane] = np.uint64(tick[lane] + 1)


@loop
def note_started(started: Any, flags: Any) -> int:
    """1 where an episode has started, else 0; returns in how many lanes it has not."""
    standing = 0
    for lane in range(_LANES):
        flags[lane] = pick(started[lane] != 0, 1.0, 0.0)
        standing += started[lane] == 0
    return standing


@loop
def clip(drawn: Any, executed: Any) -> None:
    """The four entries of the actions of one follower, clipped."""
    for k in range(np.uint64(4 * LANES)):
        executed[k] = min(max(np.float64(drawn[k]), -1.0), 1.0)


@loop
def take(actions: Any, first: int, stride: int, executed: Any, row: int) -> None:
    """One entry of the actions of consecutive worlds, clipped, to a row of those executed."""
    a, step = np.uint64(first), np.uint64(stride)
    for lane in range(_LANES):
        executed[at(row, lane)] = min(max(np.float64(actions[a + lane * step]), -1.0), 1.0)


@loop
def restore(saved: Any, first: int, sink: Any, rows: int, active: Any) -> None:
    """Put `rows` rows of `sink` back where a lane is not active."""
    for row in range(rows):
        a, b = np.uint64(first + row) * _LANES, np.uint64(row) * _LANES
        for lane in range(_LANES):
            sink[b + lane] = pick(active[lane] > 0.0, sink[b + lane], saved[a + lane])


@loop
def clear(row: Any) -> None:
    """Zero everywhere."""
    for k in range(np.uint64(len(row))):
        row[k] = 0.0


@device
def _measured(x: Any, lane: Any) -> Measured:
    q = _four(x, 9, lane)
    return Measured(
        load_vector(x, 0, lane),
        load_vector(x, 3, lane),
        load_vector(x, 6, lane),
        q,
        load_vector(x, 13, lane),
    )


@device
def _passing(x: Any, lane: Any) -> Measured:
    """Position and velocity alone, which is all that rows of a neighbour hold."""
    rest = (0.0, 0.0, 0.0)
    return Measured(
        load_vector(x, 0, lane), load_vector(x, 3, lane), rest, (1.0, 0.0, 0.0, 0.0), rest
    )


@device
def _four(x: Any, row: int, lane: Any) -> Action:
    return (x[at(row, lane)], x[at(row + 1, lane)], x[at(row + 2, lane)], x[at(row + 3, lane)])


@device
def put_vector(x: Any, row: int, lane: Any, a: Vector) -> None:
    """Store three rows of a tile from `row` on."""
    x[at(row, lane)], x[at(row + 1, lane)], x[at(row + 2, lane)] = a


@device
def _put_four(x: Any, row: int, lane: Any, a: Action) -> None:
    put_vector(x, row, lane, (a[0], a[1], a[2]))
    x[at(row + 3, lane)] = a[3]


@device
def load_reference(refs: Any, lane: Any) -> Reference:
    """A trajectory's point and its derivatives, rows 0-14 of a tile."""
    return Reference(
        load_vector(refs, 0, lane),
        load_vector(refs, 3, lane),
        load_vector(refs, 6, lane),
        load_vector(refs, 9, lane),
        load_vector(refs, 12, lane),
    )


@device
def _follow(
    own: Any, ref: Reference, command: Any, lane: Any, actuation: int, world: World
) -> None:
    """What the actuators of a vehicle do that the tracker flies along a reference."""
    wanted = track(motion(_measured(own, lane)), ref, actuation, world)
    applied = saturate(wanted, actuation, world.airframe)
    command[lane] = applied.thrust
    put_vector(command, 1, lane, applied.turn)


@loop
def lead_by_moment(seen: Any, refs: Any, command: Any, world: World) -> None:
    """The tracker's command for a leader driven by moments, in all lanes."""
    for lane in range(_LANES):
        _follow(seen, load_reference(refs, lane), command, lane, MOMENT, world)


@loop
def lead_by_rates(seen: Any, refs: Any, command: Any, world: World) -> None:
    """The tracker's command for a leader driven by rates, in all lanes."""
    for lane in range(_LANES):
        _follow(seen, load_reference(refs, lane), command, lane, RATES, world)


@device
def _drive(action: Any, command: Any, lane: Any, actuation: int, world: World) -> None:
    applied = saturate(driven(_four(action, 0, lane), world), actuation, world.airframe)
    command[lane] = applied.thrust
    put_vector(command, 1, lane, applied.turn)


@loop
def drive_by_moment(action: Any, command: Any, world: World) -> None:
    """What an action of level WRENCH does to a follower's actuators, in all lanes."""
    for lane in range(_LANES):
        _drive(action, command, lane, MOMENT, world)


@loop
def drive_by_rates(action: Any, command: Any, world: World) -> None:
    """What an action of level RATE does to a follower's actuators, in all lanes."""
    for lane in range(_LANES):
        _drive(action, command, lane, RATES, world)


@device
def _move_guide(
    x: Any, action: Any, moving: Any, active: Any, lane: Any, world: World
) -> Reference:
    """The virtual follower now, as a reference; in memory it moves on by a tick.

    Before the trigger (40) it waits.
    """
    guide = Guide(load_vector(x, GUIDE_P, lane), load_vector(x, GUIDE_V, lane))
    R = complex(x[at(ESTIMATE, lane)], x[at(ESTIMATE + 1, lane)])
    m, a = moving[lane], load_vector(action, 0, lane)
    ref = guided((m * a[0], m * a[1], m * a[2], 0.0), guide, R, world)
    moved, on = guide_on(guide, ref.a, world.clock.period), active[lane] > 0.0
    put_vector(x, GUIDE_P, lane, pick_vector(on, moved.p, guide.p))
    put_vector(x, GUIDE_V, lane, pick_vector(on, moved.v, guide.v))
    return ref


@loop
def guide_by_moment(
    x: Any, own: Any, action: Any, moving: Any, active: Any, command: Any, world: World
) -> None:
    """Level REFERENCE: move a virtual follower, and command one driven by moments along it."""
    for lane in range(_LANES):
        ref = _move_guide(x, action, moving, active, lane, world)
        _follow(own, ref, command, lane, MOMENT, world)


@loop
def guide_by_rates(
    x: Any, own: Any, action: Any, moving: Any, active: Any, command: Any, world: World
) -> None:
    """The same for a follower driven by rates."""
    for lane in range(_LANES):
        ref = _move_guide(x, action, moving, active, lane, world)
        _follow(own, ref, command, lane, RATES, world)


@device
def _exactly(x: Any, command: Any, push: Any, touch: Any, lane: Any, frame: Airframe) -> Measured:
    applied = Wrench(command[lane], load_vector(command, 1, lane))
    touching = touch[at(2, lane)] > 0.0
    return truth(_body(x, lane), applied, load_vector(push, 0, lane), touching, frame)


@device
def _put_sample(sample: Any, lane: Any, m: Measured) -> None:
    put_vector(sample, 0, lane, m.p)
    put_vector(sample, 3, lane, m.v)
    put_vector(sample, 6, lane, m.a)
    _put_four(sample, 9, lane, m.q)
    put_vector(sample, 13, lane, m.w)


@loop
def sense_exactly(x: Any, command: Any, push: Any, touch: Any, frame: Airframe) -> None:
    """A measurement without noise of one vehicle, in all lanes: the state itself but for `a`."""
    for lane in range(_LANES):
        put_vector(x, 6, lane, _exactly(x, command, push, touch, lane, frame).a)


@loop
def draw(keys: Any, counts: Any, who: int, block: int, draws: Any) -> None:
    """One block of words for a measurement: the first two of its row of pairs, the others 8 rows on."""
    for lane in range(_LANES):
        a, b, c, d = words(keys[lane], MEASUREMENT, who, counts[lane], block)
        draws[at(2 * block, lane)] = as_single(a)
        draws[at(2 * block + 1, lane)] = as_single(b)
        draws[at(2 * block + 8, lane)] = as_single(c)
        draws[at(2 * block + 9, lane)] = as_single(d)


@loop
def make_normal(draws: Any) -> None:
    """Normal numbers in place of the words: rows 0-7 and 8-15 are the pairs."""
    for k in range(_PAIRS):
        draws[k], draws[k + _PAIRS] = normal_pair(draws[k], draws[k + _PAIRS])


@device
def _normals(draws: Any, block: int, lane: Any) -> Four:
    """What `rng.normals` returns for a block."""
    return (
        np.float64(draws[at(2 * block, lane)]),
        np.float64(draws[at(2 * block + 8, lane)]),
        np.float64(draws[at(2 * block + 1, lane)]),
        np.float64(draws[at(2 * block + 9, lane)]),
    )


@loop
def add_noise(
    x: Any,
    command: Any,
    push: Any,
    touch: Any,
    sample: Any,
    frame: Airframe,
    noise: Noise,
    draws: Any,
) -> None:
    """A measurement with noise made of the normal numbers in `draws`, in all lanes."""
    for lane in range(_LANES):
        exact = _exactly(x, command, push, touch, lane, frame)
        n0, n1 = _normals(draws, 0, lane), _normals(draws, 1, lane)
        n2, n3 = _normals(draws, 2, lane), _normals(draws, 3, lane)
        _put_sample(sample, lane, perturb(exact, noise, n0, n1, n2, n3))


@device
def sense(
    x: Any,
    command: Any,
    push: Any,
    touch: Any,
    sample: Any,
    frame: Airframe,
    noise: Noise,
    keys: Any,
    counts: Any,
    who: int,
    draws: Any,
) -> None:
    """A noisy measurement, number `counts`, of vehicle `who`, in all lanes.

    It is `sensors.corrupt` in steps with room between them: `draws`, 16 rows of float32. In one loop the
    constants of Philox and of the polynomials exceed the registers, and the float64 of the measurement
    would halve the width of the float32, which together doubles the time.
    """
    for block in range(4):
        draw(keys, counts, who, block, draws)
    make_normal(draws)
    add_noise(x, command, push, touch, sample, frame, noise, draws)


@device
def _turned(x: Any, row: int, lane: Any, v0: complex, v1: complex, d_x: float, h: float) -> complex:
    return advance_heading(complex(x[at(row, lane)], x[at(row + 1, lane)]), v0, v1, d_x, h)


@device
def _keep_heading(x: Any, row: int, lane: Any, on: bool, R: complex) -> None:
    _keep(x, row, lane, on, R.real)
    _keep(x, row + 1, lane, on, R.imag)


@device
def _planar(x: Any, row: int, lane: Any) -> complex:
    return complex(x[at(row, lane)], x[at(row + 1, lane)])


@loop
def turn_headings(
    x: Any, leader: Any, before: Any, seen: Any, seen_before: Any, moving: Any, d_x: float, h: float
) -> None:
    """The slot's heading follows the leader's true motion, the estimate the measured one (23)."""
    for lane in range(_LANES):
        on = moving[lane] > 0.0
        v0, v1 = _planar(before, 0, lane), _planar(leader, 3, lane)
        _keep_heading(x, HEADING, lane, on, _turned(x, HEADING, lane, v0, v1, d_x, h))
        w0, w1 = _planar(seen_before, 0, lane), _planar(seen, 3, lane)
        _keep_heading(x, ESTIMATE, lane, on, _turned(x, ESTIMATE, lane, w0, w1, d_x, h))


@loop
def turn_headings_exactly(
    x: Any, leader: Any, before: Any, moving: Any, d_x: float, h: float
) -> None:
    """The same where the true motion is what is measured."""
    for lane in range(_LANES):
        on = moving[lane] > 0.0
        v0, v1 = _planar(before, 0, lane), _planar(leader, 3, lane)
        R = _turned(x, HEADING, lane, v0, v1, d_x, h)
        _keep_heading(x, HEADING, lane, on, R)
        _keep_heading(x, ESTIMATE, lane, on, R)


@loop
def locate(x: Any, leader: Any, own: Any, begin: Any, started: Any, d: Vector, out: Any) -> None:
    """Slot, slot error and its square into their rows of `out`; the leader is the nearest yet."""
    for lane in range(_LANES):
        on = started[lane] > 0.0
        R = complex(x[at(HEADING, lane)], x[at(HEADING + 1, lane)])
        p_L = pick_vector(on, load_vector(leader, 0, lane), load_vector(begin, 0, lane))
        v_L = pick_vector(on, load_vector(leader, 3, lane), (0.0, 0.0, 0.0))
        target = slot(R, p_L, v_L, d)
        error = sub(target.p, load_vector(own, 0, lane))
        put_vector(out, SLOT, lane, target.p)
        put_vector(out, ERROR, lane, error)
        out[at(ERROR_SQUARED, lane)] = dot(error, error)
        apart = sub(load_vector(own, 0, lane), load_vector(leader, 0, lane))
        out[at(SEPARATION_SQUARED, lane)] = dot(apart, apart)


@loop
def approach(one: Any, other: Any, out: Any) -> None:
    """Keep the least squared distance between vehicle `one` and the others in a row of `out`."""
    for lane in range(_LANES):
        e = sub(load_vector(one, 0, lane), load_vector(other, 0, lane))
        row = at(SEPARATION_SQUARED, lane)
        out[row] = min(out[row], dot(e, e))


@loop
def separate(out: Any) -> None:
    """The distance to the nearest other vehicle, from its square."""
    for lane in range(_LANES):
        out[at(SEPARATION, lane)] = np.sqrt(out[at(SEPARATION_SQUARED, lane)])


@loop
def judge(
    x: Any,
    action: Any,
    touch: Any,
    leader: Any,
    active: Any,
    size: int,
    rewards: Rewards,
    limits: Limits,
    out: Any,
    tally: Any,
) -> None:
    """Separation, reward, its terms and kind of failure into `out`; added up in `tally`.

    Worlds that have not stepped earn nothing and their followers have not failed. `touch` is of the follower,
    `leader` of the leader: a follower that has not failed is told of the leader's crash, unpaid.
    """
    for lane in range(_LANES):
        on = active[lane] > 0.0
        # Not a number where one of the two is unsound, else what it was.
        error = np.sqrt(out[at(ERROR_SQUARED, lane)]) + 0.0 * (touch[lane] + leader[lane])
        separation = np.sqrt(out[at(SEPARATION_SQUARED, lane)])
        out[at(SEPARATION, lane)] = separation
        why = failure(separation, touch[lane], touch[at(1, lane)], error, limits)
        a, b = _four(action, 0, lane), _four(x, PREVIOUS, lane)
        terms = reward(error, a, b, size, why != NO_FAILURE, rewards)
        total = terms.formation + terms.effort + terms.smoothness + terms.failure
        crashed = (why == NO_FAILURE) & (leader[lane] > limits.impact)
        failed = pick(on, pick(crashed, float(LEADER), float(why)), 0.0)
        out[at(REWARD, lane)] = pick(on, total, 0.0)
        out[at(TERMS, lane)] = pick(on, terms.formation, 0.0)
        out[at(TERMS + 1, lane)] = pick(on, terms.effort, 0.0)
        out[at(TERMS + 2, lane)] = pick(on, terms.smoothness, 0.0)
        out[at(TERMS + 3, lane)] = pick(on, terms.failure, 0.0)
        out[at(FAILED, lane)] = failed
        tally[lane] += pick(on, total, 0.0)
        tally[at(1, lane)] = max(tally[at(1, lane)], failed)
        _put_four(x, PREVIOUS, lane, pick_four(on, a, b))


@loop
def conclude(
    active: Any,
    tally: Any,
    impacts: Any,
    tick: Any,
    followers: float,
    limit: float,
    last: int,
    over: Any,
    verdicts: Any,
) -> None:
    """Mean reward, whether the episode has failed, whether it is over in time, of all worlds."""
    for lane in range(_LANES):
        on = active[lane] > 0.0
        ended = on & ((tally[at(1, lane)] > 0.0) | (impacts[lane] > limit))
        late = on & (tick[lane] >= last)
        over[lane] = np.int64(ended | late) if on else over[lane]
        verdicts[lane] = tally[lane] / followers
        verdicts[at(1, lane)] = pick(ended, 1.0, 0.0)
        verdicts[at(2, lane)] = pick(late, 1.0, 0.0)


@device
def pick_four(condition: bool, a: Action, b: Action) -> Action:
    """`a` if the condition holds, else `b`."""
    return (
        pick(condition, a[0], b[0]),
        pick(condition, a[1], b[1]),
        pick(condition, a[2], b[2]),
        pick(condition, a[3], b[3]),
    )


@device
def _show(row: Any, k: int, lane: Any, value: float, bound: float) -> None:
    """An entry of an observation, clipped, in single precision; in this order NaN becomes `-bound`."""
    row[at(k, lane)] = min(max(-bound, value), bound)


@device
def _show_vector(row: Any, k: int, lane: Any, a: Vector, bound: float) -> None:
    _show(row, k, lane, a[0], bound)
    _show(row, k + 1, lane, a[1], bound)
    _show(row, k + 2, lane, a[2], bound)


@loop
def see(x: Any, own: Any, leader: Any, begin: Any, started: Any, d: Vector, row: Any) -> None:
    """A follower's observation without guide and neighbours, into the first rows of `row`."""
    for lane in range(_LANES):
        on = started[lane] > 0.0
        R = complex(x[at(ESTIMATE, lane)], x[at(ESTIMATE + 1, lane)])
        m = _measured(leader, lane)
        anchor = pick_vector(on, m.p, load_vector(begin, 0, lane))
        o = observe(_measured(own, lane), m, anchor, R, d, _four(x, PREVIOUS, lane), on)
        _show_vector(row, 0, lane, o.slot_error, NEAR)
        _show_vector(row, 3, lane, o.relative_velocity, RATE_BOUND)
        _show_vector(row, 6, lane, o.leader_velocity, RATE_BOUND)
        _show_vector(row, 9, lane, o.leader_acceleration, RATE_BOUND)
        _show_vector(row, 12, lane, o.body_x, UNIT)
        _show_vector(row, 15, lane, o.body_z, UNIT)
        _show_vector(row, 18, lane, o.angular_velocity, RATE_BOUND)
        _show(row, 21, lane, o.heading[0], UNIT)
        _show(row, 22, lane, o.heading[1], UNIT)
        _show_vector(row, 23, lane, o.offset, NEAR)
        _show(row, 26, lane, o.previous_action[0], UNIT)
        _show(row, 27, lane, o.previous_action[1], UNIT)
        _show(row, 28, lane, o.previous_action[2], UNIT)
        _show(row, 29, lane, o.previous_action[3], UNIT)
        _show(row, 30, lane, o.started, UNIT)
        _show_vector(row, 31, lane, o.position, ANYWHERE)


@loop
def see_guide(x: Any, own: Any, k: int, row: Any) -> None:
    """What a follower sees of its virtual follower at level REFERENCE, from row `k` of `row` on."""
    for lane in range(_LANES):
        R = complex(x[at(ESTIMATE, lane)], x[at(ESTIMATE + 1, lane)])
        guide = Guide(load_vector(x, GUIDE_P, lane), load_vector(x, GUIDE_V, lane))
        g = observe_guide(_measured(own, lane), guide, R)
        _show_vector(row, k, lane, g.p, NEAR)
        _show_vector(row, k + 3, lane, g.v, RATE_BOUND)


@loop
def see_neighbour(x: Any, own: Any, other: Any, number: Any, k: int, row: Any) -> None:
    """What a follower sees of another one, from row `k` of `row` on; nothing of number -1."""
    for lane in range(_LANES):
        on = number[lane] >= 0.0
        R = complex(x[at(ESTIMATE, lane)], x[at(ESTIMATE + 1, lane)])
        o = observe_neighbour(_passing(own, lane), _passing(other, lane), R)
        nothing = (0.0, 0.0, 0.0)
        _show(row, k, lane, pick(on, o.present, 0.0), UNIT)
        _show_vector(row, k + 1, lane, pick_vector(on, o.position, nothing), NEAR)
        _show_vector(row, k + 4, lane, pick_vector(on, o.velocity, nothing), RATE_BOUND)


@loop
def forget(nearest: Any) -> None:
    """Nobody has been found yet, infinitely far."""
    for lane in range(_LANES):
        nearest[lane] = np.inf
        nearest[at(1, lane)] = -1.0


@device
def _distance_squared(own: Any, other: Any, lane: Any) -> float:
    e = sub(load_vector(other, 0, lane), load_vector(own, 0, lane))
    return float(dot(e, e))


@device
def _settle(nearest: Any, lane: Any, r: float, number: float) -> tuple[float, float]:
    """Let a candidate take the place of who is not so near; returns who is left, the other or itself.

    Of two equally far the one with the smaller number is the nearer.
    """
    held, holder = nearest[lane], nearest[at(1, lane)]
    on = (r < held) | ((r == held) & (number < holder))
    nearest[lane], nearest[at(1, lane)] = pick(on, r, held), pick(on, number, holder)
    return pick(on, held, r), pick(on, holder, number)


@loop
def measure(own: Any, other: Any, number: float, candidate: Any) -> None:
    """Squared distance to another follower, and its number."""
    for lane in range(_LANES):
        candidate[lane] = _distance_squared(own, other, lane)
        candidate[at(1, lane)] = number


@loop
def insert(candidate: Any, nearest: Any) -> None:
    """Take the candidate in where it is nearer than who is there, who becomes the candidate."""
    for lane in range(_LANES):
        r, number = _settle(nearest, lane, candidate[lane], candidate[at(1, lane)])
        candidate[lane], candidate[at(1, lane)] = r, number


@loop
def meet(own: Any, other: Any, number: float, nearest: Any, second: Any, candidate: Any) -> None:
    """`measure`, and `insert` into the first two places, in one go: most look no further."""
    for lane in range(_LANES):
        r, who = _settle(nearest, lane, _distance_squared(own, other, lane), number)
        r, who = _settle(second, lane, r, who)
        candidate[lane], candidate[at(1, lane)] = r, who
