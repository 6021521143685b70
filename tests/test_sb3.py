"""Stable-Baselines3 takes the Gymnasium face as it is."""

from __future__ import annotations

import warnings

import gymnasium as gym
import pytest
from episodes import LEVELS, SCENARIOS

import formation_env  # noqa: F401  registers the id

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # torch's own, at import
    pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.env_checker import check_env
    from stable_baselines3.common.env_util import make_vec_env


@pytest.mark.parametrize("action", LEVELS)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_its_checker_has_nothing_to_say(scenario: str, action: str) -> None:
    """Its warnings are errors here. How pictures look is tested elsewhere."""
    env = gym.make("Formation-v0", scenario=scenario, action=action)
    check_env(env, warn=True, skip_render_check=True)


def test_its_vector_environment_sees_truncations() -> None:
    envs = make_vec_env(
        "formation_env:Formation-v0", n_envs=2, seed=0, env_kwargs={"duration": 0.1}
    )
    envs.reset()
    for _ in range(5):
        _, _, dones, infos = envs.step([envs.action_space.low * 0.0] * 2)
    assert dones.all()
    for info in infos:
        assert info["TimeLimit.truncated"]
        assert info["terminal_observation"] in envs.observation_space
        assert info["episode"]["l"] == 5
