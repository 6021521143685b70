"""The loops that the compiler vectorises: one vehicle in all worlds of a tile at once.

The mathematics is that of `world`, inlined. A loop becomes vector code only if nothing in it is called
or branches, if its row stride is a constant, and if its indices are unsigned; a test looks at the
machine code. Both loops here are functions of their own, so that every caller runs the same code.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formation_env._jit import device, loop
from formation_env.memory import ESTIMATE, GUIDE_P, GUIDE_V, HEADING, LANES, PREVIOUS
from formation_env.quadrotor import MOMENT, RATES, Airframe, Body, Wrench, saturate
from formation_env.rng import MEASUREMENT, Four, as_single, normal_pair, words
from formation_env.sensors import Measured, Noise, perturb
from formation_env.slots import advance_heading, slot
from formation_env.so3 import Vector, dot, pick, pick_vector, sub
from formation_env.task import (
    NO_FAILURE,
    Limits,
    Rewards,
    failure,
    observe,
    observe_guide,
    observe_neighbour,
    reward,
)
from formation_env.trajectories import Reference
from formation_env.world import Action, Guide, World, driven, motion, substep, track, truth

_LANES = np.uint64(LANES)
_PAIRS = np.uint64(8 * LANES)


@device
def at(row: int, lane: Any) -> Any:
    """Where row `row` of a tile has its entry for a lane."""
    return np.uint64(row) * _LANES + lane


@device
def _load(x: Any, row: int, lane: Any) -> Vector:
    return (x[at(row, lane)], x[at(row + 1, lane)], x[at(row + 2, lane)])


@device
def _keep(x: Any, row: int, lane: Any, on: bool, a: float) -> None:
    """Store where the world is active."""
    x[at(row, lane)] = pick(on, a, x[at(row, lane)])


@device
def _keep_vector(x: Any, row: int, lane: Any, on: bool, a: Vector) -> None:
    _keep(x, row, lane, on, a[0])
    _keep(x, row + 1, lane, on, a[1])
    _keep(x, row + 2, lane, on, a[2])


@device
def _fly_lane(
    x: Any, command: Any, touch: Any, on: bool, lane: Any, h: float, actuation: int, frame: Airframe
) -> None:
    """One substep of one vehicle in one lane: body and push in `x`, contact noted in `touch`."""
    q = (x[at(6, lane)], x[at(7, lane)], x[at(8, lane)], x[at(9, lane)])
    body = Body(_load(x, 0, lane), _load(x, 3, lane), q, _load(x, 10, lane))
    applied = Wrench(command[lane], _load(command, 1, lane))
    after, contact = substep(body, applied, _load(x, 13, lane), h, actuation, frame)
    _keep_vector(x, 0, lane, on, after.p)
    _keep_vector(x, 3, lane, on, after.v)
    _keep(x, 6, lane, on, after.q[0])
    _keep(x, 7, lane, on, after.q[1])
    _keep(x, 8, lane, on, after.q[2])
    _keep(x, 9, lane, on, after.q[3])
    _keep_vector(x, 10, lane, on, after.w)
    harder = contact.touching & (contact.speed > touch[lane])
    touch[at(1, lane)] = pick(harder, contact.uprightness, touch[at(1, lane)])
    touch[lane] = max(touch[lane], contact.speed)
    touch[at(2, lane)] = pick(contact.touching, 1.0, 0.0)


@device
def _measured(x: Any, lane: Any) -> Measured:
    q = (x[at(9, lane)], x[at(10, lane)], x[at(11, lane)], x[at(12, lane)])
    return Measured(_load(x, 0, lane), _load(x, 3, lane), _load(x, 6, lane), q, _load(x, 13, lane))


@device
def _four(x: Any, row: int, lane: Any) -> Action:
    return (x[at(row, lane)], x[at(row + 1, lane)], x[at(row + 2, lane)], x[at(row + 3, lane)])


@device
def _put(x: Any, row: int, lane: Any, a: Vector) -> None:
    x[at(row, lane)], x[at(row + 1, lane)], x[at(row + 2, lane)] = a


@device
def _lead(seen: Any, refs: Any, command: Any, lane: Any, actuation: int, world: World) -> None:
    ref = Reference(
        _load(refs, 0, lane),
        _load(refs, 3, lane),
        _load(refs, 6, lane),
        _load(refs, 9, lane),
        _load(refs, 12, lane),
    )
    wanted = track(motion(_measured(seen, lane)), ref, actuation, world)
    applied = saturate(wanted, actuation, world.airframe)
    command[lane] = applied.thrust
    _put(command, 1, lane, applied.turn)


@loop
def lead_by_moment(seen: Any, refs: Any, command: Any, world: World) -> None:
    """The tracker's command for a leader driven by moments, in all lanes."""
    for lane in range(_LANES):
        _lead(seen, refs, command, lane, MOMENT, world)


