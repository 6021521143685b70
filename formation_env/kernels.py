"""The compiled loop over worlds: reset, step and look, tick by tick.

The mathematics is in `world`, `task` and below; here is the order of things.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device, kernel
from formation_env.lanes import (
    approach,
    clip_into,
    consider,
    drive_by_moment,
    drive_by_rates,
    fly_by_moment,
    fly_by_rates,
    forget,
    judge,
    lead_by_moment,
    lead_by_rates,
    locate,
    see,
    see_guide,
    sense,
    sense_exactly,
    turn_headings,
)
from formation_env.looking import begin_of, slot_of
from formation_env.memory import (
    CLOCK,
    EPISODE,
    ESTIMATE,
    FAILED,
    GUIDE_P,
    GUIDE_V,
    HEADING,
    LANES,
    OUTPUTS,
    OVER,
    PREVIOUS,
    SAMPLES,
    SEPARATION,
    SLOT,
    STARTED,
    TERMS,
    TICK,
    Constants,
    Floats,
    Results,
    Settings,
    State,
    episode_key,
    follower,
    latest,
    load,
    load_body,
    load_guide,
    load_sample,
    open_constants,
    open_results,
    open_state,
    put,
    put_body,
    put_sample,
    ring,
    table_row,
    unpack,
    vehicle,
)
from formation_env.quadrotor import MOMENT, Body, Wrench
from formation_env.sensors import (
    Measured,
    angular_difference,
    averaged_acceleration,
    corrupt,
    difference,
    silent,
)
from formation_env.so3 import Vector
from formation_env.task import CORE, NO_FAILURE
from formation_env.trajectories import draw, evaluate, start_direction
from formation_env.world import (
    RATE,
    REFERENCE,
    WRENCH,
    Action,
    World,
    command_guided,
    guide_on,
    guided,
    gust,
    hold_at,
    near,
    resting,
    trimmed,
    truth,
    within,
)


class Scratch(NamedTuple):
    """Room to work on one tile of L lanes, for n followers."""

    active: Floats  # (L,): 1 for worlds that step, else 0
    moving: Floats  # (L,): 1 for those whose trigger had fired before the tick
    started: Floats  # (L,): 1 for those whose trigger has fired
    before: Floats  # (2 L): the leader's planar velocity before the tick, m/s
    refs: Floats  # (15 L): the leader's reference
    seen: Floats  # (n+1, 16 L): the measurements in hand
    actions: Floats  # (n, 4 L): as executed
    commands: Floats  # (n+1, 4 L): thrust and turn of each vehicle
    touches: Floats  # (n+1, 3 L): speed, uprightness of the hardest touch-down; touching now
    where: Floats  # (n, 8 L): slot, slot error, squares of error and separation
    verdicts: Floats  # (n, 6 L): reward, its terms, kind of failure
    row: Floats  # (34 L): an observation, without guide and neighbours
    found: Floats  # (K+1, 9 L): the nearest neighbours, after one nearer than all
    rows: Floats  # (entries L): an observation, clipped


@device
def _scratch(room: Floats, c: Constants) -> Scratch:
    """`Scratch` in flat memory, whose length is `memory.room_size`."""
    n, K = len(c.offsets), c.neighbours + 1
    a = 3 + 2 + 15
    b = a + 16 * (n + 1)
    d = b + 4 * n
    e = d + 4 * (n + 1)
    f = e + 3 * (n + 1)
    g = f + 8 * n
    h = g + 6 * n
    i = h + CORE
    j = i + 9 * K
    L = LANES
    found = room[i * L : j * L].reshape(K, 9 * L)
    found[0, : 2 * L] = -1.0
    return Scratch(
        room[:L],
        room[L : 2 * L],
        room[2 * L : 3 * L],
        room[3 * L : 5 * L],
        room[5 * L : a * L],
        room[a * L : b * L].reshape(n + 1, 16 * L),
        room[b * L : d * L].reshape(n, 4 * L),
        room[d * L : e * L].reshape(n + 1, 4 * L),
        room[e * L : f * L].reshape(n + 1, 3 * L),
        room[f * L : g * L].reshape(n, 8 * L),
        room[g * L : h * L].reshape(n, 6 * L),
        room[h * L : i * L],
        found,
        room[j * L :],
    )


# Modes of `advance`: what to do with each world.
STEP, STEP_OR_RESET, STEP_AND_RESET, RESET = 0, 1, 2, 3


# -- sensing ------------------------------------------------------------------------------------


@device
def _take_sample(
    samples: Any, speeds: Any, raw: Measured, count: int, leader: bool, s: World
) -> None:
    """Store sample number `count`, its velocities differenced where they are not measured."""
    if s.clock.window > 0:
        period = s.clock.sample_every * (s.clock.period / s.clock.substeps)
        before = load_sample(samples[(count - 1) % len(samples)])
        v = difference(raw.p, before.p, period)
        a = (0.0, 0.0, 0.0)
        if leader:
            then = speeds[count % s.clock.window]
            a = averaged_acceleration(v, load(then, 0), s.clock.window, period)
            put(then, 0, v)
        raw = Measured(raw.p, v, a, raw.q, angular_difference(raw.q, before.q, period))
    put_sample(samples[count % len(samples)], raw)


@device
def _sense(state: State, t: int, i: int, room: Scratch, k: int, s: World) -> None:
    """Sample vehicle `i` in the flying worlds of tile `t` where a measurement is due."""
    for lane in range(LANES):
        if room.active[lane] == 0.0:
            continue
        w = t * LANES + lane
        elapsed = state.counters[w, TICK] * s.clock.substeps + k + 1
        if elapsed % s.clock.sample_every != 0:
            continue
        count = elapsed // s.clock.sample_every
        x = vehicle(state, w, i)
        applied = Wrench(room.commands[i, lane], (0.0, 0.0, 0.0))
        touching = room.touches[i, 2 * LANES + lane] != 0.0
        exact = truth(load_body(x), applied, load(x, 13), touching, s.airframe)
        raw = exact
        if not silent(s.noise):
            raw = corrupt(exact, s.noise, state.episode_keys[w], i, count)
        _take_sample(ring(state, w, i), state.speeds[w], raw, count, i == 0, s)


@device
def _plain(s: World) -> bool:
    """Whether every tick ends with a measurement that is at once in hand."""
    c = s.clock
    return c.window == 0 and c.delay == 0 and c.sample_every == c.substeps


@device
def _receive(state: State, t: int, room: Scratch) -> None:
    """Fetch the measurements that have arrived in all worlds of tile `t`.

    Copied even where they could be used in place: two kinds of view cost more than the copy.
    """
    worlds, delays = len(state.counters), state.samples.shape[2]
    counters, samples, seen = state.counters, state.samples, room.seen
    for i in range(samples.shape[1]):
        if delays == 1:
            seen[i] = samples[t, i, 0].reshape(16 * LANES)
        else:
            for lane in range(min(LANES, worlds - t * LANES)):
                at = (counters[t * LANES + lane, SAMPLES] + 1) % delays
                for k in range(16):
                    seen[i, k * LANES + lane] = samples[t, i, at, k, lane]


# -- reset ----------------------------------------------------------------------------------------


@device
def _place(state: State, w: int, i: int, body: Body, a: Vector, key: Any, s: World) -> None:
    """Put a vehicle with acceleration `a` into the world, its gust still, its sensors settled."""
    x = vehicle(state, w, i)
    put_body(x, body)
    put(x, 13, (0.0, 0.0, 0.0))
    exact = Measured(body.p, body.v, a, body.q, body.w)
    raw = exact
    if not silent(s.noise):
        raw = corrupt(exact, s.noise, key, i, 0)
    for k in range(s.clock.delay + 1):
        put_sample(ring(state, w, i)[k], raw)
    if i == 0:
        for k in range(s.clock.window):
            put(state.speeds[w, k], 0, body.v)


@device
def _reset(state: State, c: Constants, w: int, out: Any, s: Settings) -> None:
    """Start the next episode of world `w`."""
    counters = state.counters[w]
    counters[EPISODE] += 1
    counters[TICK] = counters[SAMPLES] = counters[CLOCK] = counters[OVER] = 0
    counters[STARTED] = 0 if s.world.on_ground else 1
    key = episode_key(state.keys[w], counters[EPISODE])
    state.episode_keys[w] = key
    table = table_row(state.tables, w)
    if len(c.drawing) > 0:
        draw(key, c.drawing, table)
    begin = evaluate(c.trajectory_kind, table, 0.0)
    R = start_direction(c.trajectory_kind, table)
    for k in range(3):
        state.begins[w // LANES, k, w % LANES] = begin.p[k]

    still = (0.0, 0.0, 0.0)
    if s.world.on_ground:
        _place(state, w, 0, resting(load(c.starts[0], 0)), still, key, s.world)
    else:
        _place(state, w, 0, trimmed(begin, s.world), begin.a, key, s.world)
    seen = latest(state, w, 0).v
    state.seen[w // LANES, 0, w % LANES] = seen[0]
    state.seen[w // LANES, 1, w % LANES] = seen[1]
    for i in range(len(c.offsets)):
        x = follower(state, w, i)
        x[HEADING], x[HEADING + 1] = R.real, R.imag
        x[ESTIMATE], x[ESTIMATE + 1] = R.real, R.imag
        for k in range(4):
            x[PREVIOUS + k] = 0.0
        target = slot_of(state, c, w, i)
        put(x, GUIDE_P, target.p)
        put(x, GUIDE_V, target.v)
        if s.world.on_ground:
            body = resting(load(c.starts[i + 1], 0))
        else:
            body = near(target, key, i + 1, s.world)
        _place(state, w, i + 1, body, still, key, s.world)
        for k in range(len(OUTPUTS)):
            out[i, k] = 0.0


# -- step -------------------------------------------------------------------------------------------


@device
def _triggered(state: State, c: Constants, w: int, s: World) -> bool:
    """The trigger (40), on true positions: every vehicle is near where it should start from."""
    ready = within(load(vehicle(state, w, 0), 0), begin_of(state, w), s.trigger)
    for i in range(len(c.offsets)):
        target = slot_of(state, c, w, i)
        p = load(vehicle(state, w, i + 1), 0)
        ready = ready and within(p, target.p, s.trigger)
    return ready


@device
def _guide(state: State, w: int, i: int, a: Action, s: World) -> Wrench:
    """Level REFERENCE: move follower `i`'s virtual follower on, and fly along it."""
    x = follower(state, w, i)
    guide = load_guide(x)
    R = complex(x[ESTIMATE], x[ESTIMATE + 1])
    ref = guided(a, guide, R, s)
    moved = guide_on(guide, ref.a, s.clock.period)
    put(x, GUIDE_P, moved.p)
    put(x, GUIDE_V, moved.v)
    return command_guided(latest(state, w, i + 1), ref, s)


