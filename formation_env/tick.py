"""One tick of one tile of worlds, in the order in which things happen: the paper's block diagram.

    leader's reference --> tracker --> actuators --> leader's body --> sensors --+
                                                                                 |
    +----------------------------------------------------------------------------+
    |  what the followers know of the leader
    v
    action --> (virtual follower --> tracker) --> actuators --> follower's body --> sensors
                                                                                 |
    slots: where the followers should be, from the leader's true motion <--------+

`tick` is the diagram. Its steps work on `memory`, which holds what is constant and what changes, and in
`room`, where a thread keeps what it needs on the way; `arrays` says what these hold, `flight` has the loops
over the worlds of a tile. All worlds of a tile are computed alike; those that do not step are put back.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formation_env import arrays, flight, quadrotor
from formation_env._jit import cold, step
from formation_env.arrays import Counters
from formation_env.calls import (
    OUTCOME,
    RESET,
    STEP_AND_RESET,
    STEP_OR_RESET,
    actions_of,
    ends_of,
    mask_of,
    mode_of,
    observations_of,
    outputs_of,
)
from formation_env.disturbances import States
from formation_env.episodes import start_episode
from formation_env.levels import command_follower, show_level
from formation_env.measuring import (
    in_hand,
    measure_exactly,
    measure_when_due,
    measure_with_noise,
    receive,
)
from formation_env.neighbours import (
    CROWD,
    approach_others,
    find_neighbours_of_many,
    separate_many,
    show_neighbours,
)
from formation_env.records import LANES, at, line_storer, loader, size, storer
from formation_env.sensors import FOLLOWERS_SENSE, Measured
from formation_env.shuffles import (
    carve,
    clear,
    clip_actions,
    copy,
    copy_numbers,
    fetch,
    gather,
    restore,
    scatter,
    take_clipped,
    turn_fours,
)
from formation_env.so3 import ZERO, Vector
from formation_env.task import Observation
from formation_env.trajectories import TrajectoryPoint, evaluate
from formation_env.world import disturbed, hold_at, next_states, pushed, within

# With more tiles than this the next one is fetched into the cache while this one flies: 9 % of a step of
# 65,536 worlds of `paper`, 6 % of one of 4,096 of `swarm`.
_FETCHED = 64

_TICK, _STARTED, _CLOCK, _OVER = (
    at(Counters, name) * LANES for name in ("tick", "started", "clock", "over")
)
_VELOCITY, _MEASURED = at(Measured, "v"), size(Measured)
_STATES = size(Measured) * LANES  # where the states of disturbances begin in a vehicle's rows
_read_body, _read_position = loader(quadrotor.Body, Measured), loader(flight.Position, Measured)
_read_point, _store_push = loader(Vector), storer(Vector)
_read_states, _store_states = loader(States), storer(States)
_read_squares, _write_reference = loader(arrays.Squares), line_storer(TrajectoryPoint)
_OBSERVED, _VERDICT = size(Observation) * LANES, size(arrays.Verdict)


@step
def tick(memory: Any, room: Any, t: int) -> None:
    """Step or reset those worlds of tile `t` that the call's mask names; show all of them."""
    here = min(LANES, arrays.worlds(memory) - t * LANES)
    receive(memory, room, t, here)
    chosen = choose_worlds(memory, room, t, here)
    if chosen.flying > 0:
        # Worlds about to be reset need not be kept.
        keep = chosen.flying + chosen.waiting < here
        disturb(memory, room, t)
        take_actions(memory, room, t, here)
        if keep:
            save(memory, room, t)
        refer(memory, room, t, here, chosen.standing)
        command(memory, room, t)
        fly(memory, room, t)
        if keep:
            put_back(memory, room, t)
        move_clocks(memory, room, t)
        receive(memory, room, t, here)
        turn_headings(memory, room, t)
    judge_and_show(memory, room, t, here, chosen)


@step
def choose_worlds(memory: Any, room: Any, t: int, here: int) -> flight.Choice:
    """Which of the `here` worlds of tile `t` step, which are to be reset, and which wait for their start."""
    mask, mode = mask_of(memory, room), mode_of(room)
    named = arrays.named(room)
    if here == LANES:
        named = carve(mask, t * LANES, (LANES,))
    else:
        for lane in range(LANES):
            named[lane] = lane < here and mask[t * LANES + lane]
    reset = 2 if mode == RESET else (1 if mode == STEP_OR_RESET else 0)
    active, moving = arrays.active(room), arrays.moving(room)
    return flight.choose(named, arrays.counters(memory, t), reset, active, moving)  # type: ignore[no-any-return]


