"""Every wrong argument is refused by name, and a refused call changes nothing."""

from __future__ import annotations

import json
from dataclasses import fields
from math import inf, nan
from typing import Any

import pytest

from formation_env import (
    FormationConfig,
    Limits,
    Noise,
    PlannerGains,
    Rewards,
    TrackerGains,
    Vehicle,
    configure,
    formation_v0,
)
from formation_env.env import FormationEnv
from formation_env.validation.checks import LONGEST
from formation_env.vector import FormationVectorEnv

QUIET = Noise(0.0, 0.0, 0.0, 0.0, 0.0)
REWARD = Rewards(0.3, 0.05, 0.01, 0.05, 0.05, 10.0)
LIMITS = Limits(0.353, 1.0, 0.5, 10.0, 15.0)
NOT_POSITIVE = (0.0, -1.0, inf, nan, "x", None, True)
NEGATIVE = (-0.1, inf, nan, "x", None)
NOT_A_COUNT = (-1, 1.5, "x", None, True, 10**9)

# Field of the configuration -> impossible values.
IMPOSSIBLE: dict[str, tuple[Any, ...]] = {
    "offsets": ((), (0.35, 0.35, -0.3), ((0.35, 0.35),), ((nan, 0.0, 0.0),), "x", None),
    "trajectory": (None, "figure-eight", lambda t: t, 3, {"path": "spiral"}),
    "path": ("given", "As given", None, True),
    "action": ("torque", None, 3),
    "start": ("air", None, 1),
    "start_offset": (*NEGATIVE, 0.6),
    "leader_start": ((0.0, 0.0), (nan, 0.0, 0.0), "x", 3),
    "follower_starts": (((0.0, 0.0, 0.0),), ((nan, 0.0, 0.0), (0.0, 1.0, 0.0)), "x"),
    "trigger": NOT_POSITIVE,
    "control_period": NOT_POSITIVE,
    "substeps": (0, *NOT_A_COUNT),
    "duration": (*NOT_POSITIVE, 0.01),
    "measurement_period": (0.0, -0.02, nan, "x", 0.0033, 0.001),
    "measurement_delay": NOT_A_COUNT,
    "estimator": ("kalman", None),
    "window": (0, *NOT_A_COUNT),
    "noise": (None, 0.1, (0.0,) * 4, LIMITS, {"pos": 0.1}, [[0.0] * 5], "paper"),
    "gust": NEGATIVE,
    "gust_time": NOT_POSITIVE,
    "vehicle": (None, "big"),
    "leader_actuation": ("wrench", None),
    "reference_actuation": ("wrench", None),
    "reference_max": ((0.0, 4.0, 4.0), (4.0, 4.0), (nan, 4.0, 4.0), 4.0, None),
    "planner": (None, 0.2),
    "tracker": (None, 0.5),
    "rates_tracker": (None, 0.5),
    "reward": (None, 1.0, (0.3, 0.05, 0.05), LIMITS, {"effort": None}, {1: 0.3}),
    "limits": (None, (0.2, 1.0, 0.5), REWARD, {"lost": True}),
    "neighbours": NOT_A_COUNT,
}
CASES = [(name, value) for name, values in IMPOSSIBLE.items() for value in values]


def test_every_field_is_tried() -> None:
    assert set(IMPOSSIBLE) | {"scenario"} == {f.name for f in fields(FormationConfig)}


@pytest.mark.parametrize(
    ("name", "value"), CASES, ids=lambda x: repr(x).partition(" at 0x")[0][:30]
)
def test_an_impossible_value_is_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=name) as caught:
        configure("nominal", **{name: value})
    message = str(caught.value)
    shown = [repr(value), "shape", "rows", "apart"]  # tables are told by their shape,
    if isinstance(value, (tuple, list)):
        shown += [repr(x) for x in value]  # or by the row that is wrong,
        shown += [repr(list(x)) for x in value if isinstance(x, tuple)]
        shown.append(repr(list(value)))
    if isinstance(value, dict):
        shown += [repr(x) for x in value.values()]  # parts by the entry
    assert any(text in message for text in shown), message
    assert "expected" in message
    assert len(message) <= LONGEST


