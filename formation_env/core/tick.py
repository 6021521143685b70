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

from formation_env._jit import cold, step
from formation_env.core import arrays, flight, judging
from formation_env.core.arrays import Counters
from formation_env.core.calls import (
    OUTCOME,
    RESET,
    STEP_AND_RESET,
    STEP_OR_RESET,
    ends_of,
    mask_of,
    mode_of,
    observations_of,
    outputs_of,
    streamed,
)
from formation_env.core.disturbing import disturb
from formation_env.core.episodes import start_episode
from formation_env.core.measuring import in_hand, receive
from formation_env.core.moving import (
    command,
    fly,
    move_clocks,
    put_back,
    refer,
    save,
    take_actions,
    turn_headings,
)
from formation_env.core.neighbours import (
    MOST_PAIRWISE,
    approach_others,
    find_neighbours_of_many,
    separate_many,
    show_neighbours,
)
from formation_env.laws.levels import show_level
from formation_env.laws.world import within
from formation_env.maths.so3 import Vector
from formation_env.memory.records import LANES, at, loader, size
from formation_env.memory.shuffles import carve, clear, copy_numbers, scatter, stream
from formation_env.physics.sensors import Measured
from formation_env.task import Observation

_STARTED, _OVER = (at(Counters, name) * LANES for name in ("started", "over"))
_read_position, _read_point = loader(flight.Position, Measured), loader(Vector)
_read_squares = loader(arrays.Squares)
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
                judging.separate(arrays.squares(room, i), arrays.outcome(room, i))
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
            rows = carve(observations_of(memory, room, False), w * one, (one,))
            copy_numbers(rows, observations_of(memory, room, True), w * one, one)
            outcomes = carve(outputs_of(memory, room, False), w * two, (two,))
            copy_numbers(outcomes, outputs_of(memory, room, True), w * two, two)
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
    many = arrays.vehicles(memory) > MOST_PAIRWISE
    standing = flight.note_started(
        arrays.counters(memory, t),
        arrays.deadline(memory),
        arrays.started(room),
        arrays.left(room),
    )
    leader = arrays.vehicle(memory, t, 0)
    begin = begin_rows(memory, t, standing, leader)
    for i in range(arrays.vehicles(memory) - 1):
        x, own = arrays.follower(memory, t, i), arrays.vehicle(memory, t, i + 1)
        started, d = arrays.started(room), arrays.offset(memory, i)
        outcome, squares = arrays.outcome(room, i), arrays.squares(room, i)
        judging.locate(started, x, leader, begin, own, d, outcome, squares)
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
    started, left = arrays.started(room), arrays.left(room)
    for i in range(n):
        squares, touch = arrays.squares(room, i), arrays.touch(room, i + 1)
        outcome = arrays.outcome(room, i)
        judging.fail(active, started, left, squares, touch, leader, tally, limits, outcome)
    for i in range(n):
        judging.pay(
            active,
            started,
            left,
            arrays.squares(room, i),
            arrays.touch(room, i + 1),
            leader,
            arrays.action(room, i),
            arrays.follower(memory, t, i),
            tally,
            arrays.action_size(memory),
            arrays.rewards(memory),
            arrays.outcome(room, i),
        )
    count, verdict = arrays.counters(memory, t), arrays.verdict(room)
    last = arrays.max_steps(memory)
    judging.conclude(count, tally, leader, active, float(n), limits, last, verdict)
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
    # What goes past the cache is put together first: single rows would not fill its lines.
    held = streamed(memory)
    sink, other_sink, begin_at, lanes = observations, outputs, t * LANES * n, here
    if held:
        sink, other_sink = arrays.held_observations(room), arrays.held_outputs(room)
        begin_at, lanes = 0, LANES
    for i in range(n):
        x, own = arrays.follower(memory, t, i), in_hand(memory, room, t, i + 1)
        judging.show(started, x, leader, begin, own, arrays.offset(memory, i), rows)
        show_level(arrays.level(memory), x, own, more)
        show_neighbours(memory, room, t, i)
        first = begin_at + i
        scatter(rows, entries, sink, first * entries, n * entries, lanes)
        scatter(arrays.outcome(room, i), OUTCOME, other_sink, first * OUTCOME, n * OUTCOME, lanes)
    if held:
        first, count = t * LANES * n, here * n
        stream(sink, observations, first * entries, count * entries)
        stream(other_sink, outputs, first * OUTCOME, count * OUTCOME)
