"""Fields set from the command line, files of fields, sweeps."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from baselines import evaluate as command
from baselines.scoring.tasks import read_setting, read_sweep, tasks
from formation_env import FeasibilityWarning, FormationConfig, configure


def flown(*words: str, scenario: str = "nominal") -> dict[str, FormationConfig]:
    """The tasks of `--set` words."""
    return tasks([scenario], settings=[read_setting(word) for word in words])


def test_fields_and_parts_of_fields() -> None:
    words = [
        "vehicle.mass=0.12",
        "noise.position=0.1",
        "planner.k1=0.3",
        "gust=0.5",
        "action=rates",
    ]
    (config,) = flown(*words, "neighbours=1", scenario="paper").values()
    usual = configure("paper", action="rates")
    assert config.vehicle.mass == 0.12 and config.noise.position == 0.1
    assert config.noise.velocity == usual.noise.velocity > 0.0, "the scenario's other parts stay"
    assert (config.planner.k1, config.planner.k2) == (0.3, usual.planner.k2)
    assert (config.gust, config.action, config.neighbours) == (0.5, "rates", 1)
    assert config.scenario == "paper" and config.start == "ground"


def test_the_scenarios_own_vehicle_is_changed() -> None:
    (config,) = flown("vehicle.moment_max=[1, 1, 1]", scenario="experiment").values()
    assert config.vehicle.mass == configure("experiment").vehicle.mass == 0.078
    assert config.vehicle.moment_max == (1.0, 1.0, 1.0)


def test_followers_and_offsets() -> None:
    assert flown("followers=5")["nominal"].followers == 5
    with pytest.warns(FeasibilityWarning):
        config = flown("offsets=[[0.35, 0.35, -0.3]]")["nominal"]
    assert config.offsets == ((0.35, 0.35, -0.3),)
    config = flown("followers=5", "noise.position=0.1")["nominal"]
    assert (config.followers, config.noise.position) == (5, 0.1)


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("gust", "expected FIELD=VALUE"),
        ("=1", "expected FIELD=VALUE"),
        ("gust=", "expected FIELD=VALUE"),
        ("gu st=1", "expected FIELD=VALUE"),
        ("gust=strong", "scenario nominal: gust = 'strong': expected"),
        ("gusts=1", "gusts"),
        ("vehicle.weight=1", "vehicle.weight = 1: expected one of mass"),
        ("wheels.mass=1", "wheels = 1: expected one of the fields scenario"),
        ("vehicle.mass=-1", "scenario nominal: vehicle.mass = -1"),
        ("gust.x=1", "gust.x = 1: expected gust to be set as a whole"),
        ("vehicle.mass.x=1", "vehicle.mass.x = 1: expected vehicle.mass to be set as a whole"),
        ("trajectory.radius=3", "trajectory.radius = 3: expected trajectory to be set as a whole"),
        ("duration=1e400", "duration = inf: expected"),
    ],
)
def test_what_cannot_be_set_is_named(word: str, message: str) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        flown(word)
    assert message in str(refusal.value)
    assert len(str(refusal.value)) <= 560


@pytest.mark.parametrize(
    "words", [("mass=0.05", "thrust_max=0.9"), ("thrust_max=0.9", "mass=0.05")]
)
def test_parts_are_set_at_once(words: tuple[str, str]) -> None:
    """The default mass is too heavy for the thrust: which is given first does not matter."""
    vehicle = flown(*(f"vehicle.{word}" for word in words))["nominal"].vehicle
    assert (vehicle.mass, vehicle.thrust_max) == (0.05, 0.9)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("gust=0:2:9", (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)),
        ("gust=0:0.3:4", (0.0, 0.1, 0.2, 0.3)),
        ("noise.position=0,0.1,0.2", (0, 0.1, 0.2)),
        ("action=rates, wrench", ("rates", "wrench")),
        ("vehicle.moment_max=[1,1,1],[2,2,2]", ([1, 1, 1], [2, 2, 2])),
    ],
)
def test_values_of_a_sweep(text: str, values: tuple[Any, ...]) -> None:
    assert read_sweep(text).values == values


@pytest.mark.parametrize(
    "text",
    ["gust", "gust=", "gust=0:1:1", "gust=0:x:3", "gust=0:inf:3", "gust=1,1", "gust=0:1:5000"],
)
def test_no_sweep(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        read_sweep(text)


def test_sweeps_are_combined() -> None:
    sweeps = [read_sweep("gust=0,0.5"), read_sweep("vehicle.mass=0.1,0.2")]
    found = tasks(["nominal", "paper:rates"], sweeps=sweeps)
    assert list(found)[:2] == ["nominal gust=0 vehicle.mass=0.1", "nominal gust=0 vehicle.mass=0.2"]
    assert len(found) == 8
    last = found["paper:rates gust=0.5 vehicle.mass=0.2"]
    assert (last.gust, last.vehicle.mass, last.action) == (0.5, 0.2, "rates")
    many = [read_sweep("gust=0:1:1000"), read_sweep("gust_time=1:2:2")]
    with pytest.raises(ValueError, match="2000 tasks: expected at most 1000"):
        tasks(["nominal"], sweeps=many)


def test_the_command_flies_file_settings_and_sweep(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.json"
    fields = {"scenario": "paper", "action": "rates", "duration": 0.2, "gust": 0.1}
    mine.write_text(json.dumps(fields), encoding="utf-8")
    out = tmp_path / "out"
    arguments = ["--config", str(mine), "--set", "noise.position=0.01", "--sweep", "gust=0.2,0.4"]
    arguments += ["--policies", "hover", "--episodes", "2", "--output", str(out)]
    assert command.main(arguments) == 0
    document = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert list(document["scenarios"]) == ["mine gust=0.2", "mine gust=0.4"]
    assert document["scenarios"]["mine gust=0.4"]["action"] == "rates"
    repeat = f"--config {mine} --set noise.position=0.01 --sweep gust=0.2,0.4 --episodes 2"
    assert document["command"] == f"python -m baselines.evaluate --policies hover {repeat}"
    table = capsys.readouterr().out.split("mine: scores by gust, m/s^2\n")[1]
    assert table.splitlines()[0].split() == ["policy", "0.2", "0.4"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot be read: No such file"),
        ("{", "not JSON"),
        ("[1]", "expected an object"),
        ('{"scenario": "windy"}', "scenario = 'windy': expected one of nominal"),
        ('{"gust": -1}', "scenario mine: gust = -1: expected"),
        ('{"vehicle": {"mass": "heavy"}}', "mass"),
        ('{"wheels": 4}', "wheels"),
    ],
)
def test_bad_files_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None, message: str
) -> None:
    mine = tmp_path / "mine.json"
    if text is not None:
        mine.write_text(text, encoding="utf-8")
    with pytest.raises(SystemExit):
        command.main(["--config", str(mine), "--output", str(tmp_path / "out")])
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe of Unix")
def test_a_pipe_is_no_file_of_fields(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "mine.json")
    with pytest.raises(SystemExit):
        command.main(["--config", str(tmp_path / "mine.json")])
    assert "a pipe, not a regular file" in capsys.readouterr().err


def test_a_whole_configuration_goes_through_a_file(tmp_path: Path) -> None:
    config = configure("experiment", gust=0.3)
    path = tmp_path / "whole.json"
    path.write_text(json.dumps(config.to_dict()), encoding="utf-8")
    found = tasks([], files=[path])["whole"]
    assert found.to_dict() == config.to_dict()
