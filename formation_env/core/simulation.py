"""Many worlds: threads, reset, seeding, saving.

Every face steps worlds through the one compiled kernel `advance`, and the threads of a `threads.Team` are in
that same machine code, on tiles of worlds that they take one by one. A world's numbers depend on its
key, its actions and nothing else, so they are bit for bit those of any other number of worlds or threads.
"""

from __future__ import annotations

import os
from functools import partial
from typing import Any, TypeVar, final

import numpy as np
from gymnasium.utils import seeding
from numba import config as numba_config
from numpy.typing import NDArray

from formation_env.config import FormationConfig
from formation_env.core import arrays, kernels
from formation_env.core.arrays import Counters, by_world, rows
from formation_env.core.exclusive import Exclusive
from formation_env.core.results import Results, Shapes
from formation_env.core.snapshots import Snapshot as Snapshot  # as `simulation.Snapshot`
from formation_env.core.snapshots import check_snapshot
from formation_env.core.threads import Team, cores
from formation_env.memory.records import LANES, size, slices
from formation_env.memory.store import Floats
from formation_env.paths.course import Course, lay_all
from formation_env.paths.references import TrajectoryPoint
from formation_env.paths.trajectory import sample
from formation_env.physics.sensors import Measured
from formation_env.task import Layout, Outcome
from formation_env.validation.checks import array, integer, require

# Each thread has at least about so many. A worker that has to be woken pays from 384 vehicles on, and one
# that still looks out from half of that.
_VEHICLES_PER_THREAD = 512

_SINGLE = np.dtype(np.float32)

A = TypeVar("A", bound=NDArray[Any])

# Of longer episodes the leader's reference is evaluated in every tick instead of tabulated, 128 bytes each.
TABULATED = 2**15  # ticks, 11 minutes at 50 Hz