@pytest.mark.parametrize("group", ["noise", "reward", "limits"])
def test_every_number_of_a_group_is_checked(group: str) -> None:
    values = {"noise": QUIET, "reward": REWARD, "limits": LIMITS}[group]
    for name in values._fields:
        for bad in (-2.0, nan, inf, "x", None):
            with pytest.raises(ValueError, match=rf"{group}\.{name} = {bad!r}"):
                configure(**{group: values._replace(**{name: bad})})


@pytest.mark.parametrize("kind", [Vehicle, PlannerGains, TrackerGains])
def test_every_number_of_a_part_is_checked(kind: type) -> None:
    part = {Vehicle: "vehicle", PlannerGains: "planner", TrackerGains: "tracker"}[kind]
    optional = {"thrust_max", "p12", "p22"}
    for field in fields(kind):
        bad: list[Any] = [-1.0, nan, inf, "x"] + ([] if field.name in optional else [None])
        for value in bad:
            with pytest.raises(ValueError, match=rf"{part}\.{field.name} = "):
                kind(**{field.name: value})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scenario": "nominl"}, r"scenario = 'nominl': expected one of 'nominal', 'paper'"),
        ({"scenario": None}, "scenario = None"),
        ({"followers": 0}, "followers = 0"),
        ({"followers": -3}, "followers = -3"),
        ({"followers": 2.0}, "followers = 2.0"),
        ({"followers": "2"}, "followers = '2'"),
        ({"followers": True}, "followers = True"),
        ({"followers": 2, "offsets": ((0.5, 0.0, 0.0),)}, "followers and offsets"),
        ({"render_mode": "ascii"}, "render_mode = 'ascii': expected"),
        ({"render_mode": 3}, "render_mode = 3"),
    ],
)
def test_every_face_refuses_alike(options: dict[str, Any], message: str) -> None:
    for make in (FormationEnv, formation_v0.parallel_env, FormationVectorEnv):
        with pytest.raises(ValueError, match=message):
            make(**options)


@pytest.mark.parametrize("make", [FormationEnv, formation_v0.parallel_env, FormationVectorEnv])
@pytest.mark.parametrize("name", ["colour", "frameskip"])
def test_an_unknown_keyword_is_pythons_own_error(make: Any, name: str) -> None:
    """Libraries probe for options of other environments, and catch what Python itself would raise."""
    with pytest.raises(
        TypeError, match=rf"got an unexpected keyword argument '{name}': known are"
    ) as e:
        make(**{name: 4})
    assert len(str(e.value)) <= LONGEST


@pytest.mark.parametrize("make", [FormationEnv, formation_v0.parallel_env, FormationVectorEnv])
def test_every_face_takes_a_configuration_in_json(make: Any) -> None:
    config = configure("paper", action="rates", noise={"position": 0.1})
    data = json.loads(json.dumps(config.to_dict()))
    assert make(scenario=data).unwrapped.config == config
    part = {"scenario": "paper", "noise": {"position": 0.1}}
    assert make(scenario=part, action="rates").unwrapped.config == config
    with pytest.raises(ValueError, match=r"^noise\.position = None: expected a finite number"):
        make(scenario={"noise": {"position": None}})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs = 0"),
        ({"num_envs": 2.0}, "num_envs = 2.0"),
        ({"num_envs": True}, "num_envs = True"),
        ({"max_episode_steps": 0}, "max_episode_steps = 0"),
        ({"max_episode_steps": "9"}, "max_episode_steps = '9'"),
        ({"threads": 0}, "threads = 0"),
        ({"threads": -1}, "threads = -1"),
        ({"threads": 1.5}, "threads = 1.5"),
        (
            {"autoreset_mode": "sometimes"},
            "autoreset_mode = 'sometimes': expected one of NEXT_STEP",
        ),
        ({"autoreset_mode": 1}, "autoreset_mode = 1"),
        ({"render_mode": "human"}, "render_mode = 'human'"),
    ],
)
def test_the_vector_face_refuses(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FormationVectorEnv(**options)


@pytest.mark.parametrize("cycles", [0, -1, 2.5, "9", True])
def test_the_parallel_face_refuses(cycles: Any) -> None:
    with pytest.raises(ValueError, match="max_cycles = "):
        formation_v0.parallel_env(max_cycles=cycles)
