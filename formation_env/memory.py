"""The memory behind `Simulation`: which number lies where, and how it is loaded and stored.

With `blocks`, `lanes` and `kernels` with its parts one layer; only these and `simulation` know the
layout. World `w` is lane `w % LANES` of tile `w // LANES`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device, plain
from formation_env.blocks import LANES, carve, reinterpret
from formation_env.crowd import BLOCK, MARGIN, MET_ROWS, QUEUE_ROWS, SEEKER_ROWS, Crowd
from formation_env.quadrotor import Airframe, Body
from formation_env.rng import philox
from formation_env.sensors import Measured, Noise, silent
from formation_env.so3 import Vector
from formation_env.task import Limits, Rewards
from formation_env.tracker import TrackerLaw
from formation_env.turning import Turning, turning
from formation_env.world import REFERENCE, Clock, Gusts, Reach, World, every_tick

if TYPE_CHECKING:
    from formation_env.config import FormationConfig

Floats = NDArray[np.float64]

# Rows of State.counters.
TICK, STARTED, CLOCK, EPISODE, OVER = range(5)
_COUNTERS = 5

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
# Rows of Scratch.outcomes that follow these.
ERROR_SQUARED, SEPARATION_SQUARED, _OUTCOME = 13, 14, 15

BATCH = 8  # followers whose results are put together before they are written
SIGHT = 8  # numbers of a vehicle in Scratch.points: p, v and two that make it a whole vector

# Rows of State.vehicles: those of a measurement, then the gust where there are any.
ATTITUDE, RATE_OF_TURN, GUST = 9, 13, 16
MEASURED_ROWS, GUST_ROWS = 16, 3

# Rows of State.followers, the guide's at level REFERENCE alone.
HEADING, ESTIMATE, PREVIOUS, GUIDE_P, GUIDE_V = 0, 2, 4, 8, 11
_FOLLOWER_ROWS, _GUIDE_ROWS = 8, 6

_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)


class State(NamedTuple):
    """All that changes: W worlds in T tiles of L lanes; n followers, D samples of delay, N averaged.

    Where measurements are exact and in time they are the state: `vehicles` holds what is measured, the
    leader's acceleration as of the last measurement, and there are no samples.
    """

    vehicles: Floats  # (T, n+1, R L): p, v, a, q, w and the gust if any; the leader first
    samples: Floats  # (T, n+1, D+1 or 0, 16 L): ring of measurements p, v, a, q, w
    followers: Floats  # (T, n, S L): slot heading, estimated heading, previous action, guide
    speeds: Floats  # (W, N, 3): ring of the leader's measured velocities
    begins: Floats  # (T, 3 L): the leader's first reference point
    tables: Floats  # (W or 1, T): the leader's trajectory
    counters: NDArray[np.int64]  # (5, T L)
    keys: NDArray[np.uint64]  # (T L,): of the streams
    episode_keys: NDArray[np.uint64]  # (T L,): of the episodes


class Constants(NamedTuple):
    """All that does not."""

    settings: Floats  # World, Rewards and Limits, flattened
    offsets: Floats  # (n, 3): d
    starts: Floats  # (n+1, 3): where vehicles stand at the start on the ground
    drawing: Floats  # bounds of a random trajectory, or empty
    references: Floats  # (max_steps + 1, 16): the leader's reference tick by tick, or empty
    turning: Floats  # Turning, flattened


class Scratch(NamedTuple):
    """Room to work on one tile of L lanes, for n followers."""

    active: Floats  # (L,): 1 for worlds that step, else 0
    moving: Floats  # (L,): 1 for those whose trigger had fired before the tick
    started: Floats  # (L,): 1 for those whose trigger has fired
    tally: Floats  # (2 L,): the followers' rewards added up, whether one failed
    verdicts: Floats  # (3 L,): a tile's part of `Results.ends`
    before: Floats  # (2 L,): the leader's planar velocity before the tick, m/s
    seen_before: Floats  # (2 L,): as measured then
    refs: Floats  # (16 L,): the leader's reference, and nothing
    lines: Floats  # (16 L,): 16 numbers of each world, to be turned into rows
    still: Floats  # (3 L,): no gust
    counts: NDArray[np.uint64]  # (L,): numbers of the samples to be taken
    rows_of: NDArray[np.int64]  # (L,): where each world's row of the leader's reference begins
    named: NDArray[np.bool_]  # (L,): worlds meant, of a tile that is not full
    drawn: NDArray[np.float32]  # (4 L,): actions of one follower, as given
    draws: NDArray[np.float32]  # (16 L,): normal numbers
    seen: (
        Floats  # (T or 1, n+1, 16 L or R L): the measurements in hand; of one tile if they are late
    )
    actions: Floats  # (n, 4 L): as executed
    commands: Floats  # (n+1, 4 L): thrust and turn of each vehicle
    touches: (
        Floats  # (n+1, 4 L): hardest touch-down: speed, uprightness; touching now; NaN if unsound
    )
    outcomes: Floats  # (n, 15 L): `OUTPUTS`, then the squares of slot error and separation
    nearest: Floats  # (K+1, 2 L): neighbours by squared distance and number; a candidate
    neighbours: Floats  # (n, K L): numbers of the nearest, -1 where there is none
    crowd: Crowd  # room to line up all vehicles of one world
    points: Floats  # (L (n+1) 8,): position and velocity of all, world by world, and nothing
    other: Floats  # (8 L,): those of one neighbour in each world
    rows: NDArray[np.float32]  # (entries L,): an observation
    shown: NDArray[np.float32]  # (L B entries,): observations of a batch of B followers
    told: Floats  # (L B 13,): their outputs
    saved: Floats  # all vehicles and measurements of a tile some of whose worlds do not step


class Results(NamedTuple):
    """What one call returns, fresh arrays."""

    observations: NDArray[np.float32]  # (W, n, entries)
    outputs: Floats  # (W, n, len(OUTPUTS))
    ends: Floats  # (3, W): the followers' mean reward; 1 where terminated; 1 where truncated
    final_observations: NDArray[np.float32]  # as observations, empty unless asked for
    final_outputs: Floats

    @property
    def rewards(self) -> Floats:
        """The followers' mean reward, `(W,)`."""
        rewards: Floats = self.ends[0]
        return rewards

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """`(W,)`."""
        flags: NDArray[np.bool_] = np.not_equal(self.ends[1], 0.0)
        return flags

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """`(W,)`."""
        flags: NDArray[np.bool_] = np.not_equal(self.ends[2], 0.0)
        return flags


