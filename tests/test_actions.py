"""Actions from what a vehicle should do: the inverse of what the environment makes of an action."""

from __future__ import annotations

import numpy as np
import pytest
from closed_loop import PROPERTY, agree, vectors
from hypothesis import given
from hypothesis import strategies as st

from baselines.policies.actions import clipped, clipped_or_zero, corrected
from formation_env import configure
from formation_env._jit import plain
from formation_env.laws.levels import Guide, acceleration_action, driven, guided, wrench_action
from formation_env.maths.so3 import Vector
from formation_env.physics.quadrotor import Wrench

WORLDS = {level: configure("nominal", action=level).world for level in ("wrench", "rates")}
UNIT = st.floats(-1.0, 1.0)


@PROPERTY
@given(st.sampled_from(sorted(WORLDS)), st.tuples(UNIT, UNIT, UNIT, UNIT))
def test_wrench_action_inverts_driven(
    level: str, action: tuple[float, float, float, float]
) -> None:
    world = WORLDS[level]
    agree(wrench_action(driven(action, world), world.reach), action, 1e-15)


@PROPERTY
@given(vectors(1.0))
def test_acceleration_action_inverts_guided(action: Vector) -> None:
    """In the formation frame, here the inertial one."""
    world = configure("nominal", action="reference", reference_max=(3.0, 2.0, 4.0)).world
    o = (0.0, 0.0, 0.0)
    wanted = guided((*action, 0.0), Guide(o, o), complex(1.0, 0.0), world).a
    agree(acceleration_action(wanted, world.reach), action, 1e-15)


def test_arrays_are_dealt_with_alike() -> None:
    """Of arrays the plain functions make what they make of each number."""
    reach = WORLDS["wrench"].reach
    many = np.random.default_rng(0).uniform(-1.0, 2.0, (4, 7))
    wanted = Wrench(many[0], (many[1], many[2], many[3]))  # type: ignore[arg-type]
    found = plain(wrench_action)(wanted, reach)
    alone = [wrench_action(Wrench(a, (b, c, d)), reach) for a, b, c, d in many.T.tolist()]
    np.testing.assert_allclose(np.array(found).T, alone, rtol=1e-15)


def test_clipping() -> None:
    wanted = [-1.0, -1.0, -0.5, 1.0, 1.0]
    assert clipped(np.array([-np.inf, -1.5, -0.5, 1.0, 9.0])).tolist() == wanted
    assert clipped(np.zeros(3)).dtype == np.float32
    assert [clipped_or_zero(a) for a in (-7.0, 0.25, np.inf, np.nan)] == [-1.0, 0.25, 1.0, 0.0]


def test_a_correction_is_clipped_and_so_is_the_sum() -> None:
    base = np.array([0.0, 0.0, 0.9, -0.9], dtype=np.float32)
    found = corrected(base, np.array([0.5, 7.0, 1.0, -1.0]), 0.25)
    assert found == pytest.approx([0.125, 0.25, 1.0, -1.0])
    assert found.dtype == np.float32
