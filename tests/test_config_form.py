"""A configuration in JSON: every field, every scenario and whole configurations go round."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from configurations import FIELDS, accepted
from episodes import SCENARIOS
from hypothesis import given, settings
from hypothesis import strategies as st

from formation_env import (
    FeasibilityWarning,
    FormationConfig,
    Limits,
    Noise,
    PlannerGains,
    Rewards,
    TrackerGains,
    Trajectory,
    Vehicle,
    configure,
    splines,
    trajectories,
)
from formation_env.configuration.leader_path import FlightWarning
from formation_env.configuration.parts import unit_of
from formation_env.laws.gains import RATES_GAINS
from formation_env.validation.plain_form import plain


def through_json(value: Any) -> Any:
    return json.loads(json.dumps(value, allow_nan=False))


def quietly(make: Callable[..., FormationConfig], *args: Any, **given: Any) -> FormationConfig:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FeasibilityWarning)
        warnings.simplefilter("ignore", FlightWarning)
        return make(*args, **given)


def test_every_field_is_drawn() -> None:
    assert set(FIELDS) | {"scenario"} == {f.name for f in fields(FormationConfig)}


@pytest.mark.parametrize("name", sorted(FIELDS))
def test_every_field_takes_its_json_form(name: str) -> None:
    @settings(max_examples=12, deadline=None)
    @given(FIELDS[name])
    def check(value: Any) -> None:
        config = accepted("nominal", {name: value})
        again = quietly(configure, "nominal", **{name: through_json(plain(value))})
        assert again == config
        assert (
            quietly(configure, "nominal", **{name: through_json(config.to_dict()[name])}) == config
        )

    check()


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(SCENARIOS), st.fixed_dictionaries({}, optional=FIELDS))
def test_whole_configurations_go_round(scenario: str, options: dict[str, Any]) -> None:
    config = accepted(scenario, options)
    data = through_json(config.to_dict())
    for again in (quietly(FormationConfig.from_dict, data), quietly(configure, data)):
        assert again == config
        assert hash(again) == hash(config)
        assert again.world == config.world
        assert again.to_dict() == data


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("followers", [None, 1, 7])
def test_scenarios_go_round_without_a_warning(scenario: str, followers: int | None) -> None:
    config = configure(scenario, followers=followers)
    data = through_json(config.to_dict())
    assert FormationConfig.from_dict(data) == config  # warnings are errors
    assert configure(data) == config
    assert configure(data, duration=1.0) == configure(config, duration=1.0)


@pytest.mark.parametrize(
    "path",
    [
        trajectories.circle(),
        trajectories.random_smooth(),
        splines.waypoints([0, 10, 20], [[0, 0, -1.5], [3, 0, -1.5], [6, 2, -1.6]]),
        splines.from_function(lambda t: (t, np.sin(0.2 * t), -1.5), duration=20.0),
    ],
    ids=lambda path: path.name,
)
def test_paths_go_round(path: Trajectory) -> None:
    config = quietly(configure, trajectory=path, duration=20.0)
    assert FormationConfig.from_dict(through_json(config.to_dict())).trajectory == path


def test_names_and_arguments_of_a_path() -> None:
    assert configure(trajectory="lemniscate").trajectory == trajectories.lemniscate()
    given = {"path": "circle", "radius": 2.0}
    assert configure(trajectory=given).trajectory == trajectories.circle(2.0)


# -- parts of which a dictionary says something ----------------------------------------------------------


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_what_a_dictionary_leaves_out_is_the_scenarios(scenario: str) -> None:
    base = configure(scenario)
    changed = configure(scenario, noise={"position": 0.25}, vehicle={"thrust_max": 3.0}, planner={})
    assert changed.noise == base.noise._replace(position=0.25)
    assert changed.vehicle == replace(base.vehicle, thrust_max=3.0)
    assert changed.planner == base.planner
    assert configure(base, noise={"position": 0.25}).noise == changed.noise
    assert configure(changed, noise={"velocity": 0.1}).noise.position == 0.25


def test_what_a_dictionary_leaves_out_is_the_default_of_the_constructor() -> None:
    given: dict[str, Any] = {"rates_tracker": {"k4": 0.7}, "limits": {"lost": 3.0}}
    config = quietly(FormationConfig, **given)
    assert config.rates_tracker == replace(RATES_GAINS, k4=0.7)
    assert config.limits == Limits(0.353, 1.0, 0.5, 3.0, 15.0)


def test_a_dictionary_starts_from_the_scenario_that_it_names() -> None:
    data = {"scenario": "experiment", "vehicle": {"thrust_max": 2.0}, "followers": 3}
    config = configure(data)
    expected = configure("experiment", followers=3, vehicle=Vehicle(mass=0.078, thrust_max=2.0))
    assert config == expected
    assert configure({}) == configure()
    assert configure({"duration": 5.0}) == configure(duration=5.0)
    each = [0.1] * len(Noise._fields)
    assert configure({"noise": each}, duration=5.0) == configure(noise=Noise(*each), duration=5.0)
    both = configure({"scenario": "paper", "noise": {"velocity": 0.3}}, noise={"position": 0.1})
    assert both.noise == configure("paper").noise._replace(position=0.1, velocity=0.3)
    assert configure({"scenario": "paper"}, followers=3) == configure("paper", followers=3)


def test_a_thrust_that_follows_the_mass_follows_it() -> None:
    assert configure(vehicle={"mass": 0.2}).vehicle.full_thrust == pytest.approx(0.4 * 9.81)
    assert configure(vehicle={"mass": 0.2, "thrust_max": 3.0}).vehicle.full_thrust == 3.0


def test_lists_are_as_good_as_tuples() -> None:
    numbers = [0.1 * (k + 1) for k in range(len(Noise._fields))]
    given: dict[str, Any] = {
        "noise": numbers,
        "reward": np.array(Rewards()),
        "limits": tuple(Limits()),
    }
    config = configure(**given)
    assert config.noise == Noise(*numbers)
    assert type(config.reward) is Rewards
    assert type(config.limits) is Limits


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            {"scenario": "paper", "colour": 1},
            r"^scenario\['colour'\] = 1: expected only fields: off",
        ),
        ({"scenario": "indoor"}, r"^scenario = 'indoor': expected one of 'nominal'"),
        ({"scenario": 3}, r"^scenario = 3: expected one of"),
        ({"scenario": []}, r"^scenario = \[\]: expected one of"),
        (
            {"noise": {"position": -1}},
            r"^noise\.position = -1: expected a finite number of at least",
        ),
        ({"rates_tracker": {"k1": -1}}, r"^rates_tracker\.k1 = -1: expected a finite number above"),
        ({"tracker": {"k1": -1}}, r"^tracker\.k1 = -1: expected a finite number above 0"),
        ({"vehicle": {"mass": "heavy"}}, r"^vehicle\.mass = 'heavy': expected"),
        (
            {"vehicle": {"wings": 2}},
            r"^vehicle = \{'wings': 2\}: expected a Vehicle, or a dict.*mass, i",
        ),
        ({"vehicle": [0.1]}, r"^vehicle = \[0\.1\]: expected a Vehicle, or"),
        (
            {"noise": [0.1]},
            r"^noise = \[0\.1\]: expected a Noise, or a dictionary with some of pos",
        ),
        ({"noise": {3: 0.1}}, r"^noise = \{3: 0\.1\}: expected a Noise"),
        ({3: 0.1}, r"^scenario\[3\] = 0\.1: expected only fields"),
        ({"followers": 3, "offsets": [[0.5, 0.0, 0.0]]}, r"followers and offsets given"),
    ],
    ids=lambda x: repr(x).partition(" at 0x")[0][:40],
)
def test_a_wrong_dictionary_is_refused_by_name(data: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        configure(data)
    assert len(str(caught.value)) <= 500


def test_a_whole_dictionary_with_something_unknown() -> None:
    data = configure().to_dict()
    with pytest.raises(
        ValueError, match=r"^data\['colour'\] = 'red': expected only fields: scenario"
    ):
        configure({**data, "colour": "red"})
    with pytest.raises(ValueError, match=r"^data = None: expected a dictionary"):
        FormationConfig.from_dict(None)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^followers = 3: expected none: give `offsets`"):
        configure(data, followers=3)


def test_the_constructors_default_where_from_dict_finds_nothing() -> None:
    assert FormationConfig.from_dict({}) == quietly(FormationConfig)


def test_other_objects_keep_their_own_checks() -> None:
    for wrong in (PlannerGains(), TrackerGains(), configure(), Vehicle):
        with pytest.raises(ValueError, match=r"^vehicle = .*: expected a Vehicle, or a dictionary"):
            configure(vehicle=wrong)


# -- units ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        *(("gust", "m/s^2"), ("duration", "s"), ("measurement_period", "s"), ("followers", "1")),
        *(("measurement_delay", "samples"), ("neighbours", "1"), ("noise.attitude", "rad")),
        *(("planner.k1", "1/s"), ("tracker.k1", "1/s^2"), ("rates_tracker.sigma_max", "m/s^2")),
        *(("vehicle.mass", "kg"), ("vehicle.thrust_max", "N"), ("vehicle.rate_max", "rad/s")),
        *(("limits.lost", "m"), ("limits.deadline", "s"), ("reward.reach", "m"), ("noise", "1")),
    ],
)
def test_units_of_fields_and_of_parts(name: str, unit: str) -> None:
    assert unit_of(FormationConfig, name) == unit
