"""The compiled loop over worlds: reset, step and look, tick by tick.

The mathematics is in `world`, `task` and below; here is the order of things.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import announced, device, kernel
from formation_env.blocks import LANES, carve, drain, fetch, gather, scatter, stream, turn_fours
from formation_env.company import CROWD, know_crowd, know_few, see_neighbours, separate_crowd
from formation_env.episodes import Task, start_episode
from formation_env.lanes import (
    approach,
    clear,
    clear_touch,
    clip,
    conclude,
    copy,
    copy_on,
    count_finite,
    doubtful_by_moment,
    doubtful_by_rates,
    drive_by_moment,
    drive_by_rates,
    find_rows,
    fly_by_moment,
    fly_by_rates,
    fly_low_by_moment,
    fly_low_by_rates,
    guide_by_moment,
    guide_by_rates,
    judge,
    lead_by_moment,
    lead_by_rates,
    locate,
    move_on,
    note_started,
    note_unsound,
    number_samples,
    restore,
    see,
    see_guide,
    sense,
    sense_exactly,
    separate,
    sort_out,
    take,
    turn_headings,
    turn_headings_exactly,
)
from formation_env.memory import (
    BATCH,
    CLOCK,
    ERROR_SQUARED,
    GUST,
    MEASURED_ROWS,
    OUTPUTS,
    OVER,
    REFERENCE_ROW,
    STARTED,
    TICK,
    Constants,
    Floats,
    Scratch,
    Settings,
    State,
    begin_of,
    counter,
    load,
    load_turning,
    open_constants,
    open_scratch,
    open_state,
    put,
    size_numbers,
    table_row,
    unpack,
    vehicle,
)
from formation_env.quadrotor import MOMENT
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
from formation_env.turning import Turning
from formation_env.world import (
    RATE,
    REFERENCE,
    WRENCH,
    World,
    every_tick,
    gust,
    hold_at,
    within,
)

# Results of more bytes than this are written past the cache, which they and the state exceed by far.
_STREAMED = 6_000_000

# With more tiles than this the next one is fetched into the cache while this one flies.
_FETCHED = 64

# Modes of `advance`: what to do with each world.
STEP, STEP_OR_RESET, STEP_AND_RESET, RESET = 0, 1, 2, 3


@device
def put_reference(x: Any, ref: Reference) -> None:
    put(x, 0, ref.p)
    put(x, 3, ref.v)
    put(x, 6, ref.a)
    put(x, 9, ref.j)
    put(x, 12, ref.s)


@device
def _refer(state: State, w: int, line: Any, kind: int, s: World) -> None:
    """The leader's reference now, where it is not in the table: waiting, or on a path of its own or long."""
    ref = hold_at(begin_of(state, w))
    if state.counters[STARTED, w] != 0:
        clock = state.counters[CLOCK, w] * s.clock.period
        ref = evaluate(kind, table_row(state.tables, w), clock)
    put_reference(line, ref)


@device
def _prepare(
    state: State, t: int, here: int, actions: Any, mask: Any, mode: int, room: Scratch, s: World
) -> tuple[int, int, int]:
    """Find out which of the `here` worlds of tile `t` step, and fetch their actions and gusts.

    Returns how many step, how many are to be reset first and how many lanes wait for their start.
    """
    named = room.named
    if here == LANES:
        named = carve(mask, t * LANES, (LANES,))
    else:
        for lane in range(LANES):
            named[lane] = lane < here and mask[t * LANES + lane]
    anew = 2 if mode == RESET else (1 if mode == STEP_OR_RESET else 0)
    over, started = counter(state, OVER, t), counter(state, STARTED, t)
    flying, waiting, standing = sort_out(named, over, started, anew, room.active, room.moving)
    if flying > 0:
        if s.gusts.kick != 0.0:
            _blow(state, t, room, s)
        _take(actions, t, here, room)
    return flying, waiting, standing


