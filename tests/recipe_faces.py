"""Run in a process of its own, on a copy of the package: a recipe's effect, seen from all three faces.

    python recipe_faces.py RECIPE ...

What each function asserts is what its recipe in CONTRIBUTING.md promises.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import formation_env
from baselines import make_policy
from formation_env import FormationConfig, configure, formation_v0
from formation_env.env import FormationEnv
from formation_env.paths.references import by_name
from train.scales import fixed_scales

Array = Any
CHECKS: dict[str, Callable[[], None]] = {}


def recipe(name: str) -> Callable[[Callable[[], None]], Callable[[], None]]:
    """Mark the check of the recipe with that heading."""

    def mark(check: Callable[[], None]) -> Callable[[], None]:
        CHECKS[name] = check
        return check

    return mark


def fly(ticks: int, action: Any, /, **task: Any) -> tuple[Array, dict[str, Array]]:
    """Observation rows `(followers, entries)` and `info` after some ticks: the same on all faces, asserted.

    `action` is one follower's, for all of them and all ticks.
    """
    one = np.asarray(action, dtype=np.float32)
    faces = [_gymnasium(ticks, one, task), _vector(ticks, one, task), _pettingzoo(ticks, one, task)]
    rows, info = faces[0]
    assert np.isfinite(rows).all()
    for other, told in faces[1:]:
        np.testing.assert_array_equal(rows, other)
        assert set(told) == set(info)
        for name in info:
            np.testing.assert_array_equal(info[name], told[name])
    return rows, info


def _gymnasium(ticks: int, action: Array, task: dict[str, Any]) -> tuple[Array, dict[str, Array]]:
    env = gym.make("Formation-v0", **task)
    n = env.unwrapped.config.followers  # type: ignore[attr-defined]
    observation, info = env.reset(seed=1)
    for _ in range(ticks):
        observation, reward, _, _, info = env.step(np.tile(action, n))
        assert env.observation_space.contains(observation)
        assert np.isclose(float(reward), sum(terms(info).values()).mean())
    return observation.reshape(n, -1), {**terms(info), "slot_error": info["slot_error"]}


def _vector(ticks: int, action: Array, task: dict[str, Any]) -> tuple[Array, dict[str, Array]]:
    envs = gym.make_vec("Formation-v0", num_envs=2, vectorization_mode="vector_entry_point", **task)
    n = envs.unwrapped.config.followers  # type: ignore[attr-defined]
    observation, info = envs.reset(seed=[1, 2])
    for _ in range(ticks):
        observation, _, _, _, info = envs.step(np.tile(action, (2, n)))
        assert envs.observation_space.contains(observation)
    told = {**terms(info), "slot_error": info["slot_error"]}
    return observation[0].reshape(n, -1), {name: value[0] for name, value in told.items()}


def _pettingzoo(ticks: int, action: Array, task: dict[str, Any]) -> tuple[Array, dict[str, Array]]:
    env = formation_v0.parallel_env(**task)
    observations, infos = env.reset(seed=1)
    for _ in range(ticks):
        observations, _, _, _, infos = env.step(dict.fromkeys(env.agents, action))
        assert all(env.observation_space(a).contains(x) for a, x in observations.items())
    each = [{**terms(infos[a]), "slot_error": infos[a]["slot_error"]} for a in env.agents]
    named = {name: np.array([one[name] for one in each]) for name in each[0]}
    return np.stack([observations[agent] for agent in env.agents]), named


def terms(info: dict[str, Any]) -> dict[str, Any]:
    """The terms of the reward."""
    return {name: value for name, value in info.items() if name.startswith("reward_")}


def named(rows: Array, **task: Any) -> dict[str, Array]:
    """Entries of observation rows by name."""
    return configure(**task).layout.unpack(rows)


def goes_round(**task: Any) -> None:
    """A configuration's JSON form gives it back."""
    config = configure(**task)
    assert FormationConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def refused(message: str, **task: Any) -> None:
    """A value is refused, by name."""
    with pytest.raises(ValueError, match=re.escape(message)):
        configure(**task)


def continues(**task: Any) -> None:
    """A state that was taken goes on identically."""
    one, two = FormationEnv(**task), FormationEnv(**task)
    one.reset(seed=3)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.5, 0.5, (8, one.action_space.shape[0])).astype(np.float32)
    for action in actions[:4]:
        one.step(action)
    two.set_state(one.get_state())
    for action in actions[4:]:
        np.testing.assert_array_equal(one.step(action)[0], two.step(action)[0])


