"""The compiled loop over worlds: reset, step and look, tick by tick.

The mathematics is in `world`, `task` and below; here is the order of things.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import announced, device, kernel
from formation_env.blocks import LANES, carve, gather, scatter
from formation_env.company import CROWD, know_crowd, know_few, see_neighbours, separate_crowd
from formation_env.episodes import Task, start_episode
from formation_env.lanes import (
    approach,
    clear,
    clear_touch,
    copy,
    count_finite,
    doubtful,
    drive_by_moment,
    drive_by_rates,
    fly_by_moment,
    fly_by_rates,
    fly_low_by_moment,
    fly_low_by_rates,
    judge,
    lead_by_moment,
    lead_by_rates,
    locate,
    repeat,
    restore,
    see,
    see_guide,
    sense,
    sense_exactly,
    separate,
    take,
    turn_headings,
)
from formation_env.memory import (
    CLOCK,
    ERROR_SQUARED,
    ESTIMATE,
    GUIDE_P,
    GUIDE_V,
    GUST,
    MEASURED_ROWS,
    OUTPUTS,
    OVER,
    REFERENCE_ROW,
    SAMPLES,
    STARTED,
    TICK,
    Constants,
    Floats,
    Scratch,
    Settings,
    State,
    begin_of,
    follower,
    latest,
    load,
    load_guide,
    open_constants,
    open_scratch,
    open_state,
    put,
    size_numbers,
    table_row,
    unpack,
    vehicle,
)
from formation_env.quadrotor import MOMENT, Wrench
from formation_env.sampling import receive, sense_when_due
from formation_env.task import CORE, GUIDE
from formation_env.team import (
    address_of,
    array_at,
    await_ticket,
    claim,
    post,
    posted,
    report,
    settle,
)
from formation_env.trajectories import Reference, evaluate
from formation_env.world import (
    RATE,
    REFERENCE,
    WRENCH,
    Action,
    World,
    command_guided,
    every_tick,
    guide_on,
    guided,
    gust,
    hold_at,
    within,
)

# Modes of `advance`: what to do with each world.
STEP, STEP_OR_RESET, STEP_AND_RESET, RESET = 0, 1, 2, 3


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
def put_reference(x: Any, ref: Reference) -> None:
    put(x, 0, ref.p)
    put(x, 3, ref.v)
    put(x, 6, ref.a)
    put(x, 9, ref.j)
    put(x, 12, ref.s)


@device
def _refer(state: State, w: int, line: Any, kind: int, s: World) -> None:
    """The leader's reference now, where it is not in the table: waiting, or on a path of its own."""
    ref = hold_at(begin_of(state, w))
    if state.counters[w, STARTED] != 0:
        clock = state.counters[w, CLOCK] * s.clock.period
        ref = evaluate(kind, table_row(state.tables, w), clock)
    put_reference(line, ref)


@device
def _prepare(
    state: State, t: int, actions: Any, mask: Any, mode: int, room: Scratch, s: World
) -> tuple[int, bool]:
    """Find out which worlds of tile `t` step, and fetch their actions and gusts.

    Returns how many step and whether any is to be reset first.
    """
    counters = state.counters
    flying, waiting = 0, False
    for lane in range(LANES):
        room.active[lane] = room.moving[lane] = 0.0
        w = t * LANES + lane
        if w >= len(counters) or not mask[w]:
            continue
        if mode == RESET or (mode == STEP_OR_RESET and counters[w, OVER] != 0):
            waiting = True
            continue
        flying += 1
        room.active[lane] = 1.0
        room.moving[lane] = np.float64(counters[w, STARTED])
        if s.gusts.kick != 0.0:
            for i in range(state.vehicles.shape[1]):
                x = vehicle(state, w, i)
                key = state.episode_keys[w]
                put(x, GUST, gust(load(x, GUST), s.gusts, key, i, counters[w, TICK]))
    if flying > 0:
        _take(actions, t, room)
    return flying, waiting


@device
def _take(actions: Any, t: int, room: Scratch) -> None:
    """The actions of tile `t`, clipped; those of lanes without a world stay what they were."""
    worlds, n, size = actions.shape
    flat, stride, executed = carve(actions, 0, (actions.size,)), n * size, room.actions
    here = min(LANES, worlds - t * LANES)
    for i in range(n):
        for k in range(size):
            first = t * LANES * stride + i * size + k
            if here == LANES:
                take(flat, first, stride, executed[i], k)
            else:
                for lane in range(here):
                    a = np.float64(flat[first + lane * stride])
                    executed[i, k * LANES + lane] = min(max(a, -1.0), 1.0)


