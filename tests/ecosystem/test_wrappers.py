"""Wrappers of Gymnasium and SuperSuit, and the environments of skrl and tianshou."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import supersuit
import torch
from gymnasium.wrappers import NormalizeObservation, RecordEpisodeStatistics, TimeAwareObservation
from gymnasium.wrappers import vector as vector_wrappers
from pettingzoo.test import parallel_api_test
from skrl.envs.wrappers.torch import wrap_env
from tianshou.data import Batch
from tianshou.env import DummyVectorEnv, PettingZooEnv

from formation_env import formation_v0

SEED = 3
SHORT = {"duration": 0.2}  # 10 steps


def zeros(env: formation_v0.FormationParallelEnv) -> dict[str, Any]:
    return {agent: np.zeros_like(env.action_space(agent).low) for agent in env.agents}


def test_time_aware_observation() -> None:
    """It reads the time limit from the spec."""
    env = TimeAwareObservation(gym.make("Formation-v0", **SHORT), flatten=True, normalize_time=True)
    own = gym.make("Formation-v0", **SHORT)
    observation, _ = env.reset(seed=SEED)
    expected, _ = own.reset(seed=SEED)
    for step in range(11):
        np.testing.assert_array_equal(observation[:-1], expected)
        assert observation[-1] == np.float32(step / 10)
        if step < 10:
            observation, _, _, truncated, _ = env.step(np.zeros_like(env.action_space.low))
            expected, *_ = own.step(np.zeros_like(own.action_space.low))
    assert truncated


@pytest.mark.parametrize("limit", [None, 7])
def test_record_episode_statistics(limit: int | None) -> None:
    env = RecordEpisodeStatistics(gym.make("Formation-v0", max_episode_steps=limit, **SHORT))
    env.reset(seed=SEED)
    total, truncated = 0.0, False
    while not truncated:
        _, reward, _, truncated, info = env.step(np.zeros_like(env.action_space.low))
        total += reward
    assert info["episode"]["l"] == (limit or 10)
    assert info["episode"]["r"] == pytest.approx(total)


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP", "DISABLED"])
def test_statistics_of_many_worlds(mode: str) -> None:
    envs = gym.make_vec("Formation-v0", num_envs=3, autoreset_mode=mode, **SHORT)
    wrapped = vector_wrappers.RecordEpisodeStatistics(
        vector_wrappers.RescaleAction(envs, np.float32(-2.0), np.float32(2.0))
    )
    own = gym.make_vec("Formation-v0", num_envs=3, autoreset_mode=mode, **SHORT)
    wrapped.reset(seed=SEED)
    own.reset(seed=SEED)
    action = np.full(own.action_space.shape, 0.01, np.float32)
    total = np.zeros(3)
    for _ in range(10):
        *_, info = wrapped.step(2.0 * action)
        _, rewards, _, truncated, _ = own.step(action)
        total += rewards
    assert truncated.all()
    np.testing.assert_allclose(info["episode"]["r"], total)
    np.testing.assert_array_equal(info["episode"]["l"], [10, 10, 10])


def test_info_as_a_list() -> None:
    envs = vector_wrappers.DictInfoToList(gym.make_vec("Formation-v0", num_envs=3))
    own = gym.make_vec("Formation-v0", num_envs=3)
    _, infos = envs.reset(seed=SEED)
    _, expected = own.reset(seed=SEED)
    names = {name for name in expected if not name.startswith("_")}
    for world, info in enumerate(infos):
        assert set(info) == names
        for name in names:
            np.testing.assert_array_equal(info[name], expected[name][world])


def test_normalized_observations() -> None:
    env = NormalizeObservation(gym.make("Formation-v0"))
    observation, _ = env.reset(seed=SEED)
    assert np.isfinite(observation).all()
    envs = vector_wrappers.NormalizeObservation(gym.make_vec("Formation-v0", num_envs=2))
    observations, _ = envs.reset(seed=SEED)
    assert np.isfinite(observations).all()


def test_black_death() -> None:
    """SuperSuit steps on with no actions after the end, and fills in zeros."""
    env = supersuit.black_death_v3(formation_v0.parallel_env(**SHORT))
    parallel_api_test(supersuit.black_death_v3(formation_v0.parallel_env(**SHORT)), 30)
    own = formation_v0.parallel_env(**SHORT)
    observations, _ = env.reset(seed=SEED)
    expected, _ = own.reset(seed=SEED)
    for _ in range(10):
        actions = zeros(own)
        observations, rewards, *_ = env.step(actions)
        expected, own_rewards, *_ = own.step(actions)
        assert rewards == own_rewards
        for agent, observation in expected.items():
            np.testing.assert_array_equal(observations[agent], observation)
    after = env.step({agent: np.zeros_like(env.action_space(agent).low) for agent in actions})
    assert all((observation == 0.0).all() for observation in after[0].values())


def test_frame_skip() -> None:
    """SuperSuit draws how many frames it skips from the environment's `np_random`."""
    env = supersuit.frame_skip_v0(formation_v0.parallel_env(**SHORT), (2, 3))
    env.reset(seed=SEED)
    observations, rewards, *_ = env.step(zeros(env.unwrapped))
    own = formation_v0.parallel_env(**SHORT)
    own.reset(seed=SEED)
    steps = [own.step(zeros(own)) for _ in range(2)]
    for agent, observation in steps[-1][0].items():
        np.testing.assert_array_equal(observations[agent], observation)
        assert rewards[agent] == pytest.approx(steps[0][1][agent] + steps[1][1][agent])


