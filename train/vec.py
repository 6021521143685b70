"""The environment for Stable-Baselines3: many worlds, every follower a row of one shared policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any, final

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from baselines.policies.actions import corrected
from baselines.policies.expert import Expert
from formation_env import FormationConfig
from formation_env.core.results import Results
from formation_env.core.simulation import Snapshot
from formation_env.interface import faces
from formation_env.interface.arguments import Fixed, check_options, configured, whole_seed
from formation_env.validation.checks import boolean, choice, integer, number, refuse
from formation_env.vector import MOST_WORLDS, FormationVectorEnv
from train.rows import EarlyEnds, central_state, follower_rewards

Array = NDArray[Any]

LONGEST_HISTORY = 1024  # rows of an observation
MOST_SCALE = 1e9  # of rewards, up to some 1e6 each: the product is far from where float32 ends
_OWN: tuple[str, ...] = ("worlds", "seed_offset", "history", "residual", "critic", "stagger")
_OWN += ("reward_scale", "threads", "render_mode")


@final
class FollowerVecEnv(Fixed, VecEnv):
    """`worlds` worlds of a scenario with a row per follower: row = world * followers + follower.

    An observation is the follower's last `history` rows, newest last; an episode begins with its first
    one repeated. With `critic="central"` the world's true state follows, as PettingZoo's `state()`
    gives it: the first `local_size` numbers are the follower's own. Rewards are the follower's own times
    `reward_scale`. All rows of a world end together; ended rows carry `terminal_observation` and
    `TimeLimit.truncated` and continue with the next episode.

    With `residual` > 0 the expert flies underneath: what is executed is its action plus `residual`
    times the row's, which is clipped to [-1, 1]. World w draws from the stream of seed
    `seed_offset + seed + w`. `stagger` ends every world's first episode early, at a random age, as if
    at its time limit, so that the worlds do not all begin and end together ever after.

    Every keyword of `FormationEnv` is taken too. Raises as it does; `seed`, `set_options` and `set_attr`
    refuse what would do nothing.
    """

    _fixed = frozenset({"config", "worlds", "followers", "num_envs", "render_mode"})

    def __init__(
        self,
        scenario: str | FormationConfig | Mapping[str, Any] = "nominal",
        worlds: int = 64,
        *,
        seed_offset: int = 0,
        history: int = 1,
        residual: float = 0.0,
        critic: str = "local",
        stagger: bool = False,
        reward_scale: float = 1.0,
        threads: int | None = None,
        render_mode: str | None = None,
        followers: int | None = None,
        **options: Any,
    ) -> None:
        worlds = integer("worlds", worlds, 1, MOST_WORLDS)
        history = integer("history", history, 1, LONGEST_HISTORY)
        residual = number("residual", residual, 0.0, 1.0, strict=False)
        critic = choice("critic", critic, ("local", "central"))
        reward_scale = number("reward_scale", reward_scale, -MOST_SCALE, MOST_SCALE, strict=False)
        self.config = configured(type(self).__name__, _OWN, scenario, followers, options)
        self.envs = FormationVectorEnv(
            worlds,
            self.config,
            autoreset_mode=AutoresetMode.DISABLED,
            threads=threads,
            render_mode=render_mode,
        )
        self.worlds, self.followers = worlds, self.config.followers
        self.entries = self.config.layout.size
        self.local_size = history * self.entries  # of an observation's numbers, the follower's own
        self.simulation_seconds = 0.0  # wall time spent in the simulation, since construction
        self.step_seconds = 0.0  # and in all of step_wait
        self._history, self._residual = history, residual
        self._central, self._scale = critic == "central", reward_scale
        self._stagger = boolean("stagger", stagger)
        self._seed_offset = integer("seed_offset", seed_offset, 0)
        self._expert = Expert(self.config) if residual > 0.0 else None
        self._last = np.zeros((worlds, self.followers, self.entries), dtype=np.float32)
        self._stack = np.zeros((worlds, self.followers, history, self.entries), dtype=np.float32)
        self._early_ends = EarlyEnds(worlds)
        self._actions = np.zeros((worlds, self.followers, self.config.action_size), np.float32)
        high = np.tile(self.config.layout.bound, history)
        if self._central:
            high = np.concatenate((high, faces.state_space(self.followers).high))
        super().__init__(
            worlds * self.followers,
            spaces.Box(-high, high, dtype=np.float32),
            faces.action_space(self.config, 1),
        )

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the next `reset`, a whole number from 0."""
        return super().seed(whole_seed(seed))

    def set_options(self, options: Any = None) -> None:
        """There are no options of `reset`: any is refused."""
        for own in options if isinstance(options, list) else [options]:
            check_options(own)

    # -- episodes -----------------------------------------------------------------------------------

    def reset(self) -> Array:
        """Begin episodes everywhere, from the seed given to `seed` if one was."""
        seed = self._seeds[0]
        first = None if seed is None else self._seed_offset + seed
        self._reset_seeds()
        self.envs.reset(seed=first)
        self._early_ends.cancel()
        if self._stagger:
            self._early_ends.stagger(np.random.default_rng(first), self.config.max_steps)
        results = self.envs.simulation.look()
        if self._expert is not None:
            self._expert.reset(worlds=self.worlds)
        self._add_observations(results, np.ones(self.worlds, dtype=np.bool_))
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return self._observe(results)

    def _add_observations(self, results: Results, fresh: NDArray[np.bool_]) -> None:
        """Append observations to the histories; in `fresh` worlds they are an episode's first."""
        self._last = results.observations
        if self._history > 1:
            self._stack[:, :, :-1] = self._stack[:, :, 1:]
        self._stack[:, :, -1] = results.observations
        if fresh.any():
            self._stack[fresh] = results.observations[fresh][:, :, None]

    def _observe(self, results: Results) -> Array:
        """Every row's observation, a new array."""
        rows = self._stack.reshape(self.num_envs, self.local_size)
        if not self._central:
            return rows.copy()
        return np.concatenate((rows, central_state(self.envs.simulation, results)), axis=1)

    # -- stepping -----------------------------------------------------------------------------------

    def step_async(self, actions: Array) -> None:
        """Note the actions, one row per follower."""
        size = self.config.action_size
        rows = faces.read_action(actions, (self.num_envs, size), "actions")
        self._actions = rows.reshape(self.worlds, self.followers, size)

    def step_wait(self) -> tuple[Array, Array, NDArray[np.bool_], list[dict[str, Any]]]:
        """One control tick in every world; worlds that end begin their next episode."""
        start = perf_counter()
        actions = self._actions
        if self._expert is not None:
            actions = corrected(self._expert.act(self._last), actions, self._residual)
        begun = perf_counter()
        results = self.envs.simulation.step(actions)
        self.simulation_seconds += perf_counter() - begun
        terminated = results.terminated
        done = terminated | results.truncated | self._early_ends.tick()
        self._add_observations(results, np.zeros_like(done))
        observations = self._observe(results)
        rewards = (self._scale * follower_rewards(results)).astype(np.float32).reshape(-1)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        dones = np.repeat(done, self.followers)
        if done.any():
            for row in np.flatnonzero(dones):
                infos[row]["terminal_observation"] = observations[row].copy()
                infos[row]["TimeLimit.truncated"] = not terminated[row // self.followers]
            observations = self._begin_again(done)
        self.step_seconds += perf_counter() - start
        return observations, rewards, dones, infos

    def _begin_again(self, done: NDArray[np.bool_]) -> Array:
        """Start the next episode in the worlds that are `done`; every row's observation then."""
        begun = perf_counter()
        results = self.envs.simulation.reset(done)
        self.simulation_seconds += perf_counter() - begun
        self._early_ends.cancel(done)
        if self._expert is not None:
            self._expert.restart(done)
        self._last = results.observations
        self._stack[done] = results.observations[done][:, :, None]
        return self._observe(results)

    # -- the rest of the interface ----------------------------------------------------------------

    def get_images(self) -> Sequence[Array | None]:
        """One frame per world; its rows share it."""
        frames = self.envs.render()
        return [None] * self.worlds if frames is None else list(frames)

    def close(self) -> None:
        """Stop the threads."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the environment behind the rows, once for each."""
        return [getattr(self.envs, attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environment behind all rows.

        Raises `AttributeError` for what is fixed when it is made, such as `config`.
        """
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        """Call a method of the environment behind the rows, once; its result for each row."""
        return [getattr(self.envs, method_name)(*args, **kwargs)] * self._count(indices)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No row is wrapped by itself."""
        return [False] * self._count(indices)

    def _count(self, indices: Any) -> int:
        return len(list(self._get_indices(indices)))

    def get_state(self) -> dict[str, Array]:
        """Everything needed to continue identically, as copies of arrays by name."""
        state = {f"world.{k}": v for k, v in self.envs.get_state().state.items()}
        state |= {name: array.copy() for name, array in self._own_state().items()}
        if self._expert is not None:
            state |= {f"expert.{k}": v for k, v in self._expert.get_state().items()}
        return state

    def _own_state(self) -> dict[str, Array]:
        """The arrays that this class itself keeps from tick to tick."""
        return {"last": self._last, "stack": self._stack, "left": self._early_ends.left}

    def set_state(self, state: dict[str, Array]) -> None:
        """Continue from what `get_state` of the same configuration and size returned.

        Raises `ValueError` where something is missing or of another shape.
        """
        parts: dict[str, dict[str, Array]] = {"world": {}, "expert": {}, "": {}}
        if not isinstance(state, dict):
            refuse("state", state, "what get_state returned")
        for name, array in state.items():
            group, _, rest = str(name).rpartition(".")
            if group not in parts or not isinstance(array, np.ndarray):
                refuse(f"state[{name!r}]", array, "an array that get_state returned")
            parts[group][rest] = array
        for name, present in self._own_state().items():
            given = parts[""].get(name)
            if given is None or given.shape != present.shape or given.dtype != present.dtype:
                raise ValueError(f"state[{name!r}] does not fit {self.worlds} worlds of this kind")
            if not np.isfinite(given).all():
                refuse(f"state[{name!r}]", given, "finite numbers")
        self.envs.set_state(Snapshot(self.config, parts["world"]))
        if self._expert is not None:
            self._expert.reset(worlds=self.worlds)
            self._expert.set_state(parts["expert"])
        self._last, self._stack = parts[""]["last"].copy(), parts[""]["stack"].copy()
        self._early_ends.left[:] = parts[""]["left"]
