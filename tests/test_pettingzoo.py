"""The PettingZoo face: the whole conformance suite, and what that suite does not look at."""

from __future__ import annotations

import copy
import importlib.util
import pickle
from typing import Any

import numpy as np
import pettingzoo
import pytest
from episodes import SCENARIOS, arrays, gentle, reward_terms, same, wild
from pettingzoo.test import (
    api_test,
    max_cycles_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
    seed_test,
    state_test,
)

from formation_env import formation_v0, trajectories
from formation_env.env import FormationEnv
from formation_env.formation_v0 import FormationParallelEnv
from formation_env.memory.records import size
from formation_env.physics.quadrotor import Body
from formation_env.task import Terms

needs_pygame = pytest.mark.skipif(
    importlib.util.find_spec("pygame") is None, reason="drawing needs pygame"
)


def acts(env: FormationParallelEnv, row: Any) -> dict[str, Any]:
    """An action row `(followers, k)` by agent."""
    return dict(zip(env.possible_agents, row, strict=True))


def shape(env: FormationParallelEnv) -> tuple[int, int]:
    return env.config.followers, env.config.action_size


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_parallel_api(scenario: str) -> None:
    parallel_api_test(formation_v0.parallel_env(scenario=scenario), num_cycles=300)


@pytest.mark.parametrize("maker", [formation_v0.env, formation_v0.raw_env])
@pytest.mark.parametrize("action", ["wrench", "reference"])
def test_api(maker: Any, action: str) -> None:
    api_test(maker(action=action, max_cycles=40), num_cycles=300)


def test_seeds() -> None:
    parallel_seed_test(formation_v0.parallel_env, num_cycles=50)
    seed_test(formation_v0.env, num_cycles=50)


def test_max_cycles() -> None:
    max_cycles_test(formation_v0)


def test_state() -> None:
    state_test(formation_v0.env(), formation_v0.parallel_env())


@needs_pygame
def test_render() -> None:
    render_test(lambda **options: formation_v0.env(max_cycles=5, **options))


@pytest.mark.skipif(not hasattr(pettingzoo, "make"), reason="PettingZoo 1.27 has a registry")
def test_it_is_in_the_registry() -> None:
    env = pettingzoo.make("parallel", "formation/formation_v0", followers=3)
    assert env.unwrapped.possible_agents == ["follower_0", "follower_1", "follower_2"]


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_seed_repeats_whole_episodes(scenario: str) -> None:
    """PettingZoo's own test compares a single step (1.27)."""
    one, two = (
        formation_v0.parallel_env(scenario=scenario),
        formation_v0.parallel_env(scenario=scenario),
    )
    two.reset(seed=99)
    assert same(one.reset(seed=4), two.reset(seed=4))
    ends = 0
    for row in wild(250, *shape(one)):
        assert same(one.step(acts(one, row)), two.step(acts(two, row)))
        assert same(one.state(), two.state())
        if not one.agents:
            ends += 1
            assert same(one.reset(), two.reset())
    assert ends > 1


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_state_is_the_truth(scenario: str) -> None:
    env = formation_v0.parallel_env(scenario=scenario)
    _, infos = env.reset(seed=0)
    n = env.config.followers
    for row in wild(15, *shape(env)):
        state, world = env.state(), env.simulation
        assert state in env.state_space
        vehicles, slots = np.split(state[:-1], [size(Body) * (n + 1)])
        parts = (world.positions, world.velocities, world.attitudes, world.angular_velocities)
        truth = np.concatenate([part[0] for part in parts], axis=1)
        np.testing.assert_array_equal(vehicles.reshape(n + 1, -1), truth.astype(np.float32))
        expected = [infos[agent]["slot"] for agent in env.possible_agents]
        np.testing.assert_array_equal(slots.reshape(n, -1), np.array(expected, np.float32))
        assert state[-1] == (env.config.start == "formation")
        _, _, ended, _, infos = env.step(acts(env, row))
        if any(ended.values()):
            break


