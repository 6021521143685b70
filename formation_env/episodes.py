"""The start of an episode in one world of a tile."""

from __future__ import annotations

from typing import Any, NamedTuple

from formation_env._jit import device
from formation_env.blocks import LANES
from formation_env.memory import (
    CLOCK,
    EPISODE,
    ESTIMATE,
    FAILED,
    GUIDE_P,
    GUIDE_V,
    GUST,
    HEADING,
    OVER,
    PREVIOUS,
    STARTED,
    TERMS,
    TICK,
    Constants,
    Scratch,
    Settings,
    State,
    begin_of,
    episode_key,
    follower,
    load,
    put,
    put_sample,
    ring,
    table_row,
    vehicle,
)
from formation_env.quadrotor import Body
from formation_env.sensors import (
    Measured,
    corrupt,
    silent,
)
from formation_env.slots import slot
from formation_env.so3 import Vector
from formation_env.trajectories import draw, evaluate, start_direction
from formation_env.world import (
    REFERENCE,
    World,
    near,
    resting,
    trimmed,
)


class Task(NamedTuple):
    """Whole numbers that say what is asked for."""

    worlds: int
    trajectory_kind: int
    neighbours: int
    action_size: int
    max_steps: int


@device
def _place(state: State, w: int, i: int, body: Body, a: Vector, key: Any, s: World) -> None:
    """Put a vehicle with acceleration `a` into the world, its gust still, its sensors settled."""
    x = vehicle(state, w, i)
    exact = Measured(body.p, body.v, a, body.q, body.w)
    put_sample(x, exact)
    if s.gusts.kick != 0.0:
        put(x, GUST, (0.0, 0.0, 0.0))
    raw = exact
    if not silent(s.noise):
        raw = corrupt(exact, s.noise, key, i, 0)
    for k in range(state.samples.shape[2]):
        put_sample(ring(state, w, i)[k], raw)
    if i == 0:
        for k in range(s.clock.window):
            put(state.speeds[w, k], 0, body.v)


@device
def _fill_rows(x: Any, lane: int) -> None:
    for row in range(0, len(x), LANES):
        for other in range(lane + 1, LANES):
            x[row + other] = x[row + lane]


@device
def _fill_lanes(state: State, w: int) -> None:
    """Let the lanes behind the last world `w` start as it does: they are computed all the same."""
    t, lane = w // LANES, w % LANES
    for i in range(state.vehicles.shape[1]):
        _fill_rows(state.vehicles[t, i], lane)
        for k in range(state.samples.shape[2]):
            _fill_rows(state.samples[t, i, k], lane)
    for i in range(state.followers.shape[1]):
        _fill_rows(state.followers[t, i], lane)


@device
def _start_of(state: State, w: int, R: complex, d: Vector, s: World) -> Any:
    """Where a follower with offset `d` should be: behind the leader or, on the ground, behind (40)'s
    reference point."""
    if s.on_ground:
        return slot(R, begin_of(state, w), (0.0, 0.0, 0.0), d)
    leader = vehicle(state, w, 0)
    return slot(R, load(leader, 0), load(leader, 3), d)


@device
def start_episode(
    state: State, c: Constants, w: int, room: Scratch, task: Task, s: Settings
) -> None:
    """Start the next episode of world `w`."""
    counters = state.counters
    counters[EPISODE, w] += 1
    counters[TICK, w] = counters[CLOCK, w] = counters[OVER, w] = 0
    counters[STARTED, w] = 0 if s.world.on_ground else 1
    key = episode_key(state.keys[w], counters[EPISODE, w])
    state.episode_keys[w] = key
    table = table_row(state.tables, w)
    if len(c.drawing) > 0:
        draw(key, c.drawing, table)
    begin = evaluate(task.trajectory_kind, table, 0.0)
    R = start_direction(task.trajectory_kind, table)
    for k in range(3):
        state.begins[w // LANES, k * LANES + w % LANES] = begin.p[k]

    still = (0.0, 0.0, 0.0)
    if s.world.on_ground:
        _place(state, w, 0, resting(load(c.starts[0], 0)), still, key, s.world)
    else:
        _place(state, w, 0, trimmed(begin, s.world), begin.a, key, s.world)
    for i in range(len(c.offsets)):
        x = follower(state, w, i)
        x[HEADING], x[HEADING + 1] = R.real, R.imag
        x[ESTIMATE], x[ESTIMATE + 1] = R.real, R.imag
        for k in range(4):
            x[PREVIOUS + k] = 0.0
        target = _start_of(state, w, R, load(c.offsets[i], 0), s.world)
        if s.world.level == REFERENCE:
            put(x, GUIDE_P, target.p)
            put(x, GUIDE_V, target.v)
        if s.world.on_ground:
            body = resting(load(c.starts[i + 1], 0))
        else:
            body = near(target, key, i + 1, s.world)
        _place(state, w, i + 1, body, still, key, s.world)
        for k in range(TERMS + 4):
            room.outcomes[i, k * LANES + w % LANES] = 0.0
        room.outcomes[i, FAILED * LANES + w % LANES] = 0.0
    if w + 1 == task.worlds:
        _fill_lanes(state, w)