@device
def _blow(state: State, t: int, room: Scratch, s: World) -> None:
    """The next gust on all vehicles in the flying worlds of tile `t`."""
    for lane in range(LANES):
        if room.active[lane] != 0.0:
            w = t * LANES + lane
            key, tick = state.episode_keys[w], state.counters[TICK, w]
            for i in range(state.vehicles.shape[1]):
                x = vehicle(state, w, i)
                put(x, GUST, gust(load(x, GUST), s.gusts, key, i, tick))


@device
def _take(actions: Any, t: int, here: int, room: Scratch) -> None:
    """The actions of tile `t`, clipped; those of lanes without a world stay what they were."""
    _, n, size = actions.shape
    flat, stride, executed = carve(actions, 0, (actions.size,)), n * size, room.actions
    for i in range(n):
        first = t * LANES * stride + i * size
        if here == LANES and size == 4:
            turn_fours(flat, first, stride, room.drawn)
            clip(room.drawn, executed[i])
            continue
        for k in range(size):
            if here == LANES:
                take(flat, first + k, stride, executed[i], k)
            else:
                for lane in range(here):
                    a = np.float64(flat[first + k + lane * stride])
                    executed[i, k * LANES + lane] = min(max(a, -1.0), 1.0)


@device
def _lead(
    state: State,
    c: Constants,
    t: int,
    here: int,
    standing: int,
    seen: Any,
    room: Scratch,
    kind: int,
    s: World,
) -> None:
    """The leader's references, and its velocity before the tick, in the `here` worlds of tile `t`."""
    table, lines, starts = carve(c.references, 0, (c.references.size,)), room.lines, room.rows_of
    copy(state.vehicles[t, 0], 3, room.before, 0, 2)
    copy(seen[0], 3, room.seen_before, 0, 2)
    source, rows = table, len(c.references)
    beyond = find_rows(counter(state, CLOCK, t), rows, REFERENCE_ROW, starts)
    if beyond > 0 or standing > 0:
        source = lines
        for lane in range(LANES):
            # The last world's where there is none, that nothing divides by zero.
            w = t * LANES + min(lane, here - 1)
            starts[lane] = lane * REFERENCE_ROW
            line = carve(lines, starts[lane], (REFERENCE_ROW,))
            if state.counters[STARTED, w] != 0 and state.counters[CLOCK, w] < rows:
                row = carve(table, state.counters[CLOCK, w] * REFERENCE_ROW, (REFERENCE_ROW,))
                for k in range(REFERENCE_ROW):
                    line[k] = row[k]
            else:
                _refer(state, w, line, kind, s)
    gather(source, starts, room.refs)


@device
def _save(state: State, t: int, room: Scratch) -> None:
    """Keep what flying changes: lanes whose worlds stand still are computed too, then put back."""
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
def _command(state: State, t: int, seen: Any, room: Scratch, s: World) -> None:
    """The commands of all vehicles of tile `t`."""
    if s.leader_actuation == MOMENT:
        lead_by_moment(seen[0], room.refs, room.commands[0], s)
    else:
        lead_by_rates(seen[0], room.refs, room.commands[0], s)
    for i in range(len(room.actions)):
        action, command = room.actions[i], room.commands[i + 1]
        if s.level == WRENCH:
            drive_by_moment(action, command, s)
        elif s.level == RATE:
            drive_by_rates(action, command, s)
        else:
            x, own = state.followers[t, i], seen[i + 1]
            if s.follower_actuation == MOMENT:
                guide_by_moment(x, own, action, room.moving, room.active, command, s)
            else:
                guide_by_rates(x, own, action, room.moving, room.active, command, s)


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
    vast: bool  # whether the results exceed the cache


@device
def _look_ahead(state: State, t: int, i: int, call: Call) -> None:
    """Have the cache fetch what vehicle `i` needs next while it is busy with flying.

    That is where its results go in this tile, and its state in the next one.
    """
    n, width = state.followers.shape[1], len(OUTPUTS)
    if i < n and not call.vast:
        row = (t * n + i) * LANES
        fetch(call.seen, row * call.entries, LANES * call.entries)
        fetch(call.told, row * width, LANES * width)
    if t + 1 < len(state.vehicles):
        fetch(state.vehicles[t + 1, i], 0, state.vehicles.shape[2])
        if state.samples.shape[2] == 1:
            fetch(state.samples[t + 1, i, 0], 0, state.samples.shape[3])
        if i < n:
            fetch(state.followers[t + 1, i], 0, state.followers.shape[2])