@final
class Simulation:
    """`num_worlds` independent worlds of one configuration.

    Rows of `actions` are float32 `(num_worlds, followers, action_size)`; results are fresh arrays, and what
    the properties return are read-only copies. `threads` is how many may work on one call, and `max_steps`
    truncates earlier than the configured duration. Raises `ValueError` for a non-finite action, naming
    world and follower, before anything changes, and for impossible arguments.

    One thread at a time: a call that comes while another thread's is at work raises `RuntimeError`.
    """

    def __init__(
        self,
        config: FormationConfig,
        num_worlds: int = 1,
        threads: int = 1,
        max_steps: int | None = None,
    ) -> None:
        require(isinstance(config, FormationConfig), "config", config, "a FormationConfig")
        num_worlds, threads = integer("num_worlds", num_worlds, 1), integer("threads", threads, 1)
        self._config, self._num_worlds = config, num_worlds
        self._max_steps = self._limited(config.max_steps if max_steps is None else max_steps)
        self._asked = min(threads, num_worlds)
        self._shape = (num_worlds, config.followers, config.action_size)
        self._tiles = arrays.tiles(num_worlds)
        # A second thread has to have enough to do; below that it would cost more than it saves.
        work = 1 + num_worlds * (config.followers + 1) // _VEHICLES_PER_THREAD
        self._threads = min(self._asked, self._tiles, work, cores())
        if numba_config.DISABLE_JIT:
            self._threads = 1  # Python has no atomics
        self._results = Shapes(config, num_worlds).results
        self._memory = arrays.allocate(config, num_worlds, self._max_steps, _references(config))
        self._open()
        self._rooms = [arrays.room(self._memory) for _ in range(self._threads)]
        self._all_worlds = np.ones(num_worlds, dtype=np.bool_)
        self._team: Team | None = None
        self._begun = False
        self._alone = Exclusive()

    # -- what it is: nothing of it can be assigned -----------------------------------------------------

    @property
    def config(self) -> FormationConfig:
        """The configuration of all worlds."""
        return self._config

    @property
    def num_worlds(self) -> int:
        """How many worlds."""
        return self._num_worlds

    @property
    def threads(self) -> int:
        """How many threads were allowed, at most one for each world."""
        return self._asked

    @property
    def max_steps(self) -> int:
        """Control ticks after which an episode is truncated; see `limit`."""
        return self._max_steps

    @property
    def layout(self) -> Layout:
        """Names of the observation's entries."""
        return self._config.layout

    # -- stepping ---------------------------------------------------------------------------------

    def seed(self, world: int, key: int) -> None:
        """Give a world a new random stream; its next reset starts that stream's first episode.

        `key` has 64 bits: `seeded_key(seed)` makes one of a seed.
        """
        world = integer("world", world, 0, self._num_worlds - 1)
        key = integer("key", key, 0, 2**64 - 1)
        with self._alone:
            self._state.keys.reshape(-1)[world] = key
            self._counters["episode"][self._place(world)] = -1
            self._begun = False

    def reset(self, mask: NDArray[np.bool_] | None = None) -> Results:
        """Start a new episode in the worlds of `mask` (all by default)."""
        return self._run(kernels.RESET, self._no_actions(), mask)

    def step(
        self, actions: NDArray[np.float32], mode: int = kernels.STEP, mask: Any = None
    ) -> Results:
        """One control tick in the worlds of `mask`. `mode` says what happens to ended episodes.

        Actions of worlds that are reset instead are not looked at.
        """
        if actions.shape != self._shape or actions.dtype is not _SINGLE:
            actions = self._rows(actions)
        if not actions.flags.carray:
            # Another layout or a read-only array would be another type, compiled for anew.
            actions = np.array(actions, order="C")
        return self._run(mode, actions, mask)

    def look(self) -> Results:
        """What every follower sees now; changes nothing."""
        no_worlds = np.zeros(self._num_worlds, dtype=np.bool_)
        return self._run(kernels.RESET, self._no_actions(), no_worlds)

    def _no_actions(self) -> NDArray[np.float32]:
        return np.zeros((1, self._config.followers, self._config.action_size), dtype=np.float32)

    def _rows(self, actions: Any) -> NDArray[np.float32]:
        found = f"{actions.dtype} {actions.shape}"
        alike = actions.dtype == _SINGLE and actions.shape == self._shape
        require(alike, "actions", found, f"float32 {self._shape}: (worlds, followers, entries)")
        return np.array(actions, dtype=_SINGLE)

    def _mask(self, mask: Any) -> NDArray[np.bool_]:
        good = isinstance(mask, np.ndarray) and mask.dtype == np.bool_
        require(
            good and mask.shape == (self._num_worlds,), "mask", mask, f"{self._num_worlds} booleans"
        )
        return np.array(mask)

    def _run(self, mode: int, actions: NDArray[np.float32], mask: Any) -> Results:
        mask = self._all_worlds if mask is None else self._mask(mask)
        alone = self._alone
        if not alone.acquire(False):
            alone.take_over()
        try:
            results = self._results(mode == kernels.STEP_AND_RESET)
            advance: Any = kernels.advance
            desk, bad = 0, -1
            if self._threads > 1:
                bad = kernels.first_bad_action(mode, actions, self._memory)
                if bad < 0:
                    # Rung before there is work: they wake while this thread is on its way into the kernel.
                    desk = self._gathered().wake()
            if bad < 0:
                bad = advance(desk, 0, mode, actions, mask, self._memory, self._rooms[0], *results)
        finally:
            alone.release()
        if bad >= 0:
            raise self._not_finite(actions, bad)
        return results

    def _not_finite(self, actions: NDArray[np.float32], bad: int) -> ValueError:
        world, follower = divmod(bad, self._config.followers)
        where = f" of world {world}" if self._num_worlds > 1 else ""
        return ValueError(
            f"action of follower_{follower}{where} = {actions[world, follower].tolist()}: "
            "expected finite numbers"
        )

    def _gathered(self) -> Team:
        """The threads, started when first needed."""
        # Threads do not survive a fork: they are not in the child.
        if self._team is None or self._team.owner != os.getpid():
            config = self._config
            actions = np.zeros((0, config.followers, config.action_size), dtype=np.float32)
            no_worlds, nothing = np.zeros(0, dtype=np.bool_), Shapes(config, 0).results(True)
            serve: Any = kernels.advance
            arguments = [
                (kernels.STEP, actions, no_worlds, self._memory, room, *nothing)
                for room in self._rooms[1:]
            ]
            servants = [partial(_serve, serve, own) for own in arguments]
            self._team = Team(self._tiles, servants)
        return self._team

    def close(self) -> None:
        """Stop the threads, if any were started."""
        with self._alone:
            if self._team is not None:
                self._team.close()
            self._team = None

    def limit(self, max_steps: int) -> None:
        """Truncate episodes after so many ticks, or at the configured duration if that is earlier."""
        with self._alone:
            self._max_steps = self._limited(max_steps)
            arrays.MEMORY.set_size(self._memory, "max_steps", self._max_steps)

    def _limited(self, max_steps: int) -> int:
        return min(integer("max_steps", max_steps, 1), self._config.max_steps)

    # -- looking in: all arrays are read-only -------------------------------------------------------

    def _open(self) -> None:
        """Views of the memory."""
        self._state = arrays.state_of(self._memory)
        self._counters = rows(self._state.counters, Counters)

    def _place(self, world: int) -> tuple[int, int, int]:
        """Where a counter of one world lies."""
        return world // LANES, 0, world % LANES

    def _counter(self, name: str) -> NDArray[np.int64]:
        """One of the counters of all worlds, a copy."""
        row: NDArray[np.int64] = self._counters[name].reshape(-1)[: self._num_worlds]
        return row

    def _vehicles(self, name: str) -> Floats:
        """One of the numbers of the true motion of all vehicles, `(worlds, vehicles, ...)`."""
        part = rows(self._state.vehicles, Measured)[name]
        return _fixed(by_world(part.reshape(*part.shape[:-2], -1), self._num_worlds))

    @property
    def positions(self) -> Floats:
        """True positions, `(num_worlds, 1 + followers, 3)`, m, inertial; the leader first."""
        return self._vehicles("p")

    @property
    def leaders(self) -> Floats:
        """True positions of the leaders alone, `(num_worlds, 3)`, m, inertial."""
        p = rows(self._state.vehicles[:, 0], Measured)["p"]
        return _fixed(np.array(p.transpose(0, 2, 1).reshape(-1, 3)[: self._num_worlds]))

    @property
    def velocities(self) -> Floats:
        """True velocities, same shape, m/s, inertial."""
        return self._vehicles("v")

    @property
    def attitudes(self) -> Floats:
        """True attitudes, `(num_worlds, 1 + followers, 4)`, quaternions (w, x, y, z)."""
        return self._vehicles("q")

    @property
    def angular_velocities(self) -> Floats:
        """True angular velocities, `(num_worlds, 1 + followers, 3)`, rad/s, body."""
        return self._vehicles("w")

    @property
    def slots(self) -> Floats:
        """Where the followers should be, `(num_worlds, followers, 3)`, m, inertial."""
        return _fixed(self.look().outputs)[..., slices(Outcome)["slot"]]

    @property
    def started(self) -> NDArray[Any]:
        """Whether the trigger (40) has fired, per world."""
        return _fixed(np.not_equal(self._counter("started"), 0))

    @property
    def seeded(self) -> NDArray[np.bool_]:
        """Whether an episode has been started since the last `seed`, per world."""
        return _fixed(np.greater_equal(self._counter("episode"), 0))

    @property
    def begun(self) -> bool:
        """Whether every world is `seeded`: asked in each step, so the answer yes is kept."""
        self._begun = self._begun or bool(self.seeded.all())
        return self._begun

    def ended(self, world: int) -> bool:
        """Whether the episode of one world has ended, or none has begun."""
        return bool(self._counters["over"][world // LANES, 0, world % LANES])

    @property
    def over(self) -> NDArray[Any]:
        """Whether the episode has ended, per world."""
        return _fixed(np.not_equal(self._counter("over"), 0))

    @property
    def time(self) -> NDArray[Any]:
        """Time since reset, s, per world."""
        return _fixed(self._counter("tick") * self._config.control_period)

    @property
    def clock(self) -> NDArray[Any]:
        """Time since the trigger (40), s, per world: the argument of the leader's reference."""
        return _fixed(self._counter("clock") * self._config.control_period)

    def reference(self, times: Floats, world: int = 0) -> Floats:
        """The leader's reference positions at `times` since the trigger, `(N, 3)`, m, inertial."""
        world = integer("world", world, 0, self._num_worlds - 1)
        tables = self._state.tables
        table = tables[world if len(tables) > 1 else 0]
        place = self._place(world)
        first = self._counters["first"][place] * self._config.control_period
        times = array("times", times, (None,)) + first
        points = sample(self._config.trajectory.kind, table, times)[:, :3]
        tile, lane = divmod(world, LANES)
        turn, side = (rows(self._state.courses, Course)[n][tile, :, lane] for n in Course._fields)
        return lay_all(Course(complex(*turn), *side), points)

    # -- saving -----------------------------------------------------------------------------------

    def get_state(self) -> Snapshot:
        """Everything needed to continue identically, as copies."""
        with self._alone:
            saved = {name: own.copy() for name, own in self._state._asdict().items()}
        return Snapshot(self._config, saved)

    def set_state(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot of the same configuration and number of worlds.

        Raises `ValueError` if it comes from another or holds what no flight leads to: counters out of range,
        numbers that are not finite or attitudes that are none in an episode that goes on. This simulation
        is then as it was.
        """
        with self._alone:
            check_snapshot(snapshot, self._config, self._state, self._num_worlds)
            for name, own in self._state._asdict().items():
                own[...] = snapshot.state[name]
            self._begun = False

    def __getstate__(self) -> dict[str, Any]:
        # The state's arrays are views, which a copy would cut off from the memory they show.
        with self._alone:
            numbers = self._memory.copy()
        left = {"_team": None, "_state": None, "_counters": None, "_memory": numbers}
        return {**self.__dict__, **left}

    def __setstate__(self, saved: dict[str, Any]) -> None:
        self.__dict__.update(saved)
        self._open()


def _references(config: FormationConfig) -> Floats:
    """The leader's reference tick by tick; empty if it is drawn anew each episode, or the episode is long."""
    path, steps = config.trajectory, config.max_steps + config.phases
    if path.random is not None or steps > TABULATED:
        return np.zeros((0, arrays.LINE))
    table, points = np.zeros((steps + 1, arrays.LINE)), size(TrajectoryPoint)
    times: Floats = np.arange(steps + 1, dtype=np.float64) * float(config.control_period)
    table[:, :points] = sample(path.kind, path.table, times)
    return table


def _fixed(values: A) -> A:
    """The array, read-only: writing into a copy would change nothing."""
    values.setflags(write=False)
    return values


def _serve(advance: Any, arguments: tuple[Any, ...], desk: int, member: int) -> None:
    """One stay of a worker in the kernel; `arguments` hold nothing of the `Simulation` but memory."""
    advance(desk, member, *arguments)


def stream_key(generator: np.random.Generator) -> int:
    """A 64-bit key for one world's random stream, drawn from `np_random`."""
    return int(generator.integers(0, 2**64, dtype=np.uint64))


def seeded_key(seed: int | None) -> int:
    """The key that `reset(seed=seed)` gives a single environment."""
    return stream_key(seeding.np_random(seed)[0])