def manual(*texts: str) -> None:
    """The manual says these."""
    for text in texts:
        assert text in (FormationEnv.__doc__ or ""), f"not in the manual: {text}"


HOVER = (0.0, 0.0, 0.0, 0.0)


@recipe("Reward term")
def reward_term() -> None:
    close = {"start_offset": 0.0}
    _, info = fly(1, HOVER, **close)
    assert (info["reward_close"] == 0.5).all()
    _, less = fly(1, HOVER, reward={"close": 0.25}, **close)
    assert (less["reward_close"] == 0.25).all()
    _, far = fly(1, HOVER, reward={"precision": 1e-3})
    assert (far["reward_close"] == 0.0).all()
    _, waits = fly(1, HOVER, start="ground", reward={"precision": 1e3})
    assert (waits["reward_close"] == 0.0).all()
    goes_round(reward={"close": 0.25})
    refused("reward.close = -1", reward={"close": -1.0})
    manual("| `reward_close` | after the trigger: the weight", "| close 0.5 |")


@recipe("Observation entry")
def observation_entry() -> None:
    rows, _ = fly(1, HOVER)
    assert named(rows)["uprightness"].shape == (2, 1)
    assert (named(rows)["uprightness"] > 0.999).all()
    rows, _ = fly(10, (0.0, 0.5, 0.0, 0.0))
    entries = named(rows)
    np.testing.assert_allclose(entries["uprightness"][:, 0], entries["body_z"][:, 2], rtol=1e-6)
    assert (entries["uprightness"] < 0.999).all()
    mean, scale = fixed_scales(configure().layout)
    assert len(mean) == len(scale) == rows.shape[1]
    assert named(scale)["uprightness"] == np.float32(0.05)
    manual("| 34 | `uprightness` | 1 | inertial | r3 . k, 1 when level | 1 |")
    assert_expert_keeps_its_slot()


def assert_expert_keeps_its_slot() -> None:
    """It finds its entries, wherever they lie."""
    env = FormationEnv()
    policy = make_policy("expert", env.config)
    observation, _ = env.reset(seed=1)
    policy.reset(1)
    for _ in range(150):
        observation, _, over, _, info = env.step(policy.act(observation))
        assert not over
    assert (np.linalg.norm(info["slot_error"], axis=1) < 0.2).all()


@recipe("Law and gain")
def law_and_gain() -> None:
    task: dict[str, Any] = {"action": "reference", "noise": {"attitude": 0.1}}
    pushed = (0.0, 0.8, 0.0)
    without, _ = fly(10, pushed, **task)
    nothing, _ = fly(10, pushed, tracker={"k_psi": 0.0}, **task)
    yawing, _ = fly(10, pushed, tracker={"k_psi": 5.0}, **task)
    np.testing.assert_array_equal(without, nothing)
    before, after = (named(x, **task)["angular_velocity"][:, 2] for x in (without, yawing))
    assert (np.abs(before) < 1e-4).all() and (np.abs(after) > 1e-3).all()
    goes_round(tracker={"k_psi": 5.0})
    refused("tracker.k_psi = -1", tracker={"k_psi": -1.0})


@recipe("Trajectory family")
def trajectory_family() -> None:
    task = {"trajectory": {"path": "approach", "distance": 4.0, "rate": 0.3}, "gust": 0.0}
    rows, _ = fly(25, HOVER, **task)
    v = named(rows, **task)["leader_velocity"]
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), 4.0 * 0.3 * np.exp(-0.3 * 0.5), rtol=1e-3)
    path = configure(**task).trajectory
    times = np.linspace(0.0, 10.0, 2001)
    flown = list(by_name(path(times)).values())
    for function, derivative in pairwise(flown):
        slope = np.gradient(function, times, axis=0)
        np.testing.assert_allclose(slope[1:-1], derivative[1:-1], atol=1e-5)
    assert path.to_dict()["kind"] == "approach"
    goes_round(**task)
    refused("rate = -1", trajectory={"path": "approach", "rate": -1.0})
    refused("table[0] (rate) = 0", trajectory={"name": "x", "kind": "approach", "table": [0.0] * 7})
    refused("table = 3 numbers", trajectory={"name": "x", "kind": "approach", "table": [1.0] * 3})
    refused("velocity", trajectory={"path": "approach", "distance": 5e3, "rate": 1.0})


