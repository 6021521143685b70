"""What is observed and paid, law by law: frames by matrices, failures and rewards by definition."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import numpy as np
import pytest
from closed_loop import PROPERTY, Array, agree, numbers, quaternions, vectors
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from formation_env import Limits, Rewards, task
from formation_env.laws.levels import LEVELS, NAMES, Estimate, Guide, view_guide
from formation_env.laws.world import Action
from formation_env.maths import so3
from formation_env.maths.so3 import Vector
from formation_env.physics.sensors import Measured
from formation_env.task import COLLISION, IMPACT, LOST, NO_FAILURE, UNSTARTED, Layout, Passing

MEASURED = st.builds(
    Measured, vectors(5.0), vectors(3.0), vectors(2.0), quaternions(), vectors(4.0)
)
ACTIONS = st.tuples(*[numbers(1.0)] * 4)
D = (0.45, -0.6, -0.3)  # m


def heading(angle: float) -> complex:
    return complex(np.cos(angle), np.sin(angle))


def into(angle: float, a: Any) -> Array:
    """`R^T a`: into the frame {F} at that heading."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ a


# -- observations ---------------------------------------------------------------------------------------


@PROPERTY
@given(MEASURED, MEASURED, vectors(3.0), numbers(3.0), ACTIONS, st.booleans())
def test_a_follower_observes_in_the_formation_frame(
    own: Measured, leader: Measured, anchor: Vector, angle: float, previous: Action, started: bool
) -> None:
    seen = task.observe(own, leader, anchor, heading(angle), D, previous, started)
    axes = Rotation.from_quat([*own.q[1:], own.q[0]]).as_matrix()
    expected = {
        "slot_error": into(angle, np.subtract(anchor, own.p)) - D,  # (7)
        "relative_velocity": into(angle, np.subtract(leader.v, own.v)),
        "leader_velocity": into(angle, leader.v),
        "leader_acceleration": into(angle, leader.a),
        "body_x": into(angle, axes[:, 0]),
        "body_z": into(angle, axes[:, 2]),
        "angular_velocity": own.w,
        "heading": (np.cos(angle), np.sin(angle)),
        "offset": D,
        "previous_action": previous,
        "started": float(started),
        "position": own.p,
    }
    assert set(expected) == set(seen._fields)
    for name, value in expected.items():
        agree(getattr(seen, name), value, 1e-13)


@PROPERTY
@given(MEASURED, MEASURED, numbers(3.0))
def test_others_are_observed_from_where_the_follower_is(
    own: Measured, other: Measured, angle: float
) -> None:
    R = heading(angle)
    seen = task.observe_neighbour(Passing(own.p, own.v), Passing(other.p, other.v), R, True)
    guide = view_guide(Estimate(R), Guide(other.p, other.v), own)
    p, v = (into(angle, np.subtract(a, b)) for a, b in ((other.p, own.p), (other.v, own.v)))
    assert seen.neighbour_present == 1.0
    agree([*seen.neighbour_position, *seen.neighbour_velocity], [*p, *v], 1e-13)
    agree([*guide.guide_position, *guide.guide_velocity], [*p, *v], 1e-13)
    none = task.observe_neighbour(Passing(own.p, own.v), Passing(other.p, other.v), R, False)
    assert none == (0.0, so3.ZERO, so3.ZERO)


@PROPERTY
@given(vectors(9.0), vectors(9.0))
def test_distance(a: Vector, b: Vector) -> None:
    agree(task.distance(a, b), np.linalg.norm(np.subtract(a, b)), 1e-13)


# -- failures -------------------------------------------------------------------------------------------

LIMITS = Limits(collision=0.2, impact=1.0, tilt=0.5, lost=10.0)


@PROPERTY
@given(
    st.sampled_from([0.0, 0.1, 0.2, 0.3, inf, nan]),
    st.sampled_from([0.0, 0.5, 1.0, 1.5, inf, nan]),
    st.sampled_from([-1.0, 0.4, 0.5, 0.6, 1.0, nan]),
    st.sampled_from([0.0, 9.0, 10.0, 11.0, inf, nan]),
    st.booleans(),
)
def test_the_first_failure_of_four_counts(
    separation: float, speed: float, upright: float, error: float, overdue: bool
) -> None:
    """A collision before an impact, a loss and a late start; what is exactly at its limit is within it."""
    expected = UNSTARTED if overdue else NO_FAILURE
    if error > 10.0 or np.isnan(error):
        expected = LOST
    touching = 0.0 < speed < inf
    if touching and (speed > 1.0 or upright < 0.5):
        expected = IMPACT
    if separation < 0.2:
        expected = COLLISION
    assert task.failure(separation, speed, upright, error, overdue, LIMITS) == expected


