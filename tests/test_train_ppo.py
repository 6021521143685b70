"""PPO on many worlds: the bridge, the networks, the files, and that a run can be stopped anywhere."""

from __future__ import annotations

import errno
import os
import signal
import sys
import warnings
from dataclasses import replace
from pathlib import Path
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

    import train.ppo.run
    import train.ppo.start
    from train.ppo.run import Run
    from train.ppo.start import prepare

from baselines.files import load
from baselines.files import save as save_policy
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned
from baselines.policies.transfer import transfer_unwarned
from formation_env import configure, formation_v0
from formation_env.task import REWARD
from formation_env.vector import FormationVectorEnv
from train import checkpoint, ppo
from train.log import HEADER
from train.margin import with_margin
from train.ppo.networks import ObservationMoments
from train.ppo.options import Options
from train.seeds import TRAINING_SEEDS
from train.vec import FollowerVecEnv

WORLDS = 5


def actions(ticks: int, rows: int, size: int = 4) -> np.ndarray[Any, Any]:
    return np.random.default_rng(1).uniform(-1.3, 1.3, (ticks, rows, size)).astype(np.float32)


# -- the bridge -----------------------------------------------------------------------------------


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


# -- a run ----------------------------------------------------------------------------------------


def small(folder: Path, **options: Any) -> Options:
    """A run of seconds: 4 updates of 128 agent steps."""
    usual: dict[str, Any] = {
        "action": "reference",
        "steps": 512,
        "worlds": 8,
        "rollout": 8,
        "batch": 64,
        "epochs": 2,
        "hidden": (8,),
        "evaluate_every": 256,
        "episodes": 2,
        "threads": 1,
        "quiet": True,
    }
    return Options(output=folder, **{**usual, **options})


def words(options: Options) -> list[str]:
    """As on a command line."""
    return [
        *options.command().split()[1:],
        "--output",
        str(options.output),
        "--quiet",
        "--threads",
        "1",
    ]


def files(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir()) if p.is_file()}