@cold
def disturb(memory: Any, room: Any, t: int) -> None:
    """What pushes the vehicles of the worlds that step from outside, held during this tick."""
    world = arrays.world(memory)
    if not disturbed(world):
        return
    active, count = arrays.active(room), arrays.counters(memory, t)
    keys = arrays.episode_key(memory, t)
    for i in range(arrays.vehicles(memory)):
        x = arrays.vehicle(memory, t, i)
        states = carve(x, _STATES, (len(x) - _STATES,))
        for lane in range(LANES):
            at_lane = np.uint64(lane)
            if active[lane] == 0.0:
                _store_push(arrays.push(room, i), at_lane, ZERO)
            else:
                body, before = _read_body(x, at_lane), _read_states(states, at_lane)
                now = next_states(before, body, world, keys[lane], i, count[_TICK + lane])
                _store_states(states, at_lane, now)
                _store_push(arrays.push(room, i), at_lane, pushed(now, body, world))


@step
def take_actions(memory: Any, room: Any, t: int, here: int) -> None:
    """The actions of tile `t`, clipped; those of lanes without a world stay what they were."""
    actions, entries = actions_of(memory, room), arrays.action_size(memory)
    stride = (arrays.vehicles(memory) - 1) * entries
    for i in range(arrays.vehicles(memory) - 1):
        first, executed = t * LANES * stride + i * entries, arrays.action(room, i)
        if here == LANES and entries == 4:
            given = arrays.given(room)
            turn_fours(actions, first, stride, given)
            clip_actions(given, executed)
            continue
        for k in range(entries):
            if here == LANES:
                take_clipped(actions, first + k, stride, executed, k)
            else:
                for lane in range(here):
                    a = np.float64(actions[first + k + lane * stride])
                    executed[k * LANES + lane] = min(max(a, -1.0), 1.0)


@cold
def save(memory: Any, room: Any, t: int) -> None:
    """Keep what flying changes: lanes whose worlds stand still are computed too, then put back."""
    rows = arrays.vehicle_rows(memory)
    for i in range(arrays.vehicles(memory)):
        copy(arrays.vehicle(memory, t, i), 0, arrays.saved(room, i), 0, rows)
        if arrays.delays(memory) == 1:
            copy(arrays.sample(memory, t, i, 0), 0, arrays.saved(room, i), rows, _MEASURED)


@cold
def put_back(memory: Any, room: Any, t: int) -> None:
    """Undo the tick in the lanes whose worlds do not step."""
    rows, active = arrays.vehicle_rows(memory), arrays.active(room)
    for i in range(arrays.vehicles(memory)):
        restore(arrays.saved(room, i), 0, arrays.vehicle(memory, t, i), rows, active)
        if arrays.delays(memory) == 1:
            restore(arrays.saved(room, i), rows, arrays.sample(memory, t, i, 0), _MEASURED, active)


@step
def refer(memory: Any, room: Any, t: int, here: int, standing: int) -> None:
    """The leader's reference in the `here` worlds of tile `t`, of which `standing` wait for their start.

    It is read from a table where there is one, in the worlds that have started.
    """
    source, starts = arrays.references(memory), arrays.line_starts(room)
    count, lines = arrays.counters(memory, t), arrays.reference_count(memory)
    beyond = flight.find_lines(count, lines, arrays.LINE, starts)
    if beyond > 0 or standing > 0:
        for lane in range(LANES):
            # The last world's where there is none, that nothing divides by zero.
            one = min(lane, here - 1)
            starts[lane] = lane * arrays.LINE
            line = carve(arrays.lines(room), lane * arrays.LINE, (arrays.LINE,))
            clock = count[_CLOCK + one]
            if count[_STARTED + one] != 0 and clock < lines:
                row = carve(source, clock * arrays.LINE, (arrays.LINE,))
                for k in range(arrays.LINE):
                    line[k] = row[k]
            else:
                _write_reference(line, reference_of(memory, t, one))
        source = arrays.lines(room)
    gather(source, starts, arrays.reference(room))


