"""What pushes a vehicle: the gust against the process it is, and what every row of the table has."""

from __future__ import annotations

from math import exp
from typing import Any

import numpy as np
import pytest
from closed_loop import PROPERTY, numbers, vectors
from hypothesis import given
from scipy import stats

from formation_env import configure
from formation_env.laws.world import World
from formation_env.maths import rng, so3
from formation_env.maths.rng import GUST, normals
from formation_env.maths.so3 import Vector
from formation_env.memory.records import fields, line_loader, size
from formation_env.physics.disturbances import (
    DISTURBANCES,
    Disturbance,
    Gust,
    Gusts,
    States,
    blows,
    gust_push,
    next_gust,
    parameters,
)
from formation_env.physics.quadrotor import Body

BODY = Body((1.0, 2.0, -3.0), (0.5, -0.25, 0.125), so3.IDENTITY, so3.ZERO)
CALM = Gust(so3.ZERO)


def all_of(kind: Any, number: float) -> Any:
    """A record all of whose numbers are this one."""
    return line_loader(kind)(np.full(size(kind), number))


# -- gusts ------------------------------------------------------------------------------------------------


def test_a_gust_is_a_gauss_markov_process() -> None:
    """Stationary with its standard deviation, and correlated by `keep` from tick to tick."""
    keep = exp(-0.2)
    gusts = Gusts(keep, 0.7 * np.sqrt(1.0 - keep**2))
    before, path = CALM, []
    for tick in range(4000):
        before = next_gust(before, BODY, gusts, tick, normals(77, GUST, 1, tick, 0))
        path.append(before.a)
    x = np.array(path[50:])
    np.testing.assert_allclose(x.std(axis=0), 0.7, rtol=0.1)
    np.testing.assert_allclose(np.mean(x[1:] * x[:-1], axis=0) / 0.49, keep, rtol=0.15)
    assert np.abs(np.corrcoef(x.T) - np.eye(3)).max() < 0.15
    kicks = (x[1:] - keep * x[:-1]) / gusts.kick  # white, standard normal
    for axis in range(3):
        assert stats.kstest(kicks[:, axis], "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(kicks.T) - np.eye(3)).max() < 0.06
    assert np.abs((kicks[1:] * kicks[:-1]).mean(axis=0)).max() < 0.06


@PROPERTY
@given(vectors(3.0), vectors(3.0), numbers(1e9))
def test_a_gust_is_of_three_numbers_one_for_each_axis(a: Vector, n: Vector, last: float) -> None:
    """Without strength what there is fades, and there are no gusts."""
    gusts = Gusts(0.5, 0.25)
    found = next_gust(Gust(a), BODY, gusts, 5, (*n, last)).a
    np.testing.assert_allclose(found, 0.5 * np.array(a) + 0.25 * np.array(n), rtol=0.0, atol=1e-15)
    faded = next_gust(Gust((1.0, 2.0, 4.0)), BODY, Gusts(0.5, 0.0), 1, (*n, last))
    assert faded.a == (0.5, 1.0, 2.0)
    assert blows(gusts)
    assert not blows(Gusts(0.9, 0.0))


@PROPERTY
@given(vectors(3.0))
def test_a_gust_is_the_acceleration_it_pushes_with(a: Vector) -> None:
    assert gust_push(Gust(a), BODY, Gusts(0.9, 0.3)) == a


# -- the table --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("one", DISTURBANCES, ids=lambda one: one.name)
def test_every_disturbance_has_parameters_in_a_world_and_a_state_that_begins_at_zero(
    one: Disturbance,
) -> None:
    """And starts with no push where its state is zero and the vehicle at rest."""
    given_by = fields(fields(World)["disturbances"])[one.name]
    assert given_by is one.parameters
    assert fields(States)[one.name] is one.state
    resting = Body(so3.ZERO, so3.ZERO, so3.IDENTITY, so3.ZERO)
    assert one.push(all_of(one.state, 0.0), resting, all_of(given_by, 0.5)) == so3.ZERO
    assert not one.acts(all_of(given_by, 0.0))


def test_no_two_rows_share_their_draws() -> None:
    """Nor are they those of anything else."""
    drawn = [one.draws.purpose for one in DISTURBANCES if one.draws is not None]
    others = {rng.START, rng.TRAJECTORY, rng.MEASUREMENT, rng.POLICY, rng.COURSE}
    assert len({*drawn} - others) == len(drawn) > 0


@pytest.mark.parametrize("period", [0.01, 0.02])
def test_gusts_are_as_strong_whatever_the_control_period(period: float) -> None:
    """In the stationary process the variance is that of the configuration, the correlation exponential."""
    config = configure(control_period=period, gust=0.7, gust_time=0.4)
    gusts = parameters(config).gusts
    assert gusts.keep == pytest.approx(np.exp(-period / 0.4))
    assert gusts.kick**2 / (1.0 - gusts.keep**2) == pytest.approx(0.49)
    assert config.world.disturbances == parameters(config)
