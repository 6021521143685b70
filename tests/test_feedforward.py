"""The closed-form third and fourth derivatives: each is the rate of the one before it."""

from __future__ import annotations

import numpy as np
import pytest
from closed_loop import PROPERTY, Sines, agree, rate
from hypothesis import given
from planar_loop import GENERIC, LAWS, SEEDS, STATES, D, control, flow, virtual

from formation_env.laws import feedforward, planner
from formation_env.laws.planner import PlannerLaw
from formation_env.paths.references import TrajectoryPoint


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_actuation_starts_with_the_law(x: np.ndarray, seed: int, law: PlannerLaw) -> None:
    leader = TrajectoryPoint(*Sines(seed).at(x[9]))
    m = feedforward.actuation(virtual(x), leader, D, law)
    agree([m.T, m.tau], control(x, leader, D, law), 1e-12)


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_actuation_rates(x: np.ndarray, seed: int, law: PlannerLaw) -> None:
    """`T_dot` is the rate of `T` along the closed loop, `T_ddot` that of `T_dot`; `tau` alike."""

    def actuation(y: np.ndarray) -> np.ndarray:
        leader = TrajectoryPoint(*Sines(seed).at(y[9]))
        return np.array(feedforward.actuation(virtual(y), leader, D, law))

    found = actuation(x)
    moving = rate(actuation, x, flow(x, TrajectoryPoint(*Sines(seed).at(x[9])), D, law), 1e-4)
    agree(found[2:], moving[:4], 1e-6)


def reference(y: np.ndarray, seed: int, law: PlannerLaw) -> np.ndarray:
    """The full reference as 15 numbers."""
    leader = TrajectoryPoint(*Sines(seed).at(y[9]))
    return np.concatenate(feedforward.full_trajectory_point(virtual(y), leader, D, law))


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_reference_is_a_chain_of_derivatives(x: np.ndarray, seed: int, law: PlannerLaw) -> None:
    """Position, velocity, acceleration, jerk, snap: all three axes, below the vertical limit."""
    law = law._replace(z_max=50.0)
    found = reference(x, seed, law)
    x_dot = flow(x, TrajectoryPoint(*Sines(seed).at(x[9])), D, law)
    moving = rate(lambda y: reference(y, seed, law), x, x_dot, 1e-4)
    agree(found[3:], moving[:12], 1e-6)


@PROPERTY
@given(STATES, SEEDS)
def test_first_two_derivatives_are_the_planners(x: np.ndarray, seed: int) -> None:
    leader = TrajectoryPoint(*Sines(seed).at(x[9]))
    plain = planner.trajectory_point(virtual(x), leader, D, GENERIC)
    full = feedforward.full_trajectory_point(virtual(x), leader, D, GENERIC)
    agree(np.concatenate(full[:3]), np.concatenate(plain[:3]), 1e-12)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_saturated_climb_has_no_jerk(side: float) -> None:
    """While (34) saturates the vertical acceleration is constant; the plane is not affected."""
    x = np.array([0.5, 1.5, 2.0, 0.6, -0.8, 0.3, -0.2, -20.0 * side, 0.2, 1.0])
    found = reference(x, 3, GENERIC)
    x_dot = flow(x, TrajectoryPoint(*Sines(3).at(1.0)), D, GENERIC)
    moving = rate(lambda y: reference(y, 3, GENERIC), x, x_dot, 1e-4)
    assert found[8] == side * GENERIC.z_max
    assert found[11] == found[14] == 0.0
    agree(found[3:], moving[:12], 1e-6)