@loop
def lead_by_rates(seen: Any, refs: Any, command: Any, world: World) -> None:
    """The tracker's command for a leader driven by rates, in all lanes."""
    for lane in range(_LANES):
        _lead(seen, refs, command, lane, RATES, world)


@device
def _drive(action: Any, command: Any, lane: Any, actuation: int, world: World) -> None:
    applied = saturate(driven(_four(action, 0, lane), world), actuation, world.airframe)
    command[lane] = applied.thrust
    _put(command, 1, lane, applied.turn)


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


@loop
def sense_exactly(
    x: Any, command: Any, touch: Any, active: Any, sample: Any, frame: Airframe
) -> None:
    """A measurement without noise of one vehicle, in the active lanes."""
    for lane in range(_LANES):
        q = _four(x, 6, lane)
        body = Body(_load(x, 0, lane), _load(x, 3, lane), q, _load(x, 10, lane))
        applied = Wrench(command[lane], _load(command, 1, lane))
        m = truth(body, applied, _load(x, 13, lane), touch[at(2, lane)] > 0.0, frame)
        _keep_sample(sample, lane, active[lane] > 0.0, m)


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
    touch: Any,
    active: Any,
    sample: Any,
    frame: Airframe,
    noise: Noise,
    draws: Any,
) -> None:
    """A measurement with noise made of the normal numbers in `draws`, in the active lanes."""
    for lane in range(_LANES):
        q = _four(x, 6, lane)
        body = Body(_load(x, 0, lane), _load(x, 3, lane), q, _load(x, 10, lane))
        applied = Wrench(command[lane], _load(command, 1, lane))
        exact = truth(body, applied, _load(x, 13, lane), touch[at(2, lane)] > 0.0, frame)
        n0, n1 = _normals(draws, 0, lane), _normals(draws, 1, lane)
        n2, n3 = _normals(draws, 2, lane), _normals(draws, 3, lane)
        _keep_sample(sample, lane, active[lane] > 0.0, perturb(exact, noise, n0, n1, n2, n3))


@device
def sense(
    x: Any,
    command: Any,
    touch: Any,
    active: Any,
    sample: Any,
    frame: Airframe,
    noise: Noise,
    keys: Any,
    counts: Any,
    who: int,
    draws: Any,
) -> None:
    """A noisy measurement, number `counts`, of vehicle `who`, in the active lanes.

    It is `sensors.corrupt` in steps with room between them: `draws`, 16 rows of float32. In one loop the
    constants of Philox and of the polynomials exceed the registers, and the float64 of the measurement
    would halve the width of the float32, which together doubles the time.
    """
    for block in range(4):
        draw(keys, counts, who, block, draws)
    make_normal(draws)
    add_noise(x, command, touch, active, sample, frame, noise, draws)


@device
def _keep_sample(sample: Any, lane: Any, on: bool, m: Measured) -> None:
    _keep_vector(sample, 0, lane, on, m.p)
    _keep_vector(sample, 3, lane, on, m.v)
    _keep_vector(sample, 6, lane, on, m.a)
    _keep(sample, 9, lane, on, m.q[0])
    _keep(sample, 10, lane, on, m.q[1])
    _keep(sample, 11, lane, on, m.q[2])
    _keep(sample, 12, lane, on, m.q[3])
    _keep_vector(sample, 13, lane, on, m.w)


