"""What a follower sees and is paid for, recomputed from the truth with matrices and SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from episodes import LEVELS, gentle
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from states import outcome

from formation_env import Limits, Rewards, configure, trajectories
from formation_env.core.simulation import Simulation
from formation_env.laws.levels import REFERENCE
from formation_env.task import FAILURES, LOST, NO_FAILURE, UNSTARTED, Layout, failure, reward

FREE = Limits(collision=1e-3, impact=1e3, tilt=-1.0, lost=1e4, deadline=1e3)
Floats = npt.NDArray[np.float64]


def begin(scenario: str = "nominal", **options: Any) -> Simulation:
    simulation = Simulation(configure(scenario, limits=FREE, **options))
    simulation.seed(0, 3)
    simulation.reset()
    return simulation


def seen_now(simulation: Simulation) -> dict[str, Floats]:
    return simulation.layout.unpack(simulation.look().observations[0].astype(np.float64))


def frame(heading: Floats) -> Floats:
    """The rotation matrix of {F}, from (cos, sin)."""
    c, s = heading
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# -- the observation --------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("scenario", ["nominal", "agile"])
def test_observation_without_noise_is_the_truth(scenario: str, level: str) -> None:
    """Every entry but the acceleration, from positions, velocities and attitudes."""
    world = (
        begin(scenario, followers=3, action=level) if scenario == "agile" else begin(action=level)
    )
    n, k = world.config.followers, world.config.action_size
    for row in gentle(60, n * k, seed=5) * np.float32(10.0):
        world.step(row.reshape(1, n, k))
        seen, slots = seen_now(world), outcome(world.look(), "slot")[0]
        p, v, w = world.positions[0], world.velocities[0], world.angular_velocities[0]
        R = Rotation.from_quat(world.attitudes[0][:, [1, 2, 3, 0]]).as_matrix()
        for i, d in enumerate(world.config.offsets):
            F = frame(seen["heading"][i]).T
            expected = {
                "slot_error": F @ (p[0] - p[i + 1]) - d,
                "relative_velocity": F @ (v[0] - v[i + 1]),
                "leader_velocity": F @ v[0],
                "body_x": F @ R[i + 1][:, 0],
                "body_z": F @ R[i + 1][:, 2],
                "angular_velocity": w[i + 1],
                "offset": d,
                "previous_action": np.pad(row.reshape(n, k)[i], (0, 4 - k)),
                "started": [1.0],
                "position": p[i + 1],
            }
            for name, value in expected.items():
                np.testing.assert_allclose(seen[name][i], value, atol=3e-6, err_msg=name)
            # Without noise the estimated heading is the slot's: the slot error is the true one.
            np.testing.assert_allclose(seen["slot_error"][i], F @ (slots[i] - p[i + 1]), atol=3e-6)


def test_leader_acceleration_is_the_rate_of_its_velocity() -> None:
    world = begin("agile")
    errors, seen_by_tick = [], []
    calm = np.zeros((1, 2, 4), np.float32)
    for _ in range(300):
        before = world.velocities[0, 0]
        world.step(calm)
        seen = seen_now(world)
        a = frame(seen["heading"][0]) @ seen["leader_acceleration"][0]
        errors.append(a - (world.velocities[0, 0] - before) / 0.02)
        seen_by_tick.append(a)
    # It is the acceleration at the end of the tick, its mean differs by half a tick of jerk.
    jerk = np.abs(np.diff(seen_by_tick, axis=0)).max() / 0.02
    assert np.abs(errors).max() < 0.5 * 0.02 * jerk + 1e-3
    assert np.linalg.norm(seen_by_tick, axis=1).max() > 0.6


def test_an_action_is_seen_in_the_next_observation_as_executed() -> None:
    world = begin(action="reference")
    world.step(np.array([[[3.0, -0.5, 0.25], [0.0, -9.0, 1.0]]], np.float32))
    expected = [[1.0, -0.5, 0.25, 0.0], [0.0, -1.0, 1.0, 0.0]]
    np.testing.assert_array_equal(seen_now(world)["previous_action"], expected)


@pytest.mark.parametrize("neighbours", [1, 3, 6])
def test_neighbours_come_nearest_first(neighbours: int) -> None:
    """Five followers: with six asked for, the last two are absent and zero."""
    world = begin("swarm", followers=5, neighbours=neighbours)
    for row in gentle(25, 20, seed=2) * np.float32(20.0):
        world.step(row.reshape(1, 5, 4))
    seen = seen_now(world)
    p, v = world.positions[0, 1:], world.velocities[0, 1:]
    for i in range(5):
        F = frame(seen["heading"][i]).T
        others = sorted((j for j in range(5) if j != i), key=lambda j: np.linalg.norm(p[j] - p[i]))
        for place in range(neighbours):
            present = seen["neighbour_present"][i, place]
            found = seen["neighbour_position"][i, place], seen["neighbour_velocity"][i, place]
            if place < 4:
                j = others[place]
                assert present == 1.0
                np.testing.assert_allclose(found[0], F @ (p[j] - p[i]), atol=3e-6)
                np.testing.assert_allclose(found[1], F @ (v[j] - v[i]), atol=3e-6)
            else:
                assert present == 0.0
                np.testing.assert_array_equal(found, 0.0)


def test_equally_near_neighbours_are_both_seen() -> None:
    """On a line the middle one has two at the same distance: neither hides the other."""
    abreast = ((0.5, 0.7, -0.3), (0.5, 0.0, -0.3), (0.5, -0.7, -0.3))
    world = begin(offsets=abreast, trajectory=trajectories.line(), start_offset=0.0)
    seen = seen_now(world)["neighbour_position"][1]
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), [0.7, 0.7], rtol=1e-6)
    np.testing.assert_allclose(seen[0], -seen[1], atol=1e-6)


# -- the slots --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", ["nominal", "experiment", "agile"])
def test_slots_solve_the_zero_dynamics(scenario: str) -> None:
    """(6) and (23) along the leader's recorded path, integrated by SciPy."""
    options: dict[str, Any] = {"offsets": ((0.35, 0.3, -0.3), (0.25, -0.3, 0.2))}
    if scenario == "experiment":
        options |= {"start": "formation"}
    if scenario == "nominal":
        options["trajectory"] = trajectories.figure_eight((4.0, 2.0), 0.125)
    world = begin(scenario, **options)
    h = world.config.control_period
    path, velocity = [world.positions[0, 0]], [world.velocities[0, 0]]
    slots = [outcome(world.look(), "slot")[0]]
    calm = np.zeros((1, 2, 4), np.float32)
    for _ in range(400):
        slots.append(outcome(world.step(calm), "slot")[0])
        path.append(world.positions[0, 0])
        velocity.append(world.velocities[0, 0])
    t = h * np.arange(401)
    v = CubicSpline(t, velocity)
    start = world.reference(np.array([0.0, 1e-6]))
    east, north = (start[1] - start[0])[1], (start[1] - start[0])[0]
    theta0 = np.arctan2(east, north)
    for i, (dx, dy, dz) in enumerate(world.config.offsets):

        def rate(now: float, theta: Floats, dx: float = dx) -> Floats:
            vx, vy, _ = v(now)
            return (np.cos(theta) * vy - np.sin(theta) * vx) / dx

        theta = solve_ivp(rate, (0.0, t[-1]), [theta0], t_eval=t, rtol=1e-10, atol=1e-10).y[0]
        c, s = np.cos(theta), np.sin(theta)
        offset = np.stack([c * dx - s * dy, s * dx + c * dy, np.full_like(c, dz)], axis=1)
        np.testing.assert_allclose(np.array(slots)[:, i], np.array(path) - offset, atol=1e-3)
        assert np.ptp(theta) > 0.1


