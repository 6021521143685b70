"""PPO on many worlds: the networks, the files, and that a run can be stopped anywhere."""

from __future__ import annotations

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

    from train.ppo.run import Run
    from train.ppo.start import prepare

from ppo_runs import shorten_evaluations, small

from baselines.files import load
from baselines.files import save as save_policy
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned
from baselines.policies.transfer import transfer_unwarned
from formation_env import configure
from formation_env.vector import FormationVectorEnv
from train import checkpoint
from train.log import HEADER
from train.margin import with_margin
from train.ppo.networks import ObservationMoments
from train.ppo.options import Options
from train.seeds import TRAINING_SEEDS


@pytest.fixture(autouse=True)
def _short_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten_evaluations(monkeypatch)


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
