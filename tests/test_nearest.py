"""The sweep against trying every pair, and against SciPy's tree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from formation_env import formations
from formation_env._jit import kernel
from formation_env.core.nearest import (
    BLOCK,
    MARGIN,
    MEETING_ROWS,
    QUEUE_ROWS,
    SEEKER_ROWS,
    find_nearest,
    found_number,
    found_square,
    number_at,
    put_in_order,
)
from formation_env.maths.so3 import dot, sub

# Without the compiler NumPy tells of infinity minus infinity, and of squares that overflow.
pytestmark = pytest.mark.filterwarnings(
    "ignore:(invalid value|overflow|divide by zero) encountered:RuntimeWarning"
)


@kernel
def _nearest(points: Any, room: Any, K: int, squares: Any, numbers: Any) -> None:
    m = len(points)
    cells, ends, queue, seekers, meeting = room
    axis = put_in_order(cells, ends, queue, points, m)
    for first in range(0, m, BLOCK):
        find_nearest(queue, seekers, meeting, axis, m, first, K)
        for k in range(min(BLOCK, m - first)):
            i = number_at(queue, first + k)
            for rank in range(squares.shape[1]):
                squares[i, rank] = found_square(seekers, k, rank)
                numbers[i, rank] = found_number(seekers, k, rank)


@kernel
def _every_pair(points: Any, squares: Any, numbers: Any) -> None:
    """All pairs with the fused operations of the sweep, kept by distance and then by number."""
    for i in range(len(points)):
        for j in range(len(points)):
            a, b = points[j], points[i]
            e = sub((a[0], a[1], a[2]), (b[0], b[1], b[2]))
            r, number = dot(e, e), j
            if i == j:
                continue
            for rank in range(squares.shape[1]):
                held, holder = squares[i, rank], numbers[i, rank]
                if r < held or (r == held and number < holder):
                    squares[i, rank], r = r, squares[i, rank]
                    numbers[i, rank], number = number, numbers[i, rank]


def room_for(m: int, k: int) -> tuple[Any, ...]:
    """The arrays that the search works in, for `m` points and `k` nearest; full of what it must not read."""
    return (
        np.full(m, -(10**9)),
        np.full(m + 1, -(10**9)),
        np.full((QUEUE_ROWS, m + 2 * MARGIN), np.nan),
        np.full((SEEKER_ROWS + 2 * max(k, 2)) * BLOCK, np.nan),
        np.full(MEETING_ROWS * BLOCK, np.nan),
    )


def nearest(points: Any, k: int, room: Any = None) -> tuple[Any, Any]:
    """Squared distances and numbers of the `k` nearest others, `(m, k)`, from the sweep."""
    m = len(points)
    squares, numbers = np.empty((m, max(k, 1))), np.empty((m, max(k, 1)), np.int64)
    room = room_for(m, k) if room is None else room
    _nearest(np.ascontiguousarray(points, dtype=float), room, k, squares, numbers)
    return squares, numbers


def in_the_same_arithmetic(points: Any, k: int) -> tuple[Any, Any]:
    """The same from all pairs, bit for bit."""
    squares, numbers = np.full((len(points), k), np.inf), np.full((len(points), k), -1)
    _every_pair(np.ascontiguousarray(points, dtype=float), squares, numbers)
    return squares, numbers


def every_pair(points: Any, k: int) -> tuple[Any, Any]:
    """The same from all pairs, ordered by distance and then by number."""
    e = points[:, None] - points[None]
    squares = e[..., 0] ** 2 + e[..., 1] ** 2 + e[..., 2] ** 2
    np.fill_diagonal(squares, np.inf)
    numbers = np.argsort(squares, axis=1, kind="stable")[:, :k]
    return np.take_along_axis(squares, numbers, axis=1), numbers


CROWDS: dict[str, Any] = {
    "cloud": lambda draw: draw.normal(size=(300, 3)),
    "flat": lambda draw: draw.uniform(size=(200, 3)) * [40.0, 30.0, 0.0],
    "line": lambda draw: np.outer(np.arange(100.0), [1.0, 0.5, 0.0]),
    "upright": lambda draw: np.outer(draw.permutation(64) * 1.0, [0.0, 0.0, -0.3]),
    "cluster and one far away": lambda draw: np.vstack([draw.normal(size=(80, 3)), [1e4, 0, 0]]),
    "all in one place": lambda draw: np.ones((50, 3)),
    "two": lambda draw: np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]),
    "wedge": lambda draw: np.array(formations.wedge(256)),
    "lattice": lambda draw: np.stack(np.mgrid[:9, :9, :3], axis=-1).reshape(-1, 3) * 1.0,
}


@pytest.mark.parametrize("name", CROWDS)
@pytest.mark.parametrize("k", [1, 2, 5])
def test_it_finds_what_trying_every_pair_finds(name: str, k: int) -> None:
    """Ties included: on a lattice nearly all distances are equal to others."""
    points = CROWDS[name](np.random.default_rng(1))
    here = min(k, len(points) - 1)
    squares, numbers = nearest(points, k)
    expected, others = every_pair(points, here)
    np.testing.assert_allclose(squares[:, :here], expected, rtol=1e-14)
    if name not in ("line", "wedge"):  # there ties are decided by rounding
        np.testing.assert_array_equal(numbers[:, :here], others)
    assert (numbers[:, here:] == -1).all()
    assert np.isinf(squares[:, here:]).all()


def test_it_finds_what_a_tree_finds() -> None:
    points = np.random.default_rng(2).uniform(-50.0, 50.0, (500, 3)) * [1.0, 1.0, 0.02]
    squares, numbers = nearest(points, 3)
    distance, others = KDTree(points).query(points, 4)
    np.testing.assert_allclose(np.sqrt(squares), distance[:, 1:], rtol=1e-12)
    np.testing.assert_array_equal(numbers, others[:, 1:])


@settings(deadline=None, max_examples=200)
@given(
    st.lists(st.tuples(*[st.integers(-4, 4)] * 3), min_size=2, max_size=40),
    st.tuples(*[st.sampled_from([0.0, 2.0**-10, 1.0, 2.0**20])] * 3),
)
def test_whatever_the_shape(places: list[tuple[int, int, int]], scale: Any) -> None:
    """Coordinates from few values, so that many coincide."""
    points = np.array(places) * np.array(scale)
    squares, numbers = nearest(points, 2)
    here = min(2, len(points) - 1)
    expected, others = every_pair(points, here)
    np.testing.assert_array_equal(squares[:, :here], expected)
    np.testing.assert_array_equal(numbers[:, :here], others)


def with_some_lost(draw: Any) -> Any:
    points = draw.normal(size=(150, 3))
    points[::7] = np.nan
    points[3, 0], points[50, 1], points[80, 2], points[81] = np.inf, -np.inf, np.nan, -np.inf
    return points


def on_a_grid(m: int) -> Any:
    return lambda draw: draw.integers(0, 6, (m, 3)) * 0.7


def at_random(m: int) -> Any:
    return lambda draw: draw.normal(size=(m, 3))


HARD: dict[str, Any] = {
    **CROWDS,
    **{f"{m} on a grid": on_a_grid(m) for m in (2, 15, 16, 17)},
    **{f"{m} at random": at_random(m) for m in (31, 33, 64, 300)},
    "some lost": with_some_lost,
    "all lost": lambda draw: np.full((40, 3), np.nan),
    "one left": lambda draw: np.vstack([np.full((40, 3), np.nan), [[1.0, 2.0, 3.0]]]),
    "too far for squares": lambda draw: draw.normal(size=(60, 3)) * 1e200,
    "too close for squares": lambda draw: draw.normal(size=(60, 3)) * 1e-200,
    "sorted backwards": lambda draw: -np.sort(draw.normal(size=(120, 3)), axis=0),
    "two camps": lambda draw: draw.normal(size=(100, 3)) + 1e9 * (np.arange(100) % 2)[:, None],
    "far from the origin": lambda draw: draw.normal(size=(100, 3)) * 1e-3 + 1e6,
}


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("k", [0, 1, 2, 3, 7])
def test_to_the_last_bit(name: str, k: int) -> None:
    """Without numbers, of two in registers, of any number: the ones all pairs give, ties included."""
    points = HARD[name](np.random.default_rng(4))
    squares, numbers = nearest(points, k)
    expected, others = in_the_same_arithmetic(points, max(k, 1))
    np.testing.assert_array_equal(squares, expected)
    if k > 0:
        np.testing.assert_array_equal(numbers, others)


def test_what_the_room_held_before_changes_nothing() -> None:
    """Of points that moved, of others, and backwards."""
    draw = np.random.default_rng(5)
    room = room_for(90, 3)
    first = np.round(draw.normal(size=(90, 3)), 1)
    for points in (first, first + 0.1, draw.normal(size=(90, 3)), -first):
        found, expected = nearest(points, 3, room), nearest(points, 3)
        np.testing.assert_array_equal(found[0], expected[0])
        np.testing.assert_array_equal(found[1], expected[1])


def test_a_point_that_is_not_finite_is_no_neighbour() -> None:
    points = np.random.default_rng(3).normal(size=(60, 3))
    points[7], points[20, 1] = np.nan, np.inf
    squares, numbers = nearest(points, 2)
    sound = np.setdiff1d(np.arange(60), [7, 20])
    assert (numbers[[7, 20]] == -1).all()
    _, others = every_pair(points[sound], 2)
    np.testing.assert_array_equal(numbers[sound], sound[others])
    assert np.isfinite(squares[sound]).all()