@cold
def reference_of(memory: Any, t: int, lane: int) -> TrajectoryPoint:
    """The leader's reference where it is not in the table: waiting, or on a path of its own or long."""
    count = arrays.counters(memory, t)
    ref = hold_at(_read_point(arrays.begin(memory, t), np.uint64(lane)))
    if count[_STARTED + lane] != 0:
        time = count[_CLOCK + lane] * arrays.read_clock(arrays.world(memory)).period
        table = arrays.own_table(memory, t * LANES + lane)
        ref = evaluate(arrays.family(memory), table, time)
    return ref


@step
def command(memory: Any, room: Any, t: int) -> None:
    """What the actuators of all vehicles do: the leader's tracker, the followers' action level."""
    world, leader = arrays.world(memory), in_hand(memory, room, t, 0)
    by = arrays.read_leader_actuation(world)
    flight.lead(arrays.reference(room), leader, world, by, arrays.command(room, 0))
    by = arrays.read_follower_actuation(world)
    moving, active = arrays.moving(room), arrays.active(room)
    for i in range(arrays.vehicles(memory) - 1):
        x, own = arrays.follower(memory, t, i), in_hand(memory, room, t, i + 1)
        action, done = arrays.action(room, i), arrays.command(room, i + 1)
        command_follower(arrays.level(memory), x, own, action, moving, active, world, by, done)


@step
def fly(memory: Any, room: Any, t: int) -> None:
    """Fly all vehicles for one tick, and measure them."""
    leader = arrays.vehicle(memory, t, 0)
    copy(leader, _VELOCITY, arrays.velocity_before(room), 0, 2)
    copy(in_hand(memory, room, t, 0), _VELOCITY, arrays.measured_before(room), 0, 2)
    clock, measuring = arrays.read_clock(arrays.world(memory)), arrays.measuring(memory)
    h, airframe = clock.period / clock.substeps, arrays.airframe_line(memory)
    # In step with the ticks a measurement is due at their end; else the worlds differ.
    aligned = clock.sample_every % clock.substeps == 0
    if measuring == arrays.EVERY_TICK:
        flight.number_samples(arrays.counters(memory, t), arrays.counts(room))
    for i in range(arrays.vehicles(memory)):
        x, applied, push = (
            arrays.vehicle(memory, t, i),
            arrays.command(room, i),
            arrays.push(room, i),
        )
        touch, by = arrays.touch(room, i), actuation_of(memory, i)
        flight.clear_touch(touch)
        fetch_next(memory, room, t, i)
        low = flight.count_landing(
            x,
            applied,
            push,
            arrays.active(room),
            arrays.clock_line(memory),
            airframe,
            arrays.bound_of_turning(memory),
            by,
        )
        for k in range(clock.substeps):
            if low > 0:
                flight.fly_low(applied, x, push, touch, h, by, airframe)
            else:
                flight.fly(applied, x, push, h, by, airframe)
            due = not aligned or k + 1 == clock.substeps
            if measuring == arrays.WHEN_DUE and due:
                measure_when_due(memory, room, t, i, k)
        flight.note_unsound(x, touch)
        if measuring == arrays.EVERY_TICK:
            measure_with_noise(memory, room, t, i)
        elif measuring == arrays.EXACT and (i == 0 or FOLLOWERS_SENSE):
            measure_exactly(memory, room, t, i)


@step
def actuation_of(memory: Any, i: int) -> int:
    """What turns vehicle `i`: moments or rates."""
    world = arrays.world(memory)
    leader, other = arrays.read_leader_actuation(world), arrays.read_follower_actuation(world)
    return leader if i == 0 else other  # type: ignore[no-any-return]


@step
def fetch_next(memory: Any, room: Any, t: int, i: int) -> None:
    """Have the cache fetch what vehicle `i` needs next while it is busy with flying.

    That is where its results go in this tile, and its state in the next one.
    """
    n = arrays.vehicles(memory) - 1
    if n >= CROWD or arrays.tile_count(memory) <= _FETCHED:
        return
    if i < n:
        entries, first = arrays.entries(memory), (t * n + i) * LANES
        fetch(observations_of(memory, room, False), first * entries, LANES * entries)
        fetch(outputs_of(memory, room, False), first * OUTCOME, LANES * OUTCOME)
    if t + 1 < arrays.tile_count(memory):
        x = arrays.vehicle(memory, t + 1, i)
        fetch(x, 0, len(x))
        if arrays.delays(memory) == 1:
            x = arrays.sample(memory, t + 1, i, 0)
            fetch(x, 0, len(x))
        if i < n:
            x = arrays.follower(memory, t + 1, i)
            fetch(x, 0, len(x))