@device
def _turn(
    x: Any, row: int, lane: Any, on: bool, v0: complex, v1: complex, d_x: float, h: float
) -> None:
    R = advance_heading(complex(x[at(row, lane)], x[at(row + 1, lane)]), v0, v1, d_x, h)
    _keep(x, row, lane, on, R.real)
    _keep(x, row + 1, lane, on, R.imag)


@loop
def turn_headings(
    x: Any, leader: Any, before: Any, seen: Any, seen_before: Any, moving: Any, d_x: float, h: float
) -> None:
    """The slot's heading follows the leader's true motion, the estimate the measured one (23)."""
    for lane in range(_LANES):
        on = moving[lane] > 0.0
        v0 = complex(before[lane], before[at(1, lane)])
        v1 = complex(leader[at(3, lane)], leader[at(4, lane)])
        _turn(x, HEADING, lane, on, v0, v1, d_x, h)
        w0 = complex(seen_before[lane], seen_before[at(1, lane)])
        w1 = complex(seen[at(3, lane)], seen[at(4, lane)])
        _turn(x, ESTIMATE, lane, on, w0, w1, d_x, h)


@loop
def locate(x: Any, leader: Any, own: Any, begin: Any, started: Any, d: Vector, where: Any) -> None:
    """Slot, slot error and its square, into rows 0-2, 3-5 and 6 of `where`; row 7 cleared."""
    for lane in range(_LANES):
        on = started[lane] > 0.0
        R = complex(x[at(HEADING, lane)], x[at(HEADING + 1, lane)])
        p_L = pick_vector(on, _load(leader, 0, lane), _load(begin, 0, lane))
        v_L = pick_vector(on, _load(leader, 3, lane), (0.0, 0.0, 0.0))
        target = slot(R, p_L, v_L, d)
        error = sub(target.p, _load(own, 0, lane))
        _put(where, 0, lane, target.p)
        _put(where, 3, lane, error)
        where[at(6, lane)] = dot(error, error)
        where[at(7, lane)] = np.inf


@loop
def approach(one: Any, other: Any, where: Any) -> None:
    """Keep the least squared distance between vehicle `one` and the others in row 7 of `where`."""
    for lane in range(_LANES):
        e = sub(_load(one, 0, lane), _load(other, 0, lane))
        where[at(7, lane)] = min(where[at(7, lane)], dot(e, e))


@loop
def judge(
    x: Any,
    action: Any,
    touch: Any,
    where: Any,
    active: Any,
    size: int,
    rewards: Rewards,
    limits: Limits,
    verdict: Any,
) -> None:
    """Reward, its four terms and the kind of failure, into the six rows of `verdict`."""
    for lane in range(_LANES):
        error = np.sqrt(where[at(6, lane)])
        separation = np.sqrt(where[at(7, lane)])
        why = failure(separation, touch[lane], touch[at(1, lane)], error, limits)
        a, b = _four(action, 0, lane), _four(x, PREVIOUS, lane)
        terms = reward(error, a, b, size, why != NO_FAILURE, rewards)
        verdict[lane] = terms.formation + terms.effort + terms.smoothness + terms.failure
        verdict[at(1, lane)] = terms.formation
        verdict[at(2, lane)] = terms.effort
        verdict[at(3, lane)] = terms.smoothness
        verdict[at(4, lane)] = terms.failure
        verdict[at(5, lane)] = float(why)
        on = active[lane] > 0.0
        _keep(x, PREVIOUS, lane, on, a[0])
        _keep(x, PREVIOUS + 1, lane, on, a[1])
        _keep(x, PREVIOUS + 2, lane, on, a[2])
        _keep(x, PREVIOUS + 3, lane, on, a[3])


