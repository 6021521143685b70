"""Many worlds: threads, reset, seeding, saving.

With `kernels` and what it is made of, `lanes`, `memory` and `blocks`, it is the layer that knows
the layout.

Every face steps worlds through the one compiled kernel `advance`, and the threads of a `team` are in
that same machine code, on tiles of worlds that they take one by one. A world's numbers depend on its
key, its actions and nothing else, so they are bit for bit those of any other number of worlds or threads.
"""

from __future__ import annotations

import os
from functools import partial
from typing import Any, NamedTuple, final

import numpy as np
from gymnasium.utils import seeding
from numba import config as numba_config
from numpy.typing import NDArray

from formation_env import kernels, memory
from formation_env._jit import plain
from formation_env.blocks import LANES
from formation_env.config import FormationConfig
from formation_env.memory import (
    ATTITUDE,
    CLOCK,
    EPISODE,
    OVER,
    RATE_OF_TURN,
    SLOT,
    STARTED,
    TICK,
    Floats,
    Results,
)
from formation_env.task import Layout
from formation_env.team import Team, cores

# Each thread has at least about so many. A worker that has to be woken pays from 384 vehicles on, and one
# that still looks out from half of that.
_VEHICLES_PER_THREAD = 512


class Snapshot(NamedTuple):
    """The complete state of a simulation and what it is a state of."""

    config: FormationConfig
    state: dict[str, NDArray[Any]]


