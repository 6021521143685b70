"""Where a state leaves the numbers: the episode ends as lost, and all that a learner gets is finite."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from episodes import LEVELS
from states import (
    PARTS,
    begun,
    finite,
    follower_rows,
    outcome,
    samples,
    still,
    term,
    unchecked,
    vehicles,
)

from formation_env import trajectories
from formation_env.core import kernels
from formation_env.core.simulation import Simulation
from formation_env.env import FormationEnv
from formation_env.formation_v0 import parallel_env
from formation_env.physics.sensors import Noise
from formation_env.task import COLLISION, FAILURES, LEADER, LOST, UNSTARTED, Rewards
from formation_env.vector import FormationVectorEnv

NAN, INF = float("nan"), float("inf")


def sound(simulation: Simulation, results: Any) -> None:
    """Finite and within the observation space."""
    bound = simulation.layout.bound
    for rows_ in (results.observations, results.final_observations):
        if rows_.size:
            assert np.isfinite(rows_).all()
            assert (np.abs(rows_) <= bound).all()
    assert np.isfinite(results.ends).all()
    assert finite(results)


@pytest.mark.parametrize("scenario", ["nominal", "paper", "experiment", "swarm"])
@pytest.mark.parametrize("who", [0, 1])
@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e200])
def test_a_state_that_is_no_number_is_lost(
    scenario: str, who: int, part: str, value: float
) -> None:
    """At once, in its own world alone; a follower's for that follower, the leader's for all."""
    flight = begun(3, scenario)
    vehicles(flight)["p"][0, :, 2, 1] -= 1.0  # in the air also where they start on the floor
    vehicles(flight)[part][0, who, 0, 1] = value
    results = flight.step(still(flight))
    sound(flight, results)
    assert results.terminated.tolist() == [False, True, False]
    failed = outcome(results, "failed")[1]
    assert (failed == LOST).all() if who == 0 else failed[0] == LOST
    np.testing.assert_array_equal(term(results, "formation")[1, failed == LOST], 0.0)
    np.testing.assert_array_equal(flight.over, [False, True, False])
    sound(flight, flight.look())
    sound(flight, flight.step(still(flight)))


@pytest.mark.parametrize("part", PARTS)
def test_the_last_substep_is_looked_at_too(part: str) -> None:
    """With one substep a speed that overflows reaches the position a tick later only."""
    flight = begun(1, substeps=1)
    vehicles(flight)[part][0, 1, 0, 0] = NAN
    assert outcome(flight.step(still(flight)), "failed")[0, 0] == LOST


def test_measurements_of_any_kind_are_shown_within_bounds() -> None:
    flight = begun(2, "paper", measurement_delay=2)
    sampled = samples(flight)
    for part in sampled.values():
        for value in (NAN, INF, -INF):
            part[0, 1, :, :, 1] = value
            sound(flight, flight.look())
    other = begun(2, "experiment", followers=3)
    for part in samples(other).values():
        part[0, 0, ..., 0] = NAN
    follower_rows(other)["estimate"][0, 1, :, 1] = NAN
    sound(other, other.look())
    for _ in range(3):
        sound(other, other.step(still(other)))


EXTREMES: dict[str, dict[str, Any]] = {
    "light": {"vehicle": {"inertia": (2e-6,) * 3}},
    "rod": {"vehicle": {"inertia": (1e-3, 1e-3, 1e-9)}},
    "strong": {"vehicle": {"moment_max": (100.0,) * 3}},
    "brisk": {"vehicle": {"rate_lag": 1e-4}, "action": "rates"},
    "unstable": {"vehicle": {"rate_lag": 1.7e-3}, "action": "rates"},
    "leader": {"vehicle": {"rate_lag": 1e-4}, "leader_actuation": "rates"},
    "thrust": {"vehicle": {"thrust_max": 1e300}},
    "noise": {"noise": Noise(1e100, 1e100, 1e100, 1e100, 1e100)},
    "noisier": {"noise": Noise(*[1e300] * 5), "action": "reference"},
    "gust": {"gust": 1e200},
    "scale": {"reward": Rewards(5e-324, 0.05, 0.05, 10.0)},
    "coarse": {"vehicle": {"inertia": (1e-6,) * 3}, "substeps": 1},
}


@pytest.mark.parametrize("name", EXTREMES)
@pytest.mark.parametrize("mode", [kernels.STEP, kernels.STEP_AND_RESET])
def test_extreme_tasks_give_finite_numbers(name: str, mode: int) -> None:
    """Under bang-bang actions, whether they are refused today or not."""
    flight = Simulation(unchecked(**EXTREMES[name]), 17)
    for world in range(17):
        flight.seed(world, world)
    sound(flight, flight.reset())
    draw = np.random.default_rng(0)
    for k in range(60):
        if k % 5 == 0:
            actions = np.sign(draw.normal(size=flight._shape)).astype(np.float32)
        sound(flight, flight.step(actions, mode))


# -- the leader's crash ---------------------------------------------------------------------------------


def crash_leader(flight: Simulation, lane: int = 0) -> None:
    """Fast into the floor, in the next tick."""
    state = vehicles(flight)
    state["p"][0, 0, 2, lane] = -0.01
    state["v"][0, 0, :, lane] = (0.0, 0.0, 5.0)


def test_the_failures_have_names() -> None:
    assert FAILURES == ("none", "collision", "impact", "lost", "leader", "unstarted")
    assert (FAILURES[LEADER], FAILURES[UNSTARTED]) == ("leader", "unstarted")


@pytest.mark.parametrize("action", LEVELS)
def test_the_leaders_crash_is_told_to_all_and_paid_by_none(action: str) -> None:
    flight, other = begun(3, action=action), begun(3, action=action)
    crash_leader(flight, 1)
    results, expected = flight.step(still(flight)), other.step(still(other))
    np.testing.assert_array_equal(outcome(results, "failed"), [[0, 0], [LEADER] * 2, [0, 0]])
    np.testing.assert_array_equal(results.terminated, [False, True, False])
    np.testing.assert_array_equal(term(results, "failure"), 0.0)  # nothing paid
    for world in (0, 2):
        np.testing.assert_array_equal(results.observations[world], expected.observations[world])


def test_a_follower_that_fails_in_the_same_tick_keeps_its_failure_that_all_pay() -> None:
    """Also the one who is told of the leader's crash, for which alone nobody would pay."""
    flight = begun(1)
    crash_leader(flight)
    p = vehicles(flight)["p"][0, :, :, 0]
    p[1] = p[0] + (0.0, 0.0, -0.1)
    results = flight.step(still(flight))
    assert outcome(results, "failed")[0].tolist() == [COLLISION, LEADER]
    assert term(results, "failure")[0].tolist() == [-10.0, -10.0]