@pytest.fixture(autouse=True)
def _short_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Episodes of a fraction of a second, for the task itself too."""

    def config(self: Options) -> Any:
        given: dict[str, Any] = {} if self.action is None else {"action": self.action}
        return configure(self.scenario, duration=0.4, **given)

    monkeypatch.setattr(Options, "config", config)


def test_worlds_have_the_margin_and_evaluations_have_not(tmp_path: Path) -> None:
    """Where sensors are exact, unless it is switched off; the card says which."""
    for margin in (True, False):
        run = prepare(small(tmp_path / str(margin), margin=margin))
        task = run.options.config()
        assert run.evaluator.config == task
        assert run.env.config == (with_margin(task) if margin else task)
        assert (run.env.config == task) != margin
        assert run.policy_file()[0].margin == margin


def numbers(run: Run) -> dict[str, Any]:
    """All that decides how a run goes on."""
    run.save(run.record)
    return checkpoint.load(run.options.output / checkpoint.NAME)[1]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"history": 3, "critic": "central"},
        {"scenario": "paper", "action": "wrench", "residual": 0.2},
        {"normalise": "running", "start_offset": 0.1, "scenario_duration": 0.2},
        {"activation": "relu", "std": 0.1, "critic_steps": 128, "action": "rates"},
        {"actor_rate": 0.1, "critic_steps": 128, "kl": 1e-3},
    ],
    ids=["plain", "history-central", "residual", "running", "relu", "slow-actor"],
)
def test_a_resumed_run_is_an_uninterrupted_one(tmp_path: Path, options: dict[str, Any]) -> None:
    """To the last bit: weights, moments, worlds, generators."""
    whole = prepare(small(tmp_path / "whole", **options))
    whole.train()
    halved = prepare(small(tmp_path / "halved", **options))
    halved.train(stop=lambda: halved.model.num_timesteps >= 256)
    assert checkpoint.load(tmp_path / "halved" / checkpoint.NAME)[0]["steps"] == 256
    resumed = prepare(small(tmp_path / "halved", **options, resume=True))
    assert resumed.model.num_timesteps == 256
    resumed.train()
    assert resumed.model.num_timesteps == 512
    one, two = numbers(whole), numbers(resumed)
    assert one.keys() == two.keys()
    assert [name for name in one if one[name].tobytes() != two[name].tobytes()] == []
    for name in ("best.safetensors", "last.safetensors"):
        (card, net), (other, same_net) = (load(tmp_path / f / name) for f in ("whole", "halved"))
        assert all(same(a, b) for a, b in zip(net, same_net, strict=True))
        assert card.score == other.score and card.steps == other.steps
    logs = [(tmp_path / f / "log.csv").read_text().splitlines() for f in ("whole", "halved")]
    assert logs[0][0] + "\n" == HEADER
    drop = [[line.split(",")[:1] + line.split(",")[2:] for line in log] for log in logs]
    assert drop[0] == drop[1] and [row[0] for row in drop[0][1:]] == ["0", "256", "512"]


@pytest.mark.parametrize("options", [{}, {"history": 3}, {"residual": 0.2}, {"critic": "central"}])
def test_the_file_acts_as_the_network(tmp_path: Path, options: dict[str, Any]) -> None:
    run = prepare(small(tmp_path, **options))
    run.train()
    with torch.no_grad():  # larger actions than at the start
        run.policy.action_net.weight.mul_(30.0)
    card, net = run.policy_file()
    assert card.package and card.method == ("residual" if "residual" in options else "ppo")
    env = run.env
    with transfer_unwarned():  # of the margin
        pilot, expert = Learned(env.config, (card, net)), Expert(env.config)
    env.seed(11)
    seen = env.reset()
    pilot.reset(worlds=env.worlds)
    expert.reset(worlds=env.worlds)
    for _ in range(10):
        wanted = run.model.predict(seen, deterministic=True)[0]
        rows = seen[:, env.local_size - env.entries : env.local_size].reshape(
            env.worlds, env.followers, -1
        )
        got = pilot.act(rows)
        below = expert.act(rows)
        executed = wanted.reshape(got.shape)
        if card.residual:
            executed = np.clip(below + card.residual * executed, -1.0, 1.0)
        assert np.abs(got - executed).max() < 1e-5
        assert np.abs(wanted).max() > 0.01
        seen, _, done, _ = env.step(wanted)
        pilot.restart(done[:: env.followers])
        expert.restart(done[:: env.followers])


def test_a_run_starts_from_a_file(tmp_path: Path) -> None:
    """With its actor, to rounding, and little exploration; at first the critic alone learns."""
    prepare(small(tmp_path / "one", history=2, activation="relu", hidden=(8, 4))).train()
    source = tmp_path / "one" / "last.safetensors"
    net = load(source)[1]
    run = prepare(small(tmp_path / "two", init=source, critic_steps=256))
    assert (run.options.history, run.options.activation, run.options.hidden) == (2, "relu", (8, 4))
    assert float(run.policy.log_std.detach().exp().max()) == pytest.approx(0.06)
    before = run.policy.mlp_extractor.value_net[0].weight.detach().clone()
    run.train(stop=lambda: run.model.num_timesteps >= 256)
    assert not torch.equal(before, run.policy.mlp_extractor.value_net[0].weight)
    card_now, now = run.policy_file()
    assert card_now.method == "ppo" and card_now.history == 2
    for a, b in zip((*net.weights, *net.biases), (*now.weights, *now.biases), strict=True):
        assert np.allclose(a, b, rtol=1e-6)
    source.unlink()  # it is not needed again
    run = prepare(Options(tmp_path / "two", resume=True, quiet=True))
    run.train()
    assert not np.allclose(net.weights[0], run.policy_file()[1].weights[0], rtol=1e-6)


def test_the_actor_may_learn_slower_than_the_critic(tmp_path: Path) -> None:
    """Adam's first step moves everything by the learning rate, and the actor by its part of it."""
    for part in (1.0, 0.1):
        once = {"steps": 10**6, "epochs": 1, "batch": 128, "actor_rate": part}
        run = prepare(small(tmp_path / str(part), **once))
        towers = run.policy.mlp_extractor
        weights = (towers.value_net[0].weight, towers.policy_net[0].weight)
        before = [w.detach().clone() for w in weights]
        run.train(stop=lambda run=run: run.model.num_timesteps > 0)  # type: ignore[misc]
        moved = [(w - b).abs().max().item() for w, b in zip(weights, before, strict=True)]
        assert moved == pytest.approx([1e-3, part * 1e-3], rel=0.05)


def test_the_actors_rate_follows_how_far_updates_go(tmp_path: Path) -> None:
    """Too far by far at first, so that it falls by the same factor again and again."""
    run = prepare(small(tmp_path, kl=1e-6, learning_rate=0.1, critic_steps=128))
    assert run.model.actor_rate == 1.0
    run.train()
    assert run.model.actor_rate == pytest.approx(1.5**-3)
    group = run.policy.optimizer.param_groups
    assert group[0]["lr"] == pytest.approx(group[1]["lr"] * 1.5**-2)
    slow = prepare(small(tmp_path / "slow", kl=0.5, actor_rate=1e-4))
    slow.train()
    assert slow.model.actor_rate == pytest.approx(1.5**4 * 1e-4)