@step
def move_clocks(memory: Any, room: Any, t: int) -> None:
    """A tick later in the worlds that have flown."""
    flight.move_on(arrays.counters(memory, t), arrays.active(room), arrays.moving(room))


@step
def turn_headings(memory: Any, room: Any, t: int) -> None:
    """The headings of slots and those that the followers estimate, in the worlds that have flown."""
    leader, before, moving = (
        arrays.vehicle(memory, t, 0),
        arrays.velocity_before(room),
        arrays.moving(room),
    )
    h = arrays.read_clock(arrays.world(memory)).period
    for i in range(arrays.vehicles(memory) - 1):
        x, d_x = arrays.follower(memory, t, i), arrays.offset(memory, i)[0]
        if arrays.measuring(memory) == arrays.EXACT:
            flight.turn_headings_exactly(before, leader, x, moving, d_x, h)
        else:
            measured, measured_before = in_hand(memory, room, t, 0), arrays.measured_before(room)
            flight.turn_headings(before, leader, measured_before, measured, x, moving, d_x, h)


@step
def judge_and_show(memory: Any, room: Any, t: int, here: int, chosen: flight.Choice) -> None:
    """Start the episodes that are due, judge the worlds that have flown, and show all of them.

    Each step stands once in here and is gone through again where the trigger fires or an episode ends:
    compiled twice, the same formula may come out with other fused operations, and the faces or the
    threads would differ in a last bit.
    """
    judged, triggered, again, waiting = False, chosen.flying == 0, True, chosen.waiting > 0
    while again:
        if waiting:
            start_due(memory, room, t, here, judged and chosen.flying > 0)
            receive(memory, room, t, here)
            waiting = False
        standing = locate(memory, room, t, here)
        if not triggered:
            triggered = True
            if standing > 0 and trigger(memory, room, t):
                continue
        if judged:
            for i in range(arrays.vehicles(memory) - 1):
                flight.separate(arrays.squares(room, i), arrays.outcome(room, i))
        else:
            judge(memory, room, t, here)
            judged = True
        show(memory, room, t, here, standing)
        again = mode_of(room) == STEP_AND_RESET and keep_last(memory, room, t, here)
        waiting = again


@step
def start_due(memory: Any, room: Any, t: int, here: int, ended: bool) -> None:
    """Start an episode in the worlds named that have not stepped, and if `ended` where one has ended."""
    mask, active, count = mask_of(memory, room), arrays.active(room), arrays.counters(memory, t)
    for lane in range(here):
        fresh = mask[t * LANES + lane] and active[lane] == 0.0
        if fresh or (ended and count[_OVER + lane] != 0):
            start_episode(memory, room, t * LANES + lane)
            active[lane] = 0.0


@step
def keep_last(memory: Any, room: Any, t: int, here: int) -> bool:
    """Copy the results of episodes that this tick has ended; whether there are any."""
    n, any_ended = arrays.vehicles(memory) - 1, False
    one, two = n * arrays.entries(memory), n * OUTCOME
    active, count = arrays.active(room), arrays.counters(memory, t)
    for lane in range(here):
        w = t * LANES + lane
        if active[lane] != 0.0 and count[_OVER + lane] != 0:
            seen = carve(observations_of(memory, room, False), w * one, (one,))
            copy_numbers(seen, observations_of(memory, room, True), w * one, one)
            done = carve(outputs_of(memory, room, False), w * two, (two,))
            copy_numbers(done, outputs_of(memory, room, True), w * two, two)
            any_ended = True
    return any_ended


@step
def begin_rows(memory: Any, t: int, standing: int, leader: Any) -> Any:
    """The leader's first reference points in tile `t`; where every lane has started, which then reads none
    of them, its rows instead, which are in the cache."""
    return leader if standing == 0 else arrays.begin(memory, t)


