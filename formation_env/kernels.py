"""The memory behind `Simulation` and the compiled loop over it: where things lie, tick by tick.

Kept apart from `simulation` only for length: the two are one layer. The mathematics is in `world`,
`task` and below; here are loads, stores and the order of things.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device, kernel
from formation_env.quadrotor import Airframe, Body, Wrench
from formation_env.rng import philox
from formation_env.sensors import (
    Measured,
    Noise,
    angular_difference,
    averaged_acceleration,
    corrupt,
    difference,
)
from formation_env.slots import Slot, advance_heading, slot
from formation_env.so3 import Vector, sub
from formation_env.task import (
    NO_FAILURE,
    Limits,
    Rewards,
    distance,
    failure,
    observe,
    observe_guide,
    observe_neighbour,
    reward,
)
from formation_env.tracker import TrackerLaw
from formation_env.trajectories import Reference, draw, evaluate, start_direction
from formation_env.world import (
    REFERENCE,
    Clock,
    Guide,
    Gusts,
    Reach,
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

if TYPE_CHECKING:
    from formation_env.config import FormationConfig

Floats = NDArray[np.float64]

# Modes of `advance`: what to do with each world.
STEP, STEP_OR_RESET, STEP_AND_RESET, RESET = 0, 1, 2, 3
_LOOKS, _STEPS, _RESETS = 0, 1, 2

# Columns of State.counters.
TICK, SAMPLES, STARTED, CLOCK, EPISODE, OVER = range(6)

# Columns of Results.outputs.
OUTPUTS = (
    "reward",
    "formation",
    "effort",
    "smoothness",
    "failure",
    "slot_x",
    "slot_y",
    "slot_z",
    "error_x",
    "error_y",
    "error_z",
    "separation",
    "failed",
)
REWARD, TERMS, SLOT, ERROR, SEPARATION, FAILED = 0, 1, 5, 8, 11, 12

# Columns of State.followers.
HEADING, ESTIMATE, PREVIOUS, GUIDE_P, GUIDE_V = 0, 2, 4, 8, 11

_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)


class State(NamedTuple):
    """All that changes, one row a world (W); n followers, D samples of delay, N in the average."""

    vehicles: Floats  # (W, n+1, 16): p, v, q, w, gust; the leader first
    samples: Floats  # (W, n+1, D+1, 16): ring of measurements p, v, a, q, w
    speeds: Floats  # (W, N, 3): ring of the leader's measured velocities
    followers: Floats  # (W, n, 14): slot heading, estimated heading, previous action, guide
    seen: Floats  # (W, 2): the leader's planar velocity as measured one tick ago
    tables: Floats  # (W or 1, T): the leader's trajectory
    counters: NDArray[np.int64]  # (W, 6)
    keys: NDArray[np.uint64]  # (W,)


class Constants(NamedTuple):
    """All that does not."""

    settings: Floats  # World, Rewards and Limits, flattened
    offsets: Floats  # (n, 3): d
    starts: Floats  # (n+1, 3): where vehicles stand at the start on the ground
    bound: NDArray[np.float32]  # (entries,): observations are clipped to it
    drawing: Floats  # bounds of a random trajectory, or empty
    trajectory_kind: int
    neighbours: int
    action_size: int
    max_steps: int


class Results(NamedTuple):
    """What one call returns, fresh arrays."""

    observations: NDArray[np.float32]  # (W, n, entries)
    outputs: Floats  # (W, n, len(OUTPUTS))
    rewards: Floats  # (W,), the followers' mean
    terminated: NDArray[np.bool_]  # (W,)
    truncated: NDArray[np.bool_]  # (W,)
    final_observations: NDArray[np.float32]  # as observations, in mode STEP_AND_RESET
    final_outputs: Floats


class Settings(NamedTuple):
    """Constants as the mathematics takes them."""

    world: World
    rewards: Rewards
    limits: Limits


def flatten(value: Any) -> list[float]:
    """The numbers of a nested tuple in order, for `unpack`."""
    if isinstance(value, tuple):
        return [x for item in value for x in flatten(item)]
    return [float(value)]


def constants(config: FormationConfig, max_steps: int) -> Constants:
    """The constant arrays of a configuration."""
    random = config.trajectory.random
    return Constants(
        np.array(flatten(Settings(config.world, config.reward, config.limits))),
        np.array(config.offsets, dtype=np.float64),
        np.array(config.ground_starts(), dtype=np.float64),
        config.layout.bound,
        np.zeros(0) if random is None else np.array(random, dtype=np.float64),
        config.trajectory.kind,
        config.neighbours,
        config.action_size,
        max_steps,
    )


def allocate(config: FormationConfig, worlds: int) -> State:
    """Arrays for `worlds` worlds that have not been reset yet."""
    n, clock = config.followers, config.world.clock
    table = config.trajectory.table
    rows = 1 if config.trajectory.random is None else worlds
    state = State(
        np.zeros((worlds, n + 1, 16)),
        np.zeros((worlds, n + 1, clock.delay + 1, 16)),
        np.zeros((worlds, clock.window, 3)),
        np.zeros((worlds, n, 14)),
        np.zeros((worlds, 2)),
        np.tile(table, (rows, 1)),
        np.zeros((worlds, 6), dtype=np.int64),
        np.zeros(worlds, dtype=np.uint64),
    )
    state.counters[:, EPISODE] = -1
    state.counters[:, OVER] = 1
    return state


def results(config: FormationConfig, worlds: int, mode: int) -> Results:
    """Fresh arrays for one call; reward terms are zero for worlds that are only looked at."""
    n, size = config.followers, config.layout.size
    spare = worlds if mode == STEP_AND_RESET else 0
    return Results(
        np.empty((worlds, n, size), dtype=np.float32),
        np.zeros((worlds, n, len(OUTPUTS))),
        np.zeros(worlds),
        np.zeros(worlds, dtype=np.bool_),
        np.zeros(worlds, dtype=np.bool_),
        np.zeros((spare, n, size), dtype=np.float32),
        np.zeros((spare, n, len(OUTPUTS))),
    )


# -- loads and stores ---------------------------------------------------------------------------


@device
def _vector(x: Any, i: int) -> Vector:
    return (x[i], x[i + 1], x[i + 2])


@device
def _put(x: Any, i: int, a: Vector) -> None:
    x[i], x[i + 1], x[i + 2] = a


@device
def _law(x: Any, i: int) -> TrackerLaw:
    return TrackerLaw(
        x[i],
        x[i + 1],
        x[i + 2],
        x[i + 3],
        x[i + 4],
        x[i + 5],
        x[i + 6],
        x[i + 7],
        x[i + 8],
        x[i + 9],
    )


@device
def unpack(x: Any) -> Settings:
    """The inverse of `flatten`; a test goes round."""
    airframe = Airframe(x[0], _vector(x, 1), x[4], x[5], _vector(x, 6), _vector(x, 9), x[12])
    world = World(
        airframe,
        _law(x, 13),
        _law(x, 23),
        Noise(x[33], x[34], x[35], x[36], x[37]),
        Clock(x[38], int(x[39]), int(x[40]), int(x[41]), int(x[42])),
        Reach(x[43], _vector(x, 44), _vector(x, 47)),
        Gusts(x[50], x[51]),
        int(x[52]),
        int(x[53]),
        int(x[54]),
        x[55],
        int(x[56]),
        x[57],
    )
    return Settings(world, Rewards(x[58], x[59], x[60], x[61]), Limits(x[62], x[63], x[64], x[65]))


@device
def _body(x: Any) -> Body:
    return Body(_vector(x, 0), _vector(x, 3), (x[6], x[7], x[8], x[9]), _vector(x, 10))


@device
def _put_body(x: Any, b: Body) -> None:
    _put(x, 0, b.p)
    _put(x, 3, b.v)
    x[6], x[7], x[8], x[9] = b.q
    _put(x, 10, b.w)


@device
def _sample(x: Any) -> Measured:
    q = (x[9], x[10], x[11], x[12])
    return Measured(_vector(x, 0), _vector(x, 3), _vector(x, 6), q, _vector(x, 13))


@device
def _put_sample(x: Any, m: Measured) -> None:
    _put(x, 0, m.p)
    _put(x, 3, m.v)
    _put(x, 6, m.a)
    x[9], x[10], x[11], x[12] = m.q
    _put(x, 13, m.w)


@device
def _latest(ring: Any, count: int) -> Measured:
    """The measurement that has arrived: the oldest in the ring, `D` samples before number `count`."""
    return _sample(ring[(count + 1) % len(ring)])


@device
def _previous(x: Any) -> tuple[float, float, float, float]:
    return (x[PREVIOUS], x[PREVIOUS + 1], x[PREVIOUS + 2], x[PREVIOUS + 3])


@device
def _guide(x: Any) -> Guide:
    return Guide(_vector(x, GUIDE_P), _vector(x, GUIDE_V))


@device
def _row(tables: Any, w: int) -> Any:
    return tables[w if len(tables) > 1 else 0]


@device
def _episode_key(key: Any, episode: int) -> Any:
    """The key of one episode of a world's stream: four Philox words of its number, two of them kept."""
    zero = np.uint64(0)
    low, high, _, _ = philox(np.uint64(episode), zero, zero, zero, key & _LOW, key >> _HALF)
    return (high << _HALF) | low