@device
def _lead(state: State, c: Constants, t: int, room: Scratch, kind: int, s: World) -> None:
    """The leader's references, and its velocity before the tick, in all worlds of tile `t`."""
    counters, table, lines = state.counters, c.references, room.lines
    here = min(LANES, len(counters) - t * LANES)
    for lane in range(here):
        w = t * LANES + lane
        line = carve(lines, lane * REFERENCE_ROW, (REFERENCE_ROW,))
        if counters[w, STARTED] != 0 and len(table) > 0:
            row = carve(table, counters[w, CLOCK] * REFERENCE_ROW, (REFERENCE_ROW,))
            for k in range(REFERENCE_ROW):
                line[k] = row[k]
        else:
            _refer(state, w, line, kind, s)
    for lane in range(here, LANES):  # that nothing divides by zero there
        for k in range(REFERENCE_ROW):
            lines[lane * REFERENCE_ROW + k] = lines[(here - 1) * REFERENCE_ROW + k]
    gather(lines, room.refs)
    copy(state.vehicles[t, 0], 3, room.before, 0, 2)
    copy(room.seen[min(t, len(room.seen) - 1), 0], 3, state.seen[t], 0, 2)


@device
def _save(state: State, t: int, room: Scratch) -> None:
    """Keep what flying changes: lanes whose worlds do not step are computed too, then put back."""
    rows = state.vehicles.shape[2] // LANES
    for i in range(state.vehicles.shape[1]):
        copy(state.vehicles[t, i], 0, room.saved, rows * i, rows)
        if state.samples.shape[2] == 1:
            at = rows * state.vehicles.shape[1] + MEASURED_ROWS * i
            copy(state.samples[t, i, 0], 0, room.saved, at, MEASURED_ROWS)


@device
def _put_back(state: State, t: int, room: Scratch) -> None:
    """Undo the tick in the lanes whose worlds do not step."""
    rows = state.vehicles.shape[2] // LANES
    for i in range(state.vehicles.shape[1]):
        restore(room.saved, rows * i, state.vehicles[t, i], rows, room.active)
        if state.samples.shape[2] == 1:
            at = rows * state.vehicles.shape[1] + MEASURED_ROWS * i
            restore(room.saved, at, state.samples[t, i, 0], MEASURED_ROWS, room.active)


@device
def _command(state: State, t: int, room: Scratch, s: World) -> None:
    """The commands of all vehicles of tile `t`."""
    seen = room.seen[min(t, len(room.seen) - 1), 0]
    if s.leader_actuation == MOMENT:
        lead_by_moment(seen, room.refs, room.commands[0], s)
    else:
        lead_by_rates(seen, room.refs, room.commands[0], s)
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
    """Fly all vehicles of tile `t` for one tick, sampling on the way."""
    h = s.clock.period / s.clock.substeps
    exact, plain = state.samples.shape[2] == 0, every_tick(s.clock)
    if plain and not exact:
        for lane in range(min(LANES, len(state.counters) - t * LANES)):
            room.counts[lane] = state.counters[t * LANES + lane, TICK] + 1
    # In step with the ticks a measurement is due at their end; else the worlds differ.
    aligned = s.clock.sample_every % s.clock.substeps == 0
    for i in range(state.vehicles.shape[1]):
        x, push = state.vehicles[t, i], room.still
        if s.gusts.kick != 0.0:
            push = carve(x, GUST * LANES, (3 * LANES,))
        actuation = s.leader_actuation if i == 0 else s.follower_actuation
        command, touch = room.commands[i], room.touches[i]
        clear_touch(touch)
        low = doubtful(x, command, push, room.active, s.clock.period, h, s.airframe.mass) > 0
        for k in range(s.clock.substeps):
            if actuation == MOMENT and low:
                fly_low_by_moment(x, command, push, h, s.airframe, touch)
            elif actuation == MOMENT:
                fly_by_moment(x, command, push, h, s.airframe)
            elif low:
                fly_low_by_rates(x, command, push, h, s.airframe, touch)
            else:
                fly_by_rates(x, command, push, h, s.airframe)
            if not plain and (not aligned or k + 1 == s.clock.substeps):
                sense_when_due(state, t, i, room, k, s)
        if exact:
            sense_exactly(x, command, push, touch, s.airframe)
        elif plain:
            sample = state.samples[t, i, 0]
            keys = carve(state.episode_keys, t * LANES, (LANES,))
            noise, counts, draws = s.noise, room.counts, room.draws
            sense(x, command, push, touch, sample, s.airframe, noise, keys, counts, i, draws)


