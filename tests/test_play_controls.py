"""Controls made from the fields of a configuration, and configurations made of what is set with them."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest

from baselines.play.controls import Control, controls, groups
from baselines.play.settings import configuration, from_fields, python, values, with_change
from baselines.system.field_comments import comments
from formation_env import SCENARIOS, FormationConfig, configure
from formation_env.config import CHOICES, COUNTS, NUMBERS, PARTS, quietly
from formation_env.memory.records import notes
from formation_env.trajectories import Trajectory
from formation_env.validation.checks import Unit, Within

CONTROLS = {control.name: control for control in controls()}


class Breeze(NamedTuple):
    """What blows."""

    # at the height
    # of the leader
    speed: Annotated[float, Within(0.0, 40.0, strict=True, unit="m/s")] = 3.0
    kind: str = "north"  # where from


@dataclass(frozen=True)
class Later:
    """A configuration of a later version."""

    scenario: str = "custom"
    gust: Annotated[float, Unit("m/s^2")] = 0.5  # known by its name
    sail: Annotated[float, Unit("m")] = 7.0  # new
    crew: int = 3
    flag: bool = False
    spare: Annotated[float | None, Unit("kg")] = None  # None: none
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)
    breeze: Breeze = Breeze()  # noqa: RUF009


def test_every_field_and_no_other_has_a_control() -> None:
    found = set(CONTROLS)
    for field in dataclasses.fields(FormationConfig):
        part = PARTS.get(field.name)
        if part is None:
            assert (field.name in found) == (field.name != "scenario")
            continue
        own = getattr(part, "_fields", None) or [f.name for f in dataclasses.fields(part)]
        assert {f"{field.name}.{name}" for name in own} <= found
    assert {one.group for one in CONTROLS.values()} == {"", *PARTS}
    assert set(groups()) == set(PARTS) and all(groups().values())


def test_a_new_field_is_a_new_control() -> None:
    found = {one.name: one for one in controls(Later, [Later()])}
    assert found["sail"] == Control(
        "sail", "", "number", "m", "new", False, 0.0, 50.0, 0.5
    )._replace(low=found["sail"].low)
    assert (found["crew"].kind, found["crew"].step, found["crew"].high) == ("integer", 1.0, 20.0)
    assert (found["flag"].kind, found["corner"].kind) == ("boolean", "vector")
    assert (found["spare"].optional, found["spare"].unit) == (True, "kg")
    assert found["breeze.speed"].group == "breeze"
    assert found["breeze.speed"].text == "at the height of the leader"
    assert 0.0 < found["breeze.speed"].low < found["breeze.speed"].high == 20.0
    assert found["breeze.kind"].kind == "text"
    assert "scenario" not in found and groups(Later) == {"breeze": "What blows."}


def test_bounds_and_choices_are_the_configurations() -> None:
    for name, allowed in CHOICES.items():
        assert CONTROLS[name].choices == tuple(allowed)
    for name, (low, high, strict) in NUMBERS.items():
        one = CONTROLS[name]
        assert one.low is not None and one.high is not None
        assert (one.low > low if strict else one.low == low) and one.high <= high
    for name, (least, most) in COUNTS.items():
        assert CONTROLS[name].low == least and CONTROLS[name].high <= most  # type: ignore[operator]
    for part in ("noise", "limits", "reward"):
        for name, within in notes(type(PARTS[part])).items():
            one = CONTROLS[f"{part}.{name}"]
            assert one.low is not None and one.high is not None
            assert one.low >= within.low and one.high <= within.high


def test_sliders_reach_beyond_every_scenario() -> None:
    for make in SCENARIOS.values():
        for name, value in values(quietly(make)).items():
            one = CONTROLS.get(name)
            if one is not None and one.high is not None and value is not None:
                assert one.low is not None and one.low <= value <= one.high, name
                assert one.step is not None and 0.0 < one.step < one.high - one.low


def test_comments_are_those_beside_the_fields() -> None:
    assert comments(FormationConfig)["gust_time"] == "its correlation time"
    assert CONTROLS["gust"].unit == "m/s^2"
    assert CONTROLS["limits.deadline"].unit == "s", "on a line of its own within the field"
    assert CONTROLS["limits.collision"].text.startswith("Least distance between the centres")
    assert comments(int) == {}, "no source text"


def test_all_paths_and_formations_that_need_no_points_are_offered() -> None:
    names = {one["name"] for one in CONTROLS["trajectory"].makers}
    assert names == {"figure_eight", "lemniscate", "circle", "line", "hover", "random_smooth"}
    shapes = {one["name"]: one for one in CONTROLS["formation"].makers}
    assert {"stack", "line", "wedge", "column", "grid", "circle"} == set(shapes)
    arguments = {one["name"]: one for one in shapes["grid"]["arguments"]}
    assert arguments["plane"]["choices"] == ("xy", "yz") and arguments["columns"]["required"]


def test_controls_are_json() -> None:
    text = json.dumps([one._asdict() for one in CONTROLS.values()], allow_nan=False)
    assert len(json.loads(text)) == len(CONTROLS)


# -- what is set ----------------------------------------------------------------------------------

CHANGES: list[dict[str, Any]] = [
    {},
    {"gust": 0.3, "planner.k1": 0.3, "noise.position": 0.1},
    {"followers": 4},
    {"formation": {"maker": "wedge", "spacing": 0.9}, "followers": 3},
    {"formation": {"maker": "grid", "columns": 2, "plane": "yz", "ahead": 0.9}, "followers": 4},
    {"trajectory": {"maker": "circle", "radius": 2.5, "centre": [1.0, 0.0]}},
    {"trajectory": "hover", "action": "rates", "measurement_period": None},
    {"vehicle.mass": 0.12, "vehicle.thrust_max": 1.962, "vehicle.limited": False},
    {"offsets": [[0.8, 0.0, -0.3]]},
]


@pytest.mark.filterwarnings("ignore::formation_env.FeasibilityWarning")
@pytest.mark.parametrize("changes", CHANGES, ids=str)
def test_the_python_that_is_shown_makes_the_configuration(changes: dict[str, Any]) -> None:
    config = configuration("nominal", changes)
    text = python("nominal", changes)
    assert max(map(len, text.splitlines())) <= 100
    space: dict[str, Any] = {}
    exec(text, space)
    assert space["config"] == config
    assert (config == configure("nominal")) == (changes == {})


def test_values_are_those_of_the_controls() -> None:
    config = configuration("paper", {"noise.position": 0.125})
    found = values(config)
    assert found["noise.position"] == 0.125 and found["followers"] == 2
    assert found["measurement_period"] is None
    assert set(found) - {"scenario"} <= set(CONTROLS)
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_a_path_of_the_command_line_is_shown_as_one_that_was_chosen() -> None:
    for path in ("hover", {"path": "circle", "radius": 2.0}):
        changes = from_fields({"trajectory": path, "gust": 0.1})
        assert set(changes["trajectory"]) - {"radius"} == {"maker"} and changes["gust"] == 0.1
        expected = configure(trajectory=path, gust=0.1)
        assert configuration("nominal", changes) == expected
    assert from_fields({"gust": 0.1}) == {"gust": 0.1}


def test_one_of_offsets_followers_and_formation_takes_the_place_of_the_others() -> None:
    changes = with_change({"followers": 3, "gust": 0.1}, "offsets", [[0.5, 0.0, 0.0]])
    assert changes == {"gust": 0.1, "offsets": [[0.5, 0.0, 0.0]]}
    changes = with_change(changes, "formation", {"maker": "line"})
    assert changes == {"gust": 0.1, "formation": {"maker": "line"}}
    assert with_change(changes, "followers", 3)["formation"] == {"maker": "line"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gust": -1.0}, "gust = -1.0"),
        ({"planner.k2": 0.5}, r"planner\.k2 = 0\.5"),
        ({"planner.nothing": 1.0}, r"planner\.nothing"),
        ({"followers": 0}, "followers = 0"),
        ({"followers": 2.5}, r"followers = 2\.5"),
        ({"formation": {"maker": "star"}}, "formation = 'star'"),
        ({"formation": {"maker": "is_rigid"}}, "formation = 'is_rigid'"),
        ({"formation": {"maker": "wedge", "n": 3}}, r"formation\.n"),
        ({"formation": {"maker": "wedge", "spacing": -1}}, r"formation\.spacing = -1"),
        ({"formation": {"maker": "grid"}}, "formation: .*columns"),
        ({"formation": 3}, "formation = 3"),
        ({"trajectory": {"maker": "circle", "radius": -2}}, r"trajectory\.radius = -2"),
        ({"trajectory": {"maker": "knot"}}, r"trajectory\.path = 'knot'"),
        ({"offsets": "far"}, "offsets"),
    ],
)
def test_what_is_impossible_is_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        configuration("nominal", changes)


def test_the_paths_table_is_no_value() -> None:
    assert "trajectory" not in values(configure())
    assert not any(isinstance(x, (Trajectory, np.ndarray)) for x in values(configure()).values())
