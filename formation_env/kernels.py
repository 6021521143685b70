"""The compiled loop over worlds: reset, step and look, tick by tick.

The mathematics is in `world`, `task` and below; here is the order of things.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device, kernel
from formation_env.looking import observe_follower, report, separation_of, slot_of
from formation_env.memory import (
    CLOCK,
    EPISODE,
    ESTIMATE,
    FAILED,
    GUIDE_P,
    GUIDE_V,
    HEADING,
    OUTPUTS,
    OVER,
    PREVIOUS,
    REWARD,
    SAMPLES,
    SEPARATION,
    STARTED,
    TERMS,
    TICK,
    Constants,
    Floats,
    Results,
    Settings,
    State,
    episode_key,
    latest,
    load,
    load_body,
    load_guide,
    load_sample,
    previous_action,
    put,
    put_body,
    put_sample,
    table_row,
    unpack,
)
from formation_env.quadrotor import Body, Wrench
from formation_env.sensors import (
    Measured,
    angular_difference,
    averaged_acceleration,
    corrupt,
    difference,
)
from formation_env.slots import advance_heading
from formation_env.so3 import Vector
from formation_env.task import NO_FAILURE, distance, failure, reward
from formation_env.trajectories import Reference, draw, evaluate, start_direction
from formation_env.world import (
    REFERENCE,
    Action,
    World,
    command_follower,
    command_leader,
    guide_on,
    guided,
    gust,
    hold,
    near,
    resting,
    substep,
    trimmed,
    truth,
    within,
)

# Modes of `advance`: what to do with each world.
STEP, STEP_OR_RESET, STEP_AND_RESET, RESET = 0, 1, 2, 3
_LOOKS, _STEPS, _RESETS = 0, 1, 2


# -- sensing ------------------------------------------------------------------------------------


@device
def _take_sample(ring: Any, speeds: Any, raw: Measured, count: int, leader: bool, s: World) -> None:
    """Store sample number `count`, its velocities differenced where they are not measured."""
    if s.clock.window > 0:
        period = s.clock.sample_every * (s.clock.period / s.clock.substeps)
        before = load_sample(ring[(count - 1) % len(ring)])
        v = difference(raw.p, before.p, period)
        a = (0.0, 0.0, 0.0)
        if leader:
            then = speeds[count % s.clock.window]
            a = averaged_acceleration(v, load(then, 0), s.clock.window, period)
            put(then, 0, v)
        raw = Measured(raw.p, v, a, raw.q, angular_difference(raw.q, before.q, period))
    put_sample(ring[count % len(ring)], raw)


@device
def _fly(
    state: State, w: int, i: int, applied: Wrench, actuation: int, key: Any, s: World
) -> tuple[float, float]:
    """Fly one vehicle for one tick, sampling on the way; returns its hardest touch-down."""
    x = state.vehicles[w, i]
    ring, speeds = state.samples[w, i], state.speeds[w]
    tick, count = state.counters[w, TICK], state.counters[w, SAMPLES]
    push = gust(load(x, 13), s.gusts, key, i, tick)
    body = load_body(x)
    h = s.clock.period / s.clock.substeps
    hardest, upright = 0.0, 1.0
    for k in range(s.clock.substeps):
        body, contact = substep(body, applied, push, h, actuation, s.airframe)
        if contact.touching and (contact.speed > hardest):
            hardest, upright = contact.speed, contact.uprightness
        if (tick * s.clock.substeps + k + 1) % s.clock.sample_every == 0:
            count += 1
            exact = truth(body, applied, push, contact.touching, s.airframe)
            raw = corrupt(exact, s.noise, key, i, count)
            _take_sample(ring, speeds, raw, count, i == 0, s)
    put_body(x, body)
    put(x, 13, push)
    return hardest, upright


# -- reset ----------------------------------------------------------------------------------------


@device
def _place(state: State, w: int, i: int, body: Body, a: Vector, key: Any, s: World) -> None:
    """Put a vehicle with acceleration `a` into the world, its gust still, its sensors settled."""
    x = state.vehicles[w, i]
    put_body(x, body)
    put(x, 13, (0.0, 0.0, 0.0))
    exact = Measured(body.p, body.v, a, body.q, body.w)
    raw = corrupt(exact, s.noise, key, i, 0)
    for k in range(s.clock.delay + 1):
        put_sample(state.samples[w, i, k], raw)
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
    table = table_row(state.tables, w)
    if len(c.drawing) > 0:
        draw(key, c.drawing, table)
    begin = evaluate(c.trajectory_kind, table, 0.0)
    R = start_direction(c.trajectory_kind, table)

    still = (0.0, 0.0, 0.0)
    if s.world.on_ground:
        _place(state, w, 0, resting(load(c.starts[0], 0)), still, key, s.world)
    else:
        _place(state, w, 0, trimmed(begin, s.world), begin.a, key, s.world)
    seen = latest(state.samples[w, 0], 0).v
    state.seen[w, 0], state.seen[w, 1] = seen[0], seen[1]
    for i in range(len(c.offsets)):
        x = state.followers[w, i]
        x[HEADING], x[HEADING + 1] = R.real, R.imag
        x[ESTIMATE], x[ESTIMATE + 1] = R.real, R.imag
        for k in range(4):
            x[PREVIOUS + k] = 0.0
        target = slot_of(state, c, w, i, begin)
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
def _action(row: Any, size: int) -> Action:
    """A follower's action as executed: clipped to [-1, 1], padded with zeros."""
    a0 = min(max(np.float64(row[0]), -1.0), 1.0)
    a1 = min(max(np.float64(row[1]), -1.0), 1.0)
    a2 = min(max(np.float64(row[2]), -1.0), 1.0)
    a3 = min(max(np.float64(row[3]), -1.0), 1.0) if size > 3 else 0.0
    return (a0, a1, a2, a3)


