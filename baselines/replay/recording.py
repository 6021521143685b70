"""Records an episode as it is flown, by a policy (`fly`) or by your own loop (`Recorder`).

    env = gym.make("Formation-v0", scenario="paper")
    observation, info = env.reset(seed=0)
    recorder = Recorder(env, "mine", seed=0)
    while not done:
        observation, reward, terminated, truncated, info = env.step(action)
        recorder.add(info)
    episode = recorder.episode()

It reads the environment's true state between steps and changes nothing: the numbers of a flight are those
without it, and what is recorded is them bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np

from baselines.own import PolicyError
from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from baselines.registry import Recipe
from baselines.replay.episode import Episode, Floats
from baselines.replay.lyapunov import NAMES, is_recorded, values, with_record
from baselines.scoring.metrics import add_tick, begin, episodes, skipped_ticks, window_ticks
from formation_env import FormationConfig
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.interface.faces import TERMS, describe, path_times
from formation_env.memory.records import size
from formation_env.task import COLUMNS, Outcome
from formation_env.validation.checks import integer, require

_STATE = ("positions", "velocities", "attitudes", "angular_velocities")
_INFO = ("slots", "slot_error", "separation", "failure", *TERMS)


@final
class Recorder:
    """Records one episode of an environment that has been reset, from there on.

    `env` is a Gymnasium or PettingZoo environment of this package, wrapped or not, or a `Simulation` of one
    world. `policy` is the name to show, or the policy itself: of an `Expert` with `keep_record=True` the
    Lyapunov functions are recorded too. `seed` is that of the reset, to be shown.

    Raises `ValueError` for any other environment, and for one that has not been reset or has ended.
    """

    def __init__(self, env: Any, policy: str | Policy = "own", seed: int | None = None) -> None:
        self._simulation = _simulation_of(env)
        named = isinstance(policy, (str, Policy))
        require(named, "policy", policy, "a name, or a baselines.Policy")
        self._name = policy if isinstance(policy, str) else policy.name
        self._expert = policy if isinstance(policy, Expert) else None
        self._seed = None if seed is None else integer("seed", seed, 0)
        s = self._simulation
        if not s.seeded[0] or s.ended(0):
            raise ValueError("no episode is under way: call reset() before Recorder(env)")
        self._config, self._tally = s.config, begin(s.started)
        self._scored = skipped_ticks(self._config), window_ticks(self._config)
        n, k = self._config.followers, self._config.action_size
        self._path = s.reference(path_times(float(s.clock[0]), self._config.duration))
        self._failure = np.zeros(n, dtype=np.int64)
        self._before = np.zeros((1, n, k), dtype=np.float32)
        self._instants: dict[str, list[Any]] = {name: [] for name in ("time", "started", *_STATE)}
        self._slots: list[Floats] = []
        self._ticks: dict[str, list[Any]] = {"actions": [], "rewards": [], "lyapunov": []}
        self._note(s.look().outputs[0, :, COLUMNS["slot"]])

    def add(self, info: Mapping[str, Any]) -> None:
        """Record a tick: call it after every `step`, with the `info` that it returned (PettingZoo: `infos`).

        Raises `ValueError` where it is not what this environment returns, or where a step was left out.
        """
        s, period = self._simulation, self._config.control_period
        outputs = _outputs_of(info, self._config.followers)
        late = round((float(s.time[0]) - self._instants["time"][-1]) / period)
        if late != 1:
            raise ValueError(
                f"{late} ticks since the last that was recorded: expected add(info) after each step, and "
                "a new Recorder after each reset"
            )
        observed = s.layout.unpack(s.look().observations[0])
        action = observed["previous_action"][None, :, : self._config.action_size].copy()
        self._failure = _failures(outputs)
        self._tick(outputs, action)
        self._note(outputs[:, COLUMNS["slot"]])

    def _note(self, slots: Floats) -> None:
        """What is true now."""
        s = self._simulation
        self._instants["time"].append(float(s.time[0]))
        self._instants["started"].append(bool(s.started[0]))
        for name in _STATE:
            self._instants[name].append(getattr(s, name)[0])
        self._slots.append(np.array(slots))

    def _tick(self, outputs: Floats, action: Any) -> None:
        """What the tick was, added to the score as the evaluation does."""
        s, config = self._simulation, self._config
        rewards = outputs[:, COLUMNS["reward"].start]
        terminated = np.array([bool(self._failure.any())])
        truncated = np.array([s.ended(0) and not terminated[0]])
        add_tick(
            self._tally,
            len(self._slots),
            *self._scored,
            np.ones(1, dtype=np.bool_),
            s.started,
            s.leaders,
            outputs[None],
            np.array([rewards.mean()]),
            terminated,
            truncated,
            action,
            self._before,
            np.array(config.offsets),
        )
        self._before = action
        self._ticks["actions"].append(action[0])
        self._ticks["rewards"].append(rewards)
        if self._expert is not None and is_recorded(self._expert):
            self._ticks["lyapunov"].append(values(self._expert))

    def episode(self) -> Episode:
        """What has been recorded so far. Raises `ValueError` where that is not one tick."""
        if not self._ticks["actions"]:
            raise ValueError("nothing was recorded: expected add(info) after each step")
        n = self._config.followers
        metrics = {k: float(x[0]) for k, x in episodes(self._tally, self._config).items()}
        return Episode(
            self._name,
            self._seed,
            self._config,
            slots=np.array(self._slots),
            actions=np.array(self._ticks["actions"], dtype=np.float32),
            rewards=np.array(self._ticks["rewards"]),
            failure=self._failure.copy(),
            path=np.array(self._path),
            lyapunov=np.array(self._ticks["lyapunov"]).reshape(-1, n, len(NAMES)),
            metrics=metrics,
            **{name: np.array(rows) for name, rows in self._instants.items()},
        )


def _failures(outputs: Floats) -> Any:
    """The kinds of failure in result rows, `(n,)`."""
    return outputs[:, COLUMNS["failed"].start].astype(np.int64)


def _simulation_of(env: Any) -> Simulation:
    found = getattr(getattr(env, "unwrapped", env), "simulation", env)
    good = isinstance(found, Simulation) and found.num_worlds == 1
    require(good, "env", env, "an environment of one world made by this package")
    assert isinstance(found, Simulation)
    return found


def _outputs_of(info: Any, followers: int) -> Floats:
    """Result rows `(n, numbers of an Outcome)` from what a step says in `info`."""
    expected = f"the info of a step, with {', '.join(_INFO)}"
    require(isinstance(info, Mapping), "info", info, expected)
    if "slot_error" not in info:  # PettingZoo's: one for each agent, where `slots` is `slot`
        each = list(info.values())
        good = len(each) == followers and all(isinstance(one, Mapping) for one in each)
        require(good, "info", sorted(map(str, info)), expected)
        info = {k: [one.get("slot" if k == "slots" else k, np.nan) for one in each] for k in _INFO}
    outputs = np.zeros((followers, size(Outcome)))
    columns = {**COLUMNS, **{name: slice(k, k + 1) for name, k in TERMS.items()}}
    names = {"slots": "slot", "failure": "failed"}
    for name in _INFO:
        where = columns[names.get(name, name)]
        try:
            rows = np.asarray(info[name], dtype=np.float64)
            outputs[:, where] = rows.reshape(followers, where.stop - where.start)
        except (KeyError, ValueError, TypeError):
            raise ValueError(f"info[{name!r}] is missing or odd: expected {expected}") from None
    outputs[:, COLUMNS["reward"].start] = outputs[:, list(TERMS.values())].sum(axis=1)
    return outputs


def fly(
    recipe: Recipe,
    config: FormationConfig,
    seed: int,
    name: str,
    progress: Callable[[int], None] | None = None,
) -> Episode:
    """The episode `seed` of a policy, as `baselines.evaluate` flies it.

    `progress` is called with 1 after every tick. Raises `PolicyError` where a user's own policy fails.
    """
    policy = with_record(recipe.make(config))
    simulation = Simulation(config)
    simulation.seed(0, seeded_key(seed))
    try:
        policy.reset(seed=seed)
        results = simulation.reset()
        recorder = Recorder(simulation, policy, seed)
        while not simulation.ended(0):
            results = simulation.step(policy.act(results.observations))
            recorder.add(describe(results.outputs[0]))
            if progress is not None:
                progress(1)
    except Exception as problem:
        if not recipe.own:
            raise
        text = " ".join(f"{type(problem).__name__}: {problem}".split())
        raise PolicyError(f"policy {recipe.own}: {text[:400]}") from problem
    return recorder.episode()._replace(policy=name)
