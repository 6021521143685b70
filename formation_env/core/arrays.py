"""Every array behind a `Simulation`: what is constant, what changes, what is scratch, what is returned.

World `w` is lane `w % LANES` of tile `w // LANES`. A statement declares an array, by its shape and, where
its rows are those of a record, by the record; `store` says where it lies, `records` at which row a number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device, plain, step
from formation_env.core.nearest import BLOCK, MARGIN, MEETING_ROWS, QUEUE_ROWS, SEEKER_ROWS
from formation_env.laws.levels import LEVELS, follower_layout
from formation_env.laws.world import Action, World, every_tick
from formation_env.maths.rng import philox
from formation_env.memory.records import LANES, flatten, line_loader, part_loader, size, slices
from formation_env.memory.shuffles import carve
from formation_env.memory.store import Floats, Store, size_reader
from formation_env.paths.course import Course
from formation_env.physics.disturbances import DISTURBANCES, States
from formation_env.physics.quadrotor import Wrench
from formation_env.physics.sensors import Measured, silent
from formation_env.physics.turning import Turning, turning
from formation_env.task import Limits, Outcome, Rewards
from formation_env.trajectories import TrajectoryPoint

if TYPE_CHECKING:
    from formation_env.config import FormationConfig

# How measurements come: exact and at once, noisy after every tick, or when they are due and maybe late.
EXACT, EVERY_TICK, WHEN_DUE = range(3)

# Numbers of a line of the leader's reference: p, v, a, j, s and one that makes it a whole vector.
LINE = size(TrajectoryPoint) + 1
HELD = 8  # most followers whose results are put together before they are written
SIGHT = 8  # numbers of a vehicle in `points`: p, v and two that make it a whole vector


class Sizes(NamedTuple):
    """The whole numbers that say how long everything is, and a few more constants."""

    worlds: int
    tiles: int
    vehicles: int  # n + 1
    delays: int  # samples in a ring, D + 1, or 0 where the state is what is measured
    window: int  # N
    tables: int  # W or 1
    table: int  # numbers in one
    drawing: int
    references: int  # lines
    entries: int
    family: int  # kind of the trajectory
    neighbours: int
    action_size: int
    max_steps: int
    deadline: int  # ticks within which the trigger (40) has to fire
    level: int
    vehicle_rows: int
    follower_rows: int
    measuring: int  # EXACT, EVERY_TICK or WHEN_DUE


class Counters(NamedTuple):
    """What is counted in a world."""

    tick: int  # ticks since reset
    started: int  # whether the trigger (40) has fired
    clock: int  # ticks since then
    episode: int  # its number, -1 before the first
    over: int  # whether the episode has ended, or none has begun
    first: int  # tick of the leader's path that the episode began with


class Touch(NamedTuple):
    """How a vehicle met the floor during a tick."""

    speed: float  # m/s, of the hardest touch-down; infinite if its state can no longer be computed
    uprightness: float  # r3 . k at it
    touching: bool  # whether it stands on the floor now


class Squares(NamedTuple):
    """Squared distances of a follower, m^2."""

    error: float  # from its slot
    separation: float  # from the nearest other vehicle


class Candidate(NamedTuple):
    """A neighbour of a follower."""

    square: float  # m^2, distance
    number: float  # which follower; -1 for none


class Tally(NamedTuple):
    """What the followers of a world have in common after a tick."""

    reward: float  # the sum
    failed: float  # whether one has: 0 or the largest index into FAILURES
    paid: bool  # whether one has by itself


class Verdict(NamedTuple):
    """What a tick was for a world."""

    reward: float  # the followers' mean
    terminated: bool
    truncated: bool


# -- the memory of a simulation: constants, then what changes ----------------------------------------------

MEMORY = Store(Sizes)
_field = MEMORY.field

world = _field("world", lambda z: (size(World),))
rewards = _field("rewards", lambda z: (size(Rewards),))
limits = _field("limits", lambda z: (size(Limits),))
bound_of_turning = _field("bound_of_turning", lambda z: (size(Turning),))
offset = _field("offsets", lambda z: (z.vehicles - 1, 3))  # d, m
# m, where vehicles stand on the ground, leader first: inertial, or where the path's course is drawn in the
# frame of its first point and direction
start = _field("starts", lambda z: (z.vehicles, 3))
drawing = _field("drawing", lambda z: (z.drawing,))  # bounds of a random trajectory
references = _field("references", lambda z: (z.references * LINE,))  # the leader's, tick by tick
CONSTANTS = tuple(MEMORY.fields)

# Measured, exact or as of the last sample, then the state of what disturbs the vehicle, if anything does.
vehicle = _field("vehicles", lambda z: (z.tiles, z.vehicles, z.vehicle_rows * LANES))
sample = _field("samples", lambda z: (z.tiles, z.vehicles, z.delays, size(Measured) * LANES))
follower = _field("followers", lambda z: (z.tiles, z.vehicles - 1, z.follower_rows * LANES))
# m/s, the leader's last measured velocities
speed = _field("speeds", lambda z: (z.worlds, z.window, 3))
begin = _field("begins", lambda z: (z.tiles, 3 * LANES))  # m, the leader's first reference point
course = _field("courses", lambda z: (z.tiles, size(Course) * LANES))
table = _field("tables", lambda z: (z.tables, z.table))  # of the leader's trajectory
counters = _field("counters", lambda z: (z.tiles, size(Counters) * LANES), np.int64)
key = _field("keys", lambda z: (z.tiles, LANES), np.uint64)  # of the random stream
episode_key = _field("episode_keys", lambda z: (z.tiles, LANES), np.uint64)

# -- the room in which one thread works on a tile -----------------------------------------------------------

ROOM = Store(Sizes)
_field = ROOM.field

call = _field("call", lambda z: (8,), np.int64)  # mode and addresses: see `calls`
named = _field("named", lambda z: (LANES,), np.bool_)  # worlds meant, of a tile that is not full
active = _field("active", lambda z: (LANES,))  # 1 for worlds that step, else 0
moving = _field("moving", lambda z: (LANES,))  # 1 for those whose trigger had fired before the tick
started = _field("started", lambda z: (LANES,))  # 1 for those whose trigger has fired
left = _field("left", lambda z: (LANES,))  # ticks within which it has to, 0 where it has
tally = _field("tally", lambda z: (size(Tally) * LANES,))
verdict = _field("verdict", lambda z: (size(Verdict) * LANES,))
# m/s, the leader's in the plane, true and as measured
velocity_before = _field("velocity_before", lambda z: (2 * LANES,))
measured_before = _field("measured_before", lambda z: (2 * LANES,))
reference = _field("reference", lambda z: (LINE * LANES,))  # the leader's, in this tick
lines = _field("lines", lambda z: (LINE * LANES,))  # numbers of each world, to be turned into rows
counts = _field("counts", lambda z: (LANES,), np.int64)  # numbers of the samples to be taken
line_starts = _field("line_starts", lambda z: (LANES,), np.int64)  # where each world's line begins
draws = _field("draws", lambda z: (size(Measured) * LANES,), np.float32)  # normal numbers
action = _field("actions", lambda z: (z.vehicles - 1, size(Action) * LANES))  # as executed
command = _field("commands", lambda z: (z.vehicles, size(Wrench) * LANES))
push = _field(
    "pushes", lambda z: (z.vehicles, 3 * LANES)
)  # m/s^2, of all disturbances in this tick
touch = _field("touches", lambda z: (z.vehicles, size(Touch) * LANES))
outcome = _field("outcomes", lambda z: (z.vehicles - 1, size(Outcome) * LANES))
squares = _field("squares", lambda z: (z.vehicles - 1, size(Squares) * LANES))
received = _field(  # late measurements that have arrived
    "received", lambda z: (z.vehicles if z.delays > 1 else 0, size(Measured) * LANES)
)
observation = _field("observation", lambda z: (z.entries * LANES,), np.float32)
# Of all followers of a tile, where results go past the cache: see `calls.streamed`.
held_observations = _field(
    "held_observations", lambda z: (z.entries * min(z.vehicles - 1, HELD) * LANES,), np.float32
)
held_outputs = _field(
    "held_outputs", lambda z: (size(Outcome) * min(z.vehicles - 1, HELD) * LANES,)
)
candidate = _field("candidates", lambda z: (z.neighbours + 1, size(Candidate) * LANES))
neighbour = _field("neighbours", lambda z: (z.vehicles - 1, z.neighbours, LANES))  # numbers, or -1
other = _field("other", lambda z: (SIGHT * LANES,))  # one neighbour in each world
points = _field("points", lambda z: (SIGHT * z.vehicles * LANES,))  # all of them, world by world
saved = _field(  # vehicles and measurements of a tile some of whose worlds do not step
    "saved",
    lambda z: (z.vehicles, (z.vehicle_rows + (size(Measured) if z.delays == 1 else 0)) * LANES),
)
# Of the search among many vehicles: see `nearest`.
cells = _field("cells", lambda z: (z.vehicles,), np.int64)
ends = _field("ends", lambda z: (z.vehicles + 1,), np.int64)
queue = _field("queue", lambda z: (QUEUE_ROWS * (z.vehicles + 2 * MARGIN),))
seekers = _field("seekers", lambda z: ((SEEKER_ROWS + 2 * max(z.neighbours, 2)) * BLOCK,))
meeting = _field("meeting", lambda z: (MEETING_ROWS * BLOCK,))

# -- reading them --------------------------------------------------------------------------------------------

worlds, tile_count, vehicles, delays = (
    size_reader(Sizes, name) for name in ("worlds", "tiles", "vehicles", "delays")
)
table_count, drawing_size, reference_count, entries = (
    size_reader(Sizes, name) for name in ("tables", "drawing", "references", "entries")
)
family, neighbours, action_size, max_steps, level = (
    size_reader(Sizes, name)
    for name in ("family", "neighbours", "action_size", "max_steps", "level")
)
window, vehicle_rows, follower_rows, measuring, deadline = (
    size_reader(Sizes, name)
    for name in ("window", "vehicle_rows", "follower_rows", "measuring", "deadline")
)
read_world = line_loader(World)
read_clock, read_airframe, read_noise = (
    part_loader(World, name) for name in ("clock", "airframe", "noise")
)
read_trigger, read_courses = part_loader(World, "trigger"), part_loader(World, "courses")
read_leader_actuation, read_follower_actuation = (
    part_loader(World, f"{flown}_actuation") for flown in ("leader", "follower")
)


def _part_line(name: str) -> Any:
    """`line(memory)`: the numbers of a part of the world's constants."""
    where = slices(World)[name]
    first, count = where.start, where.stop - where.start

    @step
    def line(memory: Floats) -> Any:
        return carve(world(memory), first, (count,))

    return line