@final
class Simulation:
    """`num_worlds` independent worlds of one configuration.

    Rows of `actions` are float32 `(num_worlds, followers, action_size)`; results are fresh arrays.
    Raises `ValueError` for a non-finite action, naming world and follower, before anything changes.
    """

    def __init__(
        self,
        config: FormationConfig,
        num_worlds: int = 1,
        threads: int = 1,
        max_steps: int | None = None,
    ) -> None:
        self.config = config
        self.max_steps = config.max_steps if max_steps is None else min(max_steps, config.max_steps)
        self.num_worlds = num_worlds
        self.threads = max(1, min(threads, num_worlds))
        self._tiles = memory.tiles(num_worlds)
        # A second thread has to have enough to do; below that it would cost more than it saves.
        work = 1 + num_worlds * (config.followers + 1) // _VEHICLES_PER_THREAD
        self._threads = min(self.threads, self._tiles, work, cores())
        if numba_config.DISABLE_JIT:
            self._threads = 1  # Python has no atomics
        self._results = memory.Shapes(config, num_worlds).results
        self.layout: Layout = config.layout
        references = np.zeros((0, memory.REFERENCE_ROW))
        if config.trajectory.random is None:
            kind, table = config.trajectory.kind, config.trajectory.table
            period = float(config.control_period)
            references = kernels.reference_table(kind, table, period, config.max_steps)
        self._memory = memory.allocate(config, num_worlds, self.max_steps, references)
        self._state = memory.views(self._memory)[1]
        self._rooms = [memory.scratch(self._memory) for _ in range(self._threads)]
        self._everyone = np.ones(num_worlds, dtype=np.bool_)
        self._team: Team | None = None
        self._begun = False

    # -- stepping ---------------------------------------------------------------------------------

    def seed(self, world: int, key: int) -> None:
        """Give a world a new random stream; its next reset starts that stream's first episode."""
        self._state.keys[world] = key
        self._state.counters[EPISODE, world] = -1
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
        if not actions.flags.carray:
            # Another layout or a read-only array would be another type, compiled for anew.
            actions = np.array(actions, order="C")
        return self._run(mode, actions, mask)

    def look(self) -> Results:
        """What every follower sees now; changes nothing."""
        nobody = np.zeros(self.num_worlds, dtype=np.bool_)
        return self._run(kernels.RESET, self._no_actions(), nobody)

    def _no_actions(self) -> NDArray[np.float32]:
        return np.zeros((1, self.config.followers, self.config.action_size), dtype=np.float32)

    def _run(self, mode: int, actions: NDArray[np.float32], mask: Any) -> Results:
        mask = self._everyone if mask is None else mask
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
        if bad >= 0:
            raise self._not_finite(actions, bad)
        return results

    def _not_finite(self, actions: NDArray[np.float32], bad: int) -> ValueError:
        world, follower = divmod(bad, self.config.followers)
        where = f" of world {world}" if self.num_worlds > 1 else ""
        return ValueError(
            f"action of follower_{follower}{where} = {actions[world, follower].tolist()}: "
            "expected finite numbers"
        )

    def _gathered(self) -> Team:
        """The threads, started when first needed."""
        # Threads do not survive a fork: they are not in the child.
        if self._team is None or self._team.owner != os.getpid():
            config = self.config
            actions = np.zeros((0, config.followers, config.action_size), dtype=np.float32)
            nobody, nothing = np.zeros(0, dtype=np.bool_), memory.Shapes(config, 0).results(True)
            serve: Any = kernels.advance
            arguments = [
                (kernels.STEP, actions, nobody, self._memory, room, *nothing)
                for room in self._rooms[1:]
            ]
            servants = [partial(_serve, serve, own) for own in arguments]
            self._team = Team(self._tiles, servants)
        return self._team

    def close(self) -> None:
        """Stop the threads, if any were started."""
        if self._team is not None:
            self._team.close()
        self._team = None

    def limit(self, max_steps: int) -> None:
        """Truncate episodes after so many ticks, or at the configured duration if that is earlier."""
        self.max_steps = min(max_steps, self.config.max_steps)
        plain(memory.size_numbers)(self._memory)[memory.MAX_STEPS] = self.max_steps

    # -- looking in -------------------------------------------------------------------------------

    def _counter(self, which: int) -> NDArray[np.int64]:
        """One of the counters of all worlds, in place."""
        row: NDArray[np.int64] = self._state.counters[which, : self.num_worlds]
        return row

    @property
    def _vehicles(self) -> Floats:
        return memory.by_world(self._state.vehicles, self.num_worlds)

    @property
    def positions(self) -> Floats:
        """True positions, `(num_worlds, 1 + followers, 3)`, m, inertial; the leader first."""
        return self._vehicles[..., 0:3]

    @property
    def leaders(self) -> Floats:
        """True positions of the leaders alone, `(num_worlds, 3)`, m, inertial."""
        rows = self._state.vehicles[:, 0, : 3 * LANES].reshape(-1, 3, LANES)
        return rows.transpose(0, 2, 1).reshape(-1, 3)[: self.num_worlds]

    @property
    def velocities(self) -> Floats:
        """True velocities, same shape, m/s, inertial."""
        return self._vehicles[..., 3:6]

    @property
    def attitudes(self) -> Floats:
        """True attitudes, `(num_worlds, 1 + followers, 4)`, quaternions (w, x, y, z)."""
        return self._vehicles[..., ATTITUDE : ATTITUDE + 4]

    @property
    def angular_velocities(self) -> Floats:
        """True angular velocities, `(num_worlds, 1 + followers, 3)`, rad/s, body."""
        return self._vehicles[..., RATE_OF_TURN : RATE_OF_TURN + 3]

    @property
    def slots(self) -> Floats:
        """Where the followers should be, `(num_worlds, followers, 3)`, m, inertial."""
        return self.look().outputs[..., SLOT : SLOT + 3]

    @property
    def started(self) -> NDArray[Any]:
        """Whether the trigger (40) has fired, per world."""
        return np.not_equal(self._counter(STARTED), 0)

    @property
    def seeded(self) -> NDArray[np.bool_]:
        """Whether an episode has been started since the last `seed`, per world."""
        return self._counter(EPISODE) >= 0

    @property
    def begun(self) -> bool:
        """Whether every world is `seeded`: asked in each step, so the answer yes is kept."""
        self._begun = self._begun or bool(self.seeded.all())
        return self._begun

    def ended(self, world: int) -> bool:
        """Whether the episode of one world has ended, or none has begun."""
        return bool(self._state.counters[OVER, world])

    @property
    def over(self) -> NDArray[Any]:
        """Whether the episode has ended, per world."""
        return np.not_equal(self._counter(OVER), 0)

    @property
    def time(self) -> NDArray[Any]:
        """Time since reset, s, per world."""
        return self._counter(TICK) * self.config.control_period

    @property
    def clock(self) -> NDArray[Any]:
        """Time since the trigger (40), s, per world: the argument of the leader's reference."""
        return self._counter(CLOCK) * self.config.control_period

    def reference(self, times: Floats, world: int = 0) -> Floats:
        """The leader's reference positions at `times` since the trigger, `(N, 3)`, m, inertial."""
        tables = self._state.tables
        table = tables[world if len(tables) > 1 else 0]
        return kernels.reference_path(self.config.trajectory.kind, table, np.asarray(times))

    # -- saving -----------------------------------------------------------------------------------

    def get_state(self) -> Snapshot:
        """Everything needed to continue identically, as copies."""
        arrays = {name: array.copy() for name, array in self._state._asdict().items()}
        return Snapshot(self.config, arrays)

    def set_state(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot of the same configuration and number of worlds.

        Raises `ValueError` if it comes from another, leaving this simulation as it was.
        """
        if not isinstance(snapshot, Snapshot):
            raise ValueError(
                f"state is a {type(snapshot).__name__}: expected what get_state returned"
            )
        if snapshot.config != self.config:
            raise ValueError("state was saved under another configuration than this environment's")
        own = self._state._asdict()
        for name, array in own.items():
            saved = snapshot.state.get(name)
            if saved is None or saved.shape != array.shape or saved.dtype != array.dtype:
                found = "missing" if saved is None else f"{saved.dtype} {saved.shape}"
                raise ValueError(
                    f"state[{name!r}] is {found}: expected {array.dtype} {array.shape}"
                )
        for name, array in own.items():
            array[...] = snapshot.state[name]
        self._begun = False

    def __getstate__(self) -> dict[str, Any]:
        # The state's arrays are views, which a copy would cut off from the memory they show.
        return {**self.__dict__, "_team": None, "_state": None}

    def __setstate__(self, saved: dict[str, Any]) -> None:
        self.__dict__.update(saved)
        self._state = memory.views(self._memory)[1]


def _serve(advance: Any, arguments: tuple[Any, ...], desk: int, member: int) -> None:
    """One stay of a worker in the kernel; `arguments` hold nothing of the `Simulation` but memory."""
    advance(desk, member, *arguments)


def stream_key(generator: np.random.Generator) -> int:
    """A 64-bit key for one world's random stream, drawn from `np_random`."""
    return int(generator.integers(0, 2**64, dtype=np.uint64))


def seeded_key(seed: int | None) -> int:
    """The key that `reset(seed=seed)` gives a single environment."""
    return stream_key(seeding.np_random(seed)[0])
