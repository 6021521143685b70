"""What is recorded is what the environment gives, and recording it changes nothing."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from replays import flown

import formation_env
from baselines import evaluate, make_policy
from baselines.own import PolicyError
from baselines.policies.expert import Expert
from baselines.policies.tuned import ExpertTuned
from baselines.registry import recipe
from baselines.replay import Episode, Recorder
from baselines.replay.lyapunov import with_record
from baselines.replay.recording import fly
from formation_env import configure, formation_v0
from formation_env.laws.tracker import TrackerLaw
from formation_env.scenarios import SCENARIOS
from formation_env.task import FAILURES
from formation_env.trajectories import line

gym.register_envs(formation_env)

ARRAYS = [name for name in Episode._fields if name not in ("policy", "seed", "config", "metrics")]


def step_through(seed: int, record: bool, **fields: Any) -> tuple[list[Any], Any]:
    """All that a Gymnasium loop with the policy `ff` sees, and its recorder."""
    env = gym.make("Formation-v0", **fields)
    policy = make_policy("ff", env.unwrapped.config)
    observation, info = env.reset(seed=seed)
    policy.reset(seed=seed)
    recorder = Recorder(env, "ff", seed) if record else None
    seen: list[Any] = [observation]
    done = False
    while not done:
        action = policy.act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        if recorder is not None:
            recorder.add(info)
        simulation = env.unwrapped.simulation
        motion = (simulation.positions[0], simulation.velocities[0], simulation.attitudes[0])
        motion += (simulation.angular_velocities[0],)
        seen.append((observation, reward, terminated, info, action, *motion))
        done = terminated or truncated
    env.close()
    return seen, recorder


@pytest.mark.parametrize("scenario", ["nominal", "paper"])
def test_a_loop_of_ones_own_is_recorded_bit_for_bit(scenario: str) -> None:
    seen, recorder = step_through(5, True, scenario=scenario, duration=2.0)
    episode = recorder.episode()
    assert episode.positions.shape == (101, 3, 3)
    for j, (_, _, _, info, action, p, v, q, w) in enumerate(seen[1:]):
        assert np.array_equal(episode.positions[j + 1], p)
        assert np.array_equal(episode.velocities[j + 1], v)
        assert np.array_equal(episode.attitudes[j + 1], q)
        assert np.array_equal(episode.angular_velocities[j + 1], w)
        assert np.array_equal(episode.slots[j + 1], info["slots"])
        assert np.array_equal(episode.actions[j], np.clip(action, -1, 1).reshape(2, 4))
        terms = sum(info[name] for name in info if name.startswith("reward_"))
        assert np.array_equal(episode.rewards[j], terms)
    assert episode.time[-1] == pytest.approx(2.0)
    assert episode.started.all() == (scenario == "nominal")


def test_recording_changes_no_number() -> None:
    watched, _ = step_through(7, True, scenario="agile", duration=2.0)
    alone, _ = step_through(7, False, scenario="agile", duration=2.0)
    for one, other in zip(watched[1:], alone[1:], strict=True):
        for x, y in zip(one, other, strict=True):
            if isinstance(x, dict):
                assert all(np.array_equal(x[name], y[name]) for name in x)
            else:
                assert np.array_equal(x, y)


@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
def test_all_faces_record_the_same(action: str) -> None:
    config = configure("nominal", action=action, duration=1.0)
    expected = fly(recipe("ff", config), config, 5, "ff")
    _, recorder = step_through(5, True, action=action, duration=1.0)
    parallel = formation_v0.parallel_env(action=action, duration=1.0)
    policy = make_policy("ff", config)
    observations, _ = parallel.reset(seed=5)
    policy.reset(seed=5)
    other = Recorder(parallel, "ff", 5)
    while parallel.agents:
        rows = policy.act(np.stack(list(observations.values())))
        actions = dict(zip(parallel.agents, rows, strict=True))
        observations, _, _, _, infos = parallel.step(actions)
        other.add(infos)
    for episode in (recorder.episode(), other.episode()):
        for name in ARRAYS:
            assert np.array_equal(getattr(episode, name), getattr(expected, name)), name
        assert episode.metrics == pytest.approx(expected.metrics, nan_ok=True)
        assert (episode.policy, episode.seed, episode.config) == ("ff", 5, config)


@pytest.mark.parametrize("policy", ["expert", "expert-tuned", "random"])
def test_score_and_figures_are_those_of_the_evaluation(policy: str) -> None:
    episode = flown(policy, 3, scenario="nominal", duration=2.0)
    config = {"scenario": "nominal", "duration": 2.0}
    report = evaluate(policy, {"short": config}, episodes=1, seed=3, threads=1, quiet=True)
    (columns,) = report.scenarios["short"].results[policy].runs.values()
    for name, value in episode.metrics.items():
        assert value == pytest.approx(columns[name][0], rel=1e-12, nan_ok=True), name


def test_a_failure_is_told() -> None:
    episode = flown("random", 0, scenario="paper", duration=40.0)
    assert FAILURES[episode.failure.max()] in episode.end()
    assert f"at {episode.time[-1]:.2f} s" in episode.end()
    assert "follower" in episode.end()
    assert episode.metrics["failed"] == 1.0
    assert len(episode.time) == len(episode.actions) + 1 < 200
    assert "random on paper:wrench, seed 0, 2 followers" in repr(episode)
    assert flown().end() == "no failure"


# -- Lyapunov functions -----------------------------------------------------------------------------


def v_sigma(e1: np.ndarray, e2: np.ndarray, law: TrackerLaw) -> float:
    """(55) as printed, by matrices."""
    x = law.k1 * e1 + law.k2 * e2
    sigma = law.sigma_max * x / np.sqrt(law.c + x**2)
    P = np.block(
        [
            [law.p11 * np.eye(3), -law.p12 * np.eye(3)],
            [-law.p12 * np.eye(3), law.p22 * np.eye(3)],
        ]
    )
    both = np.concatenate([sigma, e2])
    integral = law.sigma_max * (np.sqrt(law.c + x**2) - np.sqrt(law.c))
    return float(0.5 * both @ P @ both + integral.sum())


@pytest.mark.parametrize("action", ["wrench", "rates"])
def test_lyapunov_functions_are_the_papers(action: str) -> None:
    """Of the errors that the expert records at every decision, in a flight that is flown beside."""
    config = configure("paper", action=action, duration=1.0)
    episode = fly(recipe("expert", config), config, 3, "expert")
    env = gym.make("Formation-v0", scenario="paper", action=action, duration=1.0)
    expert = Expert(config, keep_record=True)
    observation, _ = env.reset(seed=3)
    expert.reset(seed=3)
    law = config.world.tracker if action == "wrench" else config.world.rates_tracker
    assert len(episode.lyapunov) == 50
    for V in episode.lyapunov:
        action_now = expert.act(observation)
        e = {name: rows[0] for name, rows in expert.record.items()}
        for i in range(2):
            half = {name: 0.5 * float(rows[i] @ rows[i]) for name, rows in e.items()}
            V1 = half["planner_e1"]
            V3 = v_sigma(e["tracker_e1"][i], e["tracker_e2"][i], law) + half["tracker_e3"]
            expected = (V1, V1 + half["planner_e2"], V3, V3 + half["tracker_e4"])
            np.testing.assert_allclose(V[i], expected, rtol=1e-9, atol=1e-12)
        observation = env.step(action_now)[0]
    env.close()


def test_v4_falls_where_nothing_disturbs() -> None:
    """Theorem 2, at every tick: along a straight line at constant speed the jerk and snap that the expert
    takes as zero are zero. Its virtual followers begin with null errors (II-E) and keep them there."""
    V = flown("expert", 3, gust=0.0, path="as given", trajectory=line(), start_offset=0.1).lyapunov
    assert (np.diff(V[..., 3], axis=0) < 0.0).all()
    assert V[..., :2].max() < 1e-12
    assert V[..., 3].min() > 1e-5


def test_the_tuned_expert_is_recorded_with_its_own_gains() -> None:
    config = configure("nominal", duration=1.0)
    plain, recorded = ExpertTuned(config), with_record(ExpertTuned(config))
    assert isinstance(recorded, Expert)
    env = gym.make("Formation-v0", duration=1.0)
    observation, _ = env.reset(seed=1)
    plain.reset(seed=1)
    recorded.reset(seed=1)
    for _ in range(50):
        action = plain.act(observation)
        assert np.array_equal(action, recorded.act(observation))
        observation = env.step(action)[0]
    env.close()
    assert len(flown("expert-tuned", 3, scenario="nominal", duration=2.0).lyapunov) == 100
    assert flown("ff", 3).lyapunov.shape == (0, 2, 4)


# -- refusals ---------------------------------------------------------------------------------------


def test_what_cannot_be_recorded_is_refused() -> None:
    env = gym.make("Formation-v0", duration=1.0)
    with pytest.raises(ValueError, match=r"call reset\(\) before Recorder"):
        Recorder(env)
    env.reset(seed=0)
    for wrong in (gym.make("CartPole-v1"), None, 3):
        with pytest.raises(ValueError, match=r"env = .*an environment of one world"):
            Recorder(wrong)
    envs = gym.make_vec("Formation-v0", num_envs=2, duration=1.0)
    with pytest.raises(ValueError, match="an environment of one world"):
        Recorder(envs)
    envs.close()
    with pytest.raises(ValueError, match="policy = 3: expected a name"):
        Recorder(env, 3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="seed = -1"):
        Recorder(env, seed=-1)
    recorder = Recorder(env)
    with pytest.raises(ValueError, match="nothing was recorded"):
        recorder.episode()
    info = env.step(env.action_space.sample() * 0)[4]
    for wrong in (None, {}, {"slot_error": 0}, {**info, "slots": "x"}, {"a": 1}):
        with pytest.raises(ValueError, match="expected the info of a step"):
            recorder.add(wrong)
    recorder.add(info)
    with pytest.raises(ValueError, match="0 ticks since the last"):
        recorder.add(info)
    for _ in range(2):
        info = env.step(env.action_space.sample() * 0)[4]
    with pytest.raises(ValueError, match="2 ticks since the last"):
        recorder.add(info)
    env.reset()
    with pytest.raises(ValueError, match=r"-\d+ ticks since the last"):
        recorder.add(info)
    env.close()


class Broken:
    """A policy that fails in flight."""

    def reset(self, seed: int) -> None:
        pass

    def act(self, observation: np.ndarray) -> np.ndarray:
        raise RuntimeError("no more")


def test_a_policy_of_ones_own_that_fails_is_named() -> None:
    config = configure("nominal", duration=1.0)
    with pytest.raises(PolicyError, match="policy Broken: RuntimeError: no more"):
        fly(recipe(Broken, config), config, 0, "Broken")


def test_every_scenario_is_recorded() -> None:
    for scenario in SCENARIOS:
        episode = flown("hover", 1, scenario=scenario, duration=0.5)
        assert episode.config.scenario == scenario
        assert np.isfinite(episode.path).all()
        assert len(episode.path) > 1
