"""Wrong actions, seeds, masks and states, and calls out of order: refused, and nothing is changed."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from episodes import LEVELS, gentle, same
from gymnasium.error import ResetNeeded

from formation_env import (
    configure,
    formation_v0,
    trajectories,
)
from formation_env.env import FormationEnv
from formation_env.vector import FormationVectorEnv

# -- actions --------------------------------------------------------------------------------------------

SPOILED = [
    (nan, "expected finite numbers"),
    (inf, "expected finite numbers"),
    (-inf, "expected finite numbers"),
]


def poisoned(size: int, where: int, value: float) -> np.ndarray:
    action = np.zeros(size, np.float32)
    action[where] = value
    return action


def wrong(size: int) -> list[tuple[Any, str]]:
    """Things that are not an action of `size` numbers, and what is said of them."""
    return [
        (np.zeros(size - 1, np.float32), "shape"),
        (np.zeros(size + 1, np.float32), "shape"),
        (np.zeros((1, size), np.float32), "shape"),
        (np.float32(0.0), "shape"),
        ([], "shape"),
        (np.zeros(size, np.complex64), "dtype"),
        (np.zeros(size, bool), "dtype"),
        (np.zeros(size, object), "dtype"),
        (["0"] * size, "dtype"),
        ("up", "dtype"),
        (None, "dtype"),
        ({"follower_0": 0.0}, "dtype"),
    ]


@pytest.mark.parametrize("level", LEVELS)
def test_a_bad_action_changes_nothing(level: str) -> None:
    """The state stays to the last bit, and the flight goes on as if nothing had been asked."""
    env, twin = FormationEnv("paper", action=level), FormationEnv("paper", action=level)
    k = env.config.action_size
    env.reset(seed=0), twin.reset(seed=0)
    bad: list[tuple[Any, str]] = wrong(2 * k)
    for value, message in SPOILED:
        bad.append((poisoned(2 * k, 0, value), f"follower_0 .*{message}"))
        bad.append((poisoned(2 * k, 2 * k - 1, value), f"follower_1 .*{message}"))
        bad.append((poisoned(2 * k, k, value).astype(np.float64), f"follower_1 .*{message}"))
    for action, (refused, message) in zip(gentle(len(bad), 2 * k), bad, strict=True):
        before = env.get_state().state
        with pytest.raises(ValueError, match=message):
            env.step(refused)
        assert same(env.get_state().state, before)
        assert same(env.step(action), twin.step(action))


def test_the_agent_is_named() -> None:
    env, twin = formation_v0.parallel_env(), formation_v0.parallel_env()
    env.reset(seed=0), twin.reset(seed=0)
    good = np.zeros(4, np.float32)
    cases: list[tuple[Any, str]] = [
        ({"follower_0": good}, r"actions for \['follower_0'\]: expected one for each of"),
        ({"follower_0": good, "follower_2": good}, "follower_2"),
        ({"follower_0": good, "follower_1": good, "leader": good}, "leader"),
        ({}, r"actions for \[\]"),
        ({0: good, "follower_1": good}, "actions for"),
        (np.zeros((2, 4), np.float32), "ndarray"),
        (None, "NoneType"),
        ({"follower_0": good, "follower_1": poisoned(4, 2, nan)}, "follower_1 .*finite"),
        ({"follower_0": poisoned(4, 0, inf), "follower_1": good}, "follower_0 .*finite"),
    ]
    cases += [
        ({"follower_0": good, "follower_1": bad}, f"follower_1 .*{why}") for bad, why in wrong(4)
    ]
    for refused, message in cases:
        before = env.get_state().state
        with pytest.raises(ValueError, match=message):
            env.step(refused)
        assert same(env.get_state().state, before)
        acts = {"follower_0": good, "follower_1": good}
        assert same(env.step(acts), twin.step(acts))


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP", "DISABLED"])
def test_the_world_is_named(mode: str) -> None:
    env, twin = (
        FormationVectorEnv(4, autoreset_mode=mode),
        FormationVectorEnv(4, autoreset_mode=mode),
    )
    env.reset(seed=0), twin.reset(seed=0)
    good = np.zeros((4, 8), np.float32)
    spoiled = good.copy()
    spoiled[2, 5] = nan
    cases: list[tuple[Any, str]] = [(spoiled, "follower_1 of world 2 .*finite")]
    cases += [(np.zeros((4, 7), np.float32), "shape"), (np.zeros(8, np.float32), "shape")]
    cases += [(np.zeros((4, 2, 4), np.float32), "shape"), ([["x"] * 8] * 4, "dtype")]
    for refused, message in cases:
        before = env.get_state().state
        with pytest.raises(ValueError, match=message):
            env.step(refused)
        assert same(env.get_state().state, before)
        assert same(env.step(good), twin.step(good))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_finite_action_is_clipped(level: str, kind: type) -> None:
    one, two = FormationEnv(action=level), FormationEnv(action=level)
    one.reset(seed=0), two.reset(seed=0)
    large = 1e300 if kind is np.float64 else 3e38  # the first is infinite as a float32
    size = one.action_space.shape[0]
    action = np.resize(np.array([1.5, -large, 0.25, large, -1.0], kind), size)
    for _ in range(3):
        clipped = np.clip(action, -1.0, 1.0).astype(np.float32)
        assert same(one.step(action), two.step(clipped))


def test_whole_numbers_are_an_action() -> None:
    one, two = FormationEnv(), FormationEnv()
    one.reset(seed=0), two.reset(seed=0)
    whole = [1, 0, 0, 0, -1, 0, 0, 5]
    expected = two.step(np.array(whole, np.float32))
    assert same(one.step(whole), expected)


# -- order of calls -------------------------------------------------------------------------------------


def test_nothing_steps_before_a_reset() -> None:
    single, parallel, many = FormationEnv(), formation_v0.parallel_env(), FormationVectorEnv(2)
    with pytest.raises(ResetNeeded, match="reset"):
        single.step(np.zeros(8, np.float32))
    with pytest.raises(ResetNeeded, match="reset"):
        parallel.step(dict.fromkeys(parallel.possible_agents, np.zeros(4, np.float32)))
    with pytest.raises(ResetNeeded, match="reset"):
        parallel.state()
    with pytest.raises(ResetNeeded, match="reset"):
        many.step(np.zeros((2, 8), np.float32))
    with pytest.raises(ResetNeeded, match="reset"):
        FormationEnv(render_mode="rgb_array").render()
    with pytest.raises(ResetNeeded):
        gym.make("Formation-v0").step(np.zeros(8, np.float32))


def test_nothing_steps_after_the_end() -> None:
    single, parallel = FormationEnv(duration=0.04), formation_v0.parallel_env(max_cycles=2)
    many = FormationVectorEnv(3, max_episode_steps=2, autoreset_mode="DISABLED")
    single.reset(seed=0), parallel.reset(seed=0), many.reset(seed=0)
    acts = dict.fromkeys(parallel.possible_agents, np.zeros(4, np.float32))
    for _ in range(2):
        single.step(np.zeros(8, np.float32))
        parallel.step(acts)
        many.step(np.zeros((3, 8), np.float32))
    assert parallel.agents == []
    with pytest.raises(ResetNeeded, match="over"):
        single.step(np.zeros(8, np.float32))
    with pytest.raises(ResetNeeded, match="over"):
        parallel.step(acts)
    many.reset(options={"reset_mask": np.array([True, False, True])})
    before = many.get_state().state
    with pytest.raises(ResetNeeded, match=r"worlds \[1\]"):
        many.step(np.zeros((3, 8), np.float32))
    assert same(many.get_state().state, before)


# -- resets, states -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "mask",
    [
        np.zeros(3, bool),
        np.ones(2, bool),
        np.ones(3, np.int64),
        [True, False, True],
        np.ones((3, 1), bool),
        None,
        "all",
    ],
    ids=repr,
)
def test_a_bad_reset_mask(mask: Any) -> None:
    envs = FormationVectorEnv(3)
    envs.reset(seed=0)
    before = envs.get_state().state
    with pytest.raises(ValueError, match="reset_mask"):
        envs.reset(seed=5, options={"reset_mask": mask})
    assert same(envs.get_state().state, before)


@pytest.mark.parametrize("seed", [[1, 2], [1, 2, 3, 4], "abc", 1.5, {0: 1}], ids=repr)
def test_bad_seeds_for_many_worlds(seed: Any) -> None:
    envs = FormationVectorEnv(3)
    envs.reset(seed=0)
    before = envs.get_state().state
    with pytest.raises(ValueError, match="seed"):
        envs.reset(seed=seed)
    assert same(envs.get_state().state, before)


def test_one_bad_seed_among_good_ones_changes_nothing() -> None:
    envs = FormationVectorEnv(3)
    envs.reset(seed=0)
    before = envs.get_state().state
    with pytest.raises(ValueError, match=r"seed\[2\] = -1"):
        envs.reset(seed=[4, 5, -1])
    assert same(envs.get_state().state, before)


@pytest.mark.parametrize("make", [FormationEnv, formation_v0.parallel_env])
def test_a_bad_seed(make: Any) -> None:
    env = make()
    env.reset(seed=0)
    before = env.get_state().state
    with pytest.raises(ValueError, match="seed = -1"):
        env.reset(seed=-1)
    assert same(env.get_state().state, before)


@pytest.mark.parametrize("make", [FormationEnv, formation_v0.parallel_env, FormationVectorEnv])
def test_a_state_of_something_else_is_refused(make: Any) -> None:
    env = make()
    env.reset(seed=0)
    before = env.get_state()
    other = make(followers=2, gust=0.1)
    other.reset(seed=1)
    broken = before._replace(state={**before.state, "keys": np.zeros(7, np.uint64)})
    short = before._replace(state={k: v for k, v in before.state.items() if k != "tables"})
    for state, message in (
        (other.get_state(), "another configuration"),
        (broken, r"state\['keys'\]"),
        (short, r"^state.*tables"),
        (before.state, r"^state is a dict: expected what get_state returned$"),
        (None, r"^state is a NoneType: expected what get_state returned$"),
    ):
        with pytest.raises(ValueError, match=message):
            env.set_state(state)
        assert same(env.get_state().state, before.state)


def test_a_state_of_another_number_of_worlds_is_refused() -> None:
    two, three = FormationVectorEnv(2), FormationVectorEnv(3)
    two.reset(seed=0), three.reset(seed=0)
    with pytest.raises(ValueError, match=r"state\['[a-z]+'\] is .* \(2,"):
        three.set_state(two.get_state())


def test_a_layout_refuses_other_rows() -> None:
    layout = configure().layout
    with pytest.raises(ValueError, match=r"shape \(5,\)"):
        layout.unpack(np.zeros(5))
    named = layout.unpack(np.zeros(layout.size))
    del named["heading"]
    with pytest.raises(ValueError, match="heading"):
        layout.pack(named)


def test_a_trajectory_too_short_is_refused() -> None:
    samples = trajectories.figure_eight()
    short = type(samples)(samples.name, samples.kind, samples.table, duration=5.0)
    with pytest.raises(
        ValueError, match=r"duration = 30\.0: expected at most the trajectory's 5 s"
    ):
        configure(trajectory=short)
