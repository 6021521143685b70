"""The Gymnasium vector face: many worlds in one call. `gym.make_vec("Formation-v0", num_envs=...)`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from formation_env.config import FormationConfig
from formation_env.core.kernels import STEP, STEP_AND_RESET, STEP_OR_RESET
from formation_env.core.results import Results
from formation_env.core.simulation import Simulation, Snapshot, seeded_key
from formation_env.interface import faces, specs
from formation_env.interface.arguments import Fixed, check_options, configured, limit, whole_seed
from formation_env.validation.checks import integer, refuse

Array = NDArray[Any]

MOST_WORLDS = 2**20  # some gigabytes for two followers

_MODES = {
    AutoresetMode.NEXT_STEP: STEP_OR_RESET,
    AutoresetMode.SAME_STEP: STEP_AND_RESET,
    AutoresetMode.DISABLED: STEP,
}


@final
class FormationVectorEnv(Fixed, VectorEnv[Array, Array, Array]):
    """`num_envs` independent `Formation-v0` worlds, stepped by one compiled call.

    World i gives bit for bit the numbers of `gym.make("Formation-v0", ...)` with seed `seed + i`, in
    all three autoreset modes, for any number of worlds and threads: what
    `gymnasium.vector.SyncVectorEnv` would return, dtypes and `info` masks included. Arguments and
    spaces as `FormationEnv`, and:

    `num_envs`: how many worlds, up to 2**20. `max_episode_steps`: truncates earlier than the duration.
    `autoreset_mode`: `NEXT_STEP` (Gymnasium's default), `SAME_STEP` or `DISABLED`, as enumeration or
    name; with `DISABLED`, `reset(options={"reset_mask": mask})` restarts the worlds of a boolean mask.
    `threads`: at most this many, by default one per core; they change no number.

    `info` has the entries of `FormationEnv`'s with the worlds as first axis, beside each a mask `_name`;
    with `SAME_STEP` also `final_obs` and `final_info`, a dictionary of such entries, where one has ended.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    _fixed = frozenset({"config", "render_mode", "num_envs", "autoreset_mode"})

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | FormationConfig | Mapping[str, Any] = "nominal",
        *,
        followers: int | None = None,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self.closed = True  # until it is built: Gymnasium 1.2 closes whatever is collected
        self.num_envs = integer("num_envs", num_envs, 1, MOST_WORLDS)
        workers = os.cpu_count() or 1 if threads is None else integer("threads", threads, 1)
        self._screen = faces.Screen(render_mode, ("rgb_array",))
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        own = ("num_envs", "max_episode_steps", "autoreset_mode", "threads", "render_mode")
        self.config = configured(type(self).__name__, own, scenario, followers, options)
        if max_episode_steps is not None:
            max_episode_steps = limit("max_episode_steps", max_episode_steps, self.config)
        self.render_mode = render_mode
        self.metadata = {
            **self.metadata,
            "render_fps": faces.fps(self.config),
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space = faces.observation_space(self.config, self.config.followers)
        self.single_action_space = faces.action_space(self.config, self.config.followers)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._spec: EnvSpec | None = None
        self._simulation = Simulation(self.config, self.num_envs, workers, max_episode_steps)
        self.closed = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        """Start episodes: world i from `seed + i`, or `seed[i]`, or its stream's next episode.

        The one option is `reset_mask`, a boolean array: only these worlds start anew. Raises `ValueError`
        for another, and for a seed that is not a whole number.
        """
        check_options(options, "reset_mask")
        seeds = self._seeds(seed)
        mask = self._reset_mask(options)
        anew = np.flatnonzero(
            mask & (~self._simulation.seeded | np.array([s is not None for s in seeds]))
        )
        keys = [seeded_key(seeds[i]) for i in anew]  # all of them, before anything changes
        for i, key in zip(anew, keys, strict=True):
            self._simulation.seed(int(i), key)
        results = self._simulation.reset(mask)
        self._begin_drawing()
        return self._rows(results.observations), _masked(faces.describe(results.outputs), mask)

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """One control tick in every world."""
        if not self._simulation.begun:
            raise ResetNeeded("some worlds have not begun: call reset() before step()")
        mode = _MODES[self.autoreset_mode]
        if mode == STEP and self._simulation.over.any():
            over = np.flatnonzero(self._simulation.over)[:5].tolist()
            raise ResetNeeded(f"worlds {over}... are over: reset them with a reset_mask first")
        n, k = self.config.followers, self.config.action_size
        rows = faces.read_action(actions, (self.num_envs, n * k), "actions")
        results = self._simulation.step(rows.reshape(self.num_envs, n, k), mode)
        self._begin_drawing()
        terminated, truncated = results.terminated, results.truncated
        all_worlds = np.ones(self.num_envs, dtype=np.bool_)
        info = _masked(faces.describe(results.outputs, terminated), all_worlds)
        if mode == STEP_AND_RESET and (done := terminated | truncated).any():
            info |= self._final(results, done)
        return self._rows(results.observations), results.rewards, terminated, truncated, info

    def _final(self, results: Results, done: NDArray[np.bool_]) -> dict[str, Any]:
        """What the ended episodes looked like at their last step."""
        last = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(done):
            last[i] = results.final_observations[i].reshape(-1)
        return {
            "final_obs": last,
            "_final_obs": done.copy(),
            "final_info": _masked(faces.describe(results.final_outputs), done),
            "_final_info": done.copy(),
        }

    def _rows(self, observations: Array) -> Array:
        return observations.reshape(self.num_envs, -1)

    def _begin_drawing(self) -> None:
        """Let the pictures of worlds that have just begun an episode forget the last one."""
        if self.render_mode is not None:
            for i in np.flatnonzero(self._simulation.time == 0.0):
                self._screen.begin(self._simulation, int(i))

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        several = isinstance(seed, Sequence) and not isinstance(seed, (str, bytes, bytearray))
        if isinstance(seed, np.ndarray) and seed.ndim == 1:
            several = not isinstance(seed, np.ma.MaskedArray)
        if not several:
            try:
                first = integer("seed", seed, 0)
            except ValueError:
                refuse("seed", seed, "an integer of at least 0, one for each world, or None")
            return [first + i for i in range(self.num_envs)]
        seeds: Any = seed
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries: expected {self.num_envs}")
        return [whole_seed(own, f"seed[{i}]") for i, own in enumerate(seeds)]

    def _reset_mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        if options is None or "reset_mask" not in options:
            return np.ones(self.num_envs, dtype=np.bool_)
        mask = options["reset_mask"]
        good = isinstance(mask, np.ndarray) and mask.dtype == np.bool_
        if not good or mask.shape != (self.num_envs,) or not mask.any():
            shape = f"a boolean array of shape ({self.num_envs},) with at least one True"
            refuse("options['reset_mask']", mask, shape)
        return np.array(mask)

    def render(self) -> tuple[Array, ...] | None:
        """One frame per world in mode `rgb_array`."""
        if self.render_mode is None:
            return None
        return tuple(self._screen.draw(self._simulation, i) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads."""
        self._screen.close()
        self._simulation.close()

    @property
    def spec(self) -> EnvSpec | None:
        """What `gym.make_vec` made this of, in a form that goes round through JSON; see `EnvSpec`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = specs.recorded(spec, self._simulation.max_steps)

    @property
    def simulation(self) -> Simulation:
        """The worlds behind the environment: true positions, attitudes, times."""
        return self._simulation

    def get_state(self) -> Snapshot:
        """Everything needed to continue identically from here."""
        return self._simulation.get_state()

    def set_state(self, state: Snapshot) -> None:
        """Continue from a state that `get_state` of the same configuration and size returned."""
        self._simulation.set_state(state)


def _masked(info: dict[str, Any], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Gymnasium's form: beside each array `_name`, the worlds it speaks of; zeros elsewhere."""
    # Whether all are meant is asked once: for every entry anew it was half of a small batch's step.
    others = None if mask.all() else ~mask
    result: dict[str, Any] = {}
    for name, value in info.items():
        if others is not None:
            value = value.copy()
            value[others] = 0
        result[name] = value
        result[f"_{name}"] = mask.copy()
    return result


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    if isinstance(mode, AutoresetMode):
        return mode
    for known in AutoresetMode:
        names = (known.name.lower(), str(known.value).lower())
        if isinstance(mode, str) and mode.lower() in names:
            return known
    allowed = ", ".join(known.name for known in AutoresetMode)
    refuse("autoreset_mode", mode, f"one of {allowed}")
