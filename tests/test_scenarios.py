"""The named tasks are what the paper says, and what their table says."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest
from episodes import SCENARIOS
from scipy.stats import kstest
from states import outcome

from formation_env import configure, scenarios
from formation_env.core.simulation import Simulation
from formation_env.env import FormationEnv
from formation_env.paths.references import by_name
from formation_env.trajectories import Trajectory


def started(scenario: str, worlds: int = 1, **options: object) -> Simulation:
    """Worlds just reset, each from another key."""
    simulation = Simulation(configure(scenario, **options), worlds)
    for i in range(worlds):
        simulation.seed(i, 1000 + i)
    simulation.reset()
    return simulation


@pytest.mark.parametrize("name", SCENARIOS)
def test_it_is_named_and_builds_without_a_warning(name: str) -> None:
    """Warnings are errors here."""
    config = configure(name)
    assert config.scenario == name
    assert config == configure(config)


def test_the_table_names_them_all() -> None:
    rows = [line for line in (scenarios.__doc__ or "").splitlines() if line.startswith("| `")]
    assert tuple(row.split("`")[1] for row in rows) == tuple(scenarios.SCENARIOS) == SCENARIOS


@pytest.mark.parametrize("followers", [1, 2, 5, 16, 256])
def test_a_swarm_of_any_size_never_inverts(followers: int) -> None:
    config = configure("swarm", followers=followers)
    assert config.followers == followers
    assert all(report.bound_holds for report in config.feasibility())
    assert min(report.least_speed_ratio for report in config.feasibility()) > 0.0


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("followers", [1, 3, 8])
def test_any_number_may_follow_in_every_scenario(scenario: str, followers: int) -> None:
    """Without a warning, because no virtual follower inverts, and told by the integrated (26)."""
    config = configure(scenario, followers=followers)
    assert config.followers == followers
    assert not any(report.inverts for report in config.feasibility())


def test_nominal_is_the_papers_pair_on_31() -> None:
    config = configure()
    assert config.offsets == ((0.35, 0.35, -0.3), (0.35, -0.35, -0.3))
    t = np.linspace(0.0, 30.0, 50)
    expected = np.stack([2 * np.cos(0.25 * t), np.sin(0.5 * t), np.full(50, -1.5)], axis=1)
    np.testing.assert_allclose(by_name(config.trajectory(t))["p"], expected, atol=1e-12)
    assert max(config.noise) == 0.0
    assert (config.gust, config.gust_time) == (0.04, 0.5)
    assert (config.control_period, config.substeps, config.duration) == (0.02, 4, 30.0)


def test_paper_starts_as_in_iii_c() -> None:
    world = started("paper", path="as given")
    np.testing.assert_array_equal(world.positions[0], [[0, 0, 0], [-0.5, -1, 0], [-2, 1, 0]])
    for still in (world.velocities, world.angular_velocities):
        np.testing.assert_array_equal(still, 0.0)
    np.testing.assert_array_equal(world.attitudes[0], [[1, 0, 0, 0]] * 3)
    assert not world.started[0]
    noise, gains = world.config.noise, world.config.tracker
    assert noise == (0.2, 0.1, 0.01, radians(0.02), radians(0.02))
    assert (gains.k1, gains.k2, gains.k3, gains.k4) == (0.5, 1.5, 10.0, 0.5)
    assert (gains.kz, gains.sigma_max, gains.c) == (1.0, 5.0, 50.0)
    assert (gains.p11, *gains.weights) == (1.0, pytest.approx(1 / 3), 0.5)
    planner = world.config.planner
    assert (planner.k1, planner.k2, planner.k3, planner.p_max) == (0.2, 2.0, 0.0, 5.0)
    airframe = world.config.world.airframe
    assert (airframe.mass, airframe.inertia) == (0.1, (1e-3, 1e-3, 2e-3))


def test_episodes_cover_the_path() -> None:
    """A loop of it at most 0.2 s longer than the 25 s that are scored, or than an episode of `swarm`."""
    for name in ("nominal", "paper", "experiment"):
        config = configure(name)
        assert config.trajectory.period <= 25.2
        start = config.limits.deadline if config.start == "ground" else 0.0
        assert config.duration == start + 30.0
    swarm = configure("swarm")
    assert swarm.trajectory.period <= swarm.duration < swarm.trajectory.period + 1.0
    assert swarm.duration >= 30.0


@pytest.mark.parametrize("followers", [4, 16, 64])
def test_a_swarm_turns(followers: int) -> None:
    """At the same acceleration whatever its size: its vehicles tilt by 10 degrees half of the time."""
    path = configure("swarm", followers=followers).trajectory
    flown = by_name(path(np.linspace(0.0, path.period, 2000)))
    lateral = np.linalg.norm(flown["a"], axis=1)
    tilt = np.degrees(np.arctan(lateral / 9.81))
    assert 10.0 < np.median(tilt) < 12.0
    assert tilt.max() < 20.0


def test_experiment_is_section_iv() -> None:
    config = configure("experiment")
    assert config.vehicle.mass == 0.078
    assert 1.0 / config.control_period == pytest.approx(44.0)
    clock = config.world.clock
    assert clock.sample_every * clock.period / clock.substeps == pytest.approx(1.0 / 50.0)
    assert clock.window == 100
    assert config.action == config.leader_actuation == config.reference_actuation == "rates"
    speed = np.linalg.norm(by_name(config.trajectory(np.linspace(0, 30, 200)))["v"], axis=1)
    np.testing.assert_allclose(speed, 0.5, rtol=1e-9)  # (70) as corrected


def test_agile_draws_a_new_path_each_episode() -> None:
    env = FormationEnv("agile", path="as given")
    times = np.linspace(0.0, 20.0, 400)
    paths = []
    for seed in (0, None, None, 7):
        env.reset(seed=seed)
        path = env.simulation.reference(times)
        np.testing.assert_allclose(path[0], [0, 0, -1.5], atol=1e-12)
        table = env.get_state().state["tables"][0]
        motion = Trajectory("drawn", env.config.trajectory.kind, table)(times)
        np.testing.assert_allclose(motion[:, 0], path, atol=1e-12)
        speed = np.linalg.norm(motion[:, 1], axis=1)
        assert 1.8 - 1e-9 <= speed.min() < speed.max() <= 4.2 + 1e-9
        assert np.linalg.norm(motion[:, 2], axis=1).max() <= 2.0 + 1e-9
        paths.append(path)
    for i, path in enumerate(paths):
        for other in paths[i + 1 :]:
            assert np.abs(path - other)[-1].max() > 0.1


@pytest.mark.parametrize("scenario", ["nominal", "agile", "swarm"])
def test_in_formation_the_leader_flies_on_its_reference(scenario: str) -> None:
    world = started(scenario, worlds=2)
    for w in range(2):
        h = 1e-4
        ahead = world.reference(np.array([0.0, h, 2 * h]), w)
        velocity = (-3 * ahead[0] + 4 * ahead[1] - ahead[2]) / (2 * h)
        np.testing.assert_allclose(world.positions[w, 0], ahead[0], atol=1e-12)
        np.testing.assert_allclose(world.velocities[w, 0], velocity, atol=1e-6)


def test_in_formation_followers_start_uniformly_in_a_ball() -> None:
    """The share of a ball within r is (r / R)^3, and no direction is preferred."""
    worlds = 3000
    simulation = Simulation(configure(), worlds)
    for i in range(worlds):
        simulation.seed(i, i)
    followers = outcome(simulation.reset(), "slot_error")
    away = followers.reshape(-1, 3)
    r = np.linalg.norm(away, axis=1)
    radius = simulation.config.start_offset
    assert r.max() <= radius == 0.15
    assert kstest((r / radius) ** 3, "uniform").pvalue > 0.01
    direction = away / r[:, None]
    for axis in range(3):  # Archimedes: each coordinate of a uniform direction is uniform
        assert kstest(0.5 * (direction[:, axis] + 1.0), "uniform").pvalue > 0.01
    correlation = np.corrcoef(followers[:, 0, 0], followers[:, 1, 0])[0, 1]
    assert abs(correlation) < 4.0 / np.sqrt(worlds)


def test_in_formation_followers_are_level_and_move_with_their_slots() -> None:
    world = started("agile")
    slots = outcome(world.look(), "slot")[0]
    np.testing.assert_array_equal(world.attitudes[0, 1:, 1:3], 0.0)  # turned about the vertical
    np.testing.assert_array_equal(world.angular_velocities[0, 1:], 0.0)
    velocity = world.velocities[0, 1:].copy()
    world.step(np.zeros((1, 2, 4), np.float32))
    moved = (outcome(world.look(), "slot")[0] - slots) / world.config.control_period
    np.testing.assert_allclose(velocity, moved, atol=0.02)