@loop
def see(x: Any, own: Any, leader: Any, begin: Any, started: Any, d: Vector, row: Any) -> None:
    """A follower's observation without guide and neighbours, into the rows of `row`."""
    for lane in range(_LANES):
        on = started[lane] > 0.0
        R = complex(x[at(ESTIMATE, lane)], x[at(ESTIMATE + 1, lane)])
        m = _measured(leader, lane)
        anchor = pick_vector(on, m.p, _load(begin, 0, lane))
        o = observe(_measured(own, lane), m, anchor, R, d, _four(x, PREVIOUS, lane), on)
        _put(row, 0, lane, o.slot_error)
        _put(row, 3, lane, o.relative_velocity)
        _put(row, 6, lane, o.leader_velocity)
        _put(row, 9, lane, o.leader_acceleration)
        _put(row, 12, lane, o.body_x)
        _put(row, 15, lane, o.body_z)
        _put(row, 18, lane, o.angular_velocity)
        row[at(21, lane)] = o.heading[0]
        row[at(22, lane)] = o.heading[1]
        _put(row, 23, lane, o.offset)
        row[at(26, lane)] = o.previous_action[0]
        row[at(27, lane)] = o.previous_action[1]
        row[at(28, lane)] = o.previous_action[2]
        row[at(29, lane)] = o.previous_action[3]
        row[at(30, lane)] = o.started
        _put(row, 31, lane, o.position)


@loop
def see_guide(x: Any, own: Any, row: Any) -> None:
    """What a follower sees of its virtual follower at level REFERENCE, into six rows of `row`."""
    for lane in range(_LANES):
        R = complex(x[at(ESTIMATE, lane)], x[at(ESTIMATE + 1, lane)])
        guide = Guide(_load(x, GUIDE_P, lane), _load(x, GUIDE_V, lane))
        g = observe_guide(_measured(own, lane), guide, R)
        _put(row, 0, lane, g.p)
        _put(row, 3, lane, g.v)


@loop
def forget(best: Any) -> None:
    """Begin the search for the next neighbour: none found, infinitely far."""
    for lane in range(_LANES):
        best[lane] = np.inf
        best[at(1, lane)] = -1.0
        for row in range(2, 9):
            best[at(row, lane)] = 0.0


@loop
def consider(x: Any, own: Any, other: Any, number: float, last: Any, best: Any) -> None:
    """Take follower `number` into `best` if it is nearer than what is there and beyond `last`.

    Rows of `best` and `last`: squared distance, number, then a `Neighbour`. "Beyond" orders by
    distance and, where distances are equal, by number, so that nobody is taken twice.
    """
    for lane in range(_LANES):
        R = complex(x[at(ESTIMATE, lane)], x[at(ESTIMATE + 1, lane)])
        mine, its = _measured(own, lane), _measured(other, lane)
        e = sub(its.p, mine.p)
        r = dot(e, e)
        beyond = (r > last[lane]) | ((r == last[lane]) & (number > last[at(1, lane)]))
        on = beyond & (r < best[lane])
        o = observe_neighbour(mine, its, R)
        _keep(best, 0, lane, on, r)
        _keep(best, 1, lane, on, number)
        _keep(best, 2, lane, on, o.present)
        _keep_vector(best, 3, lane, on, o.position)
        _keep_vector(best, 6, lane, on, o.velocity)


@loop
def clip_into(values: Any, first: int, rows: int, bound: Any, k: int, out: Any) -> None:
    """Rows of `values` from `first` on, clipped to `bound` from `k` on, into `out`."""
    for row in range(rows):
        limit = np.float64(bound[k + row])
        source, sink = np.uint64(first + row) * _LANES, np.uint64(k + row) * _LANES
        for lane in range(_LANES):
            out[sink + lane] = min(max(values[source + lane], -limit), limit)


@loop
def fly_by_moment(x: Any, command: Any, touch: Any, active: Any, h: float, frame: Airframe) -> None:
    """One substep of a vehicle driven by moments, in all lanes of its tile."""
    for lane in range(_LANES):
        _fly_lane(x, command, touch, active[lane] > 0.0, lane, h, MOMENT, frame)


@loop
def fly_by_rates(x: Any, command: Any, touch: Any, active: Any, h: float, frame: Airframe) -> None:
    """One substep of a vehicle driven by rates, in all lanes of its tile."""
    for lane in range(_LANES):
        _fly_lane(x, command, touch, active[lane] > 0.0, lane, h, RATES, frame)
