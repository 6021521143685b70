"""What the tests of the environment share: actions to fly, exact comparison, running an episode.

Two followers that hover (action 0) stay in the air for seconds; `gentle` stays near that, `wild`
soon ends an episode in a failure.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from formation_env.env import FormationEnv

Actions = npt.NDArray[np.float32]
Step = tuple[Any, ...]

SCENARIOS = ("nominal", "paper", "experiment", "agile", "swarm")
LEVELS = ("wrench", "rates", "reference")


def gentle(steps: int, size: int, seed: int = 0) -> Actions:
    """`(steps, size)` actions so small that no vehicle tips over within some seconds."""
    return np.random.default_rng(seed).uniform(-0.01, 0.01, (steps, size)).astype(np.float32)


def wild(steps: int, *shape: int, seed: int = 0) -> Actions:
    """`(steps, *shape)` actions, a third of them out of range."""
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (steps, *shape)).astype(np.float32)


def same(a: Any, b: Any) -> bool:
    """Equal to the last bit, of equal types and dtypes, in any nesting."""
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, np.ndarray):
        if a.dtype != b.dtype or a.shape != b.shape:
            return False
        if a.dtype == object:
            return all(same(x, y) for x, y in zip(a.ravel(), b.ravel(), strict=True))
        return a.tobytes() == b.tobytes()
    return bool(a == b)


def arrays(value: Any) -> list[npt.NDArray[Any]]:
    """All arrays in a nested result."""
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, dict):
        value = tuple(value.values())
    if isinstance(value, (list, tuple)):
        return [a for item in value for a in arrays(item)]
    return []


def reward_terms(info: dict[str, Any]) -> dict[str, Any]:
    """The entries of `info` that add up to the reward, by the term's name."""
    mark = "reward_"
    return {name.removeprefix(mark): info[name] for name in info if name.startswith(mark)}


def fly(env: FormationEnv, actions: Actions) -> list[Step]:
    """Steps of a running episode; it starts the next one, without a seed, where one ends."""
    steps: list[Step] = []
    for action in actions:
        steps.append(env.step(action))
        if steps[-1][2] or steps[-1][3]:
            steps.append(env.reset())
    return steps


def episode(env: FormationEnv, actions: Actions, seed: int | None = None) -> list[Step]:
    """A reset and `fly`."""
    return [env.reset(seed=seed), *fly(env, actions)]
