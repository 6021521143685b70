"""The configuration: what it refuses in the paper's words, how it is overridden, how kernels get it."""

from __future__ import annotations

import pickle
from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest

from formation_env import (
    SCENARIOS,
    FeasibilityWarning,
    FormationConfig,
    Noise,
    PlannerGains,
    Vehicle,
    configure,
    trajectories,
)
from formation_env.configuration.leader_path import FlightWarning
from formation_env.memory.records import flatten, line_loader
from formation_env.trajectories import circle


def test_the_bound_53() -> None:
    """`sigma_max < g - z_max`; the strongest commanded descent counts as `z_max` too."""
    with pytest.raises(
        ValueError, match=r"tracker\.sigma_max = 5\.0: .*g - z_max = 4\.91 .*\(53\)"
    ):
        configure(planner=PlannerGains(z_max=4.9))
    with pytest.raises(ValueError, match=r"tracker\.sigma_max = 5\.0: .*\(53\)"):
        configure(reference_max=(1.0, 1.0, 4.9))
    configure(planner=PlannerGains(z_max=4.8))


@pytest.mark.parametrize("d_x", [0.0, -0.35])
def test_a_leader_behind_is_refused(d_x: float) -> None:
    with pytest.raises(ValueError, match=r"offsets\[1\] = .*d_x > 0: Gamma \(14\)"):
        configure(offsets=((0.35, 0.35, -0.3), (d_x, 1.0, -0.3)))


def test_a_circle_smaller_than_d_x_is_refused() -> None:
    """(28): no heading is stable anywhere on it."""
    with pytest.raises(ValueError, match=r"no stable heading exists.*\(28\)"):
        configure(trajectory=circle(radius=0.3))


