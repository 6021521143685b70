"""The PettingZoo face: one agent per follower. `parallel_env`, `raw_env` and `env`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import wrappers
from pettingzoo.utils.conversions import parallel_to_aec_wrapper

from formation_env.config import FormationConfig
from formation_env.core.results import Results
from formation_env.core.simulation import Simulation, Snapshot, stream_key
from formation_env.interface import faces
from formation_env.interface.arguments import Fixed, check_options, configured, limit, whole_seed
from formation_env.task import COLUMNS, REWARD
from formation_env.validation.checks import integer, refuse, shown
from formation_env.validation.warning import warn_user

Array = NDArray[np.float32]


@final
class FormationParallelEnv(Fixed, ParallelEnv[str, Array, Array]):
    """Every follower is an agent, `follower_0` to `follower_{n-1}`; all act at once.

    Observations, actions, rewards, ends and arguments are those of `FormationEnv`, one row per agent;
    the reward is the agent's own. The first failure ends the episode for all, and all pay for it. `state()`
    is the truth about the world, for centralised critics. `max_cycles` truncates earlier than the duration.
    Once the episode is over there are no agents, and `step({})` returns five empty dictionaries.

    `info` has for each agent `slot` and `slot_error` (3 numbers each, m, inertial) and as numbers
    `separation` (m), `failure` and the terms `reward_...` of its reward, as `FormationEnv` describes them.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "name": "formation_v0",
        "render_modes": list(faces.RENDER_MODES),
        "render_fps": 50,
        "is_parallelizable": True,
    }

    _fixed = frozenset({"config", "render_mode"})

    def __init__(
        self,
        scenario: str | FormationConfig | Mapping[str, Any] = "nominal",
        *,
        followers: int | None = None,
        max_cycles: int | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self._screen = faces.Screen(render_mode)
        self.config = configured(
            "parallel_env", ("max_cycles", "render_mode"), scenario, followers, options
        )
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": faces.fps(self.config)}
        n = self.config.followers
        self.possible_agents = [f"follower_{i}" for i in range(n)]
        self.agents: list[str] = []
        # An agent's own objects: a space draws samples from a generator of its own.
        self.observation_spaces: dict[str, spaces.Box] = {
            agent: faces.observation_space(self.config, 1) for agent in self.possible_agents
        }
        self.action_spaces: dict[str, spaces.Box] = {
            agent: faces.action_space(self.config, 1) for agent in self.possible_agents
        }
        self.state_space = faces.state_space(n)
        # Each agent and the indices of what is its own, in arrays `(1, followers, ...)`: made once,
        # because a step spends more on finding its numbers than on reading them.
        self._places = [
            (agent, (0, i), (0, i, COLUMNS["slot"]), (0, i, COLUMNS["slot_error"]))
            for i, agent in enumerate(self.possible_agents)
        ]
        self._all_agents = frozenset(self.possible_agents)
        self._shape = (self.config.action_size,)
        self._actions = np.zeros((1, n, *self._shape), dtype=np.float32)
        self._simulation = Simulation(self.config)
        if max_cycles is not None:
            self._simulation.limit(limit("max_cycles", max_cycles, self.config))
        self._np_random: np.random.Generator | None = None
        self._keyed_by: np.random.Generator | None = None

    @property
    def max_cycles(self) -> int:
        """Steps after which an episode is truncated. It may be set; above the steps of the duration,
        as PettingZoo's own tests do, it warns and stays at these."""
        return self._simulation.max_steps

    @max_cycles.setter
    def max_cycles(self, steps: int) -> None:
        steps, most = integer("max_cycles", steps, 1), self.config.max_steps
        if steps > most:
            message = f"max_cycles = {steps}: episodes end after {most} steps, the duration"
            warn_user(message)
        self._simulation.limit(steps)

    @property
    def np_random(self) -> np.random.Generator:
        """The generator that `reset(seed=...)` seeds, as Gymnasium has it; the world's own random stream is
        keyed from it."""
        if self._np_random is None:
            self._np_random = seeding.np_random()[0]
        return self._np_random

    @np_random.setter
    def np_random(self, generator: np.random.Generator) -> None:
        self._np_random = generator

    def observation_space(self, agent: str) -> spaces.Box:
        """The space of one agent's observations; the same object each time."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box:
        """The space of one agent's actions; the same object each time."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        """Start an episode. A seed restarts the random stream; without one the next episode follows.

        There are no options. Raises `ValueError` for any, and for a seed that is not a whole number; only
        the key `"options"` is let pass, which PettingZoo's own tests send.
        """
        check_options(options, passed="options")
        if (seed := whole_seed(seed)) is not None:
            self._np_random = seeding.np_random(seed)[0]
        if self._keyed_by is not self.np_random:
            self._keyed_by = self.np_random
            self._simulation.seed(0, stream_key(self.np_random))
        results = self._simulation.reset()
        self.agents = list(self.possible_agents)
        self._screen.begin(self._simulation)
        observations, _, infos = self._by_agent(results)
        return observations, infos

    def step(
        self, actions: dict[str, Array]
    ) -> tuple[
        dict[str, Array],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """One control tick.

        Raises `ResetNeeded` before the first reset, and after the end for any actions but `{}`.
        """
        if not self.agents:
            if actions == {} and self._simulation.seeded[0]:
                return {}, {}, {}, {}, {}
            raise ResetNeeded("the episode is over or has not begun: call reset() before step()")
        results = self._simulation.step(self._read(actions))
        agents = self.agents
        _, (terminated,), (truncated,) = results.ends.tolist()
        ended, late = terminated != 0.0, truncated != 0.0
        if ended or late:
            self.agents = []
        if self._screen.mode is not None:
            self._screen.follow(self._simulation)
        observations, rewards, infos = self._by_agent(results)
        return (
            observations,
            rewards,
            dict.fromkeys(agents, ended),
            dict.fromkeys(agents, late),
            infos,
        )

    def _read(self, actions: dict[str, Array]) -> Array:
        """The actions in the agents' order, in memory that the next call writes again."""
        if not isinstance(actions, dict) or actions.keys() != self._all_agents:
            found = list(actions) if isinstance(actions, dict) else type(actions).__name__
            raise ValueError(
                f"actions for {shown(found)}: expected one for each of {shown(self.agents)}"
            )
        rows, shape = self._actions, self._shape
        for agent, own, _, _ in self._places:
            action = actions[agent]
            # The common case of `read_action` once more: the call costs as much as the copy.
            if (
                type(action) is not np.ndarray
                or action.dtype is not faces.FLOAT
                or action.shape != shape
            ):
                action = faces.read_action(action, shape, f"action of {agent}")
            rows[own] = action
        return rows

    def take_action(self, agent: str, action: Any) -> Array:
        """A copy of one agent's action, float32; raises `ValueError` for what `step` would refuse."""
        row = faces.read_action(action, self._shape, f"action of {agent}").copy()
        if not np.isfinite(row).all():
            refuse(f"action of {agent}", row, "finite numbers")
        return row

    def _by_agent(
        self, results: Results
    ) -> tuple[dict[str, Array], dict[str, float], dict[str, dict[str, Any]]]:
        """Observations, rewards and infos."""
        observations: dict[str, Array] = {}
        rewards: dict[str, float] = {}
        infos: dict[str, dict[str, Any]] = {}
        observed, outputs = results.observations, results.outputs
        # One conversion for all: a NumPy scalar each would cost more than the simulation.
        numbers = iter(outputs.tolist()[0])
        for agent, own, slot, error in self._places:
            row = next(numbers)
            observations[agent] = observed[own]
            rewards[agent] = row[REWARD]
            infos[agent] = faces.describe_agent(outputs[slot], outputs[error], row)
        return observations, rewards, infos

    def state(self) -> Array:
        """The truth, float32 within `state_space`: per vehicle, leader first, `p, v, q, omega`; per follower
        its slot; 1 if the trigger has fired; inertial frame, SI units.

        Raises `ResetNeeded` before the first reset.
        """
        if not self._simulation.seeded[0]:
            raise ResetNeeded("there is no state yet: call reset() before state()")
        row: Array = faces.states(self._simulation, self._simulation.slots)[0]
        return row

    def render(self) -> Any:
        """A frame `(height, width, 3)` of uint8 in mode `rgb_array`; a window in mode `human`."""
        return self._screen.draw(self._simulation)

    def close(self) -> None:
        """Close the window, if there is one."""
        self._screen.close()
        self._simulation.close()

    @property
    def simulation(self) -> Simulation:
        """The world behind the environment: true positions, attitudes, times."""
        return self._simulation

    def get_state(self) -> Snapshot:
        """Everything needed to continue identically from here; see also pickle and deepcopy."""
        return self._simulation.get_state()

    def set_state(self, state: Snapshot) -> None:
        """Continue from a state that `get_state` of the same configuration returned."""
        self._simulation.set_state(state)
        if self._simulation.seeded[0]:
            self._keyed_by = self.np_random  # the state's own stream goes on at the next reset
        self.agents = [] if self._simulation.over[0] else list(self.possible_agents)


def parallel_env(**options: Any) -> FormationParallelEnv:
    """The parallel environment; keywords as `FormationParallelEnv`."""
    return FormationParallelEnv(**options)


@final
class _Turns(parallel_to_aec_wrapper[str, Array, Array]):
    """PettingZoo's conversion, but for what an agent gives being looked at, and copied, in its turn.

    There it is kept until the last agent's turn, which would raise what another agent's did.
    """

    env: FormationParallelEnv

    def step(self, action: Array | None) -> None:
        """Note the action of the agent whose turn it is, refused here if it cannot be flown."""
        agent = self.agent_selection
        if not (self.terminations[agent] or self.truncations[agent]):
            action = self.env.take_action(agent, action)
        elif action is not None:
            refuse(f"action of {agent}", action, "None: its episode is over")
        super().step(action)


def raw_env(**options: Any) -> AECEnv[str, Array, Array]:
    """The agents taking turns, in the one wrapper that PettingZoo's own conversion adds as well: it guards
    the order of calls."""
    return wrappers.OrderEnforcingWrapper(_Turns(parallel_env(**options)))


def env(**options: Any) -> AECEnv[str, Array, Array]:
    """The agents taking turns: PettingZoo's AEC form of `parallel_env`."""
    return raw_env(**options)