def test_slots_do_not_depend_on_who_flies_to_them() -> None:
    one, two = begin("agile"), begin("agile")
    for a, b in zip(gentle(100, 8), gentle(100, 8, seed=9) * np.float32(30.0), strict=True):
        first, second = one.step(a.reshape(1, 2, 4)), two.step(b.reshape(1, 2, 4))
        np.testing.assert_array_equal(outcome(first, "slot")[0], outcome(second, "slot")[0])
    assert np.abs(one.positions[0, 1:] - two.positions[0, 1:]).max() > 0.01


def test_with_noise_the_estimated_heading_strays_but_not_far() -> None:
    """The zero dynamics are stable: noise in the velocity leaves a bounded error."""
    world = begin("paper", start="formation", leader_start=None, follower_starts=None)
    calm = np.zeros((1, 2, 4), np.float32)
    errors = []
    for _ in range(500):
        slots = outcome(world.step(calm), "slot")[0]
        R = (world.positions[0, 0] - slots)[0]
        d = world.config.offsets[0]
        true = np.arctan2(R[1], R[0]) - np.arctan2(d[1], d[0])
        c, s = seen_now(world)["heading"][0]
        errors.append((np.arctan2(s, c) - true + np.pi) % (2 * np.pi) - np.pi)
    assert 1e-4 < np.std(errors) < 0.2
    assert np.abs(errors).max() < 0.6