@device
def _may_land(
    x: Any, command: Any, push: Any, active: Any, actuation: int, turning: Turning, s: World
) -> bool:
    """Whether a vehicle may meet the floor in this tick in one of the active lanes; no is certain."""
    period = s.clock.period
    if actuation == MOMENT:
        return doubtful_by_moment(x, command, push, active, period, s.airframe.mass, turning) > 0
    h = period / s.clock.substeps
    return doubtful_by_rates(x, command, push, active, period, h, s.airframe) > 0


@device
def _fly(state: State, c: Constants, t: int, call: Call, room: Scratch, s: World) -> None:
    """Fly all vehicles of tile `t` for one tick, sampling on the way."""
    turning = load_turning(c.turning)
    h = s.clock.period / s.clock.substeps
    exact, plain = state.samples.shape[2] == 0, every_tick(s.clock)
    ahead = len(room.commands) <= CROWD and len(state.vehicles) > _FETCHED
    if plain and not exact:
        number_samples(counter(state, TICK, t), room.counts)
    # In step with the ticks a measurement is due at their end; else the worlds differ.
    aligned = s.clock.sample_every % s.clock.substeps == 0
    for i in range(state.vehicles.shape[1]):
        x, push = state.vehicles[t, i], room.still
        if s.gusts.kick != 0.0:
            push = carve(x, GUST * LANES, (3 * LANES,))
        actuation = s.leader_actuation if i == 0 else s.follower_actuation
        command, touch = room.commands[i], room.touches[i]
        clear_touch(touch)
        if ahead:
            _look_ahead(state, t, i, call)
        low = _may_land(x, command, push, room.active, actuation, turning, s)
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
        note_unsound(x, touch)
        if exact:
            if i == 0:  # nobody is told how a follower accelerates
                sense_exactly(x, command, push, touch, s.airframe)
        elif plain:
            sample = state.samples[t, i, 0]
            keys = carve(state.episode_keys, t * LANES, (LANES,))
            noise, counts, draws = s.noise, room.counts, room.draws
            sense(x, command, push, touch, sample, s.airframe, noise, keys, counts, i, draws)


@device
def _count(
    state: State, c: Constants, t: int, here: int, seen: Any, room: Scratch, s: World
) -> None:
    """Move the counters and headings of the worlds of tile `t` that have flown on by a tick."""
    move_on(room.active, room.moving, counter(state, TICK, t), counter(state, CLOCK, t))
    receive(state, t, here, room, s.clock)
    leader, before, moving, h = state.vehicles[t, 0], room.before, room.moving, s.clock.period
    for i in range(len(c.offsets)):
        x, d_x = state.followers[t, i], c.offsets[i, 0]
        if state.samples.shape[2] == 0:
            turn_headings_exactly(x, leader, before, moving, d_x, h)
        else:
            turn_headings(x, leader, before, seen[0], room.seen_before, moving, d_x, h)


@device
def _begin(state: State, t: int, standing: int, leader: Any) -> Any:
    """The leader's first reference points in tile `t`, where it counts as being in the worlds `standing`.

    If there are none nobody looks at them, and anything will do that is at hand.
    """
    return leader if standing == 0 else state.begins[t]


@device
def _locate(state: State, c: Constants, t: int, here: int, room: Scratch) -> int:
    """Slots, slot errors and squared separations in the `here` worlds of tile `t`.

    Returns how many lanes wait for their start.
    """
    tile, vehicles = state.vehicles[t], len(c.offsets) + 1
    standing = note_started(counter(state, STARTED, t), room.started)
    begin = _begin(state, t, standing, tile[0])
    for i in range(1, vehicles):
        x, out = state.followers[t, i - 1], room.outcomes[i - 1]
        locate(x, tile[0], tile[i], begin, room.started, load(c.offsets[i - 1], 0), out)
        if vehicles <= CROWD:
            for j in range(1, vehicles):
                if j != i:
                    approach(tile[i], tile[j], out)
    if vehicles > CROWD:
        separate_crowd(tile, here, room)
    return standing


