"""What Gymnasium records of an environment that it has made: its `spec`."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec

from formation_env.config import FormationConfig
from formation_env.interface.arguments import limit
from formation_env.validation.plain_form import plain


def recorded(spec: EnvSpec | None, steps: int) -> EnvSpec | None:
    """`spec` with the number of steps after which an episode is truncated, and keywords as JSON has them.

    Libraries look for the limit in `spec.max_episode_steps`. Of the keywords those that have no form in
    JSON stay as they are.
    """
    if spec is None:
        return None
    kwargs = {name: _plain(value) for name, value in spec.kwargs.items()}
    return replace(spec, max_episode_steps=steps, kwargs=kwargs)


def _plain(value: Any) -> Any:
    try:
        return plain(value)
    except ValueError:
        return value


def check_time_limit(config: FormationConfig) -> None:
    """Refuse the `max_episode_steps` of a `gym.make` in progress if the duration ends episodes earlier.

    `gym.make` tells it to the wrapper `TimeLimit` alone, and neither knows of the other. So it is looked up
    among the arguments of that call, which is what assigns `spec`.
    """
    frame = inspect.currentframe()
    while frame is not None and frame.f_code is not gymnasium.make.__code__:
        frame = frame.f_back
    if frame is None:
        return
    steps = frame.f_locals.get("max_episode_steps")
    if steps is None:  # then that of a spec, which `gym.make` can be given in place of the id
        steps = getattr(frame.f_locals.get("env_spec"), "max_episode_steps", None)
    if isinstance(steps, int) and steps > 0:  # -1: no such wrapper; the wrapper refuses the rest
        limit("max_episode_steps", steps, config)
