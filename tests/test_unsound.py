"""Where a state leaves the numbers: the episode ends as lost, and all that a learner gets is finite."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from episodes import LEVELS
from states import A, P, Q, V, W, begun, rows, still, unchecked, vehicles

from formation_env import kernels, trajectories
from formation_env.env import FormationEnv
from formation_env.formation_v0 import parallel_env
from formation_env.sensors import Noise
from formation_env.simulation import Simulation
from formation_env.task import COLLISION, FAILURES, LEADER, LOST, Rewards
from formation_env.vector import FormationVectorEnv

NAN, INF = float("nan"), float("inf")
FAILED = 12  # column of `Results.outputs`


def sound(simulation: Simulation, results: Any) -> None:
    """Finite and within the observation space."""
    bound = simulation.layout.bound
    for rows_ in (results.observations, results.final_observations):
        if rows_.size:
            assert np.isfinite(rows_).all()
            assert (np.abs(rows_) <= bound).all()
    assert np.isfinite(results.ends).all()
    assert np.isfinite(results.outputs[..., :5]).all()  # rewards and their terms


@pytest.mark.parametrize("scenario", ["nominal", "paper", "experiment", "swarm"])
@pytest.mark.parametrize("who", [0, 1])
@pytest.mark.parametrize("part", [P, V, Q, W], ids="pvqw")
@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e200])
def test_a_state_that_is_no_number_is_lost(
    scenario: str, who: int, part: slice, value: float
) -> None:
    """At once, in its own world alone; a follower's for that follower, the leader's for all."""
    flight = begun(3, scenario)
    vehicles(flight)[0, :, 2, 1] -= 1.0  # in the air also where they start on the floor
    vehicles(flight)[0, who, part.start, 1] = value
    results = flight.step(still(flight))
    sound(flight, results)
    assert results.ends[1].tolist() == [0.0, 1.0, 0.0]
    failed = results.outputs[1, :, FAILED]
    assert (failed == LOST).all() if who == 0 else failed[0] == LOST
    np.testing.assert_array_equal(results.outputs[1, failed == LOST, 1], 0.0)  # the formation term
    np.testing.assert_array_equal(flight.over, [False, True, False])
    sound(flight, flight.look())
    sound(flight, flight.step(still(flight)))


@pytest.mark.parametrize("part", [P, V, Q, W], ids="pvqw")
def test_the_last_substep_is_looked_at_too(part: slice) -> None:
    """With one substep a speed that overflows reaches the position a tick later only."""
    flight = begun(1, substeps=1)
    vehicles(flight)[0, 1, part.start, 0] = NAN
    assert flight.step(still(flight)).outputs[0, 0, FAILED] == LOST


def test_measurements_of_any_kind_are_shown_within_bounds() -> None:
    flight = begun(2, "paper", measurement_delay=2)
    sampled = rows(flight._state.samples)
    for part in (P, V, A, Q, W):
        for value in (NAN, INF, -INF):
            sampled[0, 1, :, part, 1] = value
            sound(flight, flight.look())
    other = begun(2, "experiment", followers=3)
    rows(other._state.samples)[0, 0, :, :, 0] = NAN
    rows(other._state.followers)[0, 1, 2:4, 1] = NAN
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
    leader = vehicles(flight)[0, 0, :, lane]
    leader[P], leader[V] = (leader[0], leader[1], -0.01), (0.0, 0.0, 5.0)


def test_the_failures_have_names() -> None:
    assert FAILURES == ("none", "collision", "impact", "lost", "leader")
    assert FAILURES[LEADER] == "leader"


@pytest.mark.parametrize("action", LEVELS)
def test_the_leaders_crash_is_told_to_all_and_paid_by_nobody(action: str) -> None:
    flight, other = begun(3, action=action), begun(3, action=action)
    crash_leader(flight, 1)
    results, expected = flight.step(still(flight)), other.step(still(other))
    np.testing.assert_array_equal(results.outputs[..., FAILED], [[0, 0], [LEADER] * 2, [0, 0]])
    np.testing.assert_array_equal(results.ends[1], [0.0, 1.0, 0.0])
    np.testing.assert_array_equal(results.outputs[..., 4], 0.0)  # nothing paid
    for world in (0, 2):
        np.testing.assert_array_equal(results.observations[world], expected.observations[world])


def test_who_fails_in_the_same_tick_keeps_the_failure_that_is_paid() -> None:
    flight = begun(1)
    crash_leader(flight)
    state = vehicles(flight)[0, :, :, 0]
    state[1, P] = state[0, P] + (0.0, 0.0, -0.1)
    results = flight.step(still(flight))
    assert results.outputs[0, :, FAILED].tolist() == [COLLISION, LEADER]
    assert results.outputs[0, :, 4].tolist() == [-10.0, 0.0]


def test_a_leader_that_lands_gently_ends_nothing() -> None:
    flight = begun(1, trajectory=trajectories.hover())
    leader = vehicles(flight)[0, 0, :, 0]
    leader[P], leader[V] = (0.0, 0.0, -0.001), (0.0, 0.0, 0.2)
    results = flight.step(still(flight))
    assert not results.ends[1].any()
    assert not results.outputs[..., FAILED].any()


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
