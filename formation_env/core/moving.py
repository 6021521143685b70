"""The steps of a tick from the actions to the headings: references, commands, flight, sensors."""

from __future__ import annotations

from typing import Any

import numpy as np

from formation_env._jit import cold, step
from formation_env.core import arrays, flight, judging
from formation_env.core.arrays import Counters
from formation_env.core.calls import OUTCOME, actions_of, observations_of, outputs_of, streamed
from formation_env.core.measuring import (
    in_hand,
    measure_exactly,
    measure_when_due,
    measure_with_noise,
)
from formation_env.core.neighbours import MOST_PAIRWISE
from formation_env.laws.levels import command_follower
from formation_env.laws.world import hold_at
from formation_env.memory.records import LANES, at, line_storer, size
from formation_env.memory.shuffles import (
    carve,
    clipped,
    copy,
    fetch,
    gather,
    restore,
    take_clipped,
)
from formation_env.physics.sensors import FOLLOWERS_SENSE, Measured
from formation_env.trajectories import TrajectoryPoint, evaluate

# With more tiles than this the next one is fetched into the cache while this one flies: 9 % of a step of
# 65,536 worlds of `paper`, 6 % of one of 4,096 of `swarm`.
_FETCHED = 64

_STARTED, _CLOCK, _FIRST = (at(Counters, name) * LANES for name in ("started", "clock", "first"))
_VELOCITY, _MEASURED = at(Measured, "v"), size(Measured)
_write_point = line_storer(TrajectoryPoint)


@step
def take_actions(memory: Any, room: Any, t: int, here: int) -> None:
    """The actions of tile `t`, clipped; those of lanes without a world stay what they were."""
    actions, entries = actions_of(memory, room), arrays.action_size(memory)
    stride = (arrays.vehicles(memory) - 1) * entries
    for i in range(arrays.vehicles(memory) - 1):
        first, executed = t * LANES * stride + i * entries, arrays.action(room, i)
        for k in range(entries):
            if here == LANES:
                take_clipped(actions, first + k, stride, executed, k)
            else:
                for lane in range(here):
                    a = np.float64(actions[first + k + lane * stride])
                    executed[k * LANES + lane] = clipped(a)


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
            number = count[_CLOCK + one] + count[_FIRST + one]
            if count[_STARTED + one] != 0 and number < lines:
                row = carve(source, number * arrays.LINE, (arrays.LINE,))
                for k in range(arrays.LINE):
                    line[k] = row[k]
            else:
                _write_point(line, reference_of(memory, t, one))
        source = arrays.lines(room)
    gather(source, starts, arrays.reference(room))
    if arrays.read_courses(arrays.world(memory)).drawn:
        flight.lay_reference(arrays.course(memory, t), arrays.reference(room))


@cold
def reference_of(memory: Any, t: int, lane: int) -> TrajectoryPoint:
    """The leader's reference where it is not in the table: waiting, or on a path of its own or long.

    On the path as it is given, not where the episode's lies.
    """
    count = arrays.counters(memory, t)
    number = count[_CLOCK + lane] + count[_FIRST + lane]
    time = number * arrays.read_clock(arrays.world(memory)).period
    table = arrays.own_table(memory, t * LANES + lane)
    ref = evaluate(arrays.family(memory), table, time)
    if count[_STARTED + lane] == 0:
        ref = hold_at(ref.p)
    return ref  # type: ignore[no-any-return]


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
        x, by = arrays.vehicle(memory, t, i), actuation_of(memory, i)
        applied, push, touch = arrays.command(room, i), arrays.push(room, i), arrays.touch(room, i)
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
    if n >= MOST_PAIRWISE or arrays.tile_count(memory) <= _FETCHED:
        return
    if i < n and not streamed(memory):
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
    leader, before = arrays.vehicle(memory, t, 0), arrays.velocity_before(room)
    moving = arrays.moving(room)
    h = arrays.read_clock(arrays.world(memory)).period
    for i in range(arrays.vehicles(memory) - 1):
        x, d_x = arrays.follower(memory, t, i), arrays.offset(memory, i)[0]
        if arrays.measuring(memory) == arrays.EXACT:
            judging.turn_headings_exactly(before, leader, x, moving, d_x, h)
        else:
            measured, measured_before = in_hand(memory, room, t, 0), arrays.measured_before(room)
            judging.turn_headings(before, leader, measured_before, measured, x, moving, d_x, h)
