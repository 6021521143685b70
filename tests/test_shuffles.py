"""Numbers turned and copied in memory: what is compiled does what its Python twin says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from formation_env._jit import kernel, plain
from formation_env.memory import shuffles
from formation_env.memory.records import LANES
from formation_env.memory.shuffles import (
    carve,
    fetch,
    gather,
    reinterpret,
    scatter,
    turn_lines,
    turn_square,
)


@kernel
def _lines(source: Any, starts: Any, first: int, row: int, sink: Any) -> None:
    turn_lines(source, starts, first, row, sink)


@kernel
def _gather(lines: Any, starts: Any, tile: Any) -> None:
    gather(lines, starts, tile)


@kernel
def _square(source: Any, at: int, sink: Any, to: int, stride: int) -> None:
    turn_square(source, at, sink, to, stride)


@kernel
def _scatter(tile: Any, rows: int, sink: Any, to: int, stride: int, lanes: int) -> None:
    fetch(sink, to, stride)
    scatter(tile, rows, sink, to, stride, lanes)


@kernel
def _carve(flat: Any, start: int, rows: int, columns: int) -> Any:
    return carve(flat, start, (rows, columns)).sum(), carve(flat, start, (rows, columns))[1, 2]


@kernel
def _fill(flat: Any, start: int, count: int, value: float) -> None:
    view = carve(flat, start, (count,))
    for k in range(len(view)):
        view[k] = value


@kernel
def _integers(block: Any, sink: Any) -> int:
    view = reinterpret(block, np.int32)
    for k in range(len(view)):
        sink[k] = view[k]
    return len(view)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_lines_become_rows(kind: type) -> None:
    draw = np.random.default_rng(0)
    lines = draw.normal(size=1000).astype(kind)
    starts = draw.integers(0, 1000 - LANES, LANES)
    tile = np.zeros(LANES * LANES, kind)
    _gather(lines, starts, tile)
    expected = lines[starts[None, :] + np.arange(LANES)[:, None]]
    np.testing.assert_array_equal(tile.reshape(LANES, LANES), expected)


def test_a_square_of_lines_lands_where_it_belongs_and_nowhere_else() -> None:
    draw = np.random.default_rng(1)
    lines, starts = draw.normal(size=500), draw.integers(0, 400, LANES)
    for first, row in ((0, 0), (8, 0), (0, 8), (8, 8)):
        found, expected = np.zeros(LANES * LANES), np.zeros(LANES * LANES)
        _lines(lines, starts, first, row, found)
        turn_lines(lines, starts, first, row, expected)
        np.testing.assert_array_equal(found, expected)
        assert np.count_nonzero(found) == 64


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_square_of_rows_becomes_lines_and_nothing_else(kind: type) -> None:
    """Of a vector's worth of lanes and rows, wherever they begin, against the Python twin."""
    source = np.random.default_rng(5).normal(size=40 * LANES).astype(kind)
    width = 64 // source.itemsize
    for at, to, stride in ((0, 0, width), (3 * LANES + 0, 5, 23), (LANES, 1, 31)):
        found, expected = np.zeros(1000, kind), np.zeros(1000, kind)
        _square(source, at, found, to, stride)
        turn_square(source, at, expected, to, stride)
        np.testing.assert_array_equal(found, expected)
        assert np.count_nonzero(found) == width * width
        j, k = np.meshgrid(np.arange(width), np.arange(width), indexing="ij")
        np.testing.assert_array_equal(found[to + j * stride + k], source[at + k * LANES + j])


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("count", [16, 17, 23, 34, 50])
@pytest.mark.parametrize("lanes", [1, 5, 15, LANES])
def test_rows_are_scattered_to_the_lines_of_as_many_worlds(
    kind: type, count: int, lanes: int
) -> None:
    """Each number once where it belongs, the lines of other worlds and what lies between untouched."""
    tile = np.random.default_rng(6).normal(size=count * LANES).astype(kind)
    stride, to = count + 3, 7
    sink = np.full(to + LANES * stride + 9, 7.0, kind)
    expected = sink.copy()
    _scatter(tile, count, sink, to, stride, lanes)
    for lane in range(lanes):
        first = to + lane * stride
        expected[first : first + count] = tile.reshape(count, LANES)[:, lane]
    np.testing.assert_array_equal(sink, expected)


