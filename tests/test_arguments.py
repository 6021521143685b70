"""What the faces make of keywords, seeds, options of `reset`, and of assignments to what is fixed."""

from __future__ import annotations

import pickle
import re
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from episodes import same
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from formation_env import configure, formation_v0
from formation_env.env import FormationEnv
from formation_env.validation.checks import LONGEST
from formation_env.vector import FormationVectorEnv

ID = "formation_env:Formation-v0"

MAKERS: dict[str, Callable[..., Any]] = {
    "FormationEnv": FormationEnv,
    "FormationVectorEnv": FormationVectorEnv,
    "make": lambda **options: gym.make(ID, **options),
    "make_vec": lambda **options: gym.make_vec(ID, num_envs=2, **options),
    "sync": lambda **options: gym.make_vec(ID, vectorization_mode="sync", **options),
    "parallel_env": formation_v0.parallel_env,
    "env": formation_v0.env,
    "raw_env": formation_v0.raw_env,
}
FACES = ("FormationEnv", "FormationVectorEnv", "parallel_env")


@pytest.mark.parametrize("face", MAKERS)
@pytest.mark.parametrize("name", ["frameskip", "Action", "self_play"])
def test_an_unknown_keyword_is_a_type_error(face: str, name: str) -> None:
    """TorchRL tries `frameskip` and looks for these words; the known names come after them."""
    with pytest.raises(
        TypeError, match=f"unexpected keyword argument '{name}': known are"
    ) as caught:
        MAKERS[face](**{name: 4})
    assert "scenario, followers" in str(caught.value)


@pytest.mark.parametrize(
    ("face", "name", "remedy"),
    [
        ("sync", "autoreset_mode", "vector_kwargs={'autoreset_mode': ...}"),
        ("sync", "threads", "without a vectorization_mode"),
        ("make", "autoreset_mode", "native vector environment"),
        ("make", "max_cycles", "max_episode_steps"),
        ("FormationEnv", "max_episode_steps", "make and make_vec"),
        ("FormationVectorEnv", "max_cycles", "max_episode_steps"),
        ("parallel_env", "max_episode_steps", "max_cycles"),
        ("env", "autoreset_mode", "native vector environment"),
    ],
)
def test_a_keyword_of_another_face_is_explained(face: str, name: str, remedy: str) -> None:
    with pytest.raises(TypeError, match=re.escape(remedy)) as caught:
        MAKERS[face](**{name: 5})
    assert f"unexpected keyword argument '{name}'" in str(caught.value)


def test_what_the_explanation_says_works() -> None:
    envs = gym.make_vec(
        ID, vectorization_mode="sync", vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP}
    )
    assert envs.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    envs.close()


# -- seeds ------------------------------------------------------------------------------------------

BAD_SEEDS = [1.9, 2.0, True, "1", -1, np.float64(3.0), np.bool_(True), 1j, b"1", np.timedelta64(3)]


@pytest.mark.parametrize("face", FACES)
@pytest.mark.parametrize("seed", BAD_SEEDS, ids=repr)
def test_a_seed_that_is_not_a_whole_number_is_refused(face: str, seed: Any) -> None:
    env = MAKERS[face]()
    env.reset(seed=0)
    before = env.get_state().state
    with pytest.raises(ValueError, match=r"seed = .*: expected an integer of at least 0"):
        env.reset(seed=seed)
    assert same(env.get_state().state, before)


@pytest.mark.parametrize("bad", BAD_SEEDS, ids=repr)
def test_nor_is_one_of_many(bad: Any) -> None:
    envs = FormationVectorEnv(2)
    envs.reset(seed=0)
    before = envs.get_state().state
    with pytest.raises(ValueError, match=r"seed\[1\] = .*: expected an integer of at least 0"):
        envs.reset(seed=[1, bad])
    assert same(envs.get_state().state, before)


@pytest.mark.parametrize(
    "seeds",
    [np.array([1.9, 2.9]), np.array([True, False]), np.array(7), b"12", bytearray(b"12"), {1, 2}],
    ids=repr,
)
def test_nor_are_other_collections(seeds: Any) -> None:
    envs = FormationVectorEnv(2)
    with pytest.raises(ValueError, match=r"seed"):
        envs.reset(seed=seeds)


@pytest.mark.parametrize("seed", [np.int64(5), np.uint8(5), 2**70], ids=repr)
@pytest.mark.parametrize("face", FACES)
def test_any_whole_number_is_a_seed(face: str, seed: Any) -> None:
    one, two = MAKERS[face](), MAKERS[face]()
    assert same(one.reset(seed=seed), two.reset(seed=int(seed)))


