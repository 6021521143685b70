"""`spec` says how long an episode is and goes round through JSON to an equal environment."""

from __future__ import annotations

import copy
import json
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from episodes import same
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RecordEpisodeStatistics, TimeAwareObservation

from formation_env import Limits, Noise, Vehicle, configure, formation_v0, trajectories
from formation_env.env import FormationEnv
from formation_env.vector import FormationVectorEnv

ID = "formation_env:Formation-v0"

# What holds of some ways to say how long an episode is.
LENGTHS: list[tuple[dict[str, Any], int]] = [
    ({}, 1500),
    ({"scenario": "paper"}, 2250),
    ({"scenario": "experiment"}, 1980),
    ({"scenario": configure("agile", duration=3.0)}, 150),
    ({"duration": 2.0}, 100),
    ({"duration": 60.0}, 3000),
    ({"duration": 2.0, "control_period": 0.04}, 50),
    ({"max_episode_steps": 30}, 30),
    ({"max_episode_steps": 1000}, 1000),
    ({"duration": 2.0, "max_episode_steps": 30}, 30),
]


def length(env: gym.Env[Any, Any]) -> int:
    """Steps of an episode that nothing else ends."""
    env.reset(seed=0)
    for k in range(1, 5000):
        if env.step(np.zeros(env.action_space.shape, np.float32))[3]:
            return k
    raise AssertionError("the episode was not truncated")


@pytest.mark.parametrize(("options", "steps"), LENGTHS, ids=repr)
def test_the_spec_says_how_long_an_episode_is(options: dict[str, Any], steps: int) -> None:
    env = gym.make(ID, **options)
    assert env.spec is not None and env.spec.max_episode_steps == steps
    envs = gym.make_vec(ID, num_envs=2, **options)
    assert envs.spec is not None and envs.spec.max_episode_steps == steps
    if "max_episode_steps" not in options:
        assert env.unwrapped.spec is not None and env.unwrapped.spec.max_episode_steps == steps
        assert gym.make(ID, max_episode_steps=-1, **options).spec.max_episode_steps == steps  # type: ignore[union-attr]


@pytest.mark.parametrize("options", [{"duration": 0.2}, {"max_episode_steps": 10}], ids=repr)
def test_the_episode_is_as_long_as_the_spec_says(options: dict[str, Any]) -> None:
    env = gym.make(ID, **options)
    assert length(env) == env.spec.max_episode_steps == 10  # type: ignore[union-attr]
    envs = gym.make_vec(ID, num_envs=2, **options)
    envs.reset(seed=0)
    late = [envs.step(np.zeros((2, 8), np.float32))[3].all() for _ in range(10)]
    assert late == [False] * 9 + [True]


def test_no_wrapper_is_added_for_it() -> None:
    """The environment keeps the time itself."""
    env: Any = gym.make(ID, disable_env_checker=True)
    assert isinstance(env.env, FormationEnv)  # within OrderEnforcing alone


def test_wrappers_that_look_for_the_limit_find_it() -> None:
    env = RecordEpisodeStatistics(TimeAwareObservation(gym.make(ID, duration=0.1)))
    obs, _ = env.reset(seed=0)
    assert obs in env.observation_space and env.get_wrapper_attr("max_timesteps") == 5
    for _ in range(5):
        obs, _, _, truncated, info = env.step(np.zeros(8, np.float32))
        assert obs in env.observation_space
    assert truncated and info["episode"]["l"] == 5


@pytest.mark.parametrize(
    ("options", "steps", "most"),
    [({}, 3000, 1500), ({"duration": 2.0}, 101, 100), ({"scenario": "paper"}, 2251, 2250)],
    ids=repr,
)
def test_a_limit_beyond_the_duration_is_refused(
    options: dict[str, Any], steps: int, most: int
) -> None:
    message = f"max_episode_steps = {steps}: expected at most {most}, the steps of duration"
    for mode in (None, "sync"):
        with pytest.raises(ValueError, match=message):
            gym.make_vec(ID, vectorization_mode=mode, max_episode_steps=steps, **options)
    with pytest.raises(ValueError, match=message):
        gym.make(ID, max_episode_steps=steps, **options)
    with pytest.raises(ValueError, match=message.replace("max_episode_steps", "max_cycles")):
        formation_v0.parallel_env(max_cycles=steps, **options)