# -- failure and reward -----------------------------------------------------------------------------------

LIMITS = Limits(collision=0.2, impact=1.0, tilt=0.5, lost=10.0)


@pytest.mark.parametrize("overdue", [False, True])
@pytest.mark.parametrize(
    ("separation", "speed", "upright", "error", "why"),
    [
        (0.21, 0.0, 0.0, 9.9, "none"),
        (0.19, 5.0, -1.0, 99.0, "collision"),  # the first of several counts
        (1.0, 1.1, 1.0, 0.0, "impact"),
        (1.0, 0.9, 0.6, 0.0, "none"),
        (1.0, 0.9, 0.4, 0.0, "impact"),
        (1.0, 0.0, 0.4, 0.0, "none"),  # tilted in the air
        (1.0, 0.0, 1.0, 10.1, "lost"),
        (np.nan, 0.0, 1.0, np.nan, "lost"),
        (np.inf, 0.0, 1.0, np.inf, "lost"),
    ],
)
def test_failures(
    separation: float, speed: float, upright: float, error: float, why: str, overdue: bool
) -> None:
    """A start that is overdue counts where nothing else does."""
    expected = "unstarted" if overdue and why == "none" else why
    assert FAILURES[failure(separation, speed, upright, error, overdue, LIMITS)] == expected


def test_failures_are_numbered_as_named() -> None:
    assert (FAILURES[NO_FAILURE], FAILURES[LOST], FAILURES[4]) == ("none", "lost", "leader")
    assert FAILURES[UNSTARTED] == FAILURES[-1] == "unstarted"


actions = st.tuples(*[st.floats(-1.0, 1.0, allow_subnormal=False)] * 4)


@given(st.floats(0.0, 1e3, allow_subnormal=False), actions, actions, st.booleans(), st.booleans())
def test_reward_is_bounded_and_best_when_exact_and_calm(
    error: float, a: Any, before: Any, failed: bool, started: bool
) -> None:
    weights = Rewards()
    terms = reward(started, 0.0, error, a, before, 4, failed, weights)
    assert 0.0 < terms.formation <= 1.0 if started else terms.formation == 0.0
    assert terms.waiting == 0.0 if started else -0.01 <= terms.waiting <= 0.0
    assert -0.05 <= terms.effort <= 0.0
    assert -0.2 <= terms.smoothness <= 0.0
    assert terms.failure == (-10.0 if failed else 0.0)
    closer = reward(started, 0.0, 0.5 * error, a, before, 4, failed, weights)
    assert closer.formation >= terms.formation
    assert closer.waiting >= terms.waiting
    best = reward(started, 0.0, 0.0, (0.0,) * 4, (0.0,) * 4, 4, False, weights)
    assert sum(best) == float(started)
    assert sum(terms) <= sum(best)
    held = reward(started, 0.0, error, a, a, 4, failed, weights)
    assert held.smoothness == 0.0


# -- the layout -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [0, REFERENCE])
@pytest.mark.parametrize("neighbours", [0, 1, 4])
@pytest.mark.parametrize("shape", [(), (3,), (2, 5)])
def test_pack_undoes_unpack(level: int, neighbours: int, shape: tuple[int, ...]) -> None:
    layout = Layout(level, neighbours)
    rows = np.arange(np.prod(shape) * layout.size, dtype=np.float32).reshape(*shape, layout.size)
    named = layout.unpack(rows)
    np.testing.assert_array_equal(layout.pack(named), rows)
    assert layout.pack(named).dtype == np.float32
    assert all(np.shares_memory(view, rows) for view in named.values() if view.size)
    total = sum(int(np.prod(view.shape[len(shape) :])) for view in named.values())
    assert total == layout.size == len(layout.bound)