def test_a_leader_that_lands_gently_ends_nothing() -> None:
    flight = begun(1, trajectory=trajectories.hover())
    for part, value in (("p", (0.0, 0.0, -0.001)), ("v", (0.0, 0.0, 0.2))):
        vehicles(flight)[part][0, 0, :, 0] = value
    results = flight.step(still(flight))
    assert not results.terminated.any()
    assert not outcome(results, "failed").any()


def test_every_face_tells_of_the_leaders_crash() -> None:
    single, many, parallel = FormationEnv(), FormationVectorEnv(2), parallel_env()
    single.reset(seed=0), many.reset(seed=0), parallel.reset(seed=0)
    for face in (single, many, parallel):
        crash_leader(face.simulation)
    _, _, ended, _, info = single.step(np.zeros(8, np.float32))
    assert ended
    assert info["failure"].tolist() == [LEADER, LEADER]
    _, _, ended, _, info = many.step(np.zeros((2, 8), np.float32))
    assert ended.tolist() == [True, False]
    assert info["failure"].tolist() == [[LEADER] * 2, [0, 0]]
    actions = {agent: np.zeros(4, np.float32) for agent in parallel.agents}
    _, _, ended, _, infos = parallel.step(actions)
    assert all(ended.values())
    assert [info["failure"] for info in infos.values()] == [LEADER, LEADER]