def test_what_the_refusal_says_works() -> None:
    with pytest.raises(ValueError, match=r"give duration=60 as well"):
        gym.make(ID, max_episode_steps=3000)
    spec = gym.make(ID, max_episode_steps=3000, duration=60).spec
    assert spec is not None and spec.max_episode_steps == 3000


def test_the_limit_of_a_spec_counts_too() -> None:
    spec = gym.make(ID).spec
    assert spec is not None
    with pytest.raises(ValueError, match="max_episode_steps = 1500: expected at most 500"):
        gym.make(spec, duration=10.0)
    assert gym.make(spec, duration=10.0, max_episode_steps=500).spec.max_episode_steps == 500  # type: ignore[union-attr]


def test_pettingzoos_limit_may_be_set_but_not_beyond_the_duration() -> None:
    """PettingZoo's own test sets it to 1000 whatever the environment."""
    env = formation_v0.parallel_env(duration=0.1)
    assert env.max_cycles == 5
    env.max_cycles = 3
    assert env.max_cycles == 3
    with pytest.warns(UserWarning, match="max_cycles = 1000: episodes end after 5 steps"):
        env.max_cycles = 1000
    assert env.max_cycles == 5


# -- JSON -------------------------------------------------------------------------------------------

KEYWORDS: list[dict[str, Any]] = [
    {},
    {"scenario": "paper", "followers": 3, "action": "rates"},
    {"offsets": np.array([[0.35, 0.2, -0.35], [0.35, -0.2, -0.95]])},
    {"offsets": ((0.35, 0.2, -0.35), (0.35, -0.2, -0.95)), "path": "as given"},
    {"trajectory": trajectories.circle(radius=2.0, speed=0.5)},
    {"trajectory": trajectories.hover()},
    {"scenario": configure("paper", action="reference", gust=0.1)},
    {"scenario": configure("agile", followers=3), "duration": 4.0},
    {"duration": np.float64(3.0), "neighbours": np.int8(1), "substeps": np.uint16(5)},
    {"noise": Noise(0.01, 0.02, 0.0, 0.0, 0.0), "gust": np.float32(0.25)},
    {"limits": Limits(collision=0.1, impact=2.0, tilt=0.5, lost=5.0, deadline=9.0)},
    {"vehicle": Vehicle(mass=0.05)},
    {"vehicle": {"mass": 0.05}, "noise": {"position": 0.01}},
    {"max_episode_steps": 40, "render_mode": "rgb_array"},
]


def round_trip(spec: EnvSpec | None) -> EnvSpec:
    assert spec is not None
    text = spec.to_json()
    json.loads(text, parse_constant=pytest.fail)  # no NaN, no Infinity: strict JSON
    return EnvSpec.from_json(text)


@pytest.mark.parametrize("options", KEYWORDS, ids=lambda options: ",".join(options))
def test_a_spec_goes_round_through_json(options: dict[str, Any]) -> None:
    env = gym.make(ID, **options)
    again = gym.make(round_trip(env.spec))
    assert again.unwrapped.config == env.unwrapped.config  # type: ignore[attr-defined]
    assert again.spec.max_episode_steps == env.spec.max_episode_steps  # type: ignore[union-attr]
    assert again.render_mode == env.render_mode
    assert round_trip(again.spec) == round_trip(env.spec)
    assert same(again.reset(seed=3), env.reset(seed=3))


@pytest.mark.parametrize("options", KEYWORDS, ids=lambda options: ",".join(options))
def test_so_does_that_of_many_worlds(options: dict[str, Any]) -> None:
    envs: Any = gym.make_vec(
        ID, num_envs=3, autoreset_mode=AutoresetMode.SAME_STEP, threads=np.int64(2), **options
    )
    again: Any = gym.make_vec(round_trip(envs.spec))
    assert isinstance(again, FormationVectorEnv)
    assert (again.config, again.num_envs) == (envs.config, 3)
    assert again.autoreset_mode == AutoresetMode.SAME_STEP
    assert again.spec.max_episode_steps == envs.spec.max_episode_steps
    assert same(again.reset(seed=3), envs.reset(seed=3))


def test_a_spec_survives_a_copy_and_prints() -> None:
    env = gym.make(ID, vehicle=Vehicle(mass=0.05))
    for copied in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert copied.spec == env.spec
    assert env.spec is not None
    text = env.spec.pprint(disable_print=True, print_all=True)
    assert text is not None and "max_episode_steps=1500" in text
    assert "Formation-v0" in str(env)