def test_where_only_the_sufficient_bound_fails_it_warns() -> None:
    """(29)-(30) for |d_x| = |d_y|: the circle's radius has to exceed sqrt(2) d_x = 0.495 m."""
    with pytest.warns(FeasibilityWarning, match=r"\(29\)-\(30\).*does not hold"):
        config = configure(trajectory=circle(radius=0.48))
    assert all(report.exists and not report.bound_holds for report in config.feasibility())
    config = configure(trajectory=circle(radius=0.51))  # warnings are errors
    assert all(report.bound_holds for report in config.feasibility())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trajectory": trajectories.hover((0.0, 0.0, -0.2))}, r"offsets\[0\] = .*floor.*\(32\)"),
        ({"offsets": ((0.5, 0.0, -0.3), (0.5, 0.1, -0.3))}, "offsets = '0.1 m apart'"),
        ({"start_offset": 0.18}, "start_offset = 0.18: .*limits.collision = 0.353 m"),
        (
            {"start": "ground", "leader_start": (0.0, 0.0, -1.0)},
            r"heights .* leader_start .* = \[-1.0, .*p_z = 0",
        ),
        ({"start": "ground", "follower_starts": ((0, 0, 0), (0.1, 0, 0))}, "0.1 m apart"),
        ({"vehicle": Vehicle, "duration": 1.0}, "vehicle = "),
        ({"measurement_period": 0.0033}, "whole number of substeps .* = 0.005 s"),
        ({"measurement_period": 0.002}, "whole number of substeps"),
        ({"duration": 0.01}, "at least one control_period = 0.02 s"),
    ],
)
def test_what_cannot_be_flown(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        configure(**options)


def test_what_a_vehicle_cannot_be() -> None:
    with pytest.raises(ValueError, match=r"vehicle\.thrust_max = 0\.9: .*0\.981"):
        Vehicle(thrust_max=0.9)  # less than its weight
    with pytest.raises(ValueError, match=r"vehicle\.inertia = .*sum of the other two"):
        Vehicle(inertia=(1e-3, 1e-3, 2.1e-3))


@pytest.mark.parametrize(("period", "substeps"), [(None, 4), (0.02, 4), (0.005, 1), (0.035, 7)])
def test_measurements_are_taken_on_substeps(period: float | None, substeps: int) -> None:
    assert configure(measurement_period=period).world.clock.sample_every == substeps


# -- overriding ---------------------------------------------------------------------------------------


def test_overriding_changes_one_field_and_leaves_the_origin() -> None:
    origin = configure("paper")
    changed = configure(origin, action="rates")
    assert (origin.action, changed.action) == ("wrench", "rates")
    assert changed == configure("paper", action="rates")
    assert configure(changed, action="wrench") == origin
    assert changed != origin


def test_a_configuration_cannot_be_changed_behind_its_checks() -> None:
    with pytest.raises(FrozenInstanceError):
        configure().substeps = 0  # type: ignore[misc]


def test_a_configuration_is_not_reformed() -> None:
    with pytest.raises(ValueError, match="followers = 3: expected none: give `offsets`"):
        configure(configure(), followers=3)


def test_own_offsets_drop_the_scenarios_starts() -> None:
    """III-C's start points belong to its own two followers."""
    assert configure("paper").follower_starts is not None
    one = configure("paper", offsets=((0.3, 0.0, -0.3),))
    assert (one.followers, one.follower_starts, one.leader_start) == (1, None, None)
    placed = configure("paper", offsets=((0.3, 0.0, -0.3),), follower_starts=((3.0, 0.0, 0.0),))
    assert placed.ground_starts()[1] == (3.0, 0.0, 0.0)


def test_numbers_of_numpy_are_numbers() -> None:
    plain = configure(substeps=5, duration=10.0, offsets=((0.4, 0.0, -0.4),), gust=0.5)
    array = configure(
        substeps=np.int64(5),
        duration=np.float32(10.0),
        offsets=np.array([[0.4, 0.0, -0.4]]),
        gust=np.float64(0.5),
    )
    assert array == plain
    assert hash(array) == hash(plain)
    assert array.world == plain.world


def test_a_pickled_configuration_is_the_same_one() -> None:
    config = configure("experiment", followers=3)
    again = pickle.loads(pickle.dumps(config))
    assert again == config
    assert again.world == config.world


@pytest.mark.parametrize(
    ("duration", "period", "steps"), [(20.0, 0.02, 1000), (40.0, 1 / 44, 1760), (0.02, 0.02, 1)]
)
def test_steps_of_an_episode(duration: float, period: float, steps: int) -> None:
    assert configure(duration=duration, control_period=period).max_steps == steps


@pytest.mark.parametrize(
    ("deadline", "period", "steps"), [(15.0, 0.02, 750), (15.0, 1 / 44, 660), (0.05, 0.02, 3)]
)
def test_ticks_until_the_deadline(deadline: float, period: float, steps: int) -> None:
    config = configure(limits={"deadline": deadline}, control_period=period)
    assert config.deadline_steps == steps


def test_a_drawn_path_begins_at_any_tick_of_its_period() -> None:
    """One that is as it is given, does not repeat itself, ends or is random begins at its first point."""
    period = circle(radius=2.0, speed=0.5).period
    assert period == pytest.approx(2.0 * np.pi * 2.0 / 0.5)
    drawn = configure(trajectory=circle(radius=2.0, speed=0.5))
    assert drawn.phases == round(period / 0.02)
    assert drawn.span == pytest.approx(30.0 + drawn.phases * 0.02)
    endless = circle(radius=2.0, speed=0.5)
    ends = type(endless)(endless.name, endless.kind, endless.table, duration=30.0)
    for config in (
        configure(drawn, path="as given"),
        configure(trajectory=trajectories.line()),
        configure(trajectory=ends),
        configure("agile"),
    ):
        assert (config.phases, config.span) == (0, config.duration)


def test_nobody_shares_a_default() -> None:
    """Two configurations with a list given for offsets do not see each other's changes."""
    offsets = [[0.4, 0.0, -0.4]]
    config = FormationConfig(offsets=offsets)  # type: ignore[arg-type]
    offsets[0][0] = 9.0
    assert config.offsets == ((0.4, 0.0, -0.4),)


def test_a_configuration_made_directly_is_none_of_the_scenarios() -> None:
    """Nor does a change make it one; the defaults, where the trajectory fails (29)-(30), warn."""
    with pytest.warns(FeasibilityWarning, match="none moves backwards"):
        config = FormationConfig()
    assert config.scenario not in SCENARIOS
    assert configure(config, duration=26.0, gust=0.04, gust_time=0.5).scenario == config.scenario
    assert configure(config.to_dict()) == config
    assert configure().scenario == configure({}).scenario == "nominal"


def test_a_configuration_warns_when_it_is_made_and_not_again() -> None:
    """By another field that neither the path nor the vehicle has to do with."""
    weak = {"moment_max": (1e-6, 1e-6, 1e-6)}
    with pytest.warns(FlightWarning, match=r"cannot fly trajectory 'figure-eight'"):
        config = configure(vehicle=weak)
    assert configure(config, substeps=5).substeps == 5  # warnings are errors
    with pytest.warns(FlightWarning, match=r"cannot fly"):
        configure(config, duration=10.0)


# -- towards the kernels --------------------------------------------------------------------------------


def numbered(template: Any, start: int = 1) -> tuple[Any, int]:
    """`template` with its numbers replaced by 1, 2, 3, ... of the same types."""
    if isinstance(template, tuple):
        values = []
        for item in template:
            value, start = numbered(item, start)
            values.append(value)
        kind = type(template)
        return (kind(*values) if hasattr(kind, "_fields") else kind(values)), start
    if isinstance(template, complex):
        return complex(start, start + 1), start + 2
    return type(template)(start), start + 1


def test_settings_come_back_from_the_flat_array() -> None:
    """Every number is another one, so an exchanged index cannot hide."""
    config = configure("experiment", noise=Noise(*np.linspace(0.1, 0.5, 5).tolist()))
    for template in (config.world, config.reward, config.limits):
        settings, stop = numbered(template)
        flat = np.array(flatten(settings))
        np.testing.assert_array_equal(flat, np.arange(1.0, stop))
        assert line_loader(type(template))(flat) == settings


def test_the_kernels_get_what_was_configured() -> None:
    vehicle = Vehicle(mass=0.2, thrust_max=5.0, rate_max=(1.0, 2.0, 3.0), rate_lag=0.1)
    config = configure(
        action="rates",
        vehicle=vehicle,
        control_period=0.04,
        substeps=8,
        measurement_period=0.02,
        measurement_delay=2,
        trigger=0.7,
        gust=2.0,
        gust_time=0.5,
    )
    world = config.world
    assert world.airframe.mass == 0.2
    assert (world.reach.thrust, world.reach.turn) == (5.0, (1.0, 2.0, 3.0))
    assert world.clock == (0.04, 8, 4, 2, 0)
    assert (world.trigger, world.on_ground) == (0.7, 0)
    assert world.disturbances.gusts.keep == pytest.approx(np.exp(-0.04 / 0.5))
    # A process with that memory and kick has the stated standard deviation.
    assert world.disturbances.gusts.kick / np.sqrt(
        1 - world.disturbances.gusts.keep**2
    ) == pytest.approx(2.0)
    assert configure("experiment").world.clock.window == 100
    free = configure(vehicle=Vehicle(limited=False)).world.airframe
    assert (free.thrust_min, free.thrust_max) == (-np.inf, np.inf)