airframe_line, clock_line, noise_line = (_part_line(n) for n in ("airframe", "clock", "noise"))


@step
def own_table(memory: Floats, w: int) -> Any:
    """The numbers of the leader's trajectory in world `w`."""
    return table(memory, w if table_count(memory) > 1 else 0)


_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)


@device
def key_of_episode(stream: Any, episode: int) -> Any:
    """The key of one episode of a world's stream: four Philox words of its number, two of them kept."""
    zero = np.uint64(0)
    low, high, _, _ = philox(np.uint64(episode), zero, zero, zero, stream & _LOW, stream >> _HALF)
    return (high << _HALF) | low


# -- Python's side -------------------------------------------------------------------------------------------


class State(NamedTuple):
    """Views of all that changes: `W` worlds in `T` tiles of `L` lanes; `n` followers.

    `D` samples of delay, `N` averaged. Where measurements are exact and in time they are the state: then
    there are no samples.
    """

    vehicles: Floats  # (T, n+1, R L): `Measured`, then `disturbances.States` if anything disturbs
    samples: Floats  # (T, n+1, D+1 or 0, 16 L): ring of `Measured`
    followers: Floats  # (T, n, S L): `levels.follower_layout`
    speeds: Floats  # (W, N, 3): ring of the leader's measured velocities
    begins: Floats  # (T, 3 L): the leader's first reference point
    courses: Floats  # (T, 3 L): `Course`, how it lies
    tables: Floats  # (W or 1, numbers): the leader's trajectory
    counters: NDArray[np.int64]  # (T, 6 L): `Counters`
    keys: NDArray[np.uint64]  # (T, L): of the streams
    episode_keys: NDArray[np.uint64]  # (T, L): of the episodes