def test_how_far_updates_should_go_falls_with_the_learning_rate(tmp_path: Path) -> None:
    """What is right at the start is too far at the end, where the rate is a tenth."""
    run = prepare(small(tmp_path, kl=1e-3, actor_rate=0.5))
    for left, expected in ((1.0, 0.5), (0.0, 0.5 / 1.5)):
        run.model._current_progress_remaining = left
        run.model._adapt_actor_rate(1e-3)
        assert run.model.actor_rate == pytest.approx(expected)
    run.model._adapt_actor_rate(1e-4)
    assert run.model.actor_rate == pytest.approx(0.5 / 1.5)


def test_a_correction_of_a_file_goes_by_that_files_name(tmp_path: Path) -> None:
    """And keeps its bound; one from nothing, and one of that, are plain corrections."""
    prepare(small(tmp_path / "one", residual=0.3)).train()
    source = tmp_path / "one" / "last.safetensors"
    assert load(source)[0].method == "residual"
    assert prepare(small(tmp_path / "two", init=source)).policy_file()[0].method == "residual"
    card, net = load(source)
    save_policy(source, replace(card, method="residual-dagger"), net)
    made, _ = prepare(small(tmp_path / "three", init=source)).policy_file()
    assert (made.method, made.residual) == ("residual-dagger-ppo", 0.3)


def test_the_actor_does_not_see_the_state_and_the_critic_does(tmp_path: Path) -> None:
    run = prepare(small(tmp_path, critic="central"))
    env = run.env
    assert env.observation_space.shape == (env.entries + 13 * 3 + 3 * 2 + 1,)
    seen = torch.from_numpy(env.reset()).requires_grad_()
    dist = run.policy.get_distribution(seen)
    dist.distribution.mean.sum().backward()
    assert seen.grad is not None
    assert (seen.grad[:, env.local_size :] == 0.0).all() and (
        seen.grad[:, : env.local_size] != 0.0
    ).any()
    seen.grad = None
    run.policy.predict_values(seen).sum().backward()
    assert (seen.grad[:, env.local_size :] != 0.0).any() and (
        seen.grad[:, : env.local_size] != 0.0
    ).any()


def test_training_seeds_are_nobody_elses(tmp_path: Path) -> None:
    run = prepare(small(tmp_path, seed=3))
    envs = FormationVectorEnv(8, run.env.config, autoreset_mode="DISABLED")
    seen = envs.reset(seed=TRAINING_SEEDS + 3 * 8 + 3)[0]
    assert same(run.env.reset(), seen.reshape(16, -1))


def test_running_mean_and_variance() -> None:
    rows = np.random.default_rng(0).normal(3.0, 2.0, (100, configure().layout.size))
    moments = ObservationMoments(configure().layout)
    for part in np.split(rows, [7, 60]):
        moments.add(part)
    mean, scale = moments.scales()
    assert np.allclose(mean, rows.mean(0), atol=1e-5)
    position = configure().layout.slices["slot_error"]
    assert np.allclose(scale[position], rows.std(0)[position], atol=1e-5)
    assert (scale[configure().layout.slices["position"]] == 10.0).all(), "a tenth of the fixed one"


# -- what goes wrong ------------------------------------------------------------------------------


def test_a_full_disk_is_one_error_and_earlier_files_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    prepare(small(tmp_path)).train()
    before = files(tmp_path)
    assert set(before) == {"best.safetensors", "last.safetensors", "log.csv", checkpoint.NAME}

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    run = prepare(small(tmp_path, resume=True, steps=1024))
    monkeypatch.setattr(train.ppo.start, "prepare", lambda options: run)
    monkeypatch.setattr(os, "fsync", full)
    status = ppo.main([*words(small(tmp_path, steps=1024)), "--resume"])
    assert status == 1
    told = capsys.readouterr().err
    assert "No space left on device" in told and "earlier files are intact" in told
    assert told.count("\n") == 1 and "Traceback" not in told
    assert files(tmp_path) == before


