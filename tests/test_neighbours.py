"""Separations and neighbours in a tile against NumPy over all pairs: of few vehicles, of two, and of many."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from states import begun, filled, lane_of, measured_in

from formation_env.core import arrays, neighbours
from formation_env.core.arrays import Squares, rows
from formation_env.core.neighbours import MOST_PAIRWISE
from formation_env.core.simulation import Simulation
from formation_env.laws.levels import Follower
from formation_env.memory.records import LANES, bounds, flatten, size
from formation_env.physics.sensors import Measured, Noise
from formation_env.task import Neighbour, Passing, observe_neighbour

# Without the compiler NumPy tells of infinity minus infinity, and of squares that overflow.
pytestmark = pytest.mark.filterwarnings(
    "ignore:(invalid value|overflow|divide by zero) encountered:RuntimeWarning"
)

Floats = npt.NDArray[np.float64]
MANY = MOST_PAIRWISE + 2
HERE = LANES - 3  # worlds in the tile: three lanes are unused


def scene(followers: int, seen: int, **options: Any) -> tuple[Simulation, Any, Any]:
    """Vehicles scattered on a coarse grid, so that many distances are equal; noisy ones as measured too."""
    flight = begun(HERE, "nominal", followers=followers, neighbours=seen, **options)
    draw = np.random.default_rng(followers + 10 * seen)
    state = arrays.MEMORY.views(flight._memory)
    for name in ("vehicles", "samples"):
        for x in state[name].reshape(-1, state[name].shape[-1])[:, : size(Measured) * LANES]:
            x[:] = filled(Measured, draw)
        place = rows(state[name], Measured)["p"]
        place[:] = draw.integers(0, 4, place.shape) * 0.5
    for x in state["followers"].reshape(-1, state["followers"].shape[-1]):
        x[: size(Follower) * LANES] = filled(Follower, draw)
    return flight, flight._memory, flight._rooms[0]


def measured(flight: Simulation) -> Floats:
    """Positions of the followers as measured, `(followers, 3, L)`."""
    state = flight._state
    if state.samples.size:
        return rows(state.samples, Measured)["p"][0, 1:, 0]  # type: ignore[no-any-return]
    return rows(state.vehicles, Measured)["p"][0, 1:]  # type: ignore[no-any-return]


def nearest(p: Floats, i: int, lane: int) -> list[int]:
    """The others of a follower by distance, of equally far ones the smaller number first."""
    square = ((p[:, :, lane] - p[i, :, lane]) ** 2).sum(axis=1)
    return sorted((j for j in range(len(p)) if j != i), key=lambda j: (square[j], j))


@pytest.mark.parametrize("seen", [1, 2, 3, 5])
@pytest.mark.parametrize("noisy", [False, True])
def test_the_neighbours_of_few_are_the_nearest(seen: int, noisy: bool) -> None:
    """As many as there are; what is measured counts, not the truth."""
    flight, memory, room = scene(4, seen, **_noise(noisy))
    p = measured(flight)
    found = arrays.ROOM.views(room)["neighbours"]
    for i in range(4):
        neighbours.find_neighbours_of_few(memory, room, 0, i)
        for lane in range(LANES):
            expected = nearest(p, i, lane)[:seen]
            assert found[i, : len(expected), lane].tolist() == expected


@pytest.mark.parametrize("seen", [1, 2, 3])
@pytest.mark.parametrize("noisy", [False, True])
def test_the_neighbours_of_many_are_the_nearest(seen: int, noisy: bool) -> None:
    flight, memory, room = scene(MANY, seen, **_noise(noisy))
    p = measured(flight)
    neighbours.find_neighbours_of_many(memory, room, 0, HERE)
    found = arrays.ROOM.views(room)["neighbours"]
    for i in range(MANY):
        for lane in (0, 5, HERE - 1):
            assert found[i, :, lane].tolist() == nearest(p, i, lane)[:seen]


def _noise(noisy: bool) -> dict[str, Any]:
    return {"noise": Noise(0.1, 0.1, 0.1, 0.1, 0.1)} if noisy else {}


def test_few_are_not_searched_as_many() -> None:
    _, memory, room = scene(4, 2)
    found = arrays.ROOM.views(room)["neighbours"]
    found[:] = 7.0
    neighbours.find_neighbours_of_many(memory, room, 0, HERE)
    assert (found == 7.0).all()


@pytest.mark.parametrize("followers", [1, 2, 5, MANY])
def test_separations_are_the_least_distances_to_others(followers: int) -> None:
    """Of the true positions; the leader is one of the others, which `locate` has looked at already of few."""
    flight, memory, room = scene(followers, 1, **_noise(True))
    p = rows(flight._state.vehicles, Measured)["p"][0]
    squares = rows(arrays.ROOM.views(room)["squares"], Squares)["separation"][:, 0]
    e = p[:, None] - p[None, 1:]
    apart = (e**2).sum(axis=2)  # (vehicles, followers, L)
    squares[:] = apart[0]
    for i in range(followers):
        apart[i + 1, i] = np.inf
    if followers > MOST_PAIRWISE:
        squares[:] = -1.0
        neighbours.separate_many(memory, room, 0, HERE)
    else:
        for i in range(followers):
            neighbours.approach_others(memory, room, 0, i)
    np.testing.assert_allclose(squares[:, :HERE], apart.min(axis=0)[:, :HERE], rtol=1e-14)


@pytest.mark.parametrize(("followers", "seen"), [(1, 2), (2, 1), (2, 3), (4, 2), (4, 5), (MANY, 2)])
def test_a_follower_is_shown_its_neighbours_nearest_first(followers: int, seen: int) -> None:
    """In the last rows of its observation; what comes before, and rows of none, stay as they are."""
    flight, memory, room = scene(followers, seen, **_noise(True))
    p, state = measured(flight), flight._state
    shown = arrays.ROOM.views(room)["observation"]
    shown[:] = 7.0
    neighbours.find_neighbours_of_many(memory, room, 0, HERE)
    limits, count = np.array(bounds(Neighbour)), min(seen, followers - 1)
    for i in range(min(followers, 3)):
        neighbours.show_neighbours(memory, room, 0, i)
        tail = shown.reshape(-1, LANES)[-seen * size(Neighbour) :].reshape(seen, -1, LANES)
        for lane in (0, 6, HERE - 1):
            known = lane_of(state.followers[0, i], Follower, lane)
            own = measured_in(state.samples[0, i + 1, 0], lane)
            order = nearest(p, i, lane)
            for rank in range(count):
                other = measured_in(state.samples[0, order[rank] + 1, 0], lane)
                pair = Passing(own.p, own.v), Passing(other.p, other.v)
                wanted = flatten(observe_neighbour(*pair, complex(*known["estimate"]), True))
                expected = np.clip(wanted, -limits, limits)
                np.testing.assert_allclose(tail[rank, :, lane], expected, 2e-6, 2e-6)
    untouched = shown.reshape(-1, LANES)
    assert (tail[count:] == 7.0).all()
    assert (untouched[: len(untouched) - seen * size(Neighbour)] == 7.0).all()


def test_where_there_is_no_neighbour_zeros_are_shown() -> None:
    """Of a follower that cannot be computed: it is no other's neighbour, and has none."""
    flight, memory, room = scene(MANY, 2)
    rows(flight._state.vehicles, Measured)["p"][0, 3, :, 4] = np.nan
    neighbours.find_neighbours_of_many(memory, room, 0, HERE)
    found = arrays.ROOM.views(room)["neighbours"]
    assert (found[2, :, 4] == -1.0).all()
    assert (found[:, :, 4] != 2.0).all()
    neighbours.show_neighbours(memory, room, 0, 2)
    tail = arrays.ROOM.views(room)["observation"].reshape(-1, LANES)[-2 * size(Neighbour) :]
    assert not tail[:, 4].any()
    assert tail[:, 5].any()


def test_a_neighbour_of_none_is_fetched_as_the_follower_itself() -> None:
    """Numbers that can be computed with, which the view then sets to zero."""
    flight, memory, room = scene(4, 2)
    views = arrays.ROOM.views(room)
    views["neighbours"][1, 0] = np.where(np.arange(LANES) % 2 == 0, -1.0, 3.0)
    neighbours.fetch_neighbour(memory, room, 0, 1, 0)
    found = rows(views["other"][: size(Passing) * LANES], Passing)
    state = rows(flight._state.vehicles, Measured)
    for name in Passing._fields:
        np.testing.assert_array_equal(found[name][:, ::2], state[name][0, 2, :, ::2])
        np.testing.assert_array_equal(found[name][:, 1::2], state[name][0, 4, :, 1::2])
