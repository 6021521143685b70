"""What `tick`, `moving` and `episodes` hand to the laws: whose motion, which vehicle, how many followers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from states import begun, follower_rows, measured_in, outcome, still

from formation_env import Noise, trajectories
from formation_env.core import arrays
from formation_env.core.simulation import Simulation
from formation_env.laws.slots import advance_heading, slot
from formation_env.laws.world import near, resting, start_yaw, trimmed
from formation_env.memory.records import LANES, flatten, size
from formation_env.paths.course import draw_course, lay_direction, lay_point
from formation_env.physics.quadrotor import GRAVITY
from formation_env.physics.sensors import Measured, corrupt, exact
from formation_env.trajectories import TrajectoryPoint, evaluate, start_direction

NOISE = Noise(0.02, 0.05, 0.04, 0.01, 0.02)
H = 0.02  # s, control period
LANE = 0


def true_state(flight: Simulation, i: int) -> Measured:
    """Of vehicle `i` in the first world."""
    return measured_in(flight._state.vehicles[0, i], LANE)


def sample(flight: Simulation, i: int) -> Measured:
    """The measurement of vehicle `i` in the first world, where there is one a tick."""
    return measured_in(flight._state.samples[0, i, 0], LANE)


def own_rows(flight: Simulation, i: int) -> dict[str, Any]:
    """What is kept of follower `i` in the first world."""
    return {name: part[0, i, :, LANE].copy() for name, part in follower_rows(flight).items()}


def episode_key(flight: Simulation) -> Any:
    return arrays.MEMORY.views(flight._memory)["episode_keys"][0, LANE]


# -- episodes -------------------------------------------------------------------------------------------


def test_an_episode_begins_as_the_laws_have_it_for_each_vehicle() -> None:
    """The leader flies along its reference, acceleration included; what is random is each vehicle's own."""
    flight = begun(noise=NOISE)
    world, key = flight.config.world, episode_key(flight)
    family = arrays.family(flight._memory)
    course, tick = draw_course(key, world.courses)
    assert tick > 0
    given = evaluate(family, arrays.own_table(flight._memory, 0), tick * H)
    first = lay_point(course, given)
    assert np.linalg.norm(first.a) > 0.05, "the path begins with an acceleration"
    leader = trimmed(first, start_yaw(key, 0, world), world)
    heading = complex(*own_rows(flight, 0)["heading"])
    assert heading == pytest.approx(complex(*first.v[:2]) / np.hypot(*first.v[:2]), abs=1e-12)
    offsets = flight.config.offsets
    for i in range(flight.config.followers + 1):
        body, a = leader, first.a
        if i > 0:
            d = tuple(map(float, offsets[i - 1]))
            body = near(slot(heading, leader.p, leader.v, d), key, i, world)
            a = (0.0, 0.0, 0.0)
        expected = exact(body, a)
        np.testing.assert_allclose(flatten(true_state(flight, i)), flatten(expected), atol=1e-12)
        told = corrupt(expected, NOISE, key, i, 0)
        np.testing.assert_allclose(flatten(sample(flight, i)), flatten(told), atol=1e-12)


def test_an_episode_goes_on_along_the_path_from_where_it_began() -> None:
    """The reference of the first ticks, and the virtual follower, which begins at its vehicle."""
    flight = begun(action="reference", gust=0.0)
    world, key = flight.config.world, episode_key(flight)
    family, table = arrays.family(flight._memory), arrays.own_table(flight._memory, 0)
    course, first = draw_course(key, world.courses)
    for i in range(flight.config.followers):
        kept, own = own_rows(flight, i), true_state(flight, i + 1)
        assert (tuple(kept["p"]), tuple(kept["v"])) == (own.p, own.v)
    for tick in range(5):
        ahead = lay_point(course, evaluate(family, table, (first + tick) * H))
        np.testing.assert_allclose(flight.leaders[0], ahead.p, atol=1e-3)
        np.testing.assert_allclose(true_state(flight, 0).v, ahead.v, atol=1e-3)
        flight.step(still(flight))
        rows = arrays.ROOM.views(flight._rooms[0])["reference"][: LANES * size(TrajectoryPoint)]
        told = arrays.rows(rows, TrajectoryPoint)["p"]
        np.testing.assert_allclose(told[:, LANE], ahead.p, atol=1e-12)