def test_an_interruption_while_compiling_ends_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is lost then, so nothing is waited for: Ctrl-C is not put off until an update is over."""

    def interrupt(*args: Any) -> None:
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        raise KeyboardInterrupt

    monkeypatch.setattr(train.ppo.run, "Evaluator", interrupt)
    assert ppo.main(["--output", str(tmp_path / "run"), "--quiet"]) == 130
    assert "interrupted: nothing was written" in capsys.readouterr().err
    assert not (tmp_path / "run" / "checkpoint.safetensors").exists()


def test_an_interruption_saves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    score_network = train.ppo.run.Evaluator.score_network
    calls = []

    def interrupted(self: Any, *policy_file: Any) -> Any:
        calls.append(None)
        if len(calls) == 2:
            signal.raise_signal(signal.SIGINT)
        return score_network(self, *policy_file)

    monkeypatch.setattr(train.ppo.run.Evaluator, "score_network", interrupted)
    handler = signal.getsignal(signal.SIGINT)
    assert ppo.main(words(small(tmp_path, steps=10_000))) == 130
    assert "--resume" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is handler
    facts = checkpoint.load(tmp_path / checkpoint.NAME)[0]
    assert facts["steps"] == 384, "after the update in hand"
    assert ppo.main(["--output", str(tmp_path), "--resume", "--steps", "512", "--quiet"]) == 0
    assert load(tmp_path / "last.safetensors")[0].steps == 512


def test_a_time_limit_ends_a_run(tmp_path: Path) -> None:
    run = prepare(small(tmp_path, steps=10**9, minutes=0.02))
    run.train()
    assert run.model.num_timesteps < 10**7
    assert load(tmp_path / "last.safetensors")[0].minutes >= 0.02


def test_the_command_says_what_it_reached(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ppo.main([w for w in words(small(tmp_path)) if w != "--quiet"]) == 0
    said = capsys.readouterr()
    assert "after 512 agent steps" in said.out
    assert "Warning" not in said.err


def test_the_profile_adds_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ppo.main([*words(small(tmp_path)), "--profile"]) == 0
    lines = [line.rsplit(" s ", 1) for line in capsys.readouterr().out.splitlines()]
    parts = [float(head.split()[-1]) for head, _ in lines[:-1]]
    assert len(parts) == 7 and min(parts) >= 0.0
    assert sum(parts) == pytest.approx(float(lines[-1][0].split()[-2]), abs=0.05)


@pytest.mark.parametrize("missing", ["tyro", "stable_baselines3", "torch", "tensorboard"])
def test_a_missing_extra_is_named(
    missing: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in list(sys.modules):
        if name.startswith("train.") and name != "train.ppo":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    assert ppo.main(["--output", "nowhere"]) == 2
    told = capsys.readouterr().err
    assert 'pip install "formation-env[train]"' in told and missing in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    "wrong",
    [
        ["--scenario", "nowhere"],
        ["--action", "telepathy"],
        ["--worlds", "0"],
        ["--gamma", "1.5"],
        ["--residual", "-1"],
        ["--history", "two"],
        ["--start-offset", "-1"],
        ["--scenario-duration", "-1"],
        ["--init", "nothing.safetensors"],
        ["--resume"],
        ["--frobnicate"],
    ],
    ids=lambda wrong: wrong[0],
)
def test_an_impossible_option(
    wrong: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "new"
    try:
        status = ppo.main(["--output", str(folder), "--steps", "64", *wrong])
    except SystemExit as stopped:
        status = stopped.code if isinstance(stopped.code, int) else -1
    assert status == 2
    told = capsys.readouterr().err
    assert "Traceback" not in told and told.strip()
    assert not folder.exists()


def test_a_run_is_not_overwritten_and_keeps_its_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prepare(small(tmp_path)).train()
    before = files(tmp_path)
    assert ppo.main(words(small(tmp_path))) == 2
    assert "--resume" in capsys.readouterr().err
    assert ppo.main([*words(small(tmp_path, history=2)), "--resume"]) == 2
    assert "--history 2: the run was started with 1" in capsys.readouterr().err
    data = (tmp_path / checkpoint.NAME).read_bytes()
    for bad in (data[:1000], b"", before["last.safetensors"]):
        (tmp_path / checkpoint.NAME).write_bytes(bad)
        assert ppo.main([*words(small(tmp_path)), "--resume"]) == 2
        assert "not a checkpoint" in capsys.readouterr().err


def test_a_policy_of_another_action_level_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prepare(small(tmp_path / "one")).train()
    source = tmp_path / "one" / "last.safetensors"
    assert ppo.main([*words(small(tmp_path / "two", action="rates")), "--init", str(source)]) == 2
    assert "action level 'reference': the configuration has 'rates'" in capsys.readouterr().err
    assert not (tmp_path / "two").exists()