def test_several_seeds_may_be_an_array_or_a_range() -> None:
    envs, other = FormationVectorEnv(3), FormationVectorEnv(3)
    expected = envs.reset(seed=4)
    assert same(other.reset(seed=range(4, 7)), expected)
    assert same(other.reset(seed=np.array([4, 5, 6], np.uint16)), expected)


# -- options of reset -------------------------------------------------------------------------------


@pytest.mark.parametrize("face", [*FACES, "env"])
@pytest.mark.parametrize("options", [{"nonsense": 1}, {"reset_masks": None}, {1: 2}, [("a", 1)], 5])
def test_unknown_options_are_refused_and_the_known_named(face: str, options: Any) -> None:
    env = MAKERS[face]()
    known = "'reset_mask'" if face == "FormationVectorEnv" else "none"
    with pytest.raises(ValueError, match=rf"options.* = .*: expected .*known keys: {known}$"):
        env.reset(seed=0, options=options)


@pytest.mark.parametrize("face", FACES)
def test_no_options_may_be_written_as_an_empty_dictionary(face: str) -> None:
    one, two = MAKERS[face](), MAKERS[face]()
    assert same(one.reset(seed=0, options={}), two.reset(seed=0))


def test_the_key_that_pettingzoo_sends_is_let_pass() -> None:
    """Its `parallel_api_test` and `api_test` call `reset(options={"options": 1})`."""
    one, two = formation_v0.parallel_env(), formation_v0.parallel_env()
    assert same(one.reset(seed=0, options={"options": 1}), two.reset(seed=0))


# -- assignments ------------------------------------------------------------------------------------


@pytest.mark.parametrize("face", [*FACES, "make"])
@pytest.mark.parametrize(
    "name", ["config", "render_mode", "num_envs", "autoreset_mode", "simulation"]
)
def test_what_is_fixed_cannot_be_assigned(face: str, name: str) -> None:
    env = MAKERS[face]().unwrapped
    if not hasattr(env, name):
        return
    before = getattr(env, name)
    with pytest.raises(AttributeError, match=r"make a new environment|no setter"):
        setattr(env, name, configure("paper") if name == "config" else "human")
    assert getattr(env, name) is before
    with pytest.raises(AttributeError):
        setattr(pickle.loads(pickle.dumps(env)), name, before)  # a copy is as strict


@pytest.mark.parametrize("face", [*FACES, "make"])
@pytest.mark.parametrize("name", ["scenario", "duration", "gust", "vehicle", "offsets"])
def test_a_field_of_the_configuration_cannot_be_assigned(face: str, name: str) -> None:
    env = MAKERS[face]().unwrapped
    with pytest.raises(AttributeError, match=rf"'{name}' of \w+ is fixed: make a new environment"):
        setattr(env, name, 1.0)


def test_a_wrapper_does_not_assign_it_either() -> None:
    env = gym.make(ID)
    with pytest.raises(AttributeError, match="'config' of FormationEnv is fixed"):
        env.set_wrapper_attr("config", configure("paper"))
    env.unwrapped.remark = "mine"  # type: ignore[attr-defined]  # what is not ours may be set
    assert env.get_wrapper_attr("remark") == "mine"


# -- numbers ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [2.0, "3", True, 0, 2**64, np.array([2]), None], ids=repr)
def test_the_number_of_worlds_is_a_whole_number(value: Any) -> None:
    with pytest.raises(ValueError, match=r"num_envs = .*: expected an integer from 1 to 1048576"):
        FormationVectorEnv(value)


@pytest.mark.parametrize(
    ("face", "name"),
    [
        ("FormationVectorEnv", "threads"),
        ("FormationVectorEnv", "max_episode_steps"),
        ("parallel_env", "max_cycles"),
    ],
)
@pytest.mark.parametrize("value", [2.0, "3", True, 0, -1, np.array([2])], ids=repr)
def test_counts_are_whole_numbers(face: str, name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"{name} = .*: expected an integer"):
        MAKERS[face](**{name: value})


@pytest.mark.parametrize(
    "steps", [1501, 2**64, 10**400], ids=lambda n: f"{n:e}"[:6] if n < 2**99 else "huge"
)
def test_a_limit_beyond_the_duration_is_refused_however_large(steps: int) -> None:
    """A longer duration is proposed only where there is one."""
    for face, name in (("FormationVectorEnv", "max_episode_steps"), ("parallel_env", "max_cycles")):
        with pytest.raises(ValueError, match=f"^{name} = .*: expected at most 1500") as caught:
            MAKERS[face](**{name: steps})
        assert ("give duration=" in str(caught.value)) == (steps < 2**40)
        assert len(str(caught.value)) <= LONGEST