def test_an_agent_may_act_in_any_form_and_order() -> None:
    """Lists, other dtypes and layouts mean the same numbers; the arrays given are left as they are."""
    one, two = formation_v0.parallel_env(followers=3), formation_v0.parallel_env(followers=3)
    one.reset(seed=5), two.reset(seed=5)
    for row in np.round(64.0 * gentle(20, 12).reshape(20, 3, 4)) / 64.0:
        plain = acts(two, row.astype(np.float32))
        spaced = np.repeat(row[2], 2).astype(np.float32)[::2]
        mixed = {"follower_2": spaced, "follower_0": row[0].tolist(), "follower_1": row[1]}
        kept = {agent: np.copy(action) for agent, action in plain.items()}
        assert same(one.step(mixed), two.step(plain))
        assert same(plain, kept)


def test_terms_of_the_reward_are_those_of_the_gymnasium_face() -> None:
    single, parallel = FormationEnv("swarm"), formation_v0.parallel_env(scenario="swarm")
    single.reset(seed=6), parallel.reset(seed=6)
    for row in wild(20, *shape(parallel)):
        terms = reward_terms(single.step(row.reshape(-1))[4])
        infos = parallel.step(acts(parallel, row))[4]
        for i, agent in enumerate(parallel.possible_agents):
            own = reward_terms(infos[agent])
            assert tuple(own) == tuple(terms) == Terms._fields
            assert own == {name: values[i] for name, values in terms.items()}
        if not parallel.agents:
            break


def test_info_holds_only_arrays_and_numbers() -> None:
    """Other libraries make a tensor of every entry, and always of the same ones."""
    env = formation_v0.parallel_env(max_cycles=3)
    entries = [env.reset(seed=0)[1]]
    while env.agents:
        entries.append(env.step(acts(env, np.zeros(shape(env), np.float32)))[4])
    for info in (own for infos in entries for own in infos.values()):
        assert {name: type(value) for name, value in info.items()} == {
            "slot": np.ndarray,
            "slot_error": np.ndarray,
            "separation": float,
            "failure": int,
            **{f"reward_{term}": float for term in Terms._fields},
        }


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_state_is_finite_when_a_vehicle_has_left_the_numbers(value: float) -> None:
    env = formation_v0.parallel_env()
    env.reset(seed=0)
    env.simulation._state.vehicles[...] = value
    assert env.state() in env.state_space
    *_, infos = env.step(acts(env, np.zeros(shape(env), np.float32)))
    assert not env.agents
    assert env.state() in env.state_space
    assert {info["failure"] for info in infos.values()} == {3}  # lost


def test_state_belongs_to_the_environment() -> None:
    """Writing into what was returned changes neither the state nor what follows."""
    spoiled, untouched = formation_v0.parallel_env(), formation_v0.parallel_env()
    for array in arrays(spoiled.reset(seed=0)):
        array[...] = 5.0
    untouched.reset(seed=0)
    assert same(spoiled.state(), untouched.state())
    for row in wild(10, 2, 4):
        expected = untouched.step(acts(untouched, row))
        found = spoiled.step(acts(spoiled, row))
        assert same(found, expected)
        for array in [*arrays(found), spoiled.state()]:
            array[...] = 5.0
        assert same(spoiled.state(), untouched.state())


def test_the_first_failure_ends_it_for_all() -> None:
    env = formation_v0.parallel_env(trajectory=trajectories.hover(), start_offset=0.0, gust=0.0)
    env.reset(seed=0)
    falling = acts(env, np.array([[-1, 0, 0, 0], [0, 0, 0, 0]], np.float32))
    while env.agents:
        _, rewards, ended, late, infos = env.step(falling)
    assert ended == {"follower_0": True, "follower_1": True}
    assert late == {"follower_0": False, "follower_1": False}
    assert [infos[a]["failure"] for a in env.possible_agents] == [2, 0]
    assert [infos[a]["reward_failure"] for a in env.possible_agents] == [-10.0, -10.0]
    for agent in env.possible_agents:
        assert rewards[agent] == pytest.approx(sum(reward_terms(infos[agent]).values()))


