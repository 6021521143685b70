"""The loops of disturbances against their laws for one vehicle in one world, and worlds that stand still."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from states import begun, disturbances, filled, lane_of, line, measured_in, still

from formation_env._jit import device
from formation_env.core import arrays
from formation_env.core.disturbing import over_table
from formation_env.maths.rng import GUST, POLICY, Four, normals
from formation_env.maths.so3 import IDENTITY, ZERO, Vector, add
from formation_env.memory import tiles
from formation_env.memory.records import LANES, flatten, size
from formation_env.physics.disturbances import (
    DISTURBANCES,
    Disturbance,
    Draws,
    Gust,
    Gusts,
    next_gust,
)
from formation_env.physics.quadrotor import Body
from formation_env.physics.sensors import Measured

(GUSTS,) = (one for one in DISTURBANCES if one.name == "gusts")
RESTING = Body(ZERO, ZERO, IDENTITY, ZERO)
WHO = 2


class Drag(NamedTuple):
    """Of a wind that begins to blow: parameters."""

    damping: float
    wind: Vector


class Wind(NamedTuple):
    """How much of the wind blows, and since when."""

    share: float
    ticks: float


@device
def is_damped(drag: Drag) -> bool:
    return drag.damping > 0.0


@device
def next_wind(before: Wind, body: Body, drag: Drag, tick: int, n: Four) -> Wind:
    return Wind(1.0 - 0.5 * (1.0 - before.share) + n[0] + n[3], 10.0 * before.ticks + tick)


@device
def drag_push(wind: Wind, body: Body, drag: Drag) -> Vector:
    s, w, v = drag.damping, drag.wind, body.v
    return (
        s * (wind.share * w[0] - v[0]),
        s * (wind.share * w[1] - v[1]),
        s * (wind.share * w[2] - v[2]),
    )


class Parameters(NamedTuple):
    """Of three disturbances."""

    drag: Drag
    gusts: Gusts
    squall: Gusts


class States(NamedTuple):
    """Of one vehicle."""

    drag: Wind
    gusts: Gust
    squall: Gust


class Place(NamedTuple):
    """A world with three disturbances, and other numbers around them."""

    before: float
    disturbances: Parameters
    after: int


TABLE = (
    Disturbance("drag", Drag, None, Wind, is_damped, None, next_wind, drag_push),
    GUSTS,
    GUSTS._replace(name="squall", draws=Draws(POLICY, common=True)),
)
ACTING = Parameters(Drag(0.25, (1.0, -2.0, 4.0)), Gusts(0.5, 0.3), Gusts(0.75, 0.1))


NOTHING = Parameters(Drag(0.0, (1.0, -2.0, 4.0)), Gusts(0.5, 0.0), Gusts(0.75, 0.0))
_OWN = len(tiles.LOOPS)
disturb_vehicle = over_table(TABLE, Place, States)
del tiles.LOOPS[_OWN:]  # the list is of the package's own loops, which other tests look at


class Numbers(NamedTuple):
    """Those of `States`."""

    drag: tuple[float, float]
    gusts: Vector
    squall: Vector


class Tile(NamedTuple):
    """What `disturb_vehicle` works on, with random numbers in it."""

    x: Any
    push: Any
    active: Any
    ticks: Any
    keys: Any
    draws: Any

    def disturb(self, parameters: Parameters) -> Tile:
        """The same after a call."""
        made = Tile(*(part.copy() for part in self))
        *given, draws = made
        disturb_vehicle(*given, WHO, line(Place(7.0, parameters, 3)), draws)
        return made

    def states(self, lane: int) -> States:
        """What disturbs the vehicle in one lane."""
        found = lane_of(self.x[size(Measured) * LANES :], Numbers, lane)
        return States(Wind(*found["drag"]), Gust(found["gusts"]), Gust(found["squall"]))


def tile(active: Any = None) -> Tile:
    """Any numbers, some worlds active or all alike."""
    draw = np.random.default_rng(5)
    return Tile(
        np.concatenate([filled(Measured, draw), filled(States, draw)]),
        draw.normal(size=3 * LANES),
        draw.integers(0, 2, LANES).astype(np.float64) if active is None else np.full(LANES, active),
        draw.integers(0, 2**40, LANES),
        draw.integers(0, 2**63, LANES).astype(np.uint64),
        draw.normal(size=16 * LANES).astype(np.float32),
    )


def push_in(x: Any, lane: int) -> Vector:
    """The push on the vehicle in one lane."""
    return tuple(x.reshape(3, LANES)[:, lane].tolist())


def alone(given: Tile, lane: int) -> tuple[States, Vector]:
    """The states in one lane a tick later, and the push, by the laws."""
    m, before, key = (
        measured_in(given.x[: size(Measured) * LANES], lane),
        given.states(lane),
        given.keys[lane],
    )
    body, tick, key = Body(m.p, m.v, m.q, m.w), int(given.ticks[lane]), given.keys[lane]
    drag, gusts, squall = ACTING
    wind = next_wind(before.drag, body, drag, tick, (0.0, 0.0, 0.0, 0.0))
    gust = next_gust(before.gusts, body, gusts, tick, normals(key, GUST, WHO, tick, 0))
    blow = next_gust(before.squall, body, squall, tick, normals(key, POLICY, 0, tick, 0))
    push = add(push_in(given.push, lane), drag_push(wind, body, drag))
    return States(wind, gust, blow), add(add(push, gust.a), blow.a)


def close(found: Any, expected: Any) -> None:
    np.testing.assert_allclose(flatten(found), flatten(expected), rtol=1e-12, atol=1e-12)


def test_in_each_lane_a_vehicle_is_disturbed_as_the_laws_have_it() -> None:
    """Each row with its own state, parameters and random numbers; their pushes are added.

    In worlds that do not step nothing changes.
    """
    before = tile()
    after = before.disturb(ACTING)
    assert 0 < before.active.sum() < LANES
    for lane in range(LANES):
        states, push = alone(before, lane)
        if before.active[lane] == 0.0:
            states, push = before.states(lane), push_in(before.push, lane)
        close(after.states(lane), states)
        close(push_in(after.push, lane), push)
    own = size(Measured) * LANES
    np.testing.assert_array_equal(after.x[:own], before.x[:own])


@pytest.mark.parametrize("name", Parameters._fields)
def test_a_row_that_does_not_act_does_nothing(name: str) -> None:
    """Nor is anything drawn unless a row that draws acts."""
    before = tile(1.0)
    after = before.disturb(NOTHING._replace(**{name: getattr(ACTING, name)}))
    for lane in range(LANES):
        states, _ = alone(before, lane)
        only = before.states(lane)._replace(**{name: getattr(states, name)})
        close(after.states(lane), only)
        assert only != before.states(lane)
    assert (name == "drag") == np.array_equal(after.draws, before.draws)
    assert all(map(np.array_equal, before, before.disturb(NOTHING)))


def test_gusts_go_on_in_the_worlds_that_step_and_nowhere_else() -> None:
    """By the law, from tick to tick: of each vehicle, with the key of the world's episode."""
    worlds = LANES + 3
    flight, draw = begun(worlds, gust=1.0, gust_time=0.2), np.random.default_rng(8)
    gusts = flight.config.world.disturbances.gusts
    keys = arrays.MEMORY.views(flight._memory)["episode_keys"].copy()
    vehicles = flight.config.followers + 1
    expected = np.zeros((2, vehicles, 3, LANES))
    ticks = np.zeros((2, LANES), int)
    for _ in range(4):
        stepping = draw.integers(0, 2, worlds).astype(bool)
        flight.step(still(flight), mask=stepping)
        for w in np.flatnonzero(stepping):
            t, lane = divmod(int(w), LANES)
            for i in range(vehicles):
                n = normals(keys[t, lane], GUST, i, ticks[t, lane], 0)
                before = Gust(tuple(expected[t, i, :, lane].tolist()))
                expected[t, i, :, lane] = next_gust(before, RESTING, gusts, 0, n).a
            ticks[t, lane] += 1
        np.testing.assert_allclose(disturbances(flight)["gusts"], expected, rtol=1e-12, atol=1e-12)
        pushes = arrays.ROOM.views(flight._rooms[0])["pushes"].reshape(vehicles, 3, LANES)
        on = np.zeros(LANES, bool)
        on[: worlds - LANES] = stepping[LANES:]
        if on.any():  # those of the last tile
            np.testing.assert_allclose(
                pushes, np.where(on, expected[1], 0.0), rtol=1e-12, atol=1e-12
            )
    assert (ticks.reshape(-1)[:worlds] > 0).sum() > 10
    assert not expected[1, :, :, worlds - LANES :].any(), "unused lanes"