@device
def _refer(state: State, c: Constants, w: int, refs: Floats, s: World) -> None:
    """The leader's reference now, where it is not in the table: waiting, or on a path of its own."""
    lane = w % LANES
    ref = hold_at(begin_of(state, w))
    if state.counters[w, STARTED] != 0:
        clock = state.counters[w, CLOCK] * s.clock.period
        ref = evaluate(c.trajectory_kind, table_row(state.tables, w), clock)
    for k in range(3):
        refs[k * LANES + lane] = ref.p[k]
        refs[(3 + k) * LANES + lane] = ref.v[k]
        refs[(6 + k) * LANES + lane] = ref.a[k]
        refs[(9 + k) * LANES + lane] = ref.j[k]
        refs[(12 + k) * LANES + lane] = ref.s[k]


@device
def _prepare(
    state: State, c: Constants, t: int, actions: Any, mask: Any, mode: int, room: Scratch, s: World
) -> tuple[bool, bool]:
    """Find out which worlds of tile `t` step, and fetch what they bring: references, actions, gusts.

    Returns whether any world steps and whether any is to be reset first. Arrays are taken out of
    their tuples once: each time counts a reference, which costs as much as the work itself.
    """
    counters, active, moving, refs = state.counters, room.active, room.moving, room.refs
    table, executed, before = c.references, room.actions, room.before
    seen = room.seen[0]
    vehicles, seen_before = state.vehicles, state.seen
    flying = waiting = False
    for lane in range(LANES):
        active[lane] = moving[lane] = 0.0
        w = t * LANES + lane
        if w >= len(counters) or not mask[w]:
            continue
        if mode == RESET or (mode == STEP_OR_RESET and counters[w, OVER] != 0):
            waiting = True
            continue
        flying = True
        active[lane] = 1.0
        started = counters[w, STARTED] != 0
        moving[lane] = 1.0 if started else 0.0
        if started and len(table) > 0:
            clock = counters[w, CLOCK]
            for k in range(15):
                refs[k * LANES + lane] = table[clock, k]
        else:
            _refer(state, c, w, refs, s)
        for k in range(2):
            before[k * LANES + lane] = vehicles[t, 0, 3 + k, lane]
            seen_before[t, k, lane] = seen[(3 + k) * LANES + lane]
        for i in range(actions.shape[1]):
            for k in range(actions.shape[2]):
                a = np.float64(actions[w, i, k])
                executed[i, k * LANES + lane] = min(max(a, -1.0), 1.0)
        if s.gusts.kick != 0.0:
            for i in range(vehicles.shape[1]):
                x = vehicle(state, w, i)
                key = state.episode_keys[w]
                put(x, 13, gust(load(x, 13), s.gusts, key, i, counters[w, TICK]))
    return flying, waiting


