"""What the reward is for: nothing but starting soon and staying on the slot pays.

Each sentence twice: of one tick, by mathematics, and of a flight of seconds, in which the paper's expert does
what is not to pay.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
import pytest
from closed_loop import PROPERTY, numbers
from episodes import SCENARIOS, reward_terms
from hypothesis import given
from hypothesis import strategies as st
from states import vehicles

from baselines import make_policy
from formation_env import Rewards, configure, formation_v0, formations, trajectories
from formation_env.env import FormationEnv
from formation_env.laws.world import Action
from formation_env.task import COLLISION, FAILURES, IMPACT, NO_FAILURE, UNSTARTED, closeness, reward

Rows = npt.NDArray[np.float32]
# What flies instead of the expert's actions `(followers, k)` in a tick, numbered from 0.
Change = Callable[[int, Rows], Rows]

WEIGHTS = Rewards()
CALM: Action = (0.0, 0.0, 0.0, 0.0)
ERRORS = st.floats(0.0, 30.0, allow_subnormal=False)  # m
ACTIONS = st.tuples(*[numbers(1.0)] * 4)
# Two vehicles that hover beside a leader that does, in still air.
HOVERING: dict[str, Any] = {"trajectory": trajectories.hover(), "start_offset": 0.0, "gust": 0.0}


def paid(started: bool, error: float, action: Any = CALM, previous: Any = CALM) -> float:
    """The reward of one tick in which no follower fails."""
    return sum(reward(started, 0.0, error, action, previous, 4, False, WEIGHTS))


def flown(
    ticks: int, change: Change = lambda tick, actions: actions, seed: int = 3, **task: Any
) -> tuple[npt.NDArray[np.float64], list[dict[str, Any]]]:
    """Joint reward and `info` of each tick of an expert's episode, at most `ticks`, its actions changed."""
    env = FormationEnv(**task)
    expert = make_policy("expert", env.config)
    observation, _ = env.reset(seed=seed)
    expert.reset(seed)
    rewards, infos = [], []
    for tick in range(ticks):
        actions = expert.act(observation).reshape(env.config.followers, -1)
        observation, earned, over, late, info = env.step(change(tick, actions).reshape(-1))
        rewards.append(earned)
        infos.append(info)
        if over or late:
            break
    return np.array(rewards), infos


def triggered(infos: list[dict[str, Any]]) -> int:
    """Number of the first tick, from 1, in which the formation is paid for."""
    return 1 + next(k for k, info in enumerate(infos) if (info["reward_formation"] > 0.0).all())


def cut(tick: int, *who: int) -> Change:
    """Some followers' thrust is cut from a tick on."""

    def change(now: int, actions: Rows) -> Rows:
        actions = actions.copy()
        if now >= tick:
            actions[list(who)] = (-1.0, 0.0, 0.0, 0.0)
        return actions

    return change


@pytest.fixture(scope="module")
def start() -> tuple[npt.NDArray[np.float64], list[dict[str, Any]]]:
    """What the expert earns in 20 s of `paper`, in which it starts."""
    return flown(1000, scenario="paper")


# -- centimetres count ----------------------------------------------------------------------------------


def test_five_centimetres_are_worth_a_fifth_less_than_one() -> None:
    assert closeness(0.01, WEIGHTS) - closeness(0.05, WEIGHTS) >= 0.2


@PROPERTY
@given(ERRORS, st.floats(1e-6, 1.0), st.booleans(), ACTIONS, ACTIONS)
def test_parking_beside_the_slot_never_pays(
    error: float, further: float, started: bool, action: Any, previous: Any
) -> None:
    """Whatever it does, a follower that is further away earns less."""
    apart = error + further * (1.0 + error)
    assert paid(started, apart, action, previous) < paid(started, error, action, previous)


def test_a_flight_beside_the_slots_earns_less() -> None:
    """Two that hover for a second, each as far above its slot as it was put."""
    sums = []
    for apart in (0.0, 0.01, 0.05, 0.15, 0.3, 1.0):
        env = FormationEnv(**HOVERING)
        env.reset(seed=0)
        vehicles(env.simulation)["p"][0, 1:, 2, 0] -= apart
        steps = [env.step(np.zeros(8, np.float32)) for _ in range(50)]
        np.testing.assert_allclose(
            np.linalg.norm(steps[-1][4]["slot_error"], axis=1), apart, atol=1e-9
        )
        sums.append(sum(step[1] for step in steps))
    assert sums[0] == pytest.approx(50.0)
    assert (np.diff(sums) < -0.5).all()


# -- waiting ----------------------------------------------------------------------------------------------