@device
def _trigger(state: State, t: int, room: Scratch, s: World) -> bool:
    """The trigger (40), on true positions: every vehicle is near where it should start from.

    Returns whether it fired in any world of tile `t`; the slots there are then others.
    """
    fired = False
    for lane in range(LANES):
        w = t * LANES + lane
        if room.active[lane] == 0.0 or state.counters[STARTED, w] != 0:
            continue
        ready = within(load(vehicle(state, w, 0), 0), begin_of(state, w), s.trigger)
        for i in range(len(room.outcomes)):
            error = room.outcomes[i, ERROR_SQUARED * LANES + lane]
            ready = ready and error < s.trigger * s.trigger
        if ready:
            state.counters[STARTED, w] = 1
            fired = True
    return fired


@device
def _judge(
    state: State, t: int, here: int, room: Scratch, ends: Any, task: Task, s: Settings
) -> None:
    """Rewards and failures of the worlds of tile `t`: nothing for those that have not flown."""
    n = len(room.actions)
    clear(room.tally)
    for i in range(n):
        judge(
            state.followers[t, i],
            room.actions[i],
            room.touches[i + 1],
            room.touches[0],
            room.active,
            task.action_size,
            s.rewards,
            s.limits,
            room.outcomes[i],
            room.tally,
        )
    tick, over, verdicts = counter(state, TICK, t), counter(state, OVER, t), room.verdicts
    impacts, limit, last = room.touches[0], s.limits.impact, task.max_steps
    conclude(room.active, room.tally, impacts, tick, float(n), limit, last, over, verdicts)
    for k in range(3):
        if here == LANES:
            copy(verdicts, k, carve(ends, k * task.worlds + t * LANES, (LANES,)), 0, 1)
        else:
            for lane in range(here):
                ends[k, t * LANES + lane] = verdicts[k * LANES + lane]


@device
def _show(
    state: State, t: int, i: int, standing: int, seen: Any, room: Scratch, d: Any, s: World
) -> None:
    """What follower `i` of tile `t` sees, into `room.rows`."""
    x, own, begin = state.followers[t, i], seen[i + 1], _begin(state, t, standing, seen[0])
    see(x, own, seen[0], begin, room.started, d, room.rows)
    k = CORE
    if s.level == REFERENCE:
        see_guide(x, own, k, room.rows)
        k += GUIDE
    if 2 < len(room.actions) <= CROWD:
        know_few(seen, i, room)
    see_neighbours(x, seen, i, k, room)


@device
def _look(
    state: State,
    c: Constants,
    t: int,
    here: int,
    standing: int,
    seen: Any,
    room: Scratch,
    call: Call,
    task: Task,
    s: World,
) -> None:
    """Write what every follower of tile `t` sees, and what became of it, into flat arrays.

    Written one by one the results of many followers would go to a place far from the last in every
    world, each of which has to be fetched first: so they are put together in batches.
    """
    n, width, entries = len(c.offsets), len(OUTPUTS), call.entries
    if n > CROWD and task.neighbours > 0:
        know_crowd(seen, here, room)
    direct = n <= BATCH and not call.vast
    shown, told, lanes = room.shown, room.told, LANES
    if direct:
        shown, told, lanes = call.seen, call.told, here
    for first in range(0, n, BATCH):
        batch = min(BATCH, n - first)
        for i in range(first, first + batch):
            _show(state, t, i, standing, seen, room, load(c.offsets[i], 0), s)
            row = t * LANES * n + i if direct else i - first
            scatter(room.rows, entries, shown, row * entries, batch * entries, lanes)
            scatter(room.outcomes[i], width, told, row * width, batch * width, lanes)
        if not direct:
            row = t * LANES * n + first
            _hand_over(room.shown, call.seen, row, n, batch, entries, here, call.vast)
            _hand_over(room.told, call.told, row, n, batch, width, here, call.vast)