@device
def _command(state: State, t: int, room: Scratch, s: World) -> None:
    """The commands of all vehicles of tile `t`."""
    if s.leader_actuation == MOMENT:
        lead_by_moment(room.seen[0], room.refs, room.commands[0], s)
    else:
        lead_by_rates(room.seen[0], room.refs, room.commands[0], s)
    for i in range(len(room.actions)):
        action, command = room.actions[i], room.commands[i + 1]
        if s.level == WRENCH:
            drive_by_moment(action, command, s)
        elif s.level == RATE:
            drive_by_rates(action, command, s)
        else:
            for lane in range(LANES):
                if room.active[lane] != 0.0:
                    # Before the trigger (40) virtual followers wait.
                    m = room.moving[lane]
                    a = (
                        m * action[lane],
                        m * action[LANES + lane],
                        m * action[2 * LANES + lane],
                        0.0,
                    )
                    applied = _guide(state, t * LANES + lane, i, a, s)
                    command[lane] = applied.thrust
                    for k in range(3):
                        command[(k + 1) * LANES + lane] = applied.turn[k]


@device
def _fly(state: State, t: int, room: Scratch, s: World) -> None:
    """Fly all vehicles of the active worlds of tile `t` for one tick, sampling on the way."""
    h = s.clock.period / s.clock.substeps
    plain = _plain(s)
    counts = np.zeros(LANES, dtype=np.uint64)
    draws = room.row.view(np.float32)
    if plain and not silent(s.noise):
        for lane in range(min(LANES, len(state.counters) - t * LANES)):
            counts[lane] = state.counters[t * LANES + lane, TICK] + 1
    # In step with the ticks a measurement is due at their end; else the worlds differ.
    aligned = s.clock.sample_every % s.clock.substeps == 0
    for i in range(state.vehicles.shape[1]):
        x = state.vehicles[t, i].reshape(16 * LANES)
        actuation = s.leader_actuation if i == 0 else s.follower_actuation
        commands, touches = room.commands[i], room.touches[i]
        for lane in range(LANES):
            touches[lane], touches[LANES + lane] = 0.0, 1.0
        for k in range(s.clock.substeps):
            if actuation == MOMENT:
                fly_by_moment(x, commands, touches, room.active, h, s.airframe)
            else:
                fly_by_rates(x, commands, touches, room.active, h, s.airframe)
            if not plain and (not aligned or k + 1 == s.clock.substeps):
                _sense(state, t, i, room, k, s)
        if plain:
            sample = state.samples[t, i, 0].reshape(16 * LANES)
            if silent(s.noise):
                sense_exactly(x, commands, touches, room.active, sample, s.airframe)
            else:
                keys = state.episode_keys[t * LANES : (t + 1) * LANES]
                air, noise, active = s.airframe, s.noise, room.active
                sense(x, commands, touches, active, sample, air, noise, keys, counts, i, draws)