class Sizes(NamedTuple):
    """The numbers that say how long everything is, and a few more constants."""

    worlds: int
    tiles: int
    vehicles: int  # n + 1
    delays: int  # D + 1, or 0 where the state is what is measured
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
    vehicle_rows: int  # R
    follower_rows: int  # S


TURNING = 9  # numbers of a `Turning`
REFERENCE_ROW = 16  # p, v, a, j, s and a number that makes it a whole number of vectors
_SIZES = len(Sizes._fields)
MAX_STEPS = Sizes._fields.index("max_steps")


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


def allocate(config: FormationConfig, worlds: int, max_steps: int, references: Floats) -> Floats:
    """Memory for `worlds` worlds that have not been reset yet: `Sizes`, `Constants`, `State`."""
    world, path = config.world, config.trajectory
    drawing = np.zeros(0) if path.random is None else np.array(path.random, dtype=np.float64)
    settings = np.array(flatten(Settings(world, config.reward, config.limits)))
    exact = plain(every_tick)(world.clock) and plain(silent)(world.noise)
    sizes = Sizes(
        worlds,
        tiles(worlds),
        config.followers + 1,
        0 if exact else world.clock.delay + 1,
        world.clock.window,
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
        MEASURED_ROWS + (GUST_ROWS if world.gusts.kick != 0.0 else 0),
        _FOLLOWER_ROWS + (_GUIDE_ROWS if world.level == REFERENCE else 0),
    )
    kept, room = (*_constant_lengths(sizes), *_state_lengths(sizes)), _scratch_lengths(sizes)
    head = _SIZES + len(kept) + len(room) + 1
    flat = np.zeros(head + sum(kept))
    numbers = plain(size_numbers)(flat)
    numbers[:_SIZES] = sizes
    numbers[_SIZES:head] = (*_starts(head, kept), *_starts(0, room), sum(room))
    constants, state = views(flat)
    fixed = (
        settings,
        config.offsets,
        config.ground_starts(),
        drawing,
        references,
        flatten(turning(world.airframe, world.clock.period, world.clock.substeps)),
    )
    for array, values in zip(constants, fixed, strict=True):
        array[...] = np.asarray(values)
    state.counters[EPISODE] = -1
    state.counters[OVER] = 1
    # Nobody has to wait for the start of a world that is not there.
    state.counters[STARTED, worlds:] = 1
    state.tables[:] = path.table
    # Lanes without a world are computed all the same: with an attitude, so that nothing divides by 0.
    state.vehicles[:, :, ATTITUDE * LANES : (ATTITUDE + 1) * LANES] = 1.0
    state.samples[:, :, :, ATTITUDE * LANES : (ATTITUDE + 1) * LANES] = 1.0
    return flat