@device
def _count(state: State, c: Constants, t: int, room: Scratch, s: World) -> None:
    """Move the counters and headings of the worlds of tile `t` that have flown on by a tick."""
    counters = state.counters
    for lane in range(LANES):
        if room.active[lane] != 0.0:
            w = t * LANES + lane
            tick = counters[w, TICK] + 1
            counters[w, TICK] = tick
            counters[w, SAMPLES] = tick * s.clock.substeps // s.clock.sample_every
            counters[w, CLOCK] += counters[w, STARTED]
    receive(state, t, room)
    leader, seen = state.vehicles[t, 0], room.seen[min(t, len(room.seen) - 1), 0]
    seen_before = state.seen[t]
    for i in range(len(c.offsets)):
        x = state.followers[t, i]
        d_x, h = c.offsets[i, 0], s.clock.period
        turn_headings(x, leader, room.before, seen, seen_before, room.moving, d_x, h)


@device
def _locate(state: State, c: Constants, t: int, room: Scratch) -> None:
    """Slots, slot errors and separations in all worlds of tile `t`."""
    vehicles = len(c.offsets) + 1
    for lane in range(min(LANES, len(state.counters) - t * LANES)):
        room.started[lane] = 1.0 if state.counters[t * LANES + lane, STARTED] != 0 else 0.0
    leader, begin = state.vehicles[t, 0], state.begins[t]
    for i in range(1, vehicles):
        x, out = state.followers[t, i - 1], room.outcomes[i - 1]
        own = state.vehicles[t, i]
        locate(x, leader, own, begin, room.started, load(c.offsets[i - 1], 0), out)
        if vehicles <= CROWD:
            for j in range(vehicles):
                if j != i:
                    approach(own, state.vehicles[t, j], out)
    if vehicles > CROWD:
        separate_crowd(state.vehicles, t, len(state.counters), room)
    for i in range(vehicles - 1):
        separate(room.outcomes[i])


@device
def _trigger(state: State, t: int, room: Scratch, s: World) -> bool:
    """The trigger (40), on true positions: every vehicle is near where it should start from.

    Returns whether it fired in any world of tile `t`; the slots there are then others.
    """
    fired = False
    for lane in range(LANES):
        w = t * LANES + lane
        if room.active[lane] == 0.0 or state.counters[w, STARTED] != 0:
            continue
        ready = within(load(vehicle(state, w, 0), 0), begin_of(state, w), s.trigger)
        for i in range(len(room.outcomes)):
            error = room.outcomes[i, ERROR_SQUARED * LANES + lane]
            ready = ready and error < s.trigger * s.trigger
        if ready:
            state.counters[w, STARTED] = 1
            fired = True
    return fired


@device
def _judge(state: State, t: int, room: Scratch, ends: Any, task: Task, s: Settings) -> None:
    """Rewards and failures of the worlds of tile `t`: nothing for those that have not flown."""
    n = len(room.actions)
    clear(room.tally)
    for i in range(n):
        judge(
            state.followers[t, i],
            room.actions[i],
            room.touches[i + 1],
            room.active,
            task.action_size,
            s.rewards,
            s.limits,
            room.outcomes[i],
            room.tally,
        )
    counters, impacts = state.counters, room.touches[0]
    for lane in range(min(LANES, len(counters) - t * LANES)):
        w = t * LANES + lane
        ended = late = False
        if room.active[lane] != 0.0:
            ended = room.tally[LANES + lane] > 0.0 or impacts[lane] > s.limits.impact
            late = counters[w, TICK] >= task.max_steps
            counters[w, OVER] = ended or late
        ends[0, w] = room.tally[lane] / n
        ends[1, w] = ended
        ends[2, w] = late