@device
def _count(state: State, c: Constants, t: int, room: Scratch, s: World) -> None:
    """Move the counters and headings of the worlds of tile `t` that have flown on by a tick."""
    counters, active = state.counters, room.active
    for lane in range(LANES):
        if active[lane] != 0.0:
            w = t * LANES + lane
            tick = counters[w, TICK] + 1
            counters[w, TICK] = tick
            counters[w, SAMPLES] = tick * s.clock.substeps // s.clock.sample_every
    _receive(state, t, room)
    leader = state.vehicles[t, 0].reshape(16 * LANES)
    seen_before, seen = state.seen[t].reshape(2 * LANES), room.seen[0]
    for i in range(len(c.offsets)):
        x = state.followers[t, i].reshape(14 * LANES)
        d_x, h = c.offsets[i, 0], s.clock.period
        turn_headings(x, leader, room.before, seen, seen_before, room.moving, d_x, h)
    for lane in range(LANES):
        if active[lane] != 0.0:
            w = t * LANES + lane
            if counters[w, STARTED] != 0:
                counters[w, CLOCK] += 1
            elif _triggered(state, c, w, s):
                counters[w, STARTED] = 1


@device
def _locate(state: State, c: Constants, t: int, room: Scratch) -> None:
    """Slots, slot errors and separations in all worlds of tile `t`."""
    worlds, vehicles = len(state.counters), len(c.offsets) + 1
    for lane in range(min(LANES, worlds - t * LANES)):
        room.started[lane] = 1.0 if state.counters[t * LANES + lane, STARTED] != 0 else 0.0
    leader, begin = state.vehicles[t, 0].reshape(16 * LANES), state.begins[t].reshape(3 * LANES)
    for i in range(1, vehicles):
        x, own = (
            state.followers[t, i - 1].reshape(14 * LANES),
            state.vehicles[t, i].reshape(16 * LANES),
        )
        where = room.where[i - 1]
        locate(x, leader, own, begin, room.started, load(c.offsets[i - 1], 0), where)
        for j in range(vehicles):
            if j != i:
                approach(own, state.vehicles[t, j].reshape(16 * LANES), where)


