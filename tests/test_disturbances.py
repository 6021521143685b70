"""What pushes a vehicle: the gust against the process it is, and the sum over a table of two disturbances."""

from __future__ import annotations

from math import exp
from typing import Any, NamedTuple

import numpy as np
import pytest
from closed_loop import PROPERTY, numbers, vectors
from hypothesis import given
from scipy import stats

from formation_env import configure
from formation_env.laws import world
from formation_env.laws.world import World
from formation_env.maths import so3
from formation_env.maths.so3 import Vector
from formation_env.memory.records import fields, flatten, line_loader, line_storer, size
from formation_env.physics import disturbances
from formation_env.physics.disturbances import (
    DISTURBANCES,
    Disturbance,
    Gust,
    Gusts,
    States,
    blows,
    gust_push,
    next_gust,
    over_table,
    parameters,
)
from formation_env.physics.quadrotor import Body

BODY = Body((1.0, 2.0, -3.0), (0.5, -0.25, 0.125), so3.IDENTITY, so3.ZERO)
CALM = Gust(so3.ZERO)
(GUSTS,) = (one for one in DISTURBANCES if one.name == "gusts")


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
        before = next_gust(before, BODY, gusts, 77, 1, tick)
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


def test_each_vehicle_has_its_own_gust_and_without_strength_nothing_changes() -> None:
    gusts = Gusts(0.9, 0.3)
    drawn = {next_gust(CALM, BODY, gusts, key, who, 5) for key in (1, 2) for who in (0, 1)}
    assert len(drawn) == 4
    kept = next_gust(Gust((1.0, 2.0, 4.0)), BODY, Gusts(0.5, 0.0), 1, 1, 1)
    assert kept.a == (0.5, 1.0, 2.0)
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


class Drag(NamedTuple):
    """Of a wind that begins to blow: parameters."""

    damping: float
    wind: Vector


class Wind(NamedTuple):
    """How much of the wind blows."""

    share: float
    ticks: float


def drag_of(config: Any) -> Drag:
    return Drag(0.1 * config.gust, (config.gust, 0.0, 0.0))


def is_damped(drag: Drag) -> bool:
    return drag.damping > 0.0


def next_wind(before: Wind, body: Body, drag: Drag, key: int, who: int, tick: int) -> Wind:
    return Wind(1.0 - 0.5 * (1.0 - before.share), float(tick + 10 * who + 100 * key))


def drag_push(wind: Wind, body: Body, drag: Drag) -> Vector:
    s = wind.share
    return tuple(drag.damping * (s * drag.wind[k] - body.v[k]) for k in range(3))  # type: ignore[return-value]


class Both(NamedTuple):
    """The parameters of two disturbances."""

    drag: Drag
    gusts: Gusts


class Place(NamedTuple):
    """A world with a second disturbance, and other numbers around."""

    before: float
    disturbances: Both
    after: int


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The functions of a table of two, made as `world` makes those of the table, in plain Python."""
    table = (
        Disturbance("drag", Drag, drag_of, Wind, is_damped, next_wind, drag_push),
        GUSTS,
    )
    states: Any = NamedTuple("States", [(one.name, one.state) for one in table])  # type: ignore[misc]
    monkeypatch.setattr(disturbances, "DISTURBANCES", table)
    monkeypatch.setattr(disturbances, "States", states)
    monkeypatch.setattr(disturbances, "device", lambda function: function)
    arguments = "states, body, line"
    acts = over_table(Place, "acting", "line", "{acts}({parameters})", "either")
    advance = over_table(
        Place,
        "advanced",
        f"{arguments}, key, who, tick",
        "{advance}({state}, body, {parameters}, key, who, tick)",
        "States",
    )
    push = over_table(Place, "summed", arguments, "{push}({state}, body, {parameters})", "add")
    return states, acts, advance, push


def place(damping: float, kick: float) -> tuple[Place, Any]:
    """A world and the line of its numbers."""
    one = Place(7.0, Both(Drag(damping, (1.0, -2.0, 4.0)), Gusts(0.5, kick)), 3)
    numbers = np.zeros(size(Place))
    line_storer(Place)(numbers, one)
    np.testing.assert_array_equal(numbers, flatten(one))
    return one, numbers


@pytest.mark.parametrize("damping", [0.0, 0.25])
@pytest.mark.parametrize("kick", [0.0, 0.3])
def test_two_disturbances_act_if_one_does(two: Any, damping: float, kick: float) -> None:
    _, acts, _, _ = two
    assert bool(acts(place(damping, kick)[1])) == (damping > 0.0 or kick > 0.0)


def test_two_disturbances_move_on_each_with_its_own_state_and_parameters(two: Any) -> None:
    states, _, advance, push = two
    given, line = place(0.25, 0.3)
    before = states(Wind(0.5, -1.0), Gust((1.0, 2.0, 3.0)))
    after = advance(before, BODY, line, 5, 1, 7)
    assert (
        after.drag
        == next_wind(before.drag, BODY, given.disturbances.drag, 5, 1, 7)
        == Wind(0.75, 517.0)
    )
    assert after.gusts == next_gust(before.gusts, BODY, given.disturbances.gusts, 5, 1, 7)
    gust, drag = after.gusts.a, drag_push(after.drag, BODY, given.disturbances.drag)
    np.testing.assert_allclose(push(after, BODY, line), np.add(gust, drag), rtol=1e-15)


@PROPERTY
@given(vectors(3.0), numbers(2.0))
def test_the_table_of_a_world_is_that_of_its_laws(a: Vector, kick: float) -> None:
    """Of all that may disturb, `nominal` has nothing; here gusts."""
    gusts, constants = Gusts(0.8, kick), configure().world
    table = constants.disturbances._replace(gusts=gusts)
    line = np.array(flatten(constants._replace(disturbances=table)))
    states = all_of(States, 0.0)._replace(gusts=Gust(a))
    assert bool(world.disturbed(line)) == blows(gusts)
    assert world.next_states(states, BODY, line, 3, 1, 9).gusts == next_gust(
        states.gusts, BODY, gusts, 3, 1, 9
    )
    assert world.pushed(states, BODY, line) == a


@pytest.mark.parametrize("period", [0.01, 0.02])
def test_gusts_are_as_strong_whatever_the_control_period(period: float) -> None:
    """In the stationary process the variance is that of the configuration, the correlation exponential."""
    config = configure(control_period=period, gust=0.7, gust_time=0.4)
    gusts = parameters(config).gusts
    assert gusts.keep == pytest.approx(np.exp(-period / 0.4))
    assert gusts.kick**2 / (1.0 - gusts.keep**2) == pytest.approx(0.49)
    assert config.world.disturbances == parameters(config)