@PROPERTY
@given(ERRORS, ACTIONS, ACTIONS)
def test_delaying_the_start_never_pays(error: float, action: Any, previous: Any) -> None:
    """Nothing is earned before it, and for the same error more after it."""
    waits, flies = (paid(started, error, action, previous) for started in (False, True))
    assert waits <= 0.0
    assert flies > waits


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_whole_wait_costs_less_than_a_failure(scenario: str) -> None:
    config = configure(scenario)
    assert 0.0 < config.reward.waiting * config.deadline_steps < config.reward.failure


def test_a_later_start_earns_less(start: Any) -> None:
    """The expert that stays on the floor for the first 2 s, all else being its own."""

    def late(tick: int, actions: Rows) -> Rows:
        return actions if tick >= 100 else np.zeros_like(actions)

    rewards, infos = start
    later, behind = flown(1000, late, scenario="paper")
    first, then = triggered(infos), triggered(behind)
    assert then > first
    assert (rewards[: first - 1] <= 0.0).all() and (later[: then - 1] <= 0.0).all()
    assert later.sum() < rewards.sum() - 0.5 * (then - first)


# -- the deadline -----------------------------------------------------------------------------------------


def ends(
    scenario: str, seconds: float, action: str = "wrench"
) -> list[tuple[int, list[int], float]]:
    """Last tick, failures and what waiting was paid on each face, of followers that never climb."""
    task: dict[str, Any] = {"scenario": scenario, "action": action, "limits": {"deadline": seconds}}
    single, agents = FormationEnv(**task), formation_v0.parallel_env(**task)
    envs = gym.make_vec(
        "formation_env:Formation-v0", num_envs=3, vectorization_mode="vector_entry_point", **task
    )
    k = single.config.action_size
    single.reset(seed=0), agents.reset(seed=0), envs.reset(seed=0)
    still, found, waited = np.zeros(k, np.float32), [], np.zeros(3)
    over = [False] * 3
    for tick in range(1, 2000):
        _, _, over[0], _, info = single.step(np.tile(still, 2))
        *_, infos = agents.step(dict.fromkeys(agents.agents, still))
        _, _, failed, _, many = envs.step(np.tile(still, (3, 2)))
        own = [infos[agent] for agent in agents.possible_agents]
        over[1], over[2] = not agents.agents, bool(failed.all())
        assert failed.all() == failed.any()
        waited += (
            info["reward_waiting"].mean(),
            np.mean([one["reward_waiting"] for one in own]),
            many["reward_waiting"].mean(),
        )
        if any(over):
            why = (info["failure"], [one["failure"] for one in own], many["failure"][2])
            found = [(tick, list(map(int, each)), float(waited[k])) for k, each in enumerate(why)]
            break
    assert over == [True] * 3
    return found


@pytest.mark.parametrize(
    ("scenario", "seconds", "ticks"),
    [("paper", 15.0, 750), ("experiment", 15.0, 660), ("paper", 0.05, 3)],
)
def test_who_has_not_started_by_the_deadline_has_failed(
    scenario: str, seconds: float, ticks: int
) -> None:
    """At that tick on all faces, and the wait was paid less than nothing, but more than a failure."""
    for last, why, waited in ends(scenario, seconds):
        assert (last, why) == (ticks, [UNSTARTED, UNSTARTED])
        assert -WEIGHTS.failure < waited < 0.0


def test_virtual_followers_have_a_deadline_too() -> None:
    """At level `reference` the tracker climbs by itself; the leader does not get there in 0.4 s."""
    assert [(last, why) for last, why, _ in ends("paper", 0.4, "reference")] == [
        (20, [UNSTARTED] * 2)
    ] * 3


def test_a_start_at_the_last_tick_is_in_time(start: Any) -> None:
    first = triggered(start[1])
    _, infos = flown(first + 50, scenario="paper", limits={"deadline": 0.02 * first})
    assert (triggered(infos), len(infos)) == (first, first + 50)
    rewards, infos = flown(first, scenario="paper", limits={"deadline": 0.02 * (first - 1)})
    assert len(infos) == first - 1
    assert (infos[-1]["failure"] == UNSTARTED).all()
    assert (infos[-1]["reward_failure"] == -WEIGHTS.failure).all()
    assert rewards[-1] < -WEIGHTS.failure


# -- failing ----------------------------------------------------------------------------------------------


@PROPERTY
@given(ERRORS)
def test_flying_on_calmly_is_never_worse_than_a_failure(error: float) -> None:
    """Once started it costs nothing, however far the slot is."""
    assert paid(True, error) > 0.0
    failed = sum(reward(True, 0.0, error, CALM, CALM, 4, True, WEIGHTS))
    assert failed <= paid(True, error) - WEIGHTS.failure


