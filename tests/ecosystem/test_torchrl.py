"""TorchRL's wrappers: their specs hold, and what they return are the environments' own numbers."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from tensordict import TensorDict
from torchrl.envs import EnvBase, GymEnv, GymWrapper, MarlGroupMapType, PettingZooWrapper
from torchrl.envs.utils import check_env_specs

from formation_env import formation_v0

SEED, STEPS = 5, 12
SHORT = {"duration": 0.2}  # truncates after 10 of the 12 steps
INFO = {"slot_error", "separation", "failure", "reward_formation", "reward_effort"}
GROUPS = [None, MarlGroupMapType.ALL_IN_ONE_GROUP, MarlGroupMapType.ONE_GROUP_PER_AGENT]


def rollout(env: EnvBase, steps: int = STEPS) -> TensorDict:
    """Steps under random actions, from the seed; episodes that end are followed by others."""
    torch.manual_seed(0)
    env.set_seed(SEED)
    return env.rollout(steps, break_when_any_done=False)


def numbers(tensor: torch.Tensor, like: Any) -> None:
    """The tensor holds these numbers, rounded to its own type."""
    expected = torch.as_tensor(np.asarray(like)).to(tensor.dtype).reshape(tensor.shape)
    assert torch.equal(tensor, expected)
    assert torch.isfinite(tensor.to(torch.float64)).all()


@pytest.mark.parametrize("groups", GROUPS)
@pytest.mark.parametrize("action", ["wrench", "reference"])
def test_pettingzoo_wrapper(groups: MarlGroupMapType | None, action: str) -> None:
    def make() -> formation_v0.FormationParallelEnv:
        return formation_v0.parallel_env(action=action, followers=3, **SHORT)

    env = PettingZooWrapper(make(), return_state=True, group_map=groups)
    check_env_specs(env, seed=SEED)
    data, own = rollout(env), make()
    places = {a: (group, i) for group, all in env.group_map.items() for i, a in enumerate(all)}
    assert set(places) == set(own.possible_agents)
    own.reset(seed=SEED)  # as `set_seed` does, before the episode that is flown
    observations, infos = own.reset()
    assert data["next", "truncated"].sum() == 1
    for now in data.unbind(0):
        for agent, (group, i) in places.items():
            numbers(now[group, "observation"][i], observations[agent])
        numbers(now["state"], own.state())
        actions = {a: now[group, "action"][i].numpy() for a, (group, i) in places.items()}
        observations, rewards, terminations, truncations, infos = own.step(actions)
        after = now["next"]
        numbers(after["state"], own.state())
        for agent, (group, i) in places.items():
            numbers(after[group, "observation"][i], observations[agent])
            numbers(after[group, "reward"][i], rewards[agent])
            numbers(after[group, "terminated"][i], terminations[agent])
            numbers(after[group, "truncated"][i], truncations[agent])
            assert set(infos[agent]) >= INFO
            for name, value in infos[agent].items():
                numbers(after[group, "info", name][i], value)
        if not own.agents:
            observations, infos = own.reset()


def test_agents_that_take_turns() -> None:
    """The AEC form, whose agents act one after another."""
    env = PettingZooWrapper(formation_v0.env(**SHORT), use_mask=True)
    check_env_specs(env, seed=SEED)
    data = rollout(env, 2 * STEPS)
    assert data["next", "done"].any()
    assert data["follower_0", "mask"].any()
    assert not data["follower_0", "mask"].all()


@pytest.mark.parametrize("action", ["wrench", "reference"])
@pytest.mark.parametrize("by_name", [False, True])
def test_gym_wrapper(action: str, by_name: bool) -> None:
    """Also `GymEnv`, which finds out by a `TypeError` that there is no keyword `frameskip`."""
    options = {"action": action, **SHORT}
    env = (
        GymEnv("Formation-v0", **options)
        if by_name
        else GymWrapper(gym.make("Formation-v0", **options))
    )
    check_env_specs(env, seed=SEED)
    data, own = rollout(env), gym.make("Formation-v0", **options)
    own.reset(seed=SEED)
    observation, _ = own.reset()
    for now in data.unbind(0):
        numbers(now["observation"], observation)
        observation, reward, terminated, truncated, _ = own.step(now["action"].numpy())
        numbers(now["next", "observation"], observation)
        numbers(now["next", "reward"], reward)
        numbers(now["next", "terminated"], terminated)
        numbers(now["next", "truncated"], truncated)
        if terminated or truncated:
            observation, _ = own.reset()
    assert data["next", "truncated"].sum() == 1


def test_info_of_the_gym_wrapper() -> None:
    """Its way to carry `info`, which takes arrays and numbers."""
    env = GymWrapper(gym.make("Formation-v0", **SHORT)).auto_register_info_dict()
    check_env_specs(env, seed=SEED)
    data, own = rollout(env, 5), gym.make("Formation-v0", **SHORT)
    own.reset(seed=SEED)
    _, info = own.reset()
    for now in data.unbind(0):
        assert set(info) >= INFO | {"slots"}
        for name, value in info.items():
            numbers(now[name], value)
        info = own.step(now["action"].numpy())[-1]


def test_frame_skip() -> None:
    """TorchRL repeats the action itself, adds the rewards in float64 and rounds the sum."""
    env, own = GymEnv("Formation-v0", frame_skip=2), gym.make("Formation-v0")
    data = rollout(env, 3)
    own.reset(seed=SEED)
    own.reset()
    for now in data.unbind(0):
        rewards = [own.step(now["action"].numpy())[1] for _ in range(2)]
        numbers(now["next", "reward"], rewards[0] + rewards[1])


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.DISABLED])
def test_gym_wrapper_over_many_worlds(mode: AutoresetMode) -> None:
    """Worlds end at different steps; TorchRL puts the last observation of an episode in `next`."""
    envs = gym.make_vec("Formation-v0", num_envs=3, autoreset_mode=mode)
    env = GymWrapper(envs)
    check_env_specs(env, seed=SEED)
    data = rollout(env, 100)
    assert data.batch_size == (3, 100)
    assert not (data["next", "done"].sum(0) == 3).any(), "TorchRL would reset all once more"
    assert (data["next", "done"].sum(1) >= 1).all()
    own = gym.make_vec("Formation-v0", num_envs=3, autoreset_mode=mode)
    own.reset(seed=SEED)
    observation, _ = own.reset()
    for now in data.unbind(1):
        numbers(now["observation"], observation)
        observation, rewards, terminated, truncated, info = own.step(now["action"].numpy())
        last = observation.copy()
        if "final_obs" in info:
            last[info["_final_obs"]] = np.stack(info["final_obs"][info["_final_obs"]])
        numbers(now["next", "observation"], last)
        numbers(now["next", "reward"], rewards)
        numbers(now["next", "terminated"], terminated)
        numbers(now["next", "truncated"], truncated)
        done = terminated | truncated
        if mode is AutoresetMode.DISABLED and done.any():
            observation, _ = own.reset(options={"reset_mask": done})
