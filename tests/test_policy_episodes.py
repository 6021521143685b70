"""Policies that remember notice new episodes: flown on without `reset` they act as with it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import formation_env
from baselines import make_policy
from baselines.files import Card, Network
from baselines.policies.base import EpisodeWarning, Policy, Rows
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned
from baselines.policies.new_episodes import DOUBTFUL, NEW, Watch
from baselines.policies.textbook import FfFilter
from baselines.policies.tuned import ExpertTuned, own
from formation_env import SCENARIOS, FormationConfig, configure
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.env import FormationEnv
from formation_env.physics.sensors import Noise
from formation_env.physics.vehicle import Vehicle
from formation_env.trajectories import hover

LEVELS = ("wrench", "rates", "reference")
gym.register_envs(formation_env)


def stacked(config: FormationConfig, history: int = 3, residual: float = 0.1) -> Learned:
    """A small random network that sees three observations and corrects the expert."""
    rng = np.random.default_rng(0)
    size, k = config.layout.size, config.action_size
    card = Card(config.action, size, k, config.scenario, "mine", history=history, residual=residual)
    W = rng.normal(size=(k, history * size)).astype(np.float32) / np.float32(100.0)
    ones = np.ones(size, np.float32)
    return Learned(config, (card, Network((W,), (0 * W[:, 0],), 0 * ones, ones)))


MAKERS: dict[str, Callable[[FormationConfig], Policy]] = {
    "expert": Expert,
    "expert-tuned": lambda config: ExpertTuned(config, own(config)),
    "history and residual": stacked,
    "ff-filter": FfFilter,
}


def seeded(config: FormationConfig, worlds: int) -> Simulation:
    simulation = Simulation(config, worlds)
    for i in range(worlds):
        simulation.seed(i, seeded_key(i))
    return simulation


def episodes(policy: Policy, config: FormationConfig, lengths: tuple[int, ...], told: bool) -> Rows:
    """All actions of several episodes of three worlds, with `reset` before each or only once."""
    simulation, actions = seeded(config, 3), []
    for number, length in enumerate(lengths):
        rows = simulation.reset().observations
        if told or number == 0:
            policy.reset(worlds=3)
        for _ in range(length):
            actions.append(policy.act(rows))
            rows = simulation.step(actions[-1]).observations
    return np.stack(actions)


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", MAKERS)
def test_episodes_without_reset_are_flown_as_with_it(scenario: str, level: str, name: str) -> None:
    """Bit for bit, whether they end while a leader waits on the floor or in full flight."""
    config = configure(scenario, action=level)
    for lengths in ((5, 3, 3), (60, 30, 10), (500, 90, 5)):
        untold, told = (
            episodes(MAKERS[name](config), config, lengths, told) for told in (False, True)
        )
        assert np.array_equal(untold, told), lengths


def test_the_expert_earns_as_much_in_a_second_episode() -> None:
    """More than half of what there is from the trigger to the end; it did not even start the leader."""
    env = FormationEnv(scenario="paper")
    policy, layout, returns = Expert(env.config), env.config.layout, []
    for _ in range(2):
        total, started, done = 0.0, 0, False
        observation, _ = env.reset(seed=0)
        while not done:
            rows = observation.reshape(-1, layout.size)
            started += bool(layout.unpack(rows)["started"].all())
            observation, reward, terminated, truncated, _ = env.step(policy.act(observation))
            total, done = total + float(reward), terminated or truncated
        assert total > 0.5 * started > 0
        returns.append(total)
    assert returns[0] == returns[1]


@pytest.mark.parametrize("scenario", ["nominal", "paper", "experiment"])
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("name", MAKERS)
def test_worlds_that_reset_themselves_need_no_restart(scenario: str, mode: str, name: str) -> None:
    """Episodes of 0.8 s that begin staggered; the policy that is told is told of every one."""
    autoreset = gym.vector.AutoresetMode(mode)
    options: dict[str, Any] = {"scenario": scenario, "duration": 0.8, "autoreset_mode": autoreset}
    envs: Any = gym.make_vec("Formation-v0", num_envs=5, **options)
    config = envs.unwrapped.config
    told, untold = MAKERS[name](config), MAKERS[name](config)
    observation, _ = envs.reset(seed=3)
    before = last = np.zeros(5, dtype=np.bool_)
    rng = np.random.default_rng(0)
    for tick in range(150):
        actions = untold.act(observation)
        if before.any():
            told.restart(before)
        assert np.array_equal(told.act(observation), actions), tick
        # Some worlds crash, so that not all begin together.
        upset = rng.random(5) < 0.3
        flown = np.where(upset[:, None], np.float32(-1.0), actions)
        observation, _, terminated, truncated, _ = envs.step(flown)
        ended = terminated | truncated
        if mode == "SameStep":
            before = ended
        else:
            before, last = last, ended
    envs.close()


# -- nothing is noticed in flight -----------------------------------------------------------------

Pilot = Callable[[int, Policy, Rows], Rows]


def _zeros(tick: int, policy: Policy, rows: Rows) -> Rows:
    return 0.0 * policy.act(rows)


def _broken(tick: int, policy: Policy, rows: Rows) -> Rows:
    """The expert, and nothing at all in one tick of three."""
    return policy.act(rows) * np.float32(tick % 3 > 0)


def _wild(tick: int, policy: Policy, rows: Rows) -> Rows:
    """Full deflections and zeros in turn: the hardest accelerations and spins there are."""
    corner = np.sign(np.random.default_rng(tick).normal(size=policy.act(rows).shape))
    return np.asarray(corner * (tick % 2), dtype=np.float32)


def noticed(config: FormationConfig, pilot: Pilot, ticks: int) -> tuple[int, int]:
    """In how many worlds and ticks of flights an episode was noticed, and was in doubt."""
    simulation, watch = seeded(config, 6), Watch(config, 6)
    rows, policy = simulation.reset().observations, Expert(config)
    found = doubts = 0
    for tick in range(ticks):
        live, told = ~simulation.over, watch.look(rows)
        # Before the trigger zeros after other actions count as a new episode: nothing has flown yet.
        found += int((watch.began & live & simulation.started).sum()) if told & NEW else 0
        doubts += told & DOUBTFUL
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", EpisodeWarning)
            actions = pilot(tick, policy, rows)
        rows = simulation.step(actions, mask=live).observations
    return found, doubts


MEASURED: dict[str, dict[str, Any]] = {
    "as it is": {},
    "slow and late": {"measurement_period": 0.06, "measurement_delay": 3},
    "fast": {"measurement_period": 0.005},
    "noisy": {"noise": Noise(0.05, 0.1, 0.1, 0.01, 0.1), "gust": 3.0},
    "differenced": {"estimator": "differenced", "window": 5, "noise": Noise(1e-3, 0, 0, 0.01, 0)},
    "unlimited": {"vehicle": Vehicle(limited=False)},
    "strong": {"vehicle": Vehicle(thrust_max=10.0, moment_max=(1.0, 1.0, 1.0)), "substeps": 8},
}


@pytest.mark.parametrize("measured", MEASURED)
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("pilot", [_zeros, _broken, _wild])
def test_no_flight_is_taken_for_a_new_episode(measured: str, level: str, pilot: Pilot) -> None:
    """Whoever commands zeros, whatever is measured: then `previous_action` is zero in flight, too."""
    config = configure("nominal", action=level, **MEASURED[measured])
    assert noticed(config, pilot, 300)[0] == 0


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("pilot", [_zeros, _broken, _wild])
def test_no_flight_of_a_scenario_is_taken_for_a_new_episode(scenario: str, pilot: Pilot) -> None:
    assert noticed(configure(scenario), pilot, 400)[0] == 0


def test_an_expert_that_watches_a_hovering_pilot_does_not_doubt() -> None:
    for scenario in SCENARIOS:
        assert noticed(configure(scenario), _zeros, 200) == (0, 0)


def test_every_reset_jumps_further_than_flight() -> None:
    """A leader that hovers, followers back within 0.2 m: what `previous_action` alone would not tell."""
    config = configure("nominal", trajectory=hover((0.0, 0.0, -2.0)))
    simulation, watch, policy = seeded(config, 200), Watch(config, 200), Expert(config)
    for episode in range(4):
        rows = simulation.reset().observations
        assert bool(watch.look(rows) & NEW) == (episode > 0)
        assert watch.began.sum() >= 199 * (episode > 0)
        policy.reset(worlds=200)
        for _ in range(50):
            rows = simulation.step(policy.act(rows)).observations
            watch.look(rows)


# -- where nothing says it ------------------------------------------------------------------------


def test_what_cannot_be_told_is_said_once() -> None:
    """Somebody flies zeros from now on, and nothing moves as it does at a reset."""
    config = configure("nominal")
    simulation, policy = seeded(config, 1), Expert(config)
    rows = simulation.reset().observations
    for _ in range(3):
        rows = simulation.step(policy.act(rows)).observations
    rows = simulation.step(0 * policy.act(rows)).observations
    with pytest.warns(EpisodeWarning, match=r"expert: the last actions were zero.*call reset\(\)"):
        policy.act(rows)
    for _ in range(3):
        rows = simulation.step(policy.act(rows)).observations
    policy.act(simulation.step(0 * policy.act(rows)).observations)


@pytest.mark.parametrize("name", MAKERS)
def test_another_number_of_worlds_in_flight(name: str) -> None:
    """Two sets of worlds share a policy, and each loses what is remembered of the other."""
    config = configure("nominal")
    few, many = seeded(config, 2), seeded(config, 3)
    policy = MAKERS[name](config)
    for simulation in (few, many):  # at the start of a flight nothing is lost
        rows = simulation.reset().observations
        for _ in range(3):
            rows = simulation.step(policy.act(rows)).observations
    with pytest.warns(EpisodeWarning, match="2 worlds in flight after another number"):
        policy.act(few.look().observations)


def test_policies_without_memory_look_at_nothing_but_the_observation() -> None:
    config = configure("nominal")
    single = stacked(config, history=1, residual=0.0)
    for policy in (single, *(make_policy(name, config) for name in ("ff", "hover", "random"))):
        assert not policy.remembers
    for history, residual in ((2, 0.0), (1, 0.1)):
        assert stacked(config, history, residual).remembers


def test_a_policy_of_ones_own_that_remembers_is_told() -> None:
    class Counter(Policy):
        name = "counter"

        def begin(self, seeds: NDArray[np.uint64]) -> None:
            self.ticks = np.zeros(len(seeds))

        def begin_again(self, mask: NDArray[np.bool_]) -> None:
            self.ticks[mask] = 0

        def decide(self, rows: Rows) -> Rows:
            self.ticks += 1
            return np.full((len(rows), 2, 4), 0.01, np.float32)

    config = configure("nominal")
    simulation, policy = seeded(config, 3), Counter(config)
    rows = simulation.reset().observations
    for _ in range(4):
        rows = simulation.step(policy.act(rows)).observations
    policy.act(simulation.reset(np.array([False, True, False])).observations)
    assert policy.ticks.tolist() == [5, 1, 5]


def test_a_restored_memory_is_compared_with_nothing() -> None:
    """The first tick of an episode again: what was seen in between is none of its business."""
    config = configure("nominal")
    simulation, policy = seeded(config, 2), Expert(config)
    rows = simulation.reset().observations.copy()
    first = policy.act(rows)
    policy.reset(worlds=2)
    saved = policy.get_state()
    for _ in range(20):
        rows_then = simulation.step(first).observations
        policy.act(rows_then)
    policy.set_state(saved)
    assert np.array_equal(policy.act(rows), first)
    for memory in (None, saved["memory"][:, :-1], saved["memory"].astype(np.float32), "x"):
        with pytest.raises(ValueError, match=r"state\['memory'\] = .*expected float64 numbers"):
            policy.set_state({"memory": memory})
