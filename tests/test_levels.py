"""Action levels: encoding undoes decoding, and a tile's loops do what the rows of the table say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from closed_loop import PROPERTY, agree, numbers, vectors
from hypothesis import given
from hypothesis import strategies as st
from states import filled, lane_of, line, tile

from formation_env import configure, task
from formation_env.core.arrays import rows
from formation_env.core.simulation import Simulation
from formation_env.laws import levels
from formation_env.laws.levels import (
    LEVELS,
    NAMES,
    Follower,
    Guide,
    Level,
    acceleration_action,
    begin_level,
    command_follower,
    drive,
    driven,
    follower_layout,
    guided,
    numbered,
    show_level,
    view_guide,
    wrench_action,
)
from formation_env.laws.slots import Slot, in_frame
from formation_env.laws.world import Action, Reach
from formation_env.maths.so3 import Vector
from formation_env.memory.records import LANES, bounds, fields, flatten, is_record, notes, size
from formation_env.physics.quadrotor import MOMENT, RATES, Wrench
from formation_env.physics.sensors import Measured
from formation_env.trajectories import TrajectoryPoint

LEVEL = pytest.mark.parametrize("level", LEVELS, ids=NAMES)
ACTIONS = st.tuples(*[numbers(1.0)] * 4)
REACHES = st.builds(
    Reach,
    st.floats(0.1, 50.0),
    st.tuples(*[st.floats(0.01, 20.0)] * 3),
    st.tuples(*[st.floats(0.1, 20.0)] * 3),
)


def decoded(level: Level, action: Action, R: complex, reach: Reach) -> Any:
    """What an action of the level asks for, as its inverse takes it."""
    world = configure(action=level.name).world._replace(reach=reach)
    if level.state is None:
        return level.decode(action, world)
    asked = level.decode(action, level.state((1.0, 2.0, -3.0), (0.5, 0.0, 0.25)), R, world)
    return in_frame(R, asked.a)


@LEVEL
@PROPERTY
@given(ACTIONS, numbers(3.0), REACHES)
def test_encoding_undoes_decoding(level: Level, action: Action, angle: float, reach: Reach) -> None:
    R = complex(np.cos(angle), np.sin(angle))
    found = level.encode(decoded(level, action, R, reach), reach)
    assert len(found) == level.size
    agree(found, action[: level.size], 1e-13)


@LEVEL
@PROPERTY
@given(vectors(9.0), numbers(9.0), REACHES)
def test_decoding_undoes_encoding(
    level: Level, wanted: Vector, thrust: float, reach: Reach
) -> None:
    """Beyond what the vehicle can do as well."""
    asked: Any = Wrench(thrust, wanted) if level.state is None else wanted
    action = (*level.encode(asked, reach), 0.0)[:4]
    agree(flatten(decoded(level, action, 1.0 + 0.0j, reach)), flatten(asked), 1e-11)


def test_the_levels_are_those_of_the_manual() -> None:
    assert NAMES == ("wrench", "rates", "reference")
    assert [numbered(name) for name in NAMES] == list(range(len(LEVELS)))
    assert NAMES[levels.REFERENCE] == "reference"
    assert [(level.size, level.actuation) for level in LEVELS] == [
        (4, MOMENT),
        (4, RATES),
        (3, None),
    ]
    assert [(level.decode, level.encode) for level in LEVELS] == [
        (driven, wrench_action), (driven, wrench_action), (guided, acceleration_action)
    ]  # fmt: skip


@LEVEL
def test_a_row_of_the_table_is_sound(level: Level) -> None:
    assert 0 < level.size <= size(Action)
    assert 0.0 < level.exploration < 1.0
    assert level.actuation in (MOMENT, RATES, None)
    for record in (level.state, level.view):
        assert record is None or is_record(record)
    if level.state is not None:
        assert fields(level.state).keys() >= {"p", "v"}
        assert level.state._fields[:2] == ("p", "v"), "it begins with what a slot holds"
    if level.view is not None:
        assert notes(level.view).keys() == fields(level.view).keys()
        assert np.isfinite(bounds(level.view)).all()


@LEVEL
def test_a_configuration_has_what_its_level_says(level: Level) -> None:
    config = configure(action=level.name)
    assert config.action_size == level.size
    assert config.world.level == LEVELS.index(level)
    entries = [entry.name for entry in config.layout.entries]
    own = [] if level.view is None else list(level.view._fields)
    assert entries == [*task.Observation._fields, *own]
    flight = Simulation(config, 2)
    assert flight._state.followers.shape[-1] == size(follower_layout(level.state)) * LANES
    if level.actuation is not None:
        assert config.world.follower_actuation == level.actuation


# -- over the lanes of a tile -------------------------------------------------------------------------------


@LEVEL
def test_the_tiles_loop_commands_what_the_level_decodes(level: Level) -> None:
    """A direct one whatever else it is handed; that of a guided level is in `test_flight`."""
    if level.state is not None:
        return
    world, draw = configure(action=level.name).world, np.random.default_rng(1)
    action, command = draw.uniform(-1.0, 1.0, size(Action) * LANES), tile(Wrench)
    x, own = filled(Follower, draw), filled(Measured, draw)
    before, flags = x.copy(), np.zeros(LANES)
    for by in (MOMENT, RATES):
        command_follower(
            LEVELS.index(level), x, own, action, flags, flags, line(world), by, command
        )
        for lane in range(LANES):
            a = tuple(action.reshape(-1, LANES)[:, lane])
            assert level.actuation is not None
            wanted = drive(a, world, level.actuation)
            np.testing.assert_allclose(
                flatten(Wrench(**lane_of(command, Wrench, lane))), flatten(wanted), rtol=1e-13
            )
    np.testing.assert_array_equal(x, before)


@PROPERTY
@given(ACTIONS, numbers(2.0), st.sampled_from([MOMENT, RATES]))
def test_a_direct_action_is_given_within_what_actuators_can(
    action: Action, scale: float, by: int
) -> None:
    """Of what is up to three times that, the nearest that they can; of moments or of rates."""
    world = configure().world
    frame = world.airframe
    most = frame.moment_max if by == MOMENT else frame.rate_max
    reach = Reach(3.0 * frame.thrust_max, tuple(3.0 * m for m in most), (1.0, 1.0, 1.0))  # type: ignore[arg-type]
    asked = driven(action, world._replace(reach=reach))
    given = drive(action, world._replace(reach=reach), by)
    agree(given.thrust, min(max(asked.thrust, frame.thrust_min), frame.thrust_max), 1e-14)
    agree(given.turn, np.clip(asked.turn, np.negative(most), most), 1e-14)


@LEVEL
def test_a_level_begins_at_the_slot_and_shows_its_view(level: Level) -> None:
    layout, draw = follower_layout(level.state), np.random.default_rng(2)
    k = LEVELS.index(level)
    x, own = filled(layout, draw), filled(Measured, draw)
    before, at = x.copy(), 5
    begin_level(k, x, np.uint64(at), Slot((1.0, 2.0, -3.0), (0.5, 0.25, 0.125)))
    changed = np.flatnonzero((x != before).reshape(-1, LANES).any(axis=0))
    assert changed.tolist() == ([] if level.state is None else [at])
    assert lane_of(x, Follower, at) == lane_of(before, Follower, at)
    if level.state is not None:
        now = lane_of(x, layout, at)
        assert (now["p"], now["v"]) == ((1.0, 2.0, -3.0), (0.5, 0.25, 0.125))
    seen = np.full(LANES * max(1, 0 if level.view is None else size(level.view)), 7.0, np.float32)
    show_level(k, x, own, seen)
    if level.view is None:
        assert (seen == 7.0).all()
        return
    for lane in range(LANES):
        now, m = lane_of(x, layout, lane), Measured(**lane_of(own, Measured, lane))
        frame = levels.Estimate(complex(*now["estimate"]))
        expected = flatten(view_guide(frame, Guide(now["p"], now["v"]), m))
        np.testing.assert_allclose(seen.reshape(-1, LANES)[:, lane], expected, 2e-6, 2e-6)


def test_what_a_policy_sees_of_a_guide_is_clipped() -> None:
    layout, k = follower_layout(Guide), numbered("reference")
    x, own = tile(layout), tile(Measured)
    rows(x, layout)["estimate"][0] = 1.0
    rows(x, layout)["p"][:], rows(x, layout)["v"][:] = 1e9, -1e9
    seen = np.zeros(LANES * size(levels.GuideView), np.float32)
    show_level(k, x, own, seen)
    signs = np.sign(seen.reshape(-1, LANES)[:, 3])
    np.testing.assert_array_equal(seen.reshape(-1, LANES)[:, 3], signs * bounds(levels.GuideView))
    assert set(signs) == {1.0, -1.0}


@PROPERTY
@given(ACTIONS, vectors(3.0), vectors(3.0))
def test_a_guided_action_is_a_point_of_a_trajectory(action: Action, p: Vector, v: Vector) -> None:
    """Where the virtual follower is, with the acceleration asked for and no derivative beyond."""
    found = guided(action, Guide(p, v), 1.0 + 0.0j, configure().world)
    o = (0.0, 0.0, 0.0)
    assert found == TrajectoryPoint(p, v, found.a, o, o)


@PROPERTY
@given(vectors(3.0), vectors(3.0), vectors(3.0), vectors(3.0), numbers(3.0))
def test_a_policy_sees_a_guide_from_its_vehicle_in_the_formation_frame(
    p: Vector, v: Vector, own_p: Vector, own_v: Vector, angle: float
) -> None:
    c, s = np.cos(angle), np.sin(angle)
    into = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    o = (0.0, 0.0, 0.0)
    own = Measured(own_p, own_v, o, (1.0, 0.0, 0.0, 0.0), o)
    seen = view_guide(levels.Estimate(complex(c, s)), Guide(p, v), own)
    agree(seen.guide_position, into @ np.subtract(p, own_p), 1e-13)
    agree(seen.guide_velocity, into @ np.subtract(v, own_v), 1e-13)