@device
def _move_headings(state: State, c: Constants, w: int, before: complex, s: World) -> None:
    """Let the slots' headings follow the leader's true motion, the estimates the measured one."""
    leader = state.vehicles[w, 0]
    after = complex(leader[3], leader[4])
    seen = latest(state.samples[w, 0], state.counters[w, SAMPLES]).v
    seen_before, seen_after = complex(state.seen[w, 0], state.seen[w, 1]), complex(seen[0], seen[1])
    for i in range(len(c.offsets)):
        x, d_x = state.followers[w, i], c.offsets[i, 0]
        R = complex(x[HEADING], x[HEADING + 1])
        R = advance_heading(R, before, after, d_x, s.clock.period)
        x[HEADING], x[HEADING + 1] = R.real, R.imag
        R = complex(x[ESTIMATE], x[ESTIMATE + 1])
        R = advance_heading(R, seen_before, seen_after, d_x, s.clock.period)
        x[ESTIMATE], x[ESTIMATE + 1] = R.real, R.imag


@device
def _triggered(state: State, c: Constants, w: int, begin: Reference, s: World) -> bool:
    """The trigger (40), on true positions: every vehicle is near where it should start from."""
    ready = within(load(state.vehicles[w, 0], 0), begin.p, s.trigger)
    for i in range(len(c.offsets)):
        target = slot_of(state, c, w, i, begin)
        p = load(state.vehicles[w, i + 1], 0)
        ready = ready and within(p, target.p, s.trigger)
    return ready


@device
def _command(state: State, c: Constants, w: int, i: int, a: Action, s: World) -> Wrench:
    """What follower `i`'s actuators do, its virtual follower moved on at level REFERENCE."""
    x = state.followers[w, i]
    own = latest(state.samples[w, i + 1], state.counters[w, SAMPLES])
    guide = load_guide(x)
    idle = (0.0, 0.0, 0.0, 0.0)
    started = state.counters[w, STARTED] != 0
    R = complex(x[ESTIMATE], x[ESTIMATE + 1])
    ref = guided(a if started else idle, guide, R, s)
    if s.level == REFERENCE:
        moved = guide_on(guide, ref.a, s.clock.period)
        put(x, GUIDE_P, moved.p)
        put(x, GUIDE_V, moved.v)
    return command_follower(a, own, ref, s)


