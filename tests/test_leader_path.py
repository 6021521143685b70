"""The path of the leader: refused beyond the bounds of an observation, warned of beyond the actuators."""

from __future__ import annotations

import warnings
from math import cos, hypot, inf, pi, sin
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from closed_loop import PROPERTY
from hypothesis import given
from hypothesis import strategies as st
from paths import closed_forms, keys, random_ones, sizes

from formation_env import SCENARIOS, FormationConfig, Vehicle, configure, splines, trajectories
from formation_env.configuration.leader_path import (
    FlightWarning,
    Reach,
    _bounds,
    _demands,
    _plainly_flyable,
)
from formation_env.laws.feasibility import FeasibilityWarning
from formation_env.paths.references import Floats, by_name
from formation_env.physics.quadrotor import GRAVITY
from formation_env.task import ANYWHERE, ENTRIES, NEAR, RATE_BOUND, Limits
from formation_env.trajectories import SINES, Trajectory, circle, line
from formation_env.validation.checks import LONGEST

pytestmark = pytest.mark.filterwarnings("ignore::formation_env.laws.feasibility.FeasibilityWarning")

gaps = st.floats(0.5, 3.0)
POINTS = np.array([[0.0, 0.0, -1.5], [1.0, 0.5, -2.5], [0.0, 0.0, -1.5]])
BACK_AND_FORTH = [[0, 0, -1.5], [8, 0, -1.5], [0, 0, -1.5]]


def log(noise: float, rate: float = 100.0, seconds: float = 10.0) -> Trajectory:
    """A flight of the paper's figure eight as a motion capture would record it."""
    t = np.arange(round(rate * seconds) + 1) / rate
    points = np.stack([2.0 * np.cos(t / 4.0), np.sin(t / 2.0), np.full_like(t, -1.5)], axis=1)
    noisy = points + noise * np.random.default_rng(0).standard_normal(points.shape)
    return splines.from_samples(t, noisy)


def bobbing(height: float, rate: float) -> Trajectory:
    """Up and down by 1 m."""
    table = [1.0, 0.0, 0.0, -height, *[0.0] * 9, 1.0, rate, 0.5 * pi]
    return Trajectory("bobbing", SINES, table)  # type: ignore[arg-type]


# -- beyond an observation's bound --------------------------------------------------------------------


def test_the_bounds_are_the_observations() -> None:
    bounds = {entry.name: entry.bound for entry in ENTRIES}
    assert (bounds["position"], bounds["slot_error"]) == (ANYWHERE, NEAR)
    assert bounds["leader_velocity"] == bounds["leader_acceleration"] == RATE_BOUND


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"trajectory": line((1.0, 0.0), start=(2e4, 0.0))},
            r"trajectory = 'line' with a position.* of 20030\.\d m .*at most 10000 m.*move the origin",
        ),
        (
            {"trajectory": line((20.0, 0.0)), "duration": 600.0},
            r"trajectory = 'line' with a position.* of 12000\.\d m at t = 600 s.*shorten `duration`",
        ),
        (
            {"trajectory": line((0.0, 150.0))},
            r"trajectory = 'line' with a velocity of 150 m/s at t = 0 s: .*at most 100 m/s",
        ),
        ({"trajectory": line((0.0, 1.0), height=1e5)}, "position"),
        ({"trajectory": line((1.0, 0.0), start=(9999.9, 0.0)), "duration": 1.0}, "slots included"),
        ({"trajectory": trajectories.hover((0.0, -2e4, -1.0))}, r"of 20000\.\d m at t = 0 s"),
        ({"trajectory": trajectories.random_smooth(), "duration": 8000.0}, "in some episode"),
        ({"trajectory": trajectories.random_smooth(90.0, 20.0)}, "velocity of 110 m/s in some"),
        (
            {"trajectory": circle(1.0, 11.0), "vehicle": Vehicle(thrust_max=20.0)},
            r"acceleration of 121 m/s\^2 at t = 0 s.*at most 100 m/s\^2",
        ),
        ({"trajectory": circle(1.0, 11.0), "vehicle": Vehicle(limited=False)}, "acceleration"),
        (
            {"leader_start": (0.0, 10001.0, 0.0), "start": "ground"},
            r"leader_start = \(0\.0, 10001\.0, 0\.0\): expected coordinates within 10000 m",
        ),
        (
            {"follower_starts": ((0, 0, 0), (-1e5, 0, 0)), "start": "ground"},
            r"follower_starts\[1\] = \(-100000\.0, 0\.0, 0\.0\): expected coordinates within 10000 m",
        ),
        (
            {"follower_starts": ((0, 0, 0), (0, 1500, 0)), "start": "ground"},
            r"follower_starts\[1\] = \(0\.0, 1500\.0, 0\.0\): .*within 1000 m.* it is 1500 m away",
        ),
        (
            {"offsets": ((1.0, 900.0, 0.0), (1.0, -900.0, 0.0))},
            r"offsets\[0\] = \[1\.0, 900\.0, 0\.0\]: .*within 1000 m.*one is 1800 m away; or fewer",
        ),
    ],
)
def test_what_an_observation_would_clip_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        configure(**options)
    assert len(str(caught.value)) <= LONGEST