# -- sensing ------------------------------------------------------------------------------------


@device
def _take_sample(ring: Any, speeds: Any, raw: Measured, count: int, leader: bool, s: World) -> None:
    """Store sample number `count`, its velocities differenced where they are not measured."""
    if s.clock.window > 0:
        period = s.clock.sample_every * (s.clock.period / s.clock.substeps)
        before = _sample(ring[(count - 1) % len(ring)])
        v = difference(raw.p, before.p, period)
        a = (0.0, 0.0, 0.0)
        if leader:
            then = speeds[count % s.clock.window]
            a = averaged_acceleration(v, _vector(then, 0), s.clock.window, period)
            _put(then, 0, v)
        raw = Measured(raw.p, v, a, raw.q, angular_difference(raw.q, before.q, period))
    _put_sample(ring[count % len(ring)], raw)


@device
def _fly(
    state: State, w: int, i: int, applied: Wrench, actuation: int, key: Any, s: World
) -> tuple[float, float]:
    """Fly one vehicle for one tick, sampling on the way; returns its hardest touch-down."""
    x = state.vehicles[w, i]
    ring, speeds = state.samples[w, i], state.speeds[w]
    tick, count = state.counters[w, TICK], state.counters[w, SAMPLES]
    push = gust(_vector(x, 13), s.gusts, key, i, tick)
    body = _body(x)
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
    _put_body(x, body)
    _put(x, 13, push)
    return hardest, upright