@device
def _hand_over(
    source: Any, sink: Any, row: int, n: int, batch: int, width: int, here: int, vast: bool
) -> None:
    """Write a batch's rows of `width` numbers to `sink`, those of the first world to row `row`."""
    run, runs = batch * width, here
    if batch == n:  # one world's behind the other's
        run, runs = here * run, 1
    for k in range(runs):
        part = carve(source, k * run, (run,))
        to = (row + k * n) * width
        if vast:
            stream(part, sink, to, run)
        else:
            copy_on(part, sink, to, run)


@device
def _bad_action(mode: int, actions: Any, state: State) -> int:
    """Number of the first row `(world, follower)` that holds a non-finite number, or -1.

    Of the worlds that step; what is said of others does not matter.
    """
    numbers, row = carve(actions, 0, (actions.size,)), actions.shape[1] * actions.shape[2]
    if count_finite(numbers) < len(numbers):
        for k in range(len(numbers)):
            if not np.isfinite(numbers[k]):
                if mode == STEP_OR_RESET and state.counters[OVER, k // row] != 0:
                    continue
                return int(k // actions.shape[2])
    return -1


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
        rows * (4 * entries + 8 * len(OUTPUTS)) > _STREAMED,
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
    told, last_seen, last_told = call.told, call.last_seen, call.last_told
    one, two = n * call.entries, n * len(OUTPUTS)
    end = min((t + 1) * LANES, task.worlds)
    here = end - t * LANES
    seen = work.seen[min(t, len(work.seen) - 1)]  # of one tile if measurements are late
    receive(state, t, here, work, s.world.clock)
    flying, waiting, standing = _prepare(state, t, here, call.actions, mask, mode, work, s.world)
    if flying > 0:
        # Worlds about to be reset need not be kept.
        kept = flying + waiting < here
        if kept:
            _save(state, t, work)
        _lead(state, c, t, here, standing, seen, work, task.trajectory_kind, s.world)
        _command(state, t, seen, work, s.world)
        _fly(state, c, t, call, work, s.world)
        if kept:
            _put_back(state, t, work)
        _count(state, c, t, here, seen, work, s.world)
    judged, triggered, again = False, flying == 0, True
    while again:
        if waiting > 0:
            for w in range(t * LANES, end):
                lane = w % LANES
                fresh = mask[w] and work.active[lane] == 0.0
                if fresh or (judged and flying > 0 and state.counters[OVER, w] != 0):
                    start_episode(state, c, w, work, task, s)
                    work.active[lane] = 0.0
            receive(state, t, here, work, s.world.clock)
            waiting = 0
        standing = _locate(state, c, t, here, work)
        if not triggered:
            triggered = True
            if standing > 0 and _trigger(state, t, work, s.world):
                continue
        if judged:
            for i in range(n):
                separate(work.outcomes[i])
        else:
            _judge(state, t, here, work, call.ends, task, s)
            judged = True
        _look(state, c, t, here, standing, seen, work, call, task, s.world)
        again = False
        if mode == STEP_AND_RESET:
            for w in range(t * LANES, end):
                if work.active[w % LANES] != 0.0 and state.counters[OVER, w] != 0:
                    copy_on(carve(call.seen, w * one, (one,)), last_seen, w * one, one)
                    copy_on(carve(told, w * two, (two,)), last_told, w * two, two)
                    again = True
                    waiting = 1


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
    sizes = size_numbers(memory)
    results = 4 * observations.size + 8 * outputs.size
    state, c = open_state(memory, sizes), open_constants(memory, sizes)
    if desk == 0:
        bad = _bad_action(mode, actions, state)
        if bad >= 0:
            return bad
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
        results > _STREAMED,
    )
    work = open_scratch(room, state, sizes)
    task = Task(sizes[0], sizes[11], sizes[12], sizes[13], sizes[14])
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
        if call.vast:
            drain()
        if member > 0:
            report(desk, done)
        else:
            if desk != 0:
                settle(desk, tiles - done)
            return -1


@kernel
def first_bad_action(mode: int, actions: NDArray[np.float32], memory: Floats) -> int:
    """Number of the first row `(world, follower)` that holds a non-finite number and matters, or -1."""
    return _bad_action(mode, actions, open_state(memory, size_numbers(memory)))


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