@device
def _look(
    state: State,
    c: Constants,
    t: int,
    room: Scratch,
    observations: Any,
    outputs: Any,
    task: Task,
    s: World,
) -> None:
    """Write what every follower of tile `t` sees, and what became of it, into flat arrays."""
    n, width = len(c.offsets), len(OUTPUTS)
    entries = len(room.rows) // LANES
    here = min(LANES, len(state.counters) - t * LANES)
    if n > CROWD and task.neighbours > 0:
        know_crowd(t, len(state.counters), room)
    begin, seen = state.begins[t], room.seen[min(t, len(room.seen) - 1), 0]
    for i in range(n):
        x, own = state.followers[t, i], room.seen[min(t, len(room.seen) - 1), i + 1]
        see(x, own, seen, begin, room.started, load(c.offsets[i], 0), room.rows)
        k = CORE
        if s.level == REFERENCE:
            see_guide(x, own, k, room.rows)
            k += GUIDE
        if 2 < n <= CROWD:
            know_few(t, i, room)
        see_neighbours(x, t, i, k, room)
        first = t * LANES * n + i
        scatter(room.rows, entries, observations, first * entries, n * entries, here)
        scatter(room.outcomes[i], width, outputs, first * width, n * width, here)


@device
def _bad_action(actions: Any) -> int:
    """Number of the first row `(world, follower)` that holds a non-finite number, or -1."""
    numbers = carve(actions, 0, (actions.size,))
    if count_finite(numbers) < len(numbers):
        for k in range(len(numbers)):
            if not np.isfinite(numbers[k]):
                return int(k // actions.shape[2])
    return -1


class Call(NamedTuple):
    """What one call is about, arrays as flat rows but for the first two and `ends`."""

    mode: int
    actions: NDArray[np.float32]
    mask: NDArray[np.bool_]
    seen: NDArray[np.float32]
    told: Floats
    ends: Floats
    last_seen: NDArray[np.float32]
    last_told: Floats
    entries: int


@device
def _posted_call(desk: int, sizes: Any) -> Call:
    """The call whose arrays another thread has put on the desk."""
    worlds, n, entries = sizes[0], sizes[2] - 1, sizes[10]
    rows, mode = worlds * n, posted(desk, 0)
    last = rows if mode == STEP_AND_RESET else 0
    return Call(
        mode,
        array_at(posted(desk, 1), (worlds, n, sizes[13]), np.float32),
        array_at(posted(desk, 2), (worlds,), np.bool_),
        array_at(posted(desk, 3), (rows * entries,), np.float32),
        array_at(posted(desk, 4), (rows * len(OUTPUTS),), np.float64),
        array_at(posted(desk, 5), (3, worlds), np.float64),
        array_at(posted(desk, 6), (last * entries,), np.float32),
        array_at(posted(desk, 7), (last * len(OUTPUTS),), np.float64),
        entries,
    )


@device
def _post_call(desk: int, call: Call) -> int:
    """Put a call on the desk; its ticket."""
    arrays = (
        call.mode,
        address_of(call.actions),
        address_of(call.mask),
        address_of(call.seen),
        address_of(call.told),
        address_of(call.ends),
        address_of(call.last_seen),
        address_of(call.last_told),
    )
    return post(desk, arrays)


@device
def _tick(
    state: State, c: Constants, t: int, call: Call, work: Scratch, task: Task, s: Settings
) -> None:
    """Step or reset those worlds of tile `t` that the call's mask names; look at the others."""
    mode, mask, n = call.mode, call.mask, len(c.offsets)
    seen, told, last_seen, last_told = call.seen, call.told, call.last_seen, call.last_told
    one = n * call.entries
    end = min((t + 1) * LANES, len(state.counters))
    receive(state, t, work)
    flying, waiting = _prepare(state, t, call.actions, mask, mode, work, s.world)
    if flying > 0:
        if flying < end - t * LANES:
            _save(state, t, work)
        _lead(state, c, t, work, task.trajectory_kind, s.world)
        _command(state, t, work, s.world)
        _fly(state, t, work, s.world)
        if flying < end - t * LANES:
            _put_back(state, t, work)
        _count(state, c, t, work, s.world)
    judged, triggered, again = False, flying == 0, True
    while again:
        if waiting:
            for w in range(t * LANES, end):
                lane = w % LANES
                fresh = mask[w] and work.active[lane] == 0.0
                if fresh or (judged and flying > 0 and state.counters[w, OVER] != 0):
                    start_episode(state, c, w, work, task, s)
                    work.active[lane] = 0.0
            receive(state, t, work)
            waiting = False
        _locate(state, c, t, work)
        if not triggered:
            triggered = True
            if _trigger(state, t, work, s.world):
                continue
        if not judged:
            _judge(state, t, work, call.ends, task, s)
            judged = True
        _look(state, c, t, work, seen, told, task, s.world)
        again = False
        if mode == STEP_AND_RESET:
            for w in range(t * LANES, end):
                if work.active[w % LANES] != 0.0 and state.counters[w, OVER] != 0:
                    repeat(seen, last_seen, w * one, one)
                    repeat(told, last_told, w * n * len(OUTPUTS), n * len(OUTPUTS))
                    again = waiting = True


@announced
@kernel
def advance(
    desk: int,
    member: int,
    mode: int,
    actions: NDArray[np.float32],
    mask: NDArray[np.bool_],
    memory: Floats,
    room: Floats,
    observations: NDArray[np.float32],
    outputs: Floats,
    ends: Floats,
    last_observations: NDArray[np.float32],
    last_outputs: Floats,
) -> int:
    """Step or reset those worlds that `mask` names; look at the others.

    `memory` is what `memory.allocate` made, `room` what `memory.scratch` did, and the rest `Results`.
    Returns the number of the first row of `actions` that holds a non-finite number, having done nothing
    then, or -1.

    `desk` is 0, or the address of a `team.Team`'s: then workers fly some of the tiles. They are in here
    too, as its `member` 1, 2, ..., with actions and results of no world, and take part in the calls of
    member 0 until none has come for a while. They do not wait for long, so the caller has to have seen
    to the actions, with `first_bad_action`, before it wakes them.

    Each thing that may happen to a world stands once in here: compiled twice, the same formula may
    come out with other fused operations, and the faces or the threads would differ in a last bit.
    """
    if desk == 0:
        bad = _bad_action(actions)
        if bad >= 0:
            return bad
    sizes = size_numbers(memory)
    call = Call(
        mode,
        carve(actions, 0, actions.shape),
        carve(mask, 0, mask.shape),
        carve(observations, 0, (observations.size,)),
        carve(outputs, 0, (outputs.size,)),
        carve(ends, 0, ends.shape),
        carve(last_observations, 0, (last_observations.size,)),
        carve(last_outputs, 0, (last_outputs.size,)),
        sizes[10],
    )
    state, c = open_state(memory, sizes), open_constants(memory, sizes)
    work = open_scratch(room, state, sizes)
    task = Task(sizes[11], sizes[12], sizes[13], sizes[14])
    s = unpack(c.settings)
    ticket, tiles = 0, sizes[1]
    if desk != 0 and member == 0:
        ticket = _post_call(desk, call)
    while True:
        if member > 0:
            ticket = await_ticket(desk, ticket)
            if ticket < 0:
                return -1
            call = _posted_call(desk, sizes)
        done = 0
        t = 0 if desk == 0 else claim(desk, ticket, member)
        while 0 <= t < tiles:
            _tick(state, c, t, call, work, task, s)
            done += 1
            t = t + 1 if desk == 0 else claim(desk, ticket, member)
        if member > 0:
            report(desk, done)
        else:
            if desk != 0:
                settle(desk, tiles - done)
            return -1


@kernel
def first_bad_action(actions: NDArray[np.float32]) -> int:
    """Number of the first row `(world, follower)` that holds a non-finite number, or -1."""
    return _bad_action(actions)


@kernel
def reference_path(kind: int, table: Floats, times: Floats) -> Floats:
    """Positions of a trajectory at `times`, `(N, 3)`."""
    path = np.empty((len(times), 3))
    for k in range(len(times)):
        put(path[k], 0, evaluate(kind, table, times[k]).p)
    return path


@announced
@kernel
def reference_table(kind: int, table: Floats, period: float, steps: int) -> Floats:
    """A trajectory tick by tick, `(steps + 1, 16)`: position and four derivatives."""
    rows = np.zeros((steps + 1, REFERENCE_ROW))
    for k in range(steps + 1):
        put_reference(rows[k], evaluate(kind, table, k * period))
    return rows