# -- slots, observation, results ------------------------------------------------------------------


@device
def _target(state: State, c: Constants, w: int, i: int, begin: Reference) -> Slot:
    """Where follower `i` should be: relative to the leader, or to the waiting reference (40)."""
    x = state.followers[w, i]
    R = complex(x[HEADING], x[HEADING + 1])
    d = _vector(c.offsets[i], 0)
    if state.counters[w, STARTED] == 0:
        return slot(R, begin.p, (0.0, 0.0, 0.0), d)
    leader = state.vehicles[w, 0]
    return slot(R, _vector(leader, 0), _vector(leader, 3), d)


@device
def _write(row: Any, k: int, bound: Any, x: float) -> int:
    row[k] = min(max(x, -bound[k]), bound[k])
    return k + 1


@device
def _write_vector(row: Any, k: int, bound: Any, a: Vector) -> int:
    for x in a:
        k = _write(row, k, bound, x)
    return k


@device
def _observe(
    state: State, c: Constants, w: int, i: int, begin: Reference, row: Any, s: World
) -> None:
    """Write follower `i`'s observation."""
    x = state.followers[w, i]
    count, started = state.counters[w, SAMPLES], state.counters[w, STARTED] != 0
    R = complex(x[ESTIMATE], x[ESTIMATE + 1])
    leader = _latest(state.samples[w, 0], count)
    own = _latest(state.samples[w, i + 1], count)
    anchor = leader.p if started else begin.p
    o = observe(own, leader, anchor, R, _vector(c.offsets[i], 0), _previous(x), started)
    b = c.bound
    k = _write_vector(row, 0, b, o.slot_error)
    k = _write_vector(row, k, b, o.relative_velocity)
    k = _write_vector(row, k, b, o.leader_velocity)
    k = _write_vector(row, k, b, o.leader_acceleration)
    k = _write_vector(row, k, b, o.body_x)
    k = _write_vector(row, k, b, o.body_z)
    k = _write_vector(row, k, b, o.angular_velocity)
    k = _write(row, k, b, o.heading[0])
    k = _write(row, k, b, o.heading[1])
    k = _write_vector(row, k, b, o.offset)
    for a in o.previous_action:
        k = _write(row, k, b, a)
    k = _write(row, k, b, o.started)
    k = _write_vector(row, k, b, o.position)
    if s.level == REFERENCE:
        g = observe_guide(own, _guide(x), R)
        k = _write_vector(row, k, b, g.p)
        k = _write_vector(row, k, b, g.v)
    _observe_neighbours(state, c, w, i, own, R, row, k)


