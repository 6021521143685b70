"""The environment for RLlib: many worlds, every follower a row of one Gymnasium vector environment.

RLlib's multi-agent environments pass dictionaries from agent to agent, in Python. Here all followers
share one policy, so each can be an environment of its own to RLlib, which then handles a row in a
tenth of the time.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from formation_env import FormationConfig
from formation_env.core.results import Results
from formation_env.core.simulation import Simulation
from formation_env.interface import faces
from train.rows import EarlyEnds, central_state, follower_rewards, seed_worlds
from train.seeds import first_training_seed

Array = NDArray[Any]


@final
class FollowerRows(VectorEnv[Any, Array, Array]):
    """`num_envs` rows, row = world * followers + follower; a row's reward is the follower's own.

    An observation is the follower's; with `central`, a dictionary of that, `obs`, and of the world's true
    state, `state`, as PettingZoo's `state()` gives it. All rows of a world end together and
    begin their next episode in the next step (Gymnasium's `NEXT_STEP`). Every world's first episode is
    truncated at a random age, so that the worlds do not all begin and end together ever after. Rewards
    are multiplied by `reward_scale`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        config: FormationConfig,
        num_envs: int,
        *,
        central: bool = False,
        reward_scale: float = 1.0,
    ) -> None:
        self.config, self.num_envs = config, num_envs
        self.worlds, rest = divmod(num_envs, config.followers)
        if rest or not self.worlds:
            raise ValueError(
                f"num_envs = {num_envs}: expected a multiple of the {config.followers} followers"
            )
        self._simulation = Simulation(config, self.worlds)
        self._central, self._scale = central, reward_scale
        self._ended = np.zeros(self.worlds, dtype=np.bool_)  # in the tick before
        self._early_ends = EarlyEnds(self.worlds)
        observation: spaces.Space[Any] = faces.observation_space(config, 1)
        if central:
            state = faces.state_space(config.followers)
            observation = spaces.Dict({"obs": observation, "state": state})
        self.single_observation_space = observation
        self.single_action_space = faces.action_space(config, 1)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seeded = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes everywhere; worlds draw from streams of their own for every seed."""
        if seed is not None or not self._seeded:
            first = first_training_seed(0 if seed is None else int(seed), self.worlds)
            seed_worlds(self._simulation, first)
            self._early_ends.stagger(np.random.default_rng(first), self.config.max_steps)
            self._seeded = True
        self._ended[:] = False
        return self._observe(self._simulation.reset()), {}

    def step(self, actions: Array) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """One control tick; worlds whose episode ended in the tick before begin the next one instead."""
        fresh = self._ended
        shape = (self.worlds, self.config.followers, self.config.action_size)
        rows = np.array(actions, dtype=np.float32).reshape(shape)
        rows[fresh] = 0.0
        results = self._simulation.step(rows, mask=~fresh)
        rewards = self._scale * follower_rewards(results)
        rewards[fresh] = 0.0
        terminated = results.terminated & ~fresh
        late = results.truncated | self._early_ends.tick(~fresh)
        truncated = late & ~fresh & ~terminated
        if fresh.any():
            self._early_ends.cancel(fresh)
            results = self._simulation.reset(fresh)
        self._ended = terminated | truncated
        ends = (np.repeat(x, self.config.followers) for x in (terminated, truncated))
        return self._observe(results), rewards.reshape(-1), *ends, {}

    def _observe(self, results: Results) -> Any:
        """Every row's observation, in new arrays."""
        local = results.observations.reshape(self.num_envs, -1).copy()
        if not self._central:
            return local
        return {"obs": local, "state": central_state(self._simulation, results)}

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads."""
        self._simulation.close()
