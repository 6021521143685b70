"""The start of an episode in one world of a tile."""

from __future__ import annotations

from typing import Any

import numpy as np

from formation_env._jit import cold, step
from formation_env.core import arrays
from formation_env.core.arrays import Counters
from formation_env.laws.levels import Follower, begin_level
from formation_env.laws.slots import Slot, out_of_frame, slot
from formation_env.laws.world import near, resting, start_yaw, trimmed
from formation_env.maths.so3 import ZERO, Vector
from formation_env.memory.records import LANES, at, line_loader, line_storer, storer
from formation_env.paths.course import Course, draw_course, lay_direction, lay_point
from formation_env.physics.quadrotor import Body
from formation_env.physics.sensors import Measured, corrupt, silent
from formation_env.physics.sensors import exact as exact_measurement
from formation_env.trajectories import draw, evaluate, start_direction

_TICK, _STARTED, _CLOCK, _EPISODE, _OVER, _FIRST = (
    at(Counters, n) * LANES for n in Counters._fields
)
_read_point, _write_point, _store_point = line_loader(Vector), line_storer(Vector), storer(Vector)
_store_measured, _store_follower = storer(Measured), storer(Follower)
_store_course = storer(Course)
_STILL = (0.0, 0.0, 0.0, 0.0)


@step
def place(memory: Any, w: int, i: int, body: Body, a: Vector, key: Any) -> None:
    """Put a vehicle with acceleration `a` into world `w`: undisturbed, its sensors settled."""
    t, lane, world = w // LANES, np.uint64(w % LANES), arrays.world(memory)
    x, exact = arrays.vehicle(memory, t, i), exact_measurement(body, a)
    for k in range(len(x) // LANES):
        x[k * LANES + w % LANES] = 0.0
    _store_measured(x, lane, exact)
    noise, raw = arrays.read_noise(world), exact
    if not silent(noise):
        raw = corrupt(exact, noise, key, i, 0)
    for k in range(arrays.delays(memory)):
        _store_measured(arrays.sample(memory, t, i, k), lane, raw)
    if i == 0:
        for k in range(arrays.window(memory)):
            _write_point(arrays.speed(memory, w, k), body.v)


@step
def fill_rows(x: Any, lane: int) -> None:
    """Let the lanes behind one hold the same."""
    for row in range(0, len(x), LANES):
        for other in range(lane + 1, LANES):
            x[row + other] = x[row + lane]


@cold
def fill_lanes(memory: Any, w: int) -> None:
    """Let the lanes behind the last world `w` start as it does: they are computed all the same."""
    t, lane = w // LANES, w % LANES
    for i in range(arrays.vehicles(memory)):
        fill_rows(arrays.vehicle(memory, t, i), lane)
        for k in range(arrays.delays(memory)):
            fill_rows(arrays.sample(memory, t, i, k), lane)
    for i in range(arrays.vehicles(memory) - 1):
        fill_rows(arrays.follower(memory, t, i), lane)


@step
def stand(memory: Any, i: int, R: complex, begin: Vector, world: Any) -> Vector:
    """Where vehicle `i` stands on the floor; the path begins at `begin` in the direction `R`."""
    place = _read_point(arrays.start(memory, i))
    if world.courses.drawn:
        apart = out_of_frame(R, place)
        place = (begin[0] + apart[0], begin[1] + apart[1], place[2])
    return place  # type: ignore[no-any-return]


@cold
def start_episode(memory: Any, room: Any, w: int) -> None:
    """Start the next episode of world `w`."""
    t, lane, at_lane = w // LANES, w % LANES, np.uint64(w % LANES)
    world, count = arrays.read_world(arrays.world(memory)), arrays.counters(memory, t)
    count[_EPISODE + lane] += 1
    count[_TICK + lane] = count[_CLOCK + lane] = count[_OVER + lane] = 0
    count[_STARTED + lane] = 0 if world.on_ground else 1
    key = arrays.key_of_episode(arrays.key(memory, t)[lane], count[_EPISODE + lane])
    arrays.episode_key(memory, t)[lane] = key
    table, family = arrays.own_table(memory, w), arrays.family(memory)
    if arrays.drawing_size(memory) > 0:
        draw(key, arrays.drawing(memory), table)
    course, first = Course(1.0 + 0.0j, 1.0), 0
    if world.courses.drawn:
        course, first = draw_course(key, world.courses)
    _store_course(arrays.course(memory, t), at_lane, course)
    count[_FIRST + lane] = first
    time = first * world.clock.period
    begin, R = evaluate(family, table, time), start_direction(family, table, time)
    if world.courses.drawn:
        begin, R = lay_point(course, begin), lay_direction(course, R)
    _store_point(arrays.begin(memory, t), at_lane, begin.p)

    yaw = start_yaw(key, 0, world)
    if world.on_ground:
        place(memory, w, 0, resting(stand(memory, 0, R, begin.p, world), yaw), ZERO, key)
    else:
        place(memory, w, 0, trimmed(begin, yaw, world), begin.a, key)
    for i in range(arrays.vehicles(memory) - 1):
        x, d = arrays.follower(memory, t, i), _read_point(arrays.offset(memory, i))
        _store_follower(x, at_lane, Follower(R, R, _STILL))
        if world.on_ground:
            # Slots are those of the reference's first point (40), at rest.
            begin_level(arrays.level(memory), x, at_lane, slot(R, begin.p, ZERO, d))
            yaw = start_yaw(key, i + 1, world)
            body = resting(stand(memory, i + 1, R, begin.p, world), yaw)
        else:
            target = slot(R, begin.p, begin.v, d)
            body = near(target, key, i + 1, world)
            begin_level(arrays.level(memory), x, at_lane, Slot(body.p, body.v))
        place(memory, w, i + 1, body, ZERO, key)
        clear_outcome(arrays.outcome(room, i), lane)
    if w + 1 == arrays.worlds(memory):
        fill_lanes(memory, w)


@step
def clear_outcome(outcome: Any, lane: int) -> None:
    """Nothing has been earned yet, and none has failed."""
    for row in range(0, len(outcome), LANES):
        outcome[row + lane] = 0.0
