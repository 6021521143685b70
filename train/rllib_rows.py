"""The RLlib face: many worlds, every follower a row of one Gymnasium vector environment.

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

from formation_env import FormationConfig, faces
from formation_env.memory import REWARD, SLOT, Results
from formation_env.simulation import Simulation, seeded_key
from train.evaluation import TRAINING_SEEDS

Array = NDArray[Any]


@final
class FollowerRows(VectorEnv[Any, Array, Array]):
    """`num_envs` rows, row = world * followers + follower; a row's reward is the follower's own.

    An observation is what the follower sees; with `central`, a dictionary of that, `obs`, and of the
    world's true state, `state`, as PettingZoo's `state()` gives it. All rows of a world end together and
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
        self._over = np.zeros(self.worlds, dtype=np.bool_)
        self._left = np.full(
            self.worlds, -1, dtype=np.int64
        )  # ticks to an early end; below 0: none
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
            first = TRAINING_SEEDS + (0 if seed is None else int(seed)) * self.worlds
            for world in range(self.worlds):
                self._simulation.seed(world, seeded_key(first + world))
            ages = np.random.default_rng(first)
            self._left = ages.integers(1, self.config.max_steps + 1, self.worlds)
            self._seeded = True
        self._over[:] = False
        return self._observe(self._simulation.reset()), {}

    def step(self, actions: Array) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """One control tick in the worlds that fly; those that had ended begin their next episode."""
        fresh = self._over
        shape = (self.worlds, self.config.followers, self.config.action_size)
        rows = np.array(actions, dtype=np.float32).reshape(shape)
        rows[fresh] = 0.0
        results = self._simulation.step(rows, mask=~fresh)
        rewards = self._scale * results.outputs[..., REWARD]
        rewards[fresh] = 0.0
        self._left[~fresh] -= 1
        terminated = results.terminated & ~fresh
        truncated = (results.truncated | (self._left == 0)) & ~fresh & ~terminated
        if fresh.any():
            self._left[fresh] = -1
            results = self._simulation.reset(fresh)
        self._over = terminated | truncated
        ends = (np.repeat(x, self.config.followers) for x in (terminated, truncated))
        return self._observe(results), rewards.reshape(-1), *ends, {}

    def _observe(self, results: Results) -> Any:
        """What every row sees, fresh arrays."""
        own = results.observations.reshape(self.num_envs, -1).copy()
        if not self._central:
            return own
        state = faces.states(self._simulation, results.outputs[..., SLOT : SLOT + 3])
        return {"obs": own, "state": np.repeat(state, self.config.followers, axis=0)}

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads."""
        self._simulation.close()