def test_on_the_ground_vehicles_stand_relative_to_where_the_path_begins() -> None:
    """Every one with its own yaw; the virtual follower waits at the slot of the path's first point."""
    flight = begun(scenario="paper", action="reference", noise=Noise())
    world, key, config = flight.config.world, episode_key(flight), flight.config
    family, table = arrays.family(flight._memory), arrays.own_table(flight._memory, 0)
    course, tick = draw_course(key, world.courses)
    begin = lay_point(course, evaluate(family, table, tick * H)).p
    R = lay_direction(course, start_direction(family, table, tick * H))
    for i, place in enumerate(config.ground_places()):
        apart = R * complex(*place[:2])
        stood = (begin[0] + apart.real, begin[1] + apart.imag, 0.0)
        expected = exact(resting(stood, start_yaw(key, i, world)), (0.0, 0.0, 0.0))
        np.testing.assert_allclose(flatten(true_state(flight, i)), flatten(expected), atol=1e-12)
    for i, d in enumerate(config.offsets):
        kept = own_rows(flight, i)
        waiting = slot(R, begin, (0.0, 0.0, 0.0), d)
        np.testing.assert_allclose(kept["p"], waiting.p, atol=1e-12)
        np.testing.assert_array_equal(kept["v"], 0.0)
        assert (
            complex(*kept["heading"]) == complex(*kept["estimate"]) == pytest.approx(R, abs=1e-12)
        )


# -- moving ---------------------------------------------------------------------------------------------


def test_measurements_out_of_step_with_the_ticks_are_taken_within_them() -> None:
    """In free fall the height tells when it was measured: at multiples of 1.5 ticks."""
    hover = trajectories.hover((0.0, 0.0, -100.0))
    flight = begun(action="rates", trajectory=hover, start_offset=0.0, measurement_period=1.5 * H)
    top = true_state(flight, 1).p[2]
    falling = still(flight)
    falling[..., 0] = -1.0
    for k in range(1, 10):
        results = flight.step(falling)
        seen = flight.layout.unpack(results.observations.astype(np.float64))
        t = k * 2 // 3 * 1.5 * H
        assert seen["position"][0, 0, 2] == pytest.approx(top + 0.5 * GRAVITY * t**2, abs=1e-5)


def test_headings_turn_by_the_true_leader_and_estimates_by_the_measured_one() -> None:
    """(23) from the velocity before the tick to the one after it, each from its own source."""
    flight = begun(noise=NOISE)
    offsets = flight.config.offsets
    for _ in range(3):
        true, told = true_state(flight, 0).v, sample(flight, 0).v
        rows = [own_rows(flight, i) for i in range(flight.config.followers)]
        flight.step(still(flight))
        for i, before in enumerate(rows):
            after, d_x = own_rows(flight, i), float(offsets[i][0])
            for name, old, new in (
                ("heading", true, true_state(flight, 0).v),
                ("estimate", told, sample(flight, 0).v),
            ):
                R = advance_heading(
                    complex(*before[name]), complex(*old[:2]), complex(*new[:2]), d_x, H
                )
                assert complex(*after[name]) == pytest.approx(R, abs=1e-12), name


# -- tick -----------------------------------------------------------------------------------------------


def test_the_reward_of_a_world_is_the_mean_of_its_followers() -> None:
    flight = begun()
    results = flight.step(still(flight))
    rewards = outcome(results, "reward")[0]
    assert rewards.std() > 0.0
    assert results.rewards[0] == pytest.approx(rewards.mean(), rel=1e-12)