@device
def _step(state: State, c: Constants, w: int, actions: Any, out: Any, s: Settings) -> bool:
    """One control tick of world `w`; returns whether it ended in a failure."""
    counters = state.counters[w]
    key = episode_key(state.keys[w], counters[EPISODE])
    table = table_row(state.tables, w)
    begin = evaluate(c.trajectory_kind, table, 0.0)
    started = counters[STARTED] != 0
    ref = hold(begin)
    if started:
        ref = evaluate(c.trajectory_kind, table, counters[CLOCK] * s.world.clock.period)

    before = complex(state.vehicles[w, 0, 3], state.vehicles[w, 0, 4])
    seen = latest(state.samples[w, 0], counters[SAMPLES])
    state.seen[w, 0], state.seen[w, 1] = seen.v[0], seen.v[1]
    n = len(c.offsets)
    crash = 0.0
    for i in range(n + 1):
        if i == 0:
            applied = command_leader(seen, ref, s.world)
            actuation = s.world.leader_actuation
        else:
            a = _action(actions[i - 1], c.action_size)
            applied = _command(state, c, w, i - 1, a, s.world)
            actuation = s.world.follower_actuation
        hardest, upright = _fly(state, w, i, applied, actuation, key, s.world)
        if i == 0:
            crash = hardest
        else:  # kept for the failure check below, once every vehicle has moved
            out[i - 1, SEPARATION], out[i - 1, FAILED] = hardest, upright

    substeps = s.world.clock.substeps
    every = s.world.clock.sample_every
    counters[TICK] += 1
    counters[SAMPLES] = counters[TICK] * substeps // every
    if started:
        counters[CLOCK] += 1
        _move_headings(state, c, w, before, s.world)
    elif _triggered(state, c, w, begin, s.world):
        counters[STARTED] = 1

    ended = crash > s.limits.impact
    for i in range(n):
        p = load(state.vehicles[w, i + 1], 0)
        hardest, upright = out[i, SEPARATION], out[i, FAILED]
        separation = separation_of(state, w, i + 1)
        error = distance(slot_of(state, c, w, i, begin).p, p)
        why = failure(separation, hardest, upright, error, s.limits)
        x = state.followers[w, i]
        a = _action(actions[i], c.action_size)
        size = c.action_size
        terms = reward(error, a, previous_action(x), size, why != NO_FAILURE, s.rewards)
        total = 0.0
        for k in range(4):
            out[i, TERMS + k] = terms[k]
            total += terms[k]
            x[PREVIOUS + k] = a[k]
        out[i, REWARD] = total
        out[i, FAILED] = why
        ended = ended or why != NO_FAILURE
    return ended


@device
def _look(state: State, c: Constants, w: int, obs: Any, out: Any, s: Settings) -> None:
    """Write what every follower of world `w` sees, and the truth beside it."""
    begin = evaluate(c.trajectory_kind, table_row(state.tables, w), 0.0)
    for i in range(len(c.offsets)):
        p = load(state.vehicles[w, i + 1], 0)
        report(out[i], slot_of(state, c, w, i, begin), p, separation_of(state, w, i + 1))
        observe_follower(state, c, w, i, begin, obs[i], s.world)


@kernel
def advance(
    first: int,
    last: int,
    mode: int,
    actions: NDArray[np.float32],
    mask: NDArray[np.bool_],
    state: State,
    c: Constants,
    r: Results,
) -> None:
    """Step or reset the worlds `first` to `last` that `mask` names; look at the others.

    The three things that may happen to a world stand once each in one loop: compiled twice, the same
    formula may come out with other fused operations, and the faces would differ in a last bit.
    """
    s = unpack(c.settings)
    n = len(c.offsets)
    for w in range(first, last):
        obs, out = r.observations[w], r.outputs[w]
        do = _STEPS
        if not mask[w]:
            do = _LOOKS
        elif mode == RESET or (mode == STEP_OR_RESET and state.counters[w, OVER] != 0):
            do = _RESETS
        again = True
        while again:
            again = False
            if do == _STEPS:
                ended = _step(state, c, w, actions[w], out, s)
                late = state.counters[w, TICK] >= c.max_steps
                r.terminated[w], r.truncated[w] = ended, late
                state.counters[w, OVER] = ended or late
                total = 0.0
                for i in range(n):
                    total += out[i, REWARD]
                r.rewards[w] = total / n
                again = mode == STEP_AND_RESET and (ended or late)
            elif do == _RESETS:
                _reset(state, c, w, out, s)
            _look(state, c, w, obs, out, s)
            if again:
                r.final_observations[w] = obs
                r.final_outputs[w] = out
                do = _RESETS


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