def tiles(worlds: int) -> int:
    """How many tiles hold so many worlds."""
    return -(-worlds // LANES)


def allocate(config: FormationConfig, worlds: int, max_steps: int, table_of: Floats) -> Floats:
    """Memory for `worlds` worlds that have not been reset yet.

    `table_of` are the leader's references tick by tick, `(ticks, LINE)`, or empty.
    """
    constant, path = config.world, config.trajectory
    bounds = np.zeros(0) if path.random is None else np.array(path.random, dtype=np.float64)
    clock, numbers = constant.clock, np.array(flatten(constant))
    at_once = plain(every_tick)(clock)
    exact = at_once and plain(silent)(constant.noise)
    state = LEVELS[constant.level].state
    pushing = constant.disturbances
    disturbed = any(plain(d.acts)(getattr(pushing, d.name)) for d in DISTURBANCES)
    sizes = Sizes(
        worlds=worlds,
        tiles=tiles(worlds),
        vehicles=config.followers + 1,
        delays=0 if exact else clock.delay + 1,
        window=clock.window,
        tables=1 if path.random is None else worlds,
        table=len(path.table),
        drawing=len(bounds),
        references=len(table_of),
        entries=config.layout.size,
        family=path.kind,
        neighbours=config.neighbours,
        action_size=config.action_size,
        max_steps=max_steps,
        deadline=config.deadline_steps,
        level=constant.level,
        vehicle_rows=size(Measured) + (size(States) if disturbed else 0),
        follower_rows=size(follower_layout(state)),
        measuring=EXACT if exact else EVERY_TICK if at_once else WHEN_DUE,
    )
    memory = MEMORY.allocate(sizes)
    views = MEMORY.views(memory)
    fixed = (
        numbers,
        flatten(config.reward),
        flatten(config.limits),
        flatten(turning(constant.airframe, clock.period, clock.substeps)),
        config.offsets,
        config.ground_places(),
        bounds,
        table_of.reshape(-1),
    )
    for name, values in zip(CONSTANTS, fixed, strict=True):
        views[name][...] = np.asarray(values)
    views["tables"][:] = path.table
    count = rows(views["counters"], Counters)
    count["episode"][...] = -1
    count["over"][...] = 1
    # No start is waited for in the lanes without a world.
    count["started"][:, 0] = np.arange(sizes.tiles * LANES).reshape(-1, LANES) >= worlds
    # These lanes are computed all the same: with a path as it is given, and with an attitude, so that
    # nothing divides by 0.
    laid = rows(views["courses"], Course)
    laid["turn"][:, 0] = laid["side"][...] = 1.0
    for name in ("vehicles", "samples"):
        rows(views[name], Measured)["q"][..., 0, :] = 1.0
    return memory


def rows(tiles: NDArray[Any], layout: Any) -> dict[str, NDArray[Any]]:
    """Views of the rows of an array of tiles `(T, ..., R L)` by the names of a record's fields.

    Each `(T, ..., numbers, L)`, of a single number `(T, ..., 1, L)`.
    """

    split = tiles.reshape(*tiles.shape[:-1], tiles.shape[-1] // LANES, LANES)
    return {name: split[..., where, :] for name, where in slices(layout).items()}


def room(memory: Floats) -> Floats:
    """Room for one thread to work in."""
    return ROOM.allocate(MEMORY.sizes(memory))


def state_of(memory: Floats) -> State:
    """Views of what changes."""
    views = MEMORY.views(memory)
    return State(*(views[name] for name in State._fields))


def by_world(tiles: NDArray[Any], worlds: int) -> NDArray[Any]:
    """An array `(T, ..., rows L)` of tiles as `(worlds, ..., rows)`, a copy."""
    split = tiles.reshape(*tiles.shape[:-1], tiles.shape[-1] // LANES, LANES)
    lanes = np.moveaxis(split, -1, 1).reshape(len(tiles) * LANES, *split.shape[1:-1])
    return lanes[:worlds].copy()
