"""Stable-Baselines3 takes the Gymnasium face as it is."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from episodes import LEVELS, SCENARIOS, same

from formation_env import configure  # which registers the id

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # torch's own, at import
    pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.env_checker import check_env
    from stable_baselines3.common.env_util import make_vec_env

    from train.vec import FollowerVecEnv


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


# -- the bridge with a row per follower -----------------------------------------------------------


def test_an_unknown_keyword_of_the_bridge_is_a_type_error() -> None:
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip': known are") as e:
        FollowerVecEnv(frameskip=4)
    assert "reward_scale" in str(e.value)
    with pytest.raises(TypeError, match="'max_cycles': PettingZoo"):
        FollowerVecEnv(max_cycles=4)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("worlds", 2.0),
        ("history", True),
        ("history", 10**9),
        ("residual", "0.5"),
        ("residual", np.nan),
        ("critic", ["central"]),
        ("stagger", 1),
        ("reward_scale", np.inf),
        ("reward_scale", 1e300),
        ("seed_offset", -1),
        ("threads", 0),
    ],
)
def test_the_bridge_names_an_impossible_number(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{name} = "):
        FollowerVecEnv("nominal", **{"worlds": 2, name: value})


def test_the_bridge_refuses_what_would_do_nothing() -> None:
    rows = FollowerVecEnv("nominal", 2)
    for name, value in (("config", configure("paper")), ("render_mode", "human"), ("num_envs", 9)):
        with pytest.raises(AttributeError, match="is fixed: make a new environment"):
            rows.set_attr(name, value)
        with pytest.raises(AttributeError, match="is fixed: make a new environment"):
            setattr(rows, name, value)
    for options in ({"nonsense": 1}, [{}, {"nonsense": 1}], 5):
        with pytest.raises(ValueError, match=r"options.* known keys: none"):
            rows.set_options(options)
    rows.set_options({})
    rows.set_options()
    for seed in (1.9, True, "1", -1):
        with pytest.raises(ValueError, match=r"^seed = .*: expected an integer of at least 0"):
            rows.seed(seed)  # type: ignore[arg-type]


def test_actions_of_the_bridge_are_an_array_of_numbers() -> None:
    rows = FollowerVecEnv("nominal", 2)
    rows.reset()
    for actions in (np.zeros((4, 3)), np.zeros((4, 4), bool), [["0"] * 4] * 4, np.zeros((2, 8))):
        with pytest.raises(ValueError, match=r"^actions has "):
            rows.step(actions)  # type: ignore[arg-type]


def test_a_central_critic_sees_numbers_whatever_is_flown() -> None:
    """Bodies that a tumble takes beyond what can be computed, as the last observation shows."""
    rod = {"inertia": (1e-12, 4.3121e-8, 4.3122e-8), "thrust_max": 9.81}
    rod["moment_max"] = (3.8e-9, 4.3121e-8, 4.3122e-4)
    rows = FollowerVecEnv("paper", 17, critic="central", vehicle=rod)
    observed = rows.reset()
    draw = np.random.default_rng(0)
    lost = 0
    for _ in range(60):
        assert all(rows.observation_space.contains(row) for row in observed)
        observed, _, _, infos = rows.step(draw.choice([-1.0, 1.0], (34, 4)).astype(np.float32))
        for info in infos:
            if "terminal_observation" in info:
                assert rows.observation_space.contains(info["terminal_observation"])
                lost += 1
    assert lost


def test_a_spoiled_state_of_the_bridge_is_refused() -> None:
    rows = FollowerVecEnv("nominal", 2, history=2)
    rows.reset()
    state = rows.get_state()
    spoiled: list[Any] = [
        None,
        {**state, "left": None},
        {**state, "last": np.full_like(state["last"], np.nan)},
        {**state, "stack": state["stack"][:1]},
        {**state, "left": state["left"].astype(np.float64)},
        {**state, "elsewhere.last": state["last"]},
    ]
    for bad in spoiled:
        with pytest.raises(ValueError, match=r"^state"):
            rows.set_state(bad)
        assert same(rows.get_state(), state)