def _starts(first: int, lengths: tuple[int, ...]) -> list[int]:
    """Where each of some arrays one behind the other begins."""
    return [first + sum(lengths[:k]) for k in range(len(lengths))]


def scratch(memory: Floats) -> Floats:
    """Room for one thread to work in."""
    return np.zeros(int(plain(size_numbers)(memory)[_HEAD - 1]))


@final
class Shapes:
    """Of what one call returns, for the fewest operations in a step of a lone world."""

    def __init__(self, config: FormationConfig, worlds: int) -> None:
        self.observations = (worlds, config.followers, config.layout.size)
        self.outputs = (worlds, config.followers, len(OUTPUTS))
        self.ends = (3, worlds)

    def results(self, final: bool) -> Results:
        """Fresh arrays; the kernel fills them all but those of episodes that did not end."""
        seen, told = np.empty(self.observations, _SINGLE), np.empty(self.outputs)
        if not final:
            return Results(seen, told, np.empty(self.ends), _NOTHING, _NO_OUTPUTS)
        last = np.zeros(self.observations, _SINGLE), np.zeros(self.outputs)
        return Results(seen, told, np.empty(self.ends), *last)


_SINGLE = np.dtype(np.float32)
_NOTHING = np.zeros((0, 0, 0), _SINGLE)
_NO_OUTPUTS = np.zeros((0, 0, len(OUTPUTS)))