@device
def _observe_neighbours(
    state: State, c: Constants, w: int, i: int, own: Measured, R: complex, row: Any, k: int
) -> None:
    """The nearest followers by measured distance, nearest first; equal distances by number."""
    count = state.counters[w, SAMPLES]
    last, last_j = -1.0, -1
    for _ in range(c.neighbours):
        best, best_j = np.inf, -1
        for j in range(len(c.offsets)):
            if j != i:
                r = distance(_latest(state.samples[w, j + 1], count).p, own.p)
                beyond = r > last or (r == last and j > last_j)
                if beyond and r < best:
                    best, best_j = r, j
        if best_j < 0:
            for _ in range(7):
                k = _write(row, k, c.bound, 0.0)
        else:
            o = observe_neighbour(own, _latest(state.samples[w, best_j + 1], count), R)
            k = _write(row, k, c.bound, o.present)
            k = _write_vector(row, k, c.bound, o.position)
            k = _write_vector(row, k, c.bound, o.velocity)
            last, last_j = best, best_j


@device
def _separation(state: State, w: int, i: int) -> float:
    """Distance from vehicle `i` to the nearest other one, m; infinite if it is alone."""
    x = state.vehicles[w]
    p = _vector(x[i], 0)
    nearest = np.inf
    for j in range(len(x)):
        if j != i:
            nearest = min(nearest, distance(p, _vector(x[j], 0)))
    return nearest


@device
def _report(out: Any, target: Slot, p: Vector, separation: float) -> None:
    """Write the truth about one follower."""
    _put(out, SLOT, target.p)
    _put(out, ERROR, sub(target.p, p))
    out[SEPARATION] = separation


# -- reset ----------------------------------------------------------------------------------------


@device
def _place(state: State, w: int, i: int, body: Body, key: Any, s: World) -> None:
    """Put a vehicle into the world, its gust still and its sensors settled on where it is."""
    x = state.vehicles[w, i]
    _put_body(x, body)
    _put(x, 13, (0.0, 0.0, 0.0))
    exact = Measured(body.p, body.v, (0.0, 0.0, 0.0), body.q, body.w)
    raw = corrupt(exact, s.noise, key, i, 0)
    for k in range(s.clock.delay + 1):
        _put_sample(state.samples[w, i, k], raw)
    if i == 0:
        for k in range(s.clock.window):
            _put(state.speeds[w, k], 0, body.v)