@device
def _judge(state: State, c: Constants, t: int, room: Scratch, r: Results, s: Settings) -> None:
    """Rewards and failures of the worlds of tile `t` that have flown."""
    n = len(c.offsets)
    for i in range(n):
        x = state.followers[t, i].reshape(14 * LANES)
        judge(
            x,
            room.actions[i],
            room.touches[i + 1],
            room.where[i],
            room.active,
            c.action_size,
            s.rewards,
            s.limits,
            room.verdicts[i],
        )
    active, touches, verdicts = room.active, room.touches, room.verdicts
    outputs, counters = r.outputs, state.counters
    for lane in range(LANES):
        if active[lane] != 0.0:
            w = t * LANES + lane
            ended, total = touches[0, lane] > s.limits.impact, 0.0
            for i in range(n):
                for k in range(TERMS + 4):
                    outputs[w, i, k] = verdicts[i, k * LANES + lane]
                why = verdicts[i, 5 * LANES + lane]
                outputs[w, i, FAILED] = why
                total += verdicts[i, lane]
                ended = ended or why != NO_FAILURE
            late = counters[w, TICK] >= c.max_steps
            r.rewards[w], r.terminated[w], r.truncated[w] = total / n, ended, late
            counters[w, OVER] = ended or late


@device
def _look(state: State, c: Constants, t: int, room: Scratch, r: Results, s: World) -> None:
    """Write what every follower of tile `t` sees, and the truth beside it."""
    here = min(LANES, len(state.counters) - t * LANES)
    begin = state.begins[t].reshape(3 * LANES)
    observations, outputs, rows, where = r.observations, r.outputs, room.rows, room.where
    for i in range(len(c.offsets)):
        x = state.followers[t, i].reshape(14 * LANES)
        d = load(c.offsets[i], 0)
        own = room.seen[i + 1]
        see(x, own, room.seen[0], begin, room.started, d, room.row)
        clip_into(room.row, 0, CORE, c.bound, 0, room.rows)
        k = CORE
        if s.level == REFERENCE:
            see_guide(x, own, room.row)
            clip_into(room.row, 0, 6, c.bound, k, room.rows)
            k += 6
        for m in range(c.neighbours):
            best = room.found[m + 1]
            forget(best)
            for j in range(len(c.offsets)):
                if j != i:
                    consider(x, own, room.seen[j + 1], float(j), room.found[m], best)
            clip_into(best, 2, 7, c.bound, k, room.rows)
            k += 7
        for lane in range(here):
            w = t * LANES + lane
            for k in range(observations.shape[2]):
                observations[w, i, k] = rows[k * LANES + lane]
            for k in range(6):
                outputs[w, i, SLOT + k] = where[i, k * LANES + lane]
            outputs[w, i, SEPARATION] = np.sqrt(where[i, 7 * LANES + lane])


