"""A world's physics against closed forms: actuators, gusts, the floor, the virtual follower, the start."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from episodes import gentle
from states import counters, outcome

from formation_env import Limits, Noise, Vehicle, configure, trajectories
from formation_env.core.arrays import by_world
from formation_env.core.simulation import Simulation
from formation_env.physics.quadrotor import GRAVITY

HOVER = trajectories.hover()
STILL: dict[str, Any] = {
    "trajectory": HOVER,
    "path": "as given",
    "start_offset": 0.0,
    "gust": 0.0,
}
FREE = Limits(collision=1e-3, impact=1.0, tilt=0.5, lost=1e3, deadline=1e9)
H = 0.02  # s, control period
NOISE = Noise(0.02, 0.03, 0.04, 0.01, 0.02)


def begin(worlds: int = 1, scenario: str = "nominal", **options: Any) -> Simulation:
    simulation = Simulation(configure(scenario, **options), worlds)
    for i in range(worlds):
        simulation.seed(i, 50 + i)
    simulation.reset()
    return simulation


def push(simulation: Simulation, action: Any, steps: int) -> None:
    """The same action for every follower."""
    config = simulation.config
    shape = (simulation.num_worlds, config.followers, config.action_size)
    row = np.broadcast_to(np.asarray(action, np.float32), shape).copy()
    for _ in range(steps):
        simulation.step(row)


# -- actuators ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", ["wrench", "rates"])
@pytest.mark.parametrize("a", [0.0, 0.25, -0.25, 1.0])
def test_thrust_action_is_in_units_of_the_weight(level: str, a: float) -> None:
    """`0.5 T_max (a + 1)` with `T_max = 2 m g`: the vehicle accelerates upwards with `g a`."""
    world = begin(action=level, limits=FREE, **STILL)
    z = world.positions[0, 1:, 2]
    push(world, [a, 0, 0, 0], 20)
    t = 20 * H
    np.testing.assert_allclose(world.positions[0, 1:, 2], z - 0.5 * GRAVITY * a * t**2, atol=1e-12)
    np.testing.assert_allclose(world.velocities[0, 1:, 2], -GRAVITY * a * t, atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_moment_action_turns_about_its_body_axis(axis: int) -> None:
    """From rest about a principal axis: `omega = M t / J`."""
    world = begin(limits=FREE, **STILL)
    action = np.zeros(4)
    action[1 + axis] = 0.5
    push(world, action, 5)
    vehicle = world.config.vehicle
    expected = np.zeros(3)
    expected[axis] = 0.5 * vehicle.moment_max[axis] / vehicle.inertia[axis] * 5 * H
    np.testing.assert_allclose(world.angular_velocities[0, 1:], [expected] * 2, atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_rate_action_is_followed_with_a_lag(axis: int) -> None:
    """`omega = omega_c (1 - exp(-t / tau))`, to the accuracy of the Runge-Kutta steps."""
    vehicle = Vehicle(rate_max=(10.0, 8.0, 5.0), rate_lag=0.07)
    world = begin(action="rates", vehicle=vehicle, limits=FREE, **STILL)
    action = np.zeros(4)
    action[1 + axis] = -0.2
    push(world, action, 4)
    expected = np.zeros(3)
    expected[axis] = -0.2 * vehicle.rate_max[axis] * (1.0 - np.exp(-4 * H / 0.07))
    np.testing.assert_allclose(world.angular_velocities[0, 1:], [expected] * 2, atol=1e-7)


def test_actuators_have_limits_unless_told_otherwise() -> None:
    """At `reference`, a guide that flees faster than a vehicle falls asks for a negative thrust."""
    fast = {"reference_max": (4.0, 4.0, 4.0), "planner": configure().planner}
    falls = []
    for limited in (True, False):
        vehicle = Vehicle(thrust_max=1.0, limited=limited)
        world = begin(action="reference", vehicle=vehicle, limits=FREE, **STILL, **fast)
        push(world, [0, 0, -1.0], 40)  # upwards at 4 m/s^2: 1.38 N of which 1 N is to be had
        falls.append(-world.velocities[0, 1, 2])
    assert falls[0] == pytest.approx((1.0 / 0.1 - GRAVITY) * 40 * H, rel=1e-6)
    assert falls[1] > 5.0 * falls[0]


def test_more_substeps_change_nothing_but_the_last_digits() -> None:
    """The actuators are held during a tick, so the substeps only refine the integration."""
    ends = []
    for substeps in (1, 2, 4, 40):
        world = begin(substeps=substeps, limits=FREE, trajectory=HOVER)
        for row in gentle(40, 8) * np.float32(20.0):
            world.step(row.reshape(1, 2, 4))
        ends.append(world.positions[0])
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert errors[0] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.3)  # fourth order
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.3)


# -- the leader -----------------------------------------------------------------------------------------


def test_a_trimmed_leader_stays_on_a_moving_reference() -> None:
    """It starts with null tracker errors, so the noise-free tracker has nothing to correct."""
    world = begin(limits=FREE, gust=0.0)
    worst = 0.0
    for k in range(1, 400):
        push(world, [0, 0, 0, 0], 1)
        if world.over[0]:
            break
        reference = world.reference(np.array([k * H]))[0]
        worst = max(worst, float(np.linalg.norm(world.positions[0, 0] - reference)))
    assert k == 399
    assert worst < 0.01


def test_a_hovering_leader_does_not_move() -> None:
    world = begin(**STILL)
    push(world, [0, 0, 0, 0], 200)
    np.testing.assert_allclose(world.positions[0, 0], [0, 0, -1.5], atol=1e-12)
    assert world.time[0] == pytest.approx(4.0)
    assert world.clock[0] == pytest.approx(4.0)


# -- the virtual follower of the reference level ----------------------------------------------------------


def test_the_guide_moves_by_the_action() -> None:
    """Constant acceleration in the formation frame, exactly; the heading of (31) at 0 is east."""
    world = begin(action="reference", **STILL)
    a = np.array([0.3, -0.2, 0.1])
    slots = outcome(world.look(), "slot")[0]
    push(world, a, 30)
    t = 30 * H
    moved = 0.5 * 4.0 * np.float32(a).astype(np.float64) * t**2  # reference_max = 4
    seen = world.config.layout.unpack(world.look().observations[0])
    guide = seen["position"] + seen["guide_position"]  # the hover's heading is 0: {F} is inertial
    np.testing.assert_allclose(seen["heading"], [[1, 0]] * 2, atol=1e-7)
    np.testing.assert_allclose(guide, slots + moved, atol=2e-6)
    velocity = world.velocities[0, 1:] + seen["guide_velocity"]
    np.testing.assert_allclose(velocity, [4.0 * a * t] * 2, atol=2e-6)


@pytest.mark.parametrize("actuation", ["moment", "rates"])
def test_the_tracker_brings_the_vehicle_to_the_guide(actuation: str) -> None:
    """It lags behind a guide that leaps away and stops; yaw angles differ."""
    calm: dict[str, Any] = {"trajectory": HOVER, "gust": 0.0, "limits": FREE}
    world = begin(8, action="reference", reference_actuation=actuation, **calm)

    def behind() -> Any:
        seen = world.config.layout.unpack(world.look().observations)
        return np.linalg.norm(seen["guide_position"], axis=2)

    np.testing.assert_allclose(behind(), 0.0, atol=1e-6)
    for a in (1.0, -1.0):
        push(world, [0.6 * a, -0.8 * a, 0.0], 15)
    first = behind()
    push(world, [0, 0, 0], 600)
    assert first.min() > 0.05
    assert behind().max() < 0.1 * first.min()


def test_the_guide_begins_at_the_vehicle() -> None:
    """So that a follower that starts off its slot has the way there before it, and not its tracker."""
    world = begin(8, action="reference", limits=FREE)
    seen = world.config.layout.unpack(world.look().observations)
    for name in ("guide_position", "guide_velocity"):
        np.testing.assert_array_equal(seen[name], 0.0)
    assert np.linalg.norm(outcome(world.look(), "slot_error"), axis=2).min() > 1e-3


# -- gusts ----------------------------------------------------------------------------------------------


def test_gusts_have_the_stated_size_and_memory() -> None:
    """A hovering level vehicle is moved by the gust alone, which is held during a tick."""
    size, memory, worlds = 0.5, 0.3, 400
    high = {"trajectory": trajectories.hover((0.0, 0.0, -100.0)), "start_offset": 0.0}
    world = begin(worlds, action="rates", gust=size, gust_time=memory, limits=FREE, **high)
    push(world, [0, 0, 0, 0], 75)  # it starts still: five times its memory
    speeds = [world.velocities]
    for _ in range(60):
        push(world, [0, 0, 0, 0], 1)
        speeds.append(world.velocities)
    assert not world.over.any()
    gust = np.diff(speeds, axis=0)[:, :, 1:] / H  # (60, worlds, 2, 3)
    np.testing.assert_allclose(gust.std(axis=(0, 1, 2)), size, rtol=0.05)
    assert np.abs(gust.mean(axis=(0, 1, 2))).max() < 0.05 * size
    for lag in (1, 10, 25):
        product = (gust[:-lag] * gust[lag:]).mean(axis=(0, 1, 2)) / size**2
        np.testing.assert_allclose(product, np.exp(-lag * H / memory), atol=0.06)
    parts = gust.transpose(2, 3, 0, 1).reshape(6, -1)  # by vehicle and axis
    assert np.abs(np.corrcoef(parts) - np.eye(6)).max() < 0.1


def test_gusts_start_still() -> None:
    """One tick after the reset it is the kick alone: `size sqrt(1 - keep^2)`."""
    worlds = 2000
    blown = {**STILL, "gust": 1.0, "gust_time": 0.2}
    world = begin(worlds, action="rates", limits=FREE, **blown)
    push(world, [0, 0, 0, 0], 1)
    kick = world.velocities[:, 1:] / H
    assert kick.std() == pytest.approx(np.sqrt(1.0 - np.exp(-2 * H / 0.2)), rel=0.03)


# -- the floor ------------------------------------------------------------------------------------------


def test_at_rest_on_the_floor_until_thrust_exceeds_weight() -> None:
    world = begin(scenario="paper")
    before = world.positions[0, 1:]
    for thrust in (-1.0, -0.3, -1e-3):
        push(world, [thrust, 0, 0, 0], 20)
        np.testing.assert_array_equal(world.positions[0, 1:], before)
        np.testing.assert_array_equal(world.velocities[0, 1:], 0.0)
    push(world, [0.01, 0, 0, 0], 20)
    rise = 0.5 * GRAVITY * np.float32(0.01) * (20 * H) ** 2
    np.testing.assert_allclose(world.positions[0, 1:, 2], -rise, rtol=1e-6)
    assert not world.over[0]


def test_moments_do_not_tip_over_a_vehicle_that_rests() -> None:
    world = begin(scenario="paper")
    before = world.attitudes[0, 1:]
    np.testing.assert_array_equal(before[:, 1:3], 0.0)
    push(world, [-1.0, 1.0, 1.0, 0.0], 20)
    np.testing.assert_array_equal(world.attitudes[0, 1:], before)


# -- the trigger (40) -----------------------------------------------------------------------------------


BELOW = ((1.65, 0.35, 0.0), (2.35, 0.35, 0.0))  # the followers under where they start from
LATE: dict[str, dict[str, Any]] = {
    "noisy": {},
    "follower": {"noise": configure().noise},
    "leader": {
        "noise": configure().noise,
        "leader_start": (-4.0, 0.0, 0.0),
        "follower_starts": BELOW,
    },
}


@pytest.mark.parametrize("late", LATE)
def test_the_trigger_fires_when_all_are_near_and_not_before(late: str) -> None:
    """Until then the slots hang on the first reference point, from then on on the leader itself."""
    options = {"path": "as given", "limits": FREE, **LATE[late]}
    world = begin(scenario="paper", action="reference", **options)
    first = np.array([2.0, 0.0, -1.5])  # (31) at 0, where it flies east
    waiting = first - np.array([[-0.35, 0.35, -0.3], [0.35, 0.35, -0.3]])
    starts = np.vstack([first, waiting])
    calm = np.zeros((1, 2, 3), np.float32)
    fired = 0
    for k in range(1, 3000):
        results = world.step(calm)
        away = np.linalg.norm(world.positions[0] - starts, axis=1)
        if world.started[0]:
            fired = k
            break
        assert away.max() >= world.config.trigger
        assert world.clock[0] == 0.0
        np.testing.assert_allclose(outcome(results, "slot")[0], waiting, atol=1e-12)
        seen = world.config.layout.unpack(results.observations[0].astype(np.float64))
        assert (seen["started"] == 0.0).all()
        # As seen in {F}, which looks east, from where it measures itself to be.
        x, y, z = (waiting - seen["position"]).T
        np.testing.assert_allclose(seen["slot_error"], np.stack([y, -x, z], axis=1), atol=1e-5)
        nearest = away[0] if late == "leader" else away[1:].max()
    assert fired > 100
    assert nearest >= world.config.trigger, "who is late by design was not"
    assert away.max() < world.config.trigger
    offsets = waiting - first
    for k in range(20):  # the heading has hardly turned yet
        slots = outcome(world.look(), "slot")[0]
        np.testing.assert_allclose(slots - world.positions[0, 0], offsets, atol=0.1)
        assert world.clock[0] == pytest.approx(k * H)
        results = world.step(calm)
        assert (world.config.layout.unpack(results.observations)["started"] == 1.0).all()
    height = outcome(world.look(), "slot")[0, :, 2]
    np.testing.assert_allclose(height - world.positions[0, 0, 2], 0.3)


def test_one_that_stays_behind_holds_the_trigger() -> None:
    world = begin(scenario="paper", path="as given", limits=FREE)
    push(world, [-1, 0, 0, 0], 1500)
    assert not world.started[0]
    np.testing.assert_allclose(world.positions[0, 0], [2.0, 0.0, -1.5], atol=0.5)


def test_keys_are_kept_apart() -> None:
    """No two episodes of a stream and no two streams share a start."""
    starts = set()
    for key in range(40):
        world = Simulation(configure())
        world.seed(0, key)
        for _ in range(5):
            starts.add(world.reset().observations.tobytes())
    assert len(starts) == 200


def test_only_masked_worlds_are_touched() -> None:
    world = begin(5, "agile")
    push(world, [0, 0, 0, 0], 7)
    before = world.get_state().state
    mask = np.array([False, True, False, False, True])
    world.reset(mask)
    after = world.get_state().state
    for name, array in before.items():
        old, new = array, after[name]
        if len(array) == 1:  # one tile of worlds side by side, the world in the last place
            old, new = by_world(array, 5), by_world(after[name], 5)  # without the unused lanes
        np.testing.assert_array_equal(new[~mask], old[~mask])
    (ticks,) = counters(after["counters"])["tick"][:, :5]
    np.testing.assert_array_equal(ticks, np.where(mask, 0, 7))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"noise": NOISE},
        {"noise": NOISE, "measurement_delay": 2},
        {"estimator": "differenced", "noise": NOISE, "gust": 0.5, "action": "reference"},
    ],
    ids=["exact", "noisy", "late", "differenced in gusts"],
)
def test_a_step_leaves_the_other_worlds_as_they_are(options: dict[str, Any]) -> None:
    """Lanes that stand still are computed with the others: state and measurement are put back."""
    world = begin(5, **options)
    push(world, 0.01, 7)
    mask = np.array([False, True, False, False, True])
    before, shown = world.get_state().state, world.look().observations
    k, n = world.config.action_size, world.config.followers
    results = world.step(np.full((5, n, k), 0.02, np.float32), mask=mask)
    after = world.get_state().state
    for name, array in before.items():
        old, new = array, after[name]
        if len(array) == 1:
            old, new = by_world(array, 5), by_world(after[name], 5)
        np.testing.assert_array_equal(new[~mask], old[~mask], err_msg=name)
    np.testing.assert_array_equal(results.observations[~mask], shown[~mask])
    assert (results.observations[mask] != shown[mask]).any(axis=(1, 2)).all()


def test_the_trigger_fires_in_worlds_that_step_alone() -> None:
    """From the first tick on all are near enough, but a world that stands still waits for its own."""
    world = begin(3, start="ground", trigger=1e3)
    assert not world.started.any()
    n, k = world.config.followers, world.config.action_size
    world.step(np.zeros((3, n, k), np.float32), mask=np.array([True, False, True]))
    assert world.started.tolist() == [True, False, True]


def test_leaders_come_first() -> None:
    """In one tile and in two, whose last is not full."""
    for worlds in (3, 19):
        simulation = Simulation(configure("nominal"), worlds)
        for w in range(worlds):
            simulation.seed(w, w)
        simulation.reset()
        assert np.array_equal(simulation.leaders, simulation.positions[:, 0])
