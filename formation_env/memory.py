"""The memory behind `Simulation`: which number lies where, and how it is loaded and stored.

With `looking` and `kernels` one layer; only these and `simulation` know the layout.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device
from formation_env.quadrotor import Airframe, Body
from formation_env.rng import philox
from formation_env.sensors import Measured, Noise
from formation_env.so3 import Vector
from formation_env.task import Limits, Rewards
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
    final_observations: NDArray[np.float32]  # as observations, empty unless asked for
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


def results(config: FormationConfig, worlds: int, final: bool) -> Results:
    """Fresh arrays for one call; reward terms are zero for worlds that are only looked at."""
    n, size = config.followers, config.layout.size
    spare = worlds if final else 0
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
def latest(ring: Any, count: int) -> Measured:
    """The measurement that has arrived: the oldest in the ring, `D` samples before number `count`."""
    return load_sample(ring[(count + 1) % len(ring)])


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