@recipe("Virtual vehicle")
def virtual_vehicle() -> None:
    task = {"action": "smooth", "start_offset": 0.0}
    first, _ = fly(1, (1.0, 0.0, 0.0), **task)
    later, _ = fly(20, (1.0, 0.0, 0.0), **task)
    sharp, _ = fly(20, (1.0, 0.0, 0.0), action="reference", start_offset=0.0)
    assert first.shape == sharp.shape
    ahead = [named(x, **task)["guide_velocity"][:, 0] for x in (first, later, sharp)]
    assert (ahead[0] < 0.02).all() and (ahead[0] < ahead[1]).all() and (ahead[1] < ahead[2]).all()
    waiting, _ = fly(3, (1.0, 0.0, 0.0), action="smooth", start="ground")
    entries = named(waiting, action="smooth")
    own = entries["leader_velocity"] - entries["relative_velocity"]
    np.testing.assert_allclose(entries["guide_velocity"], -own, atol=1e-6)
    manual('| `"smooth"` | 3 |', 'only with `action="smooth"`: virtual')
    continues(**task)
    goes_round(**task)


@recipe("Action level")
def action_level() -> None:
    task = {"action": "rotors"}
    same, _ = fly(5, (0.1, 0.1, 0.1, 0.1), **task)
    lifted, _ = fly(5, (0.1, 0.0, 0.0, 0.0))
    entry = configure().layout.slices["previous_action"]
    shown = np.ones(same.shape[1], bool)
    shown[entry] = False
    np.testing.assert_allclose(same[:, shown], lifted[:, shown], atol=1e-5)
    rolled, _ = fly(5, (0.1, -0.1, -0.1, 0.1), **task)
    wrench, _ = fly(5, (0.0, 0.1, 0.0, 0.0))
    np.testing.assert_allclose(rolled[:, shown], wrench[:, shown], atol=1e-5)
    level, world = configure(**task).level, configure(**task).world
    decode, encode = (getattr(f, "py_func", f) for f in (level.decode, level.encode))
    asked = (0.3, -0.2, 0.5, -0.7)
    np.testing.assert_allclose(encode(decode(asked, world), world.reach), asked, atol=1e-12)
    continues(**task)
    refused("'rotors'", action="sails")
    manual('| `"rotors"` | 4 | thrusts of four rotors |')


@recipe("Sensor")
def sensor() -> None:
    quiet, _ = fly(3, (0.5, 0.0, 0.0, 0.0))
    entries = named(quiet)
    np.testing.assert_allclose(entries["height"][:, 0], -entries["position"][:, 2], rtol=1e-6)
    noisy = {"noise": {"height": 0.3}}
    for more in ({}, {"measurement_delay": 2}, {"measurement_period": 0.04}):
        task = {**noisy, **more}
        rows, _ = fly(5, (0.5, 0.0, 0.0, 0.0), **task)
        entries = named(rows, **task)
        apart = np.abs(entries["height"][:, 0] + entries["position"][:, 2])
        assert (apart > 1e-4).all() and (apart < 3.0).all()
    rows, _ = fly(10, HOVER, scenario="experiment", start="formation")
    entries = named(rows, scenario="experiment")
    np.testing.assert_allclose(entries["height"][:, 0], -entries["position"][:, 2], atol=1e-3)
    refused("noise.height = -1", noise={"height": -1.0})
    manual("| 34 | `height` | m | inertial |")
    goes_round(**noisy)
    continues(**noisy)


@recipe("Disturbance")
def disturbance() -> None:
    alone = {"trajectory": "hover", "offsets": ((0.6, 0.0, 0.0),), "gust": 0.0}
    calm, _ = fly(50, HOVER, **alone)
    task = {**alone, "wind": 1.0}
    blown, _ = fly(50, HOVER, **task)
    moved = named(blown, **task)["position"] - named(calm, **task)["position"]
    # The second integral of 1 - exp(-t / 2 s), for 1 s.
    np.testing.assert_allclose(moved[:, 0], -(0.5 - 2.0 + 4.0 * (1.0 - np.exp(-0.5))), atol=0.01)
    np.testing.assert_allclose(moved[:, 1:], 0.0, atol=1e-5)
    both, _ = fly(5, HOVER, gust=1.0, wind=1.0)
    gusty, _ = fly(5, HOVER, gust=1.0)
    assert (named(both)["position"][:, 0] < named(gusty)["position"][:, 0]).all()
    refused("wind = -1", wind=-1.0)
    goes_round(wind=1.0)
    continues(wind=1.0)


if __name__ == "__main__":
    print(formation_env.__file__)
    for name in sys.argv[1:]:
        CHECKS[name]()
