"""A trajectory as numbers, lists and names: there and back through JSON, exactly."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from closed_loop import PROPERTY
from hypothesis import given
from hypothesis import strategies as st
from paths import closed_forms, random_ones

from formation_env import splines, trajectories
from formation_env.trajectories import Trajectory, as_trajectory
from formation_env.validation.checks import LONGEST

POINTS = [[0.0, 0.0, -1.0], [1.0, 0.0, -1.0]]
anything = st.one_of(closed_forms, random_ones())


@PROPERTY
@given(anything)
def test_a_trajectory_goes_through_json_exactly(curve: Trajectory) -> None:
    data = json.loads(json.dumps(curve.to_dict(), allow_nan=False))
    for again in (Trajectory.from_dict(data), as_trajectory("trajectory", data)):
        assert again == curve  # every bit of the table
        assert type(again.random) is type(curve.random)


def test_a_log_goes_through_json_exactly() -> None:
    t = np.linspace(0.0, 60.0, 6000)
    log = np.stack([np.cos(t / 3.0), np.sin(t / 3.0), -1.5 - 0.1 * np.sin(t)], axis=1)
    curve = splines.from_samples(t, log)
    assert Trajectory.from_dict(json.loads(json.dumps(curve.to_dict()))) == curve


def test_a_trajectory_by_its_name_and_arguments() -> None:
    curve = trajectories.circle(2.0)
    assert as_trajectory("trajectory", curve) is curve
    assert as_trajectory("trajectory", {"path": "circle", "radius": 2}) == curve
    for name in ("figure_eight", "lemniscate", "circle", "line", "hover", "random_smooth"):
        assert as_trajectory("trajectory", name) == getattr(trajectories, name)()
    given_ = {"path": "waypoints", "times": [0, 1], "points": POINTS}
    assert as_trajectory("trajectory", given_) == splines.waypoints([0.0, 1.0], POINTS)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (7, r"path = 7: expected a Trajectory, one of 'figure_eight', "),
        (None, r"path = None: expected a Trajectory"),
        ({}, r"path = \{\}: expected a Trajectory"),
        ([0.0] * 9999, r"path = list of 9999 entries, the first 0.0: expected a Trajectory"),
        ("circel", r"path.path = 'circel': expected one of 'figure_eight', "),
        ({"path": ["circle"]}, r"path.path = \['circle'\]: expected one of"),
        ({"path": "circle", "radios": 2}, r"path.radios = 2: expected one of circle's radius, "),
        ({"path": "circle", "radius": -2}, r"path.radius = -2: expected a finite number above 0"),
        ({"path": "circle", "radius": "2"}, r"path.radius = '2': expected a finite number"),
        ({"path": "waypoints", "times": [0, 1]}, r"path.points = None: expected an argument"),
        ({"kind": "sines"}, r"path.name = None: expected an entry"),
        ({"kind": "sines", "size": 2}, r"path.size = 2: expected one of name, kind, table"),
        ({"name": "x", "kind": "sine", "table": [1.0]}, r"path.kind = 'sine': expected one of"),
        ({"name": "x", "kind": 0, "table": [1.0]}, r"path.table = 1 numbers: expected 16"),
    ],
    ids=lambda x: repr(x).partition(" at 0x")[0][:30],
)
def test_what_describes_no_trajectory(value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}") as caught:
        as_trajectory("path", value)
    assert len(str(caught.value)) <= LONGEST