@device
def _reset(state: State, c: Constants, w: int, out: Any, s: Settings) -> None:
    """Start the next episode of world `w`."""
    counters = state.counters[w]
    counters[EPISODE] += 1
    counters[TICK] = counters[SAMPLES] = counters[CLOCK] = counters[OVER] = 0
    counters[STARTED] = 0 if s.world.on_ground else 1
    key = _episode_key(state.keys[w], counters[EPISODE])
    table = _row(state.tables, w)
    if len(c.drawing) > 0:
        draw(key, c.drawing, table)
    begin = evaluate(c.trajectory_kind, table, 0.0)
    R = start_direction(c.trajectory_kind, table)

    leader = resting(_vector(c.starts[0], 0)) if s.world.on_ground else trimmed(begin, s.world)
    _place(state, w, 0, leader, key, s.world)
    seen = _latest(state.samples[w, 0], 0).v
    state.seen[w, 0], state.seen[w, 1] = seen[0], seen[1]
    for i in range(len(c.offsets)):
        x = state.followers[w, i]
        x[HEADING], x[HEADING + 1] = R.real, R.imag
        x[ESTIMATE], x[ESTIMATE + 1] = R.real, R.imag
        for k in range(4):
            x[PREVIOUS + k] = 0.0
        target = _target(state, c, w, i, begin)
        _put(x, GUIDE_P, target.p)
        _put(x, GUIDE_V, target.v)
        if s.world.on_ground:
            body = resting(_vector(c.starts[i + 1], 0))
        else:
            body = near(target, key, i + 1, s.world)
        _place(state, w, i + 1, body, key, s.world)
        for k in range(len(OUTPUTS)):
            out[i, k] = 0.0


# -- step -------------------------------------------------------------------------------------------


@device
def _action(row: Any, size: int) -> tuple[float, float, float, float]:
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
    seen = _latest(state.samples[w, 0], state.counters[w, SAMPLES]).v
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
    ready = within(_vector(state.vehicles[w, 0], 0), begin.p, s.trigger)
    for i in range(len(c.offsets)):
        target = _target(state, c, w, i, begin)
        p = _vector(state.vehicles[w, i + 1], 0)
        ready = ready and within(p, target.p, s.trigger)
    return ready


@device
def _command(
    state: State, c: Constants, w: int, i: int, a: tuple[float, float, float, float], s: World
) -> Wrench:
    """What follower `i`'s actuators do, its virtual follower moved on at level REFERENCE."""
    x = state.followers[w, i]
    own = _latest(state.samples[w, i + 1], state.counters[w, SAMPLES])
    guide = _guide(x)
    idle = (0.0, 0.0, 0.0, 0.0)
    started = state.counters[w, STARTED] != 0
    R = complex(x[ESTIMATE], x[ESTIMATE + 1])
    ref = guided(a if started else idle, guide, R, s)
    if s.level == REFERENCE:
        moved = guide_on(guide, ref.a, s.clock.period)
        _put(x, GUIDE_P, moved.p)
        _put(x, GUIDE_V, moved.v)
    return command_follower(a, own, ref, s)


@device
def _step(state: State, c: Constants, w: int, actions: Any, out: Any, s: Settings) -> bool:
    """One control tick of world `w`; returns whether it ended in a failure."""
    counters = state.counters[w]
    key = _episode_key(state.keys[w], counters[EPISODE])
    table = _row(state.tables, w)
    begin = evaluate(c.trajectory_kind, table, 0.0)
    started = counters[STARTED] != 0
    ref = hold(begin)
    if started:
        ref = evaluate(c.trajectory_kind, table, counters[CLOCK] * s.world.clock.period)

    before = complex(state.vehicles[w, 0, 3], state.vehicles[w, 0, 4])
    seen = _latest(state.samples[w, 0], counters[SAMPLES])
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
        p = _vector(state.vehicles[w, i + 1], 0)
        hardest, upright = out[i, SEPARATION], out[i, FAILED]
        separation = _separation(state, w, i + 1)
        error = distance(_target(state, c, w, i, begin).p, p)
        why = failure(separation, hardest, upright, error, s.limits)
        x = state.followers[w, i]
        a = _action(actions[i], c.action_size)
        size = c.action_size
        terms = reward(error, a, _previous(x), size, why != NO_FAILURE, s.rewards)
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
    begin = evaluate(c.trajectory_kind, _row(state.tables, w), 0.0)
    for i in range(len(c.offsets)):
        p = _vector(state.vehicles[w, i + 1], 0)
        _report(out[i], _target(state, c, w, i, begin), p, _separation(state, w, i + 1))
        _observe(state, c, w, i, begin, obs[i], s.world)


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
        _put(path[k], 0, evaluate(kind, table, times[k]).p)
    return path
