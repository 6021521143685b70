"""The bridge from many worlds to Stable-Baselines3: a row for each follower."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from episodes import same

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # their own, at import
    for module in ("torch", "stable_baselines3", "tensorboard", "tyro"):
        pytest.importorskip(module)
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from baselines.policies.expert import Expert
from formation_env import formation_v0
from formation_env.task import REWARD
from formation_env.vector import FormationVectorEnv
from train.vec import FollowerVecEnv

WORLDS = 5


def actions(ticks: int, rows: int, size: int = 4) -> np.ndarray[Any, Any]:
    return np.random.default_rng(1).uniform(-1.3, 1.3, (ticks, rows, size)).astype(np.float32)


@pytest.mark.parametrize("scenario", ["nominal", "paper"])
def test_the_bridge_is_the_vector_environment(scenario: str) -> None:
    """The same numbers as SAME_STEP gives, a row per follower; failures and time limits both occur."""
    options: dict[str, Any] = {"duration": 0.8, "start": "formation"}
    rows = FollowerVecEnv(scenario, WORLDS, seed_offset=100, **options)
    envs = FormationVectorEnv(WORLDS, scenario, autoreset_mode="SAME_STEP", **options)
    rows.seed(3)
    n, entries = rows.followers, rows.entries
    first = envs.reset(seed=103)[0]
    assert same(rows.reset(), first.reshape(WORLDS * n, entries))
    ends = set()
    for act in actions(120, WORLDS * n):
        act[: 2 * n] *= 0.01  # two worlds reach the time limit
        seen, reward, done, infos = rows.step(act)
        obs, mean, terminated, truncated, info = envs.step(act.reshape(WORLDS, -1))
        assert same(seen, obs.reshape(WORLDS * n, entries))
        assert np.array_equal(done, np.repeat(terminated | truncated, n))
        assert reward.dtype == np.float32
        assert np.allclose(reward.reshape(WORLDS, n).mean(1), mean, atol=1e-6)
        for row in range(WORLDS * n):
            world, follower = divmod(row, n)
            if not done[row]:
                assert infos[row] == {}
                continue
            last = info["final_obs"][world].reshape(n, entries)[follower]
            assert same(infos[row]["terminal_observation"], last)
            late = bool(truncated[world] and not terminated[world])
            assert infos[row]["TimeLimit.truncated"] == late
            ends.add(late)
    assert ends == {True, False}


def test_rewards_are_each_followers_own() -> None:
    env = FollowerVecEnv("nominal", 2, reward_scale=0.5)
    other = FormationVectorEnv(2, "nominal", autoreset_mode="DISABLED")
    env.seed(0)
    env.reset()
    other.reset(seed=0)
    act = actions(1, 4)[0]
    own = other.simulation.step(act.reshape(2, 2, 4)).outputs[..., REWARD]
    assert len(np.unique(own)) == 4
    assert np.array_equal(env.step(act)[1], (0.5 * own).astype(np.float32).ravel())


def test_arrays_and_infos_are_fresh() -> None:
    """SB3 writes into the rewards that it is given."""
    envs = [FollowerVecEnv("nominal", 2, history=2, duration=0.1) for _ in range(2)]
    for env in envs:
        env.seed(0)
    spoiled, _ = (env.reset() for env in envs)
    spoiled[:] = np.nan
    for act in actions(12, 4):
        seen, rewards, dones, infos = envs[0].step(act)
        assert all(
            same(a, b)
            for a, b in zip((seen, rewards, dones, infos), envs[1].step(act), strict=True)
        )
        for info in infos:
            for value in info.values():
                if isinstance(value, np.ndarray):
                    value[:] = np.nan
            info.clear()
        seen[:], rewards[:], dones[:] = np.nan, np.nan, True


def test_history_repeats_the_first_and_ends_with_the_newest() -> None:
    plain, deep = (FollowerVecEnv("nominal", 3, history=k, duration=0.1) for k in (1, 3))
    for env in (plain, deep):
        env.seed(5)
    rows = [plain.reset()] * 3
    assert same(deep.reset(), np.concatenate(rows, axis=1))
    for act in actions(12, 6):
        seen, _, dones, infos = plain.step(act)
        stack, _, _, deep_infos = deep.step(act)
        rows = [*rows[1:], seen]
        if dones.any():
            last = np.stack([i["terminal_observation"] for i in infos])
            ended = np.stack([i["terminal_observation"] for i in deep_infos])
            assert same(ended, np.concatenate([*rows[:2], last], axis=1))
            rows = [seen] * 3
        assert same(stack, np.concatenate(rows, axis=1))


def test_the_central_critic_is_given_the_state() -> None:
    """As PettingZoo has it, also of the last tick of an episode."""
    env = FollowerVecEnv("paper", 1, critic="central", duration=0.1)
    parallel = formation_v0.parallel_env(scenario="paper", duration=0.1)
    env.seed(7)
    seen = env.reset()
    parallel.reset(seed=7)
    for act in actions(5, 2):
        assert np.array_equal(seen[:, env.local_size :], np.stack([parallel.state()] * 2))
        seen, _, done, infos = env.step(act)
        parallel.step(dict(zip(parallel.possible_agents, act, strict=True)))
    assert done.all()
    assert np.array_equal(infos[1]["terminal_observation"][env.local_size :], parallel.state())


def test_a_residual_of_nothing_is_the_expert() -> None:
    """Also in worlds that begin anew one by one."""
    options: dict[str, Any] = {"duration": 0.3, "stagger": True}
    under = FollowerVecEnv("paper", WORLDS, residual=0.2, **options)
    plain = FollowerVecEnv("paper", WORLDS, **options)
    expert = Expert(plain.config)
    for env in (under, plain):
        env.seed(1)
    seen = under.reset()
    assert same(seen, plain.reset())
    expert.reset(worlds=WORLDS)
    begun = 0
    for _ in range(40):
        act = expert.act(seen.reshape(WORLDS, 2, -1)).reshape(-1, 4)
        seen, _, done, _ = plain.step(act)
        assert same(under.step(np.zeros_like(act))[0], seen)
        ended = done[::2]
        expert.restart(ended)
        begun += 0 < ended.sum() < WORLDS
    assert begun > 2


def test_staggered_worlds_end_apart_and_as_if_at_the_time_limit() -> None:
    env = FollowerVecEnv("nominal", 64, duration=1.0, stagger=True)
    env.seed(0)
    env.reset()
    when: list[set[int]] = [set() for _ in range(64)]
    for tick in range(1, 101):
        _, _, dones, infos = env.step(np.zeros((128, 4), dtype=np.float32))
        for row in np.flatnonzero(dones):
            assert infos[row]["TimeLimit.truncated"]
            when[row // 2].add(tick)
    first = [min(each) for each in when]
    assert len(set(first)) > 25 and max(first) <= 50
    assert all(tick + 50 in each or tick > 50 for each in when for tick in each)


def test_the_rest_of_the_interface() -> None:
    env = FollowerVecEnv("nominal", 2)
    assert env.get_attr("render_mode") == [None] * 4
    assert [c.followers for c in env.get_attr("config", indices=[1, 2])] == [2, 2]
    env.set_attr("remark", "x")
    assert env.get_attr("remark", indices=0) == ["x"]
    env.reset()
    assert len(env.env_method("get_state", indices=[0])) == 1
    assert env.env_is_wrapped(VecMonitor) == [False] * 4
    assert env.get_images() == [None, None]
    drawn = FollowerVecEnv("nominal", 2, render_mode="rgb_array")
    drawn.reset()
    frames = drawn.get_images()
    assert len(frames) == 2 and frames[0] is not None and frames[0].ndim == 3
    env.close()


@pytest.mark.parametrize(
    ("option", "value"),
    [("history", 0), ("residual", 1.5), ("critic", "global"), ("worlds", 0)],
)
def test_the_bridge_refuses(option: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{option} = "):
        FollowerVecEnv("nominal", **{option: value})


def test_wrappers_and_seeds_of_the_library() -> None:
    """Two runs with a seed are the same bit for bit, another seed is another."""

    def trained(seed: int) -> dict[str, torch.Tensor]:
        env = VecNormalize(VecMonitor(FollowerVecEnv("nominal", 4, duration=0.2)))
        model = PPO(
            "MlpPolicy", env, n_steps=16, batch_size=64, n_epochs=2, seed=seed, device="cpu"
        )
        model.learn(512)
        assert len(model.ep_info_buffer or ()) > 0
        weights: dict[str, torch.Tensor] = model.policy.state_dict()
        return weights

    one, again, other = trained(0), trained(0), trained(1)
    assert all(torch.equal(one[name], again[name]) for name in one)
    assert not torch.equal(one["action_net.weight"], other["action_net.weight"])


def test_a_state_of_the_bridge_continues_identically() -> None:
    options: dict[str, Any] = {"history": 2, "residual": 0.3, "stagger": True, "duration": 0.3}
    env, other = (FollowerVecEnv("paper", 4, **options) for _ in range(2))
    env.reset()
    acts = actions(20, 8)
    for act in acts:
        env.step(act)
    other.set_state(env.get_state())
    for act in acts:
        ours, theirs = env.step(act), other.step(act)
        assert all(same(a, b) for a, b in zip(ours, theirs, strict=True))
    with pytest.raises(ValueError, match="fit"):
        FollowerVecEnv("paper", 3, **options).set_state(env.get_state())