# -- the reward -----------------------------------------------------------------------------------------

WEIGHTS = Rewards(0.4, 0.06, waiting=0.02, effort=0.05, smoothness=0.07, failure=10.0)
CALM: Action = (0.0, 0.0, 0.0, 0.0)


@PROPERTY
@given(numbers(30.0), ACTIONS, ACTIONS, st.sampled_from([3, 4]), st.booleans(), st.booleans())
def test_the_reward_is_what_its_docstring_says(
    error: float, action: Action, previous: Action, size: int, failed: bool, started: bool
) -> None:
    a, b, e = np.array(action), np.array(previous), abs(error)
    found = task.reward(started, 25.0, e, action, previous, size, failed, WEIGHTS)
    wide, narrow = 0.4**2 / (0.4**2 + e**2), 0.06**2 / (0.06**2 + e**2)
    near = (wide + narrow) / 2.0
    agree(task.closeness(e, WEIGHTS), near, 1e-14)
    agree(found.formation, near if started else 0.0, 1e-14)
    agree(found.waiting, 0.0 if started else -0.02 * (1.0 - near), 1e-15)
    agree(found.effort, -0.05 * a @ a / size, 1e-14)
    agree(found.smoothness, -0.07 * (a - b) @ (a - b) / size, 1e-14)
    assert found.failure == (-10.5 if failed else 0.0)  # 25 ticks to the deadline at 0.02


@pytest.mark.parametrize(("error", "near"), [(0.0, 1.0), (inf, 0.0), (nan, 0.0)])
def test_the_terms_at_the_ends_of_closeness(error: float, near: float) -> None:
    assert task.reward(True, 0.0, error, CALM, CALM, 4, False, WEIGHTS) == (
        near,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    waiting = 0.02 * (near - 1.0)
    assert task.reward(False, 0.0, error, CALM, CALM, 4, False, WEIGHTS) == (
        0.0,
        waiting,
        0.0,
        0.0,
        0.0,
    )


# -- the layout -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", range(len(LEVELS)), ids=NAMES)
@pytest.mark.parametrize("neighbours", [0, 3])
def test_entries_lie_side_by_side(level: int, neighbours: int) -> None:
    """Each entry of a row has one name, one place and one bound; neighbours come last, one by one."""
    layout = Layout(level, neighbours)
    row = np.arange(float(layout.size))
    named = layout.unpack(row)
    sizes = [(entry.name, entry.size, entry.bound) for entry in task.ENTRIES]
    sizes += [(one.name, one.size, one.bound) for one in task.entries(LEVELS[level].view)]
    start = 0
    for name, size, bound in sizes:
        assert named[name].tolist() == list(range(start, start + size))
        assert set(layout.bound[start : start + size]) == {np.float32(bound)}
        start += size
    for k in range(neighbours):
        for entry in task.NEIGHBOUR_ENTRIES:
            assert named[entry.name][k].tolist() == list(range(start, start + entry.size))
            assert set(layout.bound[start : start + entry.size]) == {np.float32(entry.bound)}
            start += entry.size
    assert start == layout.size == len(layout.bound)
    np.testing.assert_array_equal(layout.pack(named), row)


def test_entries_are_the_fields_of_an_observation() -> None:
    assert tuple(entry.name for entry in task.ENTRIES) == task.Observation._fields
    names = tuple(entry.name for entry in task.NEIGHBOUR_ENTRIES)
    assert names == task.Neighbour._fields


@pytest.mark.parametrize("size", [0, 1])
def test_rows_and_names_of_another_layout_are_refused(size: int) -> None:
    layout = Layout(NAMES.index("wrench"), 1)
    with pytest.raises(ValueError, match=r"observation has shape"):
        layout.unpack(np.zeros((2, size * (layout.size + 1))))
    named = layout.unpack(np.zeros(layout.size))
    del named["started"]
    with pytest.raises(ValueError, match=r"entries missing or unknown = \['started'\]"):
        layout.pack(named)