@pytest.mark.parametrize("face", FACES)
@pytest.mark.parametrize("mode", ["ascii", 3, True, np.array(["human"]), ["rgb_array"]], ids=repr)
def test_a_render_mode_is_a_name(face: str, mode: Any) -> None:
    with pytest.raises(ValueError, match=r"render_mode = .*: expected one of .*'rgb_array'"):
        MAKERS[face](render_mode=mode)


# -- actions ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "action",
    [
        [[0.0] * 8, [0.0]],
        np.ma.masked_array(np.zeros(8), mask=[True] + [False] * 7),
        np.zeros(8, complex),
        np.zeros(8, bool),
        "00000000",
        None,
    ],
    ids=lambda action: type(action).__name__,
)
def test_an_action_is_an_array_of_numbers(action: Any) -> None:
    env = FormationEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"^action .*expected"):
        env.step(action)


@pytest.mark.parametrize("followers", [2, 300])
@pytest.mark.parametrize(
    "actions", [{}, {f"x{i}": 0 for i in range(1000)}, {"x" * 9999: 0}, [0] * 999], ids=len
)
def test_actions_of_the_wrong_agents_are_refused_in_few_words(followers: int, actions: Any) -> None:
    env = formation_v0.parallel_env(scenario="swarm", followers=followers)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"expected one for each of .*follower_0") as caught:
        env.step(actions)
    assert len(str(caught.value)) <= LONGEST


def spoiled(value: float) -> Any:
    return np.array([0.0, value, 0.0, 0.0], np.float32)


@pytest.mark.parametrize(
    "bad", [spoiled(np.nan), spoiled(np.inf), np.zeros(3), "up", None], ids=repr
)
@pytest.mark.parametrize("turn", [0, 1, 2])
def test_taking_turns_a_bad_action_is_refused_in_its_agents_turn(bad: Any, turn: int) -> None:
    """And the environment goes on with a corrected one, as if nothing had been."""
    env, untouched = (formation_v0.env(followers=3) for _ in range(2))
    env.reset(seed=1), untouched.reset(seed=1)
    for tick in range(3):
        for i, agent in enumerate(env.possible_agents):
            if tick == 1 and i == turn:
                with pytest.raises(ValueError, match=f"action of {agent}"):
                    env.step(bad)
                assert env.agent_selection == agent
            env.step(np.full(4, 0.1 * i, np.float32))
            untouched.step(np.full(4, 0.1 * i, np.float32))
            assert same(env.last(), untouched.last())
    assert same(env.state(), untouched.state())


def test_taking_turns_an_action_after_the_end_is_refused_and_it_goes_on() -> None:
    env = formation_v0.env(max_cycles=1)
    env.reset(seed=0)
    for _ in env.possible_agents:
        env.step(np.zeros(4, np.float32))
    for agent in env.possible_agents:
        with pytest.raises(
            ValueError, match=rf"^action of {agent} = .*: expected None: its episode"
        ):
            env.step(np.zeros(4, np.float32))
        env.step(None)
    assert not env.agents


def test_taking_turns_an_array_may_be_used_again() -> None:
    env, other = formation_v0.env(), formation_v0.env()
    env.reset(seed=1), other.reset(seed=1)
    action = np.zeros(4, np.float32)
    for value in (0.5, -0.5):
        action[:] = value
        env.step(action)
        other.step(np.full(4, value, np.float32))
    assert same(env.last(), other.last())


# -- after the end ----------------------------------------------------------------------------------


def test_after_the_end_no_actions_give_nothing() -> None:
    """As MPE2 does; SuperSuit's `black_death_v3` relies on it."""
    env = formation_v0.parallel_env(max_cycles=1)
    with pytest.raises(ResetNeeded):
        env.step({})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="expected one for each of"):
        env.step({})
    env.step({agent: np.zeros(4, np.float32) for agent in env.agents})
    before = env.get_state().state
    for _ in range(2):
        assert env.step({}) == ({}, {}, {}, {}, {})
    assert same(env.get_state().state, before)
    assert set(env.reset()[0]) == set(env.possible_agents)
    with pytest.raises(ResetNeeded):
        formation_v0.parallel_env().step({})