@step
def locate(memory: Any, room: Any, t: int, here: int) -> int:
    """Slots, slot errors and squared separations; returns how many lanes wait for their start."""
    many = arrays.vehicles(memory) > CROWD
    standing = flight.note_started(arrays.counters(memory, t), arrays.started(room))
    leader = arrays.vehicle(memory, t, 0)
    begin = begin_rows(memory, t, standing, leader)
    for i in range(arrays.vehicles(memory) - 1):
        x, own, squares = (
            arrays.follower(memory, t, i),
            arrays.vehicle(memory, t, i + 1),
            arrays.squares(room, i),
        )
        d, started = arrays.offset(memory, i), arrays.started(room)
        flight.locate(started, x, leader, begin, own, d, arrays.outcome(room, i), squares)
        if not many:
            approach_others(memory, room, t, i)
    if many:
        separate_many(memory, room, t, here)
    return standing  # type: ignore[no-any-return]


@cold
def trigger(memory: Any, room: Any, t: int) -> bool:
    """The trigger (40), on true positions: every vehicle is near where it should start from.

    Returns whether it fired in any world of tile `t`; the slots there are then others.
    """
    e_max, fired = arrays.read_trigger(arrays.world(memory)), False
    active, count = arrays.active(room), arrays.counters(memory, t)
    for lane in range(LANES):
        if active[lane] == 0.0 or count[_STARTED + lane] != 0:
            continue
        at_lane = np.uint64(lane)
        leader = _read_position(arrays.vehicle(memory, t, 0), at_lane).p
        ready = within(leader, _read_point(arrays.begin(memory, t), at_lane), e_max)
        for i in range(arrays.vehicles(memory) - 1):
            error = _read_squares(arrays.squares(room, i), at_lane).error
            ready = ready and error < e_max * e_max
        if ready:
            count[_STARTED + lane] = 1
            fired = True
    return fired


@step
def judge(memory: Any, room: Any, t: int, here: int) -> None:
    """Rewards and failures; those of worlds that have not flown are zero."""
    tally, active, leader = arrays.tally(room), arrays.active(room), arrays.touch(room, 0)
    n, limits = arrays.vehicles(memory) - 1, arrays.limits(memory)
    clear(tally)
    for i in range(n):
        flight.judge(
            active,
            arrays.squares(room, i),
            arrays.touch(room, i + 1),
            leader,
            arrays.action(room, i),
            arrays.follower(memory, t, i),
            tally,
            arrays.action_size(memory),
            arrays.rewards(memory),
            limits,
            arrays.outcome(room, i),
        )
    count, last, verdict = (
        arrays.counters(memory, t),
        arrays.max_steps(memory),
        arrays.verdict(room),
    )
    flight.conclude(count, tally, leader, active, float(n), limits, last, verdict)
    ends, worlds = ends_of(memory, room), arrays.worlds(memory)
    for k in range(_VERDICT):
        first = k * worlds + t * LANES
        if here == LANES:
            copy_numbers(carve(verdict, k * LANES, (LANES,)), ends, first, LANES)
        else:
            for lane in range(here):
                ends[first + lane] = verdict[k * LANES + lane]


@step
def show(memory: Any, room: Any, t: int, here: int, standing: int) -> None:
    """Write what every follower of tile `t` observes, and its outcome, to the results of the call."""
    n, entries = arrays.vehicles(memory) - 1, arrays.entries(memory)
    observations, outputs = observations_of(memory, room, False), outputs_of(memory, room, False)
    leader, rows = in_hand(memory, room, t, 0), arrays.observation(room)
    begin, started = begin_rows(memory, t, standing, leader), arrays.started(room)
    more = carve(rows, _OBSERVED, (len(rows) - _OBSERVED,))
    find_neighbours_of_many(memory, room, t, here)
    for i in range(n):
        x, own = arrays.follower(memory, t, i), in_hand(memory, room, t, i + 1)
        flight.show(started, x, leader, begin, own, arrays.offset(memory, i), rows)
        show_level(arrays.level(memory), x, own, more)
        show_neighbours(memory, room, t, i)
        first = t * LANES * n + i
        scatter(rows, entries, observations, first * entries, n * entries, here)
        scatter(arrays.outcome(room, i), OUTCOME, outputs, first * OUTCOME, n * OUTCOME, here)