def test_skrl_parallel() -> None:
    """skrl's wrapper, and the state of centralised critics."""
    own = formation_v0.parallel_env(**SHORT)
    env = wrap_env(formation_v0.parallel_env(**SHORT), wrapper="pettingzoo")
    assert env.possible_agents == own.possible_agents
    assert all(env.state_space(agent) == own.state_space for agent in env.possible_agents)
    env.reset()
    own.reset()
    state = env.state()
    for agent in env.possible_agents:
        assert state[agent].shape == (1, *own.state_space.shape)
        assert torch.isfinite(state[agent]).all()
    actions = {a: torch.zeros(1, *env.action_space(a).shape) for a in env.possible_agents}
    for _ in range(10):
        observations, rewards, _, truncated, _ = env.step(actions)
        assert all(torch.isfinite(o).all() for o in observations.values())
        assert all(torch.isfinite(r).all() for r in rewards.values())
    assert all(bool(t) for t in truncated.values())


@pytest.mark.parametrize("worlds", [None, 3])
def test_skrl_gymnasium(worlds: int | None) -> None:
    made = (
        gym.make("Formation-v0")
        if worlds is None
        else gym.make_vec("Formation-v0", num_envs=worlds)
    )
    env = wrap_env(made, wrapper="gymnasium")
    assert env.num_envs == (worlds or 1)
    env.reset()
    observations, rewards, *_ = env.step(torch.zeros(env.num_envs, *env.action_space.shape))
    assert observations.shape == (env.num_envs, *env.observation_space.shape)
    assert rewards.shape == (env.num_envs, 1)
    assert torch.isfinite(observations).all()


def test_tianshou() -> None:
    """The agents take turns; the rewards of all come with each turn."""
    own = formation_v0.env(**SHORT)
    own.reset(seed=SEED)
    envs = DummyVectorEnv([lambda: PettingZooEnv(formation_v0.env(**SHORT)) for _ in range(2)])
    observations, _ = envs.reset(seed=SEED)
    for _ in range(len(own.agents) * 10):
        agent = own.agent_selection
        expected = own.last()[0]
        assert observations[0]["agent_id"] == agent
        np.testing.assert_array_equal(observations[0]["obs"], expected)
        action = np.zeros(own.action_space(agent).shape, np.float32)
        observations, rewards, _, truncated, _ = envs.step(np.stack([action, action]))
        own.step(action)
        np.testing.assert_allclose(rewards[0], [own.rewards[a] for a in own.possible_agents])
    assert truncated.all()
    assert Batch(observations[0]).obs.dtype == np.float32
