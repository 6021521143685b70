"""Minari: a data set remembers the environment that it was collected in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from minari import DataCollector, MinariDataset, load_dataset

import formation_env
from formation_env import Noise, Vehicle, formations, splines, trajectories

SEED = 11
DEFAULT = formation_env.configure()
OPTIONS: dict[str, dict[str, Any]] = {
    "nothing": {},
    "scenario": {"scenario": "paper", "followers": 3, "action": "rates"},
    "array": {"offsets": np.array([[1.0, 0.5, 0.0], [1.0, -0.5, 0.25], [2.0, 0.0, 0.0]])},
    "formation": {"offsets": formations.wedge(4), "neighbours": np.int64(1)},
    "trajectory": {"trajectory": trajectories.circle(radius=3.0, speed=0.7)},
    "spline": {
        "trajectory": splines.waypoints([0.0, 4.0, 8.0], [[0, 0, -2], [4, 1, -2], [8, 0, -1.5]]),
        "duration": 8.0,
    },
    "tuples": {
        "noise": Noise(0.01, 0.02, 0.05, 0.01, 0.02),
        "limits": DEFAULT.limits._replace(lost=5.0),
        "reward": DEFAULT.reward._replace(effort=0.1),
        "vehicle": Vehicle(mass=0.5),
    },
    "plain": {
        "offsets": [[1.0, 0.5, 0.0], [1.0, -0.5, 0.25]],
        "noise": DEFAULT.noise._asdict(),
        "vehicle": {"mass": 0.5},
        "trajectory": {"path": "circle", "radius": 3.0},
    },
    "configuration": {"scenario": formation_env.configure("agile", followers=2, action="rates")},
    "numpy": {"duration": np.float64(0.3), "control_period": np.float32(0.02)},
    "limit": {"max_episode_steps": 7},
}


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Minari keeps its data sets."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))


def collect(env: gym.Env[Any, Any], record_infos: bool = False, **options: bool) -> MinariDataset:
    """Three episodes: two short ones, and one to its end. Minari draws the seeds of later ones."""
    collector = DataCollector(env, record_infos=record_infos)
    collector.action_space.seed(SEED)
    collector.reset(seed=SEED)
    for steps in (3, 5, 10_000):
        for _ in range(steps):
            *_, terminated, truncated, _ = collector.step(collector.action_space.sample())
            if terminated or truncated:
                break
        collector.reset(options=options)
    made = collector.create_dataset(
        "formation/test-v0",
        algorithm_name="random",
        author="The Formation authors",
        author_email="none",
        code_permalink="none",
        description="Random actions",
    )
    collector.close()
    return made


def repeat(data: MinariDataset, env: gym.Env[Any, Any]) -> None:
    """The environment gives the numbers that were collected, from the seeds that were stored."""
    assert data.total_episodes == 3
    for episode in data.iterate_episodes():
        (facts,) = data.storage.get_episode_metadata([episode.id])
        observation, _ = env.reset(seed=int(facts["seed"]) if "seed" in facts else None)
        np.testing.assert_array_equal(episode.observations[0], observation)
        last = len(episode.actions) - 1
        for k, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, _ = env.step(action)
            np.testing.assert_array_equal(episode.observations[k + 1], observation)
            assert np.isfinite(observation).all()
            assert episode.rewards[k] == reward
            assert episode.terminations[k] == terminated
            assert episode.truncations[k] == (truncated or (k == last and not terminated))


@pytest.mark.parametrize("name", OPTIONS)
def test_round_trip(name: str) -> None:
    """Stored, loaded and recovered: the same configuration, and the same numbers from a seed."""
    env = gym.make("Formation-v0", **OPTIONS[name])
    collect(env)
    data = load_dataset("formation/test-v0")
    assert data.spec.env_spec is not None
    recovered = data.recover_environment()
    assert recovered.unwrapped.config == env.unwrapped.config
    assert recovered.observation_space == env.observation_space == data.observation_space
    assert recovered.action_space == env.action_space == data.action_space
    steps = OPTIONS[name].get("max_episode_steps", env.unwrapped.config.max_steps)
    assert recovered.spec.max_episode_steps == env.spec.max_episode_steps == steps
    repeat(data, recovered)


def test_seeds_are_the_users() -> None:
    """Minari's own option, which it passes on to the environment, leaves the stream alone."""
    data = collect(gym.make("Formation-v0"), minari_autoseed=False)
    assert ["seed" in facts for facts in data.storage.get_episode_metadata(range(3))] == [
        True,
        False,
        False,
    ]
    repeat(data, data.recover_environment())


def test_infos_are_stored() -> None:
    env = gym.make("Formation-v0")
    (first, *_) = collect(env, record_infos=True).iterate_episodes()
    env.reset(seed=SEED)
    for k, action in enumerate(first.actions):
        info = env.step(action)[-1]
        assert info.keys() <= first.infos.keys()
        for name, value in info.items():
            np.testing.assert_array_equal(first.infos[name][k + 1], value)


@pytest.mark.parametrize("name", OPTIONS)
def test_spec_as_json(name: str) -> None:
    """What `gym.make` stores goes through JSON, and makes an equal environment."""
    env = gym.make("Formation-v0", **OPTIONS[name])
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.config == env.unwrapped.config
    assert again.spec.to_json() == env.spec.to_json()