def test_only_observed_neighbours_have_to_be_near() -> None:
    wide = ((1.0, 900.0, 0.0), (1.0, -900.0, 0.0), (1.0, 0.0, 0.0))
    calm = line((0.5, 0.0))
    assert configure(offsets=wide, trajectory=calm, neighbours=1).neighbours == 1
    assert configure(offsets=wide[:2], trajectory=calm, neighbours=0).neighbours == 0
    with pytest.raises(ValueError, match=r"offsets\[0\] = .*its 2 nearest"):
        configure(offsets=wide, trajectory=calm, neighbours=2)


def test_only_the_configured_duration_counts() -> None:
    configure(trajectory=line((20.0, 0.0)), duration=499.0)
    for_ever = line((0.0, -99.0), start=(0.0, 9999.0))
    assert configure(trajectory=for_ever, duration=100.0).duration == 100.0


# -- what the actuators cannot give -------------------------------------------------------------------


def test_the_issues_way_points_are_warned_of() -> None:
    curve = splines.waypoints([0.0, 1.0, 2.0], BACK_AND_FORTH)
    with pytest.warns(FlightWarning) as caught:
        configure(trajectory=curve, duration=2.0)
    (text,) = (str(one.message) for one in caught if one.category is FlightWarning)
    # The peak lies where it turns back; by hand, |g k - a| = sqrt(67.2^2 + 9.81^2).
    assert "'waypoints', which accelerates at up to 67.2 m/s^2 at t = 1 s" in text
    assert "|g k - a| of 67.9 m/s^2 at t = 1 s where vehicle.thrust_max / mass is 19.6" in text
    assert "low it down" in text and "\n" not in text and len(text) <= LONGEST


@pytest.mark.parametrize("noise", [1e-6, 1e-4, 1e-3])
@pytest.mark.parametrize("actuation", ["moment", "rates"])
def test_a_noisy_log_is_warned_of(noise: float, actuation: str) -> None:
    limit = "moment_max" if actuation == "moment" else "rate_max"
    with pytest.warns(
        FlightWarning, match=rf"vehicle\.{limit}.*smooth a measured log or give fewer rows"
    ) as caught:
        configure(trajectory=log(noise), duration=10.0, leader_actuation=actuation)
    assert all(len(str(one.message)) <= LONGEST for one in caught)


@pytest.mark.parametrize(
    ("trajectory", "vehicle", "reason"),
    [
        (circle(2.0, 6.0), Vehicle(), "thrust"),  # 18 m/s^2
        (bobbing(5.0, 3.1), Vehicle(), None),  # 9.61 m/s^2
        (bobbing(5.0, 3.14), Vehicle(), "faster than gravity"),  # 9.86 m/s^2
        (circle(2.0, 5.8), Vehicle(), None),  # 16.82 m/s^2
        (circle(2.0, 5.8), Vehicle(thrust_max=1.9), "thrust"),
        (circle(2.0, 5.8), Vehicle(moment_max=(1e-3, 1e-3, 1e-3)), "moment_max"),
        (circle(2.0, 6.0), Vehicle(thrust_max=3.0), None),
        (circle(2.0, 13.0), Vehicle(limited=False), None),
        (trajectories.random_smooth(20.0, 10.0, 38.0), Vehicle(), "thrust"),
    ],
)
def test_who_is_warned(trajectory: Trajectory, vehicle: Vehicle, reason: str | None) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        configure(trajectory=trajectory, vehicle=vehicle)
    texts = [str(one.message) for one in caught if one.category is FlightWarning]
    assert len(texts) == (reason is not None)
    assert all(str(reason) in text for text in texts)


def flown(config: FormationConfig) -> tuple[float, bool]:
    """How far the leader gets from its path, m, and whether an episode ends before its time.

    The followers, flown through virtual followers that keep their velocity, cannot crash.
    """
    env: Any = gym.make("Formation-v0", scenario=config).unwrapped
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, np.float32)
    worst, step, crashed, over = 0.0, 0, False, False
    while not (crashed or over):
        _, _, crashed, over, _ = env.step(action)
        step += 1
        leader = env.simulation.positions[0, 0]
        target = by_name(config.trajectory(min(step * config.control_period, config.duration)))["p"]
        worst = max(worst, float(np.linalg.norm(leader - target)))
    return worst, bool(crashed)


SOME_PATHS: list[tuple[Trajectory, float]] = [
    *((circle(2.0, speed, 3.0), 10.0) for speed in (3.0, 5.8, 6.0, 7.0)),
    *(
        (splines.waypoints([0.0, t, 2.0 * t], BACK_AND_FORTH), 2.0 * t)
        for t in (1.0, 1.5, 2.0, 3.0)
    ),
    *((trajectories.figure_eight(rate=rate, height=3.0), 10.0) for rate in (1.0, 1.9, 2.5, 3.0)),
    *((log(noise), 10.0) for noise in (0.0, 1e-9, 1e-6, 1e-4)),
    (log(1e-6, 20.0), 10.0),
    (log(1e-3, 20.0), 10.0),
]