@kernel
def advance(
    first: int,
    last: int,
    mode: int,
    actions: NDArray[np.float32],
    mask: NDArray[np.bool_],
    floats: Floats,
    counters: NDArray[np.int64],
    keys: NDArray[np.uint64],
    numbers: Floats,
    bound: NDArray[np.float32],
    sizes: NDArray[np.int64],
    observations: NDArray[np.float32],
    outputs: Floats,
    flags: NDArray[np.bool_],
    last_observations: NDArray[np.float32],
    last_outputs: Floats,
    flat: Floats,
) -> None:
    """Step or reset those worlds of the tiles `first` to `last` that `mask` names; look at the others.

    `floats` to `sizes` are `Memory`, `observations` to `last_outputs` what `memory.results` made,
    `flat` is room for `Scratch`.

    Each thing that may happen to a world stands once in here: compiled twice, the same formula may
    come out with other fused operations, and the faces would differ in a last bit.
    """
    state = open_state(floats, counters, keys, sizes)
    c = open_constants(numbers, bound, sizes)
    r = open_results(observations, outputs, flags, last_observations, last_outputs, sizes)
    s = unpack(c.settings)
    room = _scratch(flat, c)
    worlds = len(state.counters)
    for t in range(first, last):
        end = min((t + 1) * LANES, worlds)
        _receive(state, t, room)
        flying, waiting = _prepare(state, c, t, actions, mask, mode, room, s.world)
        if flying:
            _command(state, t, room, s.world)
            _fly(state, t, room, s.world)
            _count(state, c, t, room, s.world)
        judged, again = not flying, True
        while again:
            if waiting:
                for w in range(t * LANES, end):
                    lane = w % LANES
                    fresh = mask[w] and room.active[lane] == 0.0
                    if fresh or (judged and flying and state.counters[w, OVER] != 0):
                        _reset(state, c, w, r.outputs[w], s)
                        room.active[lane] = 0.0
                _receive(state, t, room)
                waiting = False
            _locate(state, c, t, room)
            if not judged:
                _judge(state, c, t, room, r, s)
                judged = True
            _look(state, c, t, room, r, s.world)
            again = False
            if mode == STEP_AND_RESET:
                for w in range(t * LANES, end):
                    if room.active[w % LANES] != 0.0 and state.counters[w, OVER] != 0:
                        r.final_observations[w] = r.observations[w]
                        r.final_outputs[w] = r.outputs[w]
                        again = waiting = True


@kernel
def first_bad_action(actions: NDArray[np.float32]) -> Any:
    """Number of the first row `(world, follower)` that holds a non-finite number, or -1."""
    worlds, n, size = actions.shape
    for w in range(worlds):
        for i in range(n):
            for k in range(size):
                if not np.isfinite(actions[w, i, k]):
                    return w * n + i
    return -1


@kernel
def reference_path(kind: int, table: Floats, times: Floats) -> Floats:
    """Positions of a trajectory at `times`, `(N, 3)`."""
    path = np.empty((len(times), 3))
    for k in range(len(times)):
        put(path[k], 0, evaluate(kind, table, times[k]).p)
    return path


@kernel
def reference_table(kind: int, table: Floats, period: float, steps: int) -> Floats:
    """A trajectory tick by tick, `(steps + 1, 15)`: position and four derivatives."""
    rows = np.empty((steps + 1, 15))
    for k in range(steps + 1):
        ref = evaluate(kind, table, k * period)
        put(rows[k], 0, ref.p)
        put(rows[k], 3, ref.v)
        put(rows[k], 6, ref.a)
        put(rows[k], 9, ref.j)
        put(rows[k], 12, ref.s)
    return rows