@pytest.mark.parametrize("steps", [1, 7])
def test_it_truncates_at_max_cycles(steps: int) -> None:
    env = formation_v0.parallel_env(max_cycles=steps)
    env.reset(seed=0)
    late = []
    while env.agents:
        late.append(env.step(acts(env, np.zeros((2, 4), np.float32)))[3])
    assert env.max_cycles == steps == len(late)
    assert all(late[-1].values())
    assert not any(any(flags.values()) for flags in late[:-1])


def test_agents_taking_turns_fly_the_same_episode() -> None:
    turns, at_once = formation_v0.env(max_cycles=30), formation_v0.parallel_env(max_cycles=30)
    turns.reset(seed=3), at_once.reset(seed=3)
    for row in wild(30, 2, 4, seed=9):
        for action in row:
            turns.step(action)
        obs, rewards, ended, late, _ = at_once.step(acts(at_once, row))
        for agent in at_once.possible_agents:
            assert same(turns.observe(agent), obs[agent])
        assert turns.rewards == rewards
        assert (turns.terminations, turns.truncations) == (ended, late)
        if not at_once.agents:
            break
    assert not at_once.agents


# -- conventions of the libraries that PettingZoo's own tests do not look at --------------------------


def test_every_agent_has_spaces_of_its_own() -> None:
    env = formation_v0.parallel_env(followers=3)
    for space in (env.observation_space, env.action_space):
        mine = [space(agent) for agent in env.possible_agents]
        assert [space(agent) for agent in env.possible_agents] == mine  # equal in value,
        assert all(
            space(agent) is own for agent, own in zip(env.possible_agents, mine, strict=True)
        )
        assert len({id(own) for own in mine}) == 3  # other objects
        for own in mine:
            own.seed(0)
        before = [own.sample() for own in mine]
        mine[0].seed(0)  # and this seeds no other
        assert same(mine[0].sample(), before[0])
        assert not same(mine[1].sample(), before[1])


def test_it_has_a_generator_that_reset_seeds() -> None:
    """SuperSuit's `frame_skip_v0` draws from `env.unwrapped.np_random`."""
    one, two = formation_v0.parallel_env(), formation_v0.parallel_env()
    drawn = one.np_random.integers(0, 2**31)
    assert drawn != two.np_random.integers(0, 2**31)
    single = FormationEnv()
    for env in (one, two, single):
        env.reset(seed=4)
    assert one.np_random is one.np_random
    draws = [env.np_random.integers(0, 2**31, 3).tolist() for env in (one, two, single)]
    assert draws[0] == draws[1] == draws[2]  # the same generator as on the Gymnasium face
    # Drawing from it does not change the episodes that follow.
    two.np_random.random(5)
    for _ in range(3):
        assert same(one.reset(), two.reset())


def test_a_generator_may_be_given() -> None:
    one, two = formation_v0.parallel_env(), formation_v0.parallel_env()
    one.reset(seed=0)
    for env in (one, two):
        env.np_random = np.random.default_rng(7)
    assert same(one.reset(), two.reset())


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_with_the_same_episodes(copied: Any) -> None:
    env = formation_v0.parallel_env()
    env.reset(seed=4)
    twin = copied(env)
    assert same(env.reset(), twin.reset())
    assert env.np_random.random() == twin.np_random.random()
    env.set_state(state := twin.get_state())
    assert same(env.reset(), twin.reset())
    other = formation_v0.parallel_env()
    other.set_state(state)
    assert same(other.reset(), formation_and_reset(twin, state))


def formation_and_reset(env: FormationParallelEnv, state: Any) -> Any:
    """What a reset gives from a state."""
    env.set_state(state)
    return env.reset()