@pytest.mark.parametrize(("curve", "duration"), SOME_PATHS)
def test_the_warning_tells_what_the_leader_can_fly(curve: Trajectory, duration: float) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        config = configure(
            trajectory=curve,
            duration=duration,
            action="reference",
            path="as given",
            start_offset=0.0,
            gust=0.0,
            limits=Limits(collision=1e-3, impact=1.0, tilt=0.5, lost=1e3),
        )
        apart, crashed = flown(config)
    warned = any(one.category is FlightWarning for one in caught)
    assert crashed == warned
    assert apart < 0.05 or warned


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("followers", [1, 2, 7, 64])
def test_no_scenario_warns(scenario: str, followers: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", FlightWarning)
        for options in ({}, {"leader_actuation": "rates"}, {"duration": 600.0}):
            configure(scenario, followers=followers, **options)


@pytest.mark.parametrize("name", trajectories.FACTORIES)
def test_no_default_warns(name: str) -> None:
    if name in ("waypoints", "from_samples"):
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error", FlightWarning)
        configure(trajectory=trajectories.as_trajectory("trajectory", name))


def test_the_readmes_path_does_not_warn() -> None:
    path = splines.from_function(lambda t: (t, 3.0 * sin(0.2 * t), -1.5), duration=30.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", FlightWarning)
        configure(trajectory=path, duration=30.0)


def test_the_demands_are_those_of_differentiation() -> None:
    """Of a circle: `|b|` is constant, `r3d` turns at `V / r` about a cone; checked by differences."""
    curve, lag, h = trajectories.figure_eight((2.0, 1.0), 1.3), 0.05, 1e-3
    times = np.arange(0.0, 10.0, h)
    b = np.array([0.0, 0.0, GRAVITY]) - by_name(curve(times))["a"]
    r3d = b / np.linalg.norm(b, axis=1)[:, None]
    rate: Floats = np.cross(r3d, np.gradient(r3d, h, axis=0))
    turning = np.gradient(rate, h, axis=0)[2:-2]
    demands = _demands(curve, 10.0, lag)
    most = np.linalg.norm(turning, axis=1).max()
    assert demands.turning.value == pytest.approx(most, rel=2e-3)
    most = np.linalg.norm(rate[2:-2] + lag * turning, axis=1).max()
    assert demands.command.value == pytest.approx(most, rel=2e-3)
    steady = _demands(circle(2.0, 4.0), 10.0, lag)
    assert steady.thrust.value == pytest.approx(hypot(8.0, GRAVITY))
    assert steady.acceleration == (pytest.approx(8.0), 0.0)
    still = _demands(trajectories.hover((3.0, cos(1.0), -2.0)), 1e9, lag)
    assert still.thrust.value == GRAVITY and still.position.value == 3.0


@PROPERTY
@given(
    closed_forms
    | st.builds(lambda t, s: splines.waypoints([0.0, t, 2.0 * t], s * POINTS), gaps, sizes)
)
def test_what_needs_no_look_is_within_bounds(curve: Trajectory) -> None:
    """The bounds that spare most paths a closer look are never below what the look would find."""
    duration, lag = min(curve.duration, 20.0), 0.05
    norms = np.linalg.norm(curve(np.linspace(0.0, duration, 501)), axis=2).max(axis=0)
    assert (norms <= _bounds(curve, duration) * (1.0 + 1e-9) + 1e-9).all()
    found = _demands(curve, duration, lag)
    unlimited = Reach(inf, inf, inf, lag)
    for limit, peak in (
        ("thrust", found.thrust),
        ("turning", found.turning),
        ("command", found.command),
    ):
        if peak.value > 1e-6:
            short = unlimited._replace(**{limit: 0.999 * peak.value})
            assert not _plainly_flyable(curve, duration, 0.0, short)
    falls = found.descent.value >= GRAVITY
    assert not (falls and _plainly_flyable(curve, duration, 0.0, unlimited))


@PROPERTY
@given(random_ones(), keys, st.floats(1.0, 100.0))
def test_bounds_of_a_random_trajectory_hold_for_its_draws(
    curve: Trajectory, key: int, duration: float
) -> None:
    motion = curve.drawn(key)(np.linspace(0.0, duration, 501))
    bounds = _bounds(curve, duration)
    assert np.abs(motion[:, 0]).max() <= bounds[0] * (1.0 + 1e-9)
    assert (np.linalg.norm(motion[:, 1:], axis=2).max(axis=0) <= bounds[1:] * (1.0 + 1e-9)).all()


def test_most_paths_need_no_look() -> None:
    reach = Reach(2.0 * GRAVITY, 70.0, 14.0, 0.05)
    for scenario in SCENARIOS:
        config = configure(scenario)
        assert _plainly_flyable(config.trajectory, config.duration, 3.0, reach)
    assert _plainly_flyable(log(0.0), 10.0, 1.0, reach)


def test_the_class_of_the_warning_is_its_own() -> None:
    """Who ignores the one kind is still told of the other."""
    assert not issubclass(FlightWarning, FeasibilityWarning)
    assert issubclass(FlightWarning, UserWarning)