@PROPERTY
@given(ERRORS, st.integers(0, 750))
def test_ending_the_wait_by_a_failure_gains_nothing(error: float, left: int) -> None:
    """It costs what waiting to the deadline, wherever, and failing there would."""
    crash = sum(reward(False, float(left), error, CALM, CALM, 4, True, WEIGHTS))
    tick = paid(False, error)
    assert crash <= tick * (left + 1) - WEIGHTS.failure + 1e-9


@pytest.mark.parametrize("after", [-100, 100], ids=["before the trigger", "after it"])
def test_cutting_thrust_never_pays(start: Any, after: int) -> None:
    """All else being the expert's; two seconds before the trigger and two after it."""
    rewards, infos = start
    tick = triggered(infos) + after
    crashed, last = flown(1000, cut(tick, 0, 1), scenario="paper")
    np.testing.assert_array_equal(crashed[:tick], rewards[:tick])
    assert tick < len(crashed) < 1000
    assert (last[-1]["failure"] != NO_FAILURE).any()
    for flight in range(len(crashed), len(rewards)):  # against flights that end at any later tick
        assert crashed.sum() < rewards[: flight + 1].sum() - 0.5 * WEIGHTS.failure


@pytest.mark.parametrize("who", [0, 1])
def test_whoever_fails_all_lose_the_same(who: int) -> None:
    rewards, infos = flown(400, cut(0, who), **HOVERING)
    expected = [NO_FAILURE] * 2
    expected[who] = IMPACT
    assert infos[-1]["failure"].tolist() == expected
    for k, info in enumerate(infos):
        lost = -WEIGHTS.failure if k == len(infos) - 1 else 0.0
        assert info["reward_failure"].tolist() == [lost, lost]
    assert rewards[-1] < 1.0 - WEIGHTS.failure


def test_hurting_a_neighbour_never_pays() -> None:
    """The lower of two climbs into the one above: it earns less than if it had stayed, as does the other."""
    above = ((0.5, 0.0, -0.3), (0.5, 0.0, -1.0))

    def ram(tick: int, actions: Rows) -> Rows:
        return np.array([actions[0], (1.0, 0.0, 0.0, 0.0)], np.float32)

    (_, hurt), (_, kept) = (
        flown(100, change, **HOVERING, offsets=above) for change in (ram, cut(100, 0))
    )
    assert (hurt[-1]["failure"] == COLLISION).all()
    assert len(hurt) < 100
    own, whole = (
        np.sum([sum(reward_terms(info).values()) for info in infos], axis=0)
        for infos in (hurt, kept[: len(hurt)])
    )
    assert (own < whole - 0.9 * WEIGHTS.failure).all()


@pytest.mark.parametrize("followers", [1, 2, 16])
def test_a_failure_costs_the_joint_reward_the_same(followers: int) -> None:
    """One of them falls to the floor."""
    offsets = formations.wedge(followers, spacing=1.0)
    rewards, infos = flown(400, cut(0, followers - 1), **HOVERING, offsets=offsets)
    assert FAILURES[infos[-1]["failure"][-1]] == "impact"
    assert (infos[-1]["failure"][:-1] == NO_FAILURE).all()
    others = {name: x for name, x in reward_terms(infos[-1]).items() if name != "failure"}
    assert rewards[-1] - sum(x.mean() for x in others.values()) == pytest.approx(-WEIGHTS.failure)


# -- chattering -------------------------------------------------------------------------------------------


@PROPERTY
@given(st.booleans(), ERRORS, ACTIONS, st.tuples(*[numbers(0.5)] * 4))
def test_chattering_never_pays(started: bool, error: float, mean: Any, swing: Any) -> None:
    """Actions that alternate about their mean earn less than the mean itself, by all of the swing."""
    one, two = np.add(mean, swing), np.subtract(mean, swing)
    both = paid(started, error, tuple(one), tuple(two)) + paid(
        started, error, tuple(two), tuple(one)
    )
    square = float(np.square(swing).mean())
    costs = 2.0 * square * (WEIGHTS.effort + 4.0 * WEIGHTS.smoothness)
    assert both - 2.0 * paid(started, error, mean, mean) == pytest.approx(-costs, abs=1e-12)


def test_a_flight_that_chatters_earns_less() -> None:
    """The expert's moments with a swing of a fifth of them, whose mean is nothing, for 4 s."""

    def chatter(tick: int, actions: Rows) -> Rows:
        swing = np.array([0.0, 0.2, 0.2, 0.2], np.float32)
        return np.clip(actions + (-swing if tick % 2 else swing), -1.0, 1.0)

    calm, chattered = flown(200)[0], flown(200, chatter)[0]
    assert len(calm) == len(chattered) == 200
    assert chattered.sum() < calm.sum() - 1.0
