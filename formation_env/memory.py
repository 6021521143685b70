"""The memory behind `Simulation`: which number lies where, and how it is loaded and stored.

With `looking` and `kernels` one layer; only these and `simulation` know the layout.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device, plain
from formation_env.quadrotor import Airframe, Body
from formation_env.rng import philox
from formation_env.sensors import Measured, Noise
from formation_env.so3 import Vector
from formation_env.task import CORE, Limits, Rewards
from formation_env.tracker import TrackerLaw
from formation_env.world import Action, Clock, Guide, Gusts, Reach, World

if TYPE_CHECKING:
    from formation_env.config import FormationConfig

Floats = NDArray[np.float64]

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


# Worlds side by side in a tile. A power of two that fills the widest vector registers twice; world `w`
# is lane `w % LANES` of tile `w // LANES`.
LANES = 16


class State(NamedTuple):
    """All that changes: W worlds in T tiles of L lanes; n followers, D samples of delay, N averaged."""

    vehicles: Floats  # (T, n+1, 16, L): p, v, q, w, gust; the leader first
    samples: Floats  # (T, n+1, D+1, 16, L): ring of measurements p, v, a, q, w
    followers: Floats  # (T, n, 14, L): slot heading, estimated heading, previous action, guide
    speeds: Floats  # (W, N, 3): ring of the leader's measured velocities
    seen: Floats  # (T, 2, L): the leader's planar velocity as measured one tick ago
    begins: Floats  # (T, 3, L): the leader's first reference point
    tables: Floats  # (W or 1, T): the leader's trajectory
    counters: NDArray[np.int64]  # (W, 6)
    keys: NDArray[np.uint64]  # (T L,): of the streams
    episode_keys: NDArray[np.uint64]  # (T L,): of the episodes


class Constants(NamedTuple):
    """All that does not."""

    settings: Floats  # World, Rewards and Limits, flattened
    offsets: Floats  # (n, 3): d
    starts: Floats  # (n+1, 3): where vehicles stand at the start on the ground
    drawing: Floats  # bounds of a random trajectory, or empty
    references: (
        Floats  # (max_steps + 1, 15): the leader's reference tick by tick, or empty if random
    )
    bound: NDArray[np.float32]  # (entries,): observations are clipped to it
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
    final_observations: NDArray[np.float32]  # as observations, empty unless asked for
    final_outputs: Floats


class Sizes(NamedTuple):
    """The numbers that say how long everything is, and a few more constants: one integer array."""

    worlds: int
    tiles: int
    vehicles: int  # n + 1
    delays: int  # D + 1
    window: int  # N
    tables: int  # W or 1
    table: int  # numbers in one
    settings: int
    drawing: int
    references: int  # rows
    entries: int
    trajectory_kind: int
    neighbours: int
    action_size: int
    max_steps: int


MAX_STEPS = Sizes._fields.index("max_steps")


class Memory(NamedTuple):
    """Everything in a few flat arrays: each array handed to a kernel costs 0.1 us."""

    floats: Floats  # State's, one after the other
    counters: NDArray[np.int64]  # (W, 6)
    keys: NDArray[np.uint64]  # (2, T L)
    constants: Floats  # Constants', one after the other
    bound: NDArray[np.float32]
    sizes: NDArray[np.int64]  # Sizes


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


def allocate(config: FormationConfig, worlds: int, max_steps: int, references: Floats) -> Memory:
    """Memory for `worlds` worlds that have not been reset yet."""
    n, clock, path = config.followers, config.world.clock, config.trajectory
    drawing = np.zeros(0) if path.random is None else np.array(path.random, dtype=np.float64)
    settings = np.array(flatten(Settings(config.world, config.reward, config.limits)))
    fixed = (settings, config.offsets, config.ground_starts(), drawing, references)
    sizes = Sizes(
        worlds,
        -(-worlds // LANES),
        n + 1,
        clock.delay + 1,
        clock.window,
        1 if path.random is None else worlds,
        len(path.table),
        len(settings),
        len(drawing),
        len(references),
        config.layout.size,
        path.kind,
        config.neighbours,
        config.action_size,
        max_steps,
    )
    lanes = sizes.tiles * LANES
    floats = lanes * (16 * (n + 1) * (clock.delay + 2) + 14 * n + 5)
    floats += worlds * clock.window * 3 + sizes.tables * sizes.table
    memory = Memory(
        np.zeros(floats),
        np.zeros((worlds, 6), dtype=np.int64),
        np.zeros((2, sizes.tiles * LANES), dtype=np.uint64),
        np.concatenate([np.ravel(x) for x in fixed]).astype(np.float64),
        config.layout.bound,
        np.array(sizes, dtype=np.int64),
    )
    memory.counters[:, EPISODE] = -1
    memory.counters[:, OVER] = 1
    state = views(memory)
    state.tables[:] = path.table
    # Lanes without a world are computed all the same: with an attitude, so that nothing divides by 0.
    state.vehicles[:, :, 6] = 1.0
    state.samples[:, :, :, 9] = 1.0
    return memory


def room_size(config: FormationConfig) -> int:
    """How many numbers `Scratch` needs."""
    n, entries = config.followers, config.layout.size
    rows = 3 + 2 + 15 + 16 * (n + 1) + 4 * n + 7 * (n + 1) + 14 * n + CORE
    return LANES * (rows + 9 * (config.neighbours + 1) + entries)


def results(config: FormationConfig, worlds: int, final: bool) -> tuple[Results, tuple[Any, ...]]:
    """Fresh arrays for one call, and the fewer ones that a kernel takes; zero but for observations."""
    n, size, width = config.followers, config.layout.size, len(OUTPUTS)
    spare = worlds if final else 0
    observations = np.empty((worlds, n, size), dtype=np.float32)
    floats = np.zeros(worlds * (n * width + 1))
    flags = np.zeros((2, worlds), dtype=np.bool_)
    last = _NOTHING if not final else np.zeros((spare, n, size), dtype=np.float32)
    last_outputs = _NO_OUTPUTS if not final else np.zeros((spare, n, width))
    outputs = floats[worlds:].reshape(worlds, n, width)
    named = Results(observations, outputs, floats[:worlds], flags[0], flags[1], last, last_outputs)
    return named, (observations, floats, flags, last, last_outputs)


_NOTHING = np.zeros((0, 0, 0), dtype=np.float32)
_NO_OUTPUTS = np.zeros((0, 0, len(OUTPUTS)))


def views(memory: Memory) -> State:
    """The state in Python: views by name."""
    opened: State = plain(open_state)(memory.floats, memory.counters, memory.keys, memory.sizes)
    return opened


# -- opening flat memory --------------------------------------------------------------------------


@device
def open_state(floats: Floats, counters: Any, keys: Any, sizes: Any) -> State:
    """The arrays of `State` in flat memory."""
    T, V, D, N, W = sizes[1], sizes[2], sizes[3], sizes[4], sizes[0]
    a = T * V * 16 * LANES
    b = a + a * D
    d = b + T * (V - 1) * 14 * LANES
    e = d + W * N * 3
    f = e + T * 2 * LANES
    g = f + T * 3 * LANES
    return State(
        floats[:a].reshape(T, V, 16, LANES),
        floats[a:b].reshape(T, V, D, 16, LANES),
        floats[b:d].reshape(T, V - 1, 14, LANES),
        floats[d:e].reshape(W, N, 3),
        floats[e:f].reshape(T, 2, LANES),
        floats[f:g].reshape(T, 3, LANES),
        floats[g:].reshape(sizes[5], sizes[6]),
        counters,
        keys[0],
        keys[1],
    )


@device
def open_constants(numbers: Floats, bound: Any, sizes: Any) -> Constants:
    """The arrays of `Constants` in flat memory."""
    n = sizes[2] - 1
    a = sizes[7]
    b = a + 3 * n
    d = b + 3 * (n + 1)
    e = d + sizes[8]
    return Constants(
        numbers[:a],
        numbers[a:b].reshape(n, 3),
        numbers[b:d].reshape(n + 1, 3),
        numbers[d:e],
        numbers[e:].reshape(sizes[9], 15),
        bound,
        sizes[11],
        sizes[12],
        sizes[13],
        sizes[14],
    )


@device
def open_results(
    observations: Any, floats: Floats, flags: Any, last: Any, last_outputs: Any, sizes: Any
) -> Results:
    """The arrays of `Results` as `results` made them."""
    W, n = sizes[0], sizes[2] - 1
    outputs = floats[W:].reshape(W, n, len(OUTPUTS))
    return Results(observations, outputs, floats[:W], flags[0], flags[1], last, last_outputs)


# -- loads and stores ---------------------------------------------------------------------------


@device
def vehicle(state: State, w: int, i: int) -> Any:
    """The 16 numbers of vehicle `i` of world `w`."""
    return state.vehicles[w // LANES, i, :, w % LANES]


@device
def ring(state: State, w: int, i: int) -> Any:
    """The measurements of vehicle `i` of world `w`, `(D+1, 16)`."""
    return state.samples[w // LANES, i, :, :, w % LANES]


@device
def follower(state: State, w: int, i: int) -> Any:
    """The 14 numbers of follower `i` of world `w`."""
    return state.followers[w // LANES, i, :, w % LANES]


@device
def load(x: Any, i: int) -> Vector:
    return (x[i], x[i + 1], x[i + 2])


@device
def put(x: Any, i: int, a: Vector) -> None:
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
    airframe = Airframe(x[0], load(x, 1), x[4], x[5], load(x, 6), load(x, 9), x[12])
    world = World(
        airframe,
        _law(x, 13),
        _law(x, 23),
        Noise(x[33], x[34], x[35], x[36], x[37]),
        Clock(x[38], int(x[39]), int(x[40]), int(x[41]), int(x[42])),
        Reach(x[43], load(x, 44), load(x, 47)),
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
def load_body(x: Any) -> Body:
    return Body(load(x, 0), load(x, 3), (x[6], x[7], x[8], x[9]), load(x, 10))


@device
def put_body(x: Any, b: Body) -> None:
    put(x, 0, b.p)
    put(x, 3, b.v)
    x[6], x[7], x[8], x[9] = b.q
    put(x, 10, b.w)


@device
def load_sample(x: Any) -> Measured:
    q = (x[9], x[10], x[11], x[12])
    return Measured(load(x, 0), load(x, 3), load(x, 6), q, load(x, 13))


@device
def put_sample(x: Any, m: Measured) -> None:
    put(x, 0, m.p)
    put(x, 3, m.v)
    put(x, 6, m.a)
    x[9], x[10], x[11], x[12] = m.q
    put(x, 13, m.w)


@device
def latest(state: State, w: int, i: int) -> Measured:
    """The measurement of vehicle `i` that has arrived: the oldest in its ring."""
    samples = ring(state, w, i)
    return load_sample(samples[(state.counters[w, SAMPLES] + 1) % len(samples)])


@device
def previous_action(x: Any) -> Action:
    return (x[PREVIOUS], x[PREVIOUS + 1], x[PREVIOUS + 2], x[PREVIOUS + 3])


@device
def load_guide(x: Any) -> Guide:
    return Guide(load(x, GUIDE_P), load(x, GUIDE_V))


@device
def table_row(tables: Any, w: int) -> Any:
    return tables[w if len(tables) > 1 else 0]


@device
def episode_key(key: Any, episode: int) -> Any:
    """The key of one episode of a world's stream: four Philox words of its number, two of them kept."""
    zero = np.uint64(0)
    low, high, _, _ = philox(np.uint64(episode), zero, zero, zero, key & _LOW, key >> _HALF)
    return (high << _HALF) | low


def by_world(tiles: NDArray[Any], worlds: int) -> NDArray[Any]:
    """An array `(T, ..., L)` of tiles as `(worlds, ...)`, a copy."""
    return np.moveaxis(tiles, -1, 1).reshape(-1, *tiles.shape[1:-1])[:worlds].copy()