def test_a_view_is_in_place_and_of_the_shape_asked_for() -> None:
    flat = np.arange(40.0)
    for view in (_carve, plain(_carve)):
        assert view(flat, 5, 3, 4) == (flat[5:17].sum(), flat[11])
    _fill(flat, 3, 5, -1.0)
    np.testing.assert_array_equal(flat, [0.0, 1.0, 2.0, *[-1.0] * 5, *range(8, 40)])


def test_memory_is_read_as_numbers_of_another_kind() -> None:
    block = np.array([1.5, -2.25, 1e300])
    found = np.zeros(6, np.int64)
    assert _integers(block, found) == 6
    np.testing.assert_array_equal(found, block.view(np.int32))


# -- the loops that move numbers -----------------------------------------------------------------------


def test_rows_are_copied_where_they_are_asked_for() -> None:
    source, sink = np.arange(1.0, 6.0 * LANES + 1.0), np.zeros(7 * LANES)
    shuffles.copy(source, 2, sink, 3, 2)
    expected = np.zeros((7, LANES))
    expected[3:5] = source.reshape(6, LANES)[2:4]
    np.testing.assert_array_equal(sink.reshape(7, LANES), expected)


@pytest.mark.parametrize("count", [0, 1, 7, 33])
def test_numbers_are_copied_where_they_are_asked_for(count: int) -> None:
    source, sink = np.arange(1.0, 41.0), np.zeros(50)
    shuffles.copy_numbers(source, sink, 5, count)
    expected = np.zeros(50)
    expected[5 : 5 + count] = source[:count]
    np.testing.assert_array_equal(sink, expected)


def test_lanes_that_are_not_active_are_restored() -> None:
    draw = np.random.default_rng(7)
    saved, sink = draw.normal(size=(9, LANES)), draw.normal(size=(5, LANES))
    active = draw.integers(0, 2, LANES).astype(float)
    expected = sink.copy()
    expected[:3] = np.where(active > 0.0, sink[:3], saved[4:7])
    shuffles.restore(saved.ravel(), 4, sink.ravel(), 3, active)
    np.testing.assert_array_equal(sink, expected)


def test_a_row_is_cleared() -> None:
    row = np.array([1.0, np.nan, -np.inf, 7.0] * 8)
    shuffles.clear(row)
    np.testing.assert_array_equal(row, np.zeros(32))


@pytest.mark.parametrize("count", [1, 8, 100])
def test_finite_numbers_are_counted(count: int) -> None:
    draw = np.random.default_rng(8)
    numbers = draw.normal(size=count).astype(np.float32)
    numbers[::3] = draw.choice([np.nan, np.inf, -np.inf], len(numbers[::3]))
    assert shuffles.count_finite(numbers) == np.isfinite(numbers).sum()


def test_actions_are_clipped() -> None:
    """One entry of each world, to a row of those of one follower."""
    draw = np.random.default_rng(9)
    for first, stride, row in ((0, 6, 0), (2, 7, 3)):
        actions = draw.uniform(-2.0, 2.0, first + LANES * stride).astype(np.float32)
        actions[first], actions[first + stride] = np.inf, -np.inf
        executed = np.full(4 * LANES, 7.0)
        shuffles.take_clipped(actions, first, stride, executed, row)
        expected = np.full((4, LANES), 7.0)
        expected[row] = np.clip(actions[first::stride][:LANES].astype(np.float64), -1.0, 1.0)
        np.testing.assert_array_equal(executed.reshape(4, LANES), expected)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("to", [0, 1, 5, 15])
def test_streamed_numbers_arrive_and_no_others_are_written(kind: type, to: int) -> None:
    source = np.random.default_rng(to).normal(size=100).astype(kind)
    sink = np.full(140, -7.0, kind)
    shuffles.stream(source, sink, to, 97)
    shuffles.drain()
    np.testing.assert_array_equal(sink[to : to + 97], source[:97])
    assert np.all(sink[:to] == -7.0)
    assert np.all(sink[to + 97 :] == -7.0)