def tiles(worlds: int) -> int:
    """How many tiles hold so many worlds."""
    return -(-worlds // LANES)


def views(memory: Floats) -> tuple[Constants, State]:
    """What lies in the memory, by name."""
    numbers = plain(size_numbers)(memory)
    return plain(open_constants)(memory, numbers), plain(open_state)(memory, numbers)


# -- opening flat memory --------------------------------------------------------------------------
#
# The memory begins with the numbers of `Sizes`, then the starts of all arrays: first those of
# `Constants` and `State` in the memory itself, then those of `Scratch` in its own.


def _constant_lengths(z: Sizes) -> tuple[int, ...]:
    n = z.vehicles - 1
    references = REFERENCE_ROW * z.references
    return (z.settings, 3 * n, 3 * z.vehicles, z.drawing, references, TURNING)


def _state_lengths(z: Sizes) -> tuple[int, ...]:
    lanes, n = z.tiles * LANES, z.vehicles - 1
    return (
        z.vehicle_rows * z.vehicles * lanes,
        MEASURED_ROWS * z.vehicles * z.delays * lanes,
        z.follower_rows * n * lanes,
        3 * z.worlds * z.window,
        3 * lanes,
        z.tables * z.table,
        _COUNTERS * lanes,
        lanes,
        lanes,
    )


def _scratch_lengths(z: Sizes) -> tuple[int, ...]:
    """In the order of `Scratch`."""
    V, K, L = z.vehicles, z.neighbours + 1, LANES
    n = V - 1
    saved = z.vehicle_rows + (MEASURED_ROWS if z.delays == 1 else 0)
    return (
        *(L, L, L, 2 * L, 3 * L, 2 * L, 2 * L, REFERENCE_ROW * L, REFERENCE_ROW * L, 3 * L),
        *(L, L, L // 8, 2 * L, 8 * L),
        MEASURED_ROWS * V * L if z.delays > 1 else 0,
        4 * n * L,
        4 * V * L,
        4 * V * L,
        _OUTCOME * n * L,
        2 * K * L,
        (K - 1) * n * L,
        _crowd_length(V, K - 1),
        SIGHT * V * L,
        SIGHT * L,
        z.entries * L // 2,
        z.entries * min(n, BATCH) * L // 2,
        len(OUTPUTS) * min(n, BATCH) * L,
        saved * V * L,
    )


_CONSTANTS, _STATE, _SCRATCH = (len(kind._fields) for kind in (Constants, State, Scratch))
_STATE_AT = _SIZES + _CONSTANTS
_SCRATCH_AT = _STATE_AT + _STATE
_HEAD = _SCRATCH_AT + _SCRATCH + 1


@device
def size_numbers(memory: Any) -> Any:
    """The head of the memory: `Sizes`, then the starts of the arrays, then the length of `Scratch`."""
    return reinterpret(carve(memory, 0, (_HEAD,)), np.int64)


@device
def open_constants(memory: Any, z: Any) -> Constants:
    """The arrays of `Constants` in the memory with the head `z`."""
    at = carve(z, _SIZES, (_CONSTANTS,))
    return Constants(
        carve(memory, at[0], (z[7],)),
        carve(memory, at[1], (z[2] - 1, 3)),
        carve(memory, at[2], (z[2], 3)),
        carve(memory, at[3], (z[8],)),
        carve(memory, at[4], (z[9], REFERENCE_ROW)),
        carve(memory, at[5], (TURNING,)),
    )


@device
def open_state(memory: Any, z: Any) -> State:
    """The arrays of `State` in the memory with the head `z`."""
    at = carve(z, _STATE_AT, (_STATE,))
    T, V, R, S = z[1], z[2], z[15], z[16]
    return State(
        carve(memory, at[0], (T, V, R * LANES)),
        carve(memory, at[1], (T, V, z[3], MEASURED_ROWS * LANES)),
        carve(memory, at[2], (T, V - 1, S * LANES)),
        carve(memory, at[3], (z[0], z[4], 3)),
        carve(memory, at[4], (T, 3 * LANES)),
        carve(memory, at[5], (z[5], z[6])),
        carve(
            reinterpret(carve(memory, at[6], (_COUNTERS * T * LANES,)), np.int64),
            0,
            (_COUNTERS, T * LANES),
        ),
        reinterpret(carve(memory, at[7], (T * LANES,)), np.uint64),
        reinterpret(carve(memory, at[8], (T * LANES,)), np.uint64),
    )


def _crowd_length(m: int, K: int) -> int:
    rows = SEEKER_ROWS + MET_ROWS + 2 * max(K, 2)
    return 2 * m + 1 + QUEUE_ROWS * (m + 2 * MARGIN) + rows * BLOCK


@device
def _open_crowd(room: Any, at: int, m: int, K: int) -> Crowd:
    queue, places = at + 2 * m + 1, m + 2 * MARGIN
    a = queue + QUEUE_ROWS * places
    b = a + SEEKER_ROWS * BLOCK
    ranks = max(K, 2)
    return Crowd(
        reinterpret(carve(room, at, (m,)), np.int64),
        reinterpret(carve(room, at + m, (m + 1,)), np.int64),
        carve(room, queue, (QUEUE_ROWS, places)),
        carve(room, a, ((SEEKER_ROWS + 2 * ranks) * BLOCK,)),
        carve(room, b + 2 * ranks * BLOCK, (MET_ROWS * BLOCK,)),
        carve(room, b, (ranks, 2 * BLOCK)),
    )


@device
def open_scratch(room: Any, state: State, z: Any) -> Scratch:
    """`Scratch` in a flat array of `scratch`; measurements that are not late are used in place."""
    at = carve(z, _SCRATCH_AT, (_SCRATCH + 1,))
    T, V, K, L = z[1], z[2], z[12] + 1, LANES
    seen = carve(room, at[15], (1, V, MEASURED_ROWS * L))
    if z[3] == 0:
        seen = carve(state.vehicles, 0, (T, V, z[15] * L))
    elif z[3] == 1:
        seen = carve(state.samples, 0, (T, V, MEASURED_ROWS * L))
    return Scratch(
        carve(room, at[0], (L,)),
        carve(room, at[1], (L,)),
        carve(room, at[2], (L,)),
        carve(room, at[3], (2 * L,)),
        carve(room, at[4], (3 * L,)),
        carve(room, at[5], (2 * L,)),
        carve(room, at[6], (2 * L,)),
        carve(room, at[7], (REFERENCE_ROW * L,)),
        carve(room, at[8], (REFERENCE_ROW * L,)),
        carve(room, at[9], (3 * L,)),
        reinterpret(carve(room, at[10], (L,)), np.uint64),
        reinterpret(carve(room, at[11], (L,)), np.int64),
        reinterpret(carve(room, at[12], (L // 8,)), np.bool_),
        reinterpret(carve(room, at[13], (2 * L,)), np.float32),
        reinterpret(carve(room, at[14], (8 * L,)), np.float32),
        seen,
        carve(room, at[16], (V - 1, 4 * L)),
        carve(room, at[17], (V, 4 * L)),
        carve(room, at[18], (V, 4 * L)),
        carve(room, at[19], (V - 1, _OUTCOME * L)),
        carve(room, at[20], (K, 2 * L)),
        carve(room, at[21], (V - 1, (K - 1) * L)),
        _open_crowd(room, at[22], V, K - 1),
        carve(room, at[23], (SIGHT * V * L,)),
        carve(room, at[24], (SIGHT * L,)),
        reinterpret(carve(room, at[25], (z[10] * L // 2,)), np.float32),
        reinterpret(carve(room, at[26], (z[10] * min(V - 1, BATCH) * L // 2,)), np.float32),
        carve(room, at[27], (len(OUTPUTS) * min(V - 1, BATCH) * L,)),
        carve(room, at[28], (at[29] - at[28],)),
    )


# -- loads and stores ---------------------------------------------------------------------------


@device
def vehicle(state: State, w: int, i: int) -> Any:
    """The numbers of vehicle `i` of world `w`."""
    return state.vehicles[w // LANES, i, w % LANES :: LANES]


@device
def ring(state: State, w: int, i: int) -> Any:
    """The measurements of vehicle `i` of world `w`, `(D+1, 16)`."""
    return state.samples[w // LANES, i, :, w % LANES :: LANES]


@device
def follower(state: State, w: int, i: int) -> Any:
    """The numbers of follower `i` of world `w`."""
    return state.followers[w // LANES, i, w % LANES :: LANES]


@device
def begin_of(state: State, w: int) -> Vector:
    """The leader's first reference point in world `w`."""
    return load(state.begins[w // LANES, w % LANES :: LANES], 0)


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
def load_turning(x: Any) -> Turning:
    """The inverse of `flatten` for a `Turning`."""
    return Turning(load(x, 0), load(x, 3), x[6], x[7], x[8])


@device
def load_body(x: Any) -> Body:
    m = load_sample(x)
    return Body(m.p, m.v, m.q, m.w)


@device
def load_gust(x: Any) -> Vector:
    """The acceleration by a gust of a vehicle: zero where there are none."""
    return load(x, GUST) if len(x) > GUST else (0.0, 0.0, 0.0)


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
def counter(state: State, which: int, t: int) -> Any:
    """One of the counters of all worlds of tile `t`."""
    return carve(state.counters, which * state.counters.shape[1] + t * LANES, (LANES,))


@device
def oldest(state: State, w: int, clock: Clock) -> int:
    """Where the oldest of the last samples of world `w` lies in a ring."""
    taken = state.counters[TICK, w] * clock.substeps // clock.sample_every
    return int((taken + 1) % state.samples.shape[2])


@device
def latest(state: State, w: int, i: int, clock: Clock) -> Measured:
    """The measurement of vehicle `i` that has arrived: the state itself, or the oldest in its ring."""
    if state.samples.shape[2] == 0:
        return load_sample(vehicle(state, w, i))
    return load_sample(ring(state, w, i)[oldest(state, w, clock)])


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
    """An array `(T, ..., rows L)` of tiles as `(worlds, ..., rows)`, a copy."""
    split = tiles.reshape(*tiles.shape[:-1], tiles.shape[-1] // LANES, LANES)
    lanes = np.moveaxis(split, -1, 1).reshape(len(tiles) * LANES, *split.shape[1:-1])
    return lanes[:worlds].copy()
