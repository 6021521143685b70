"""Numbers turned, copied and streamed in memory: what is compiled does what its Python twin says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from formation_env.blocks import (
    LANES,
    drain,
    fetch,
    gather,
    offset,
    stream,
    stream_line,
    turn_fours,
    turn_lines,
)
from numba import config as numba

from formation_env import kernels
from formation_env._jit import kernel
from formation_env.config import FormationConfig
from formation_env.scenarios import configure
from formation_env.simulation import Simulation


@kernel
def _lines(source: Any, starts: Any, first: int, row: int, sink: Any) -> None:
    turn_lines(source, starts, first, row, sink)


@kernel
def _gather(lines: Any, starts: Any, tile: Any) -> None:
    gather(lines, starts, tile)


@kernel
def _fours(source: Any, at: int, stride: int, sink: Any) -> None:
    turn_fours(source, at, stride, sink)


@kernel
def _stream(source: Any, sink: Any, to: int, count: int) -> None:
    fetch(sink, to, count)
    stream(source, sink, to, count)
    drain()


@kernel
def _offset(block: Any) -> int:
    return offset(block)


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


@pytest.mark.parametrize(("at", "stride"), [(0, 4), (4, 8), (7, 13)])
def test_four_numbers_of_each_lane_become_rows(at: int, stride: int) -> None:
    source = np.random.default_rng(2).normal(size=at + LANES * stride).astype(np.float32)
    sink = np.zeros(4 * LANES, np.float32)
    _fours(source, at, stride, sink)
    expected = source[at + np.arange(LANES)[None, :] * stride + np.arange(4)[:, None]]
    np.testing.assert_array_equal(sink.reshape(4, LANES), expected)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("count", [0, 1, 7, 8, 16, 33, 200])
def test_what_is_streamed_arrives_wherever_lines_begin(kind: type, count: int) -> None:
    source = np.random.default_rng(3).normal(size=count).astype(kind)
    memory = np.zeros(400, kind)
    for start in range(20):
        block = memory[start : start + 300]
        for to in (0, 3, 40):
            memory[:] = 0.0
            _stream(source, block, to, count)
            expected = np.zeros(400, kind)
            expected[start + to : start + to + count] = source
            np.testing.assert_array_equal(memory, expected)


def test_a_line_of_numbers_is_copied() -> None:
    source, sink = np.arange(16.0), np.zeros(16)
    stream_line(source, 2, sink, 8)
    np.testing.assert_array_equal(sink, [*np.zeros(8), *np.arange(2.0, 10.0)])


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_offsets_are_those_of_the_address(kind: type) -> None:
    memory = np.zeros(64, kind)
    for start in range(20):
        block = memory[start:]
        assert _offset(block) == offset(block)
        size = block.itemsize
        assert (block.ctypes.data - _offset(block) * size) % 64 == 0


@pytest.mark.skipif(
    bool(numba.DISABLE_JIT), reason="Python streams nothing, and would take minutes"
)
@pytest.mark.parametrize(
    ("followers", "worlds", "threads"),
    [(2, 12_293, 1), (2, 12_293, 2), (9, 2_501, 1), (33, 701, 2)],
)
def test_streamed_results_are_the_same(followers: int, worlds: int, threads: int) -> None:
    """Of so many worlds they go past the cache; of the same worlds in smaller groups they do not."""
    config = configure("agile", followers=followers)
    shape = (worlds, followers, config.action_size)
    assert worlds * followers * (4 * config.layout.size + 104) > kernels._STREAMED
    actions = np.random.default_rng(4).uniform(-1.0, 1.0, (6, *shape)).astype(np.float32)
    groups = [range(200), range(worlds - 37, worlds)]
    whole = _flown(config, range(worlds), actions, threads)
    for group in groups:
        part = _flown(config, group, actions[:, group], 1)
        for one, other in zip(whole, part, strict=True):
            for a, b in zip(one, other, strict=True):
                rows = a[..., group] if a.shape == (3, worlds) else a[group]
                np.testing.assert_array_equal(rows, b)


def _flown(config: FormationConfig, worlds: range, actions: Any, threads: int) -> list[Any]:
    """Results of some steps that also return the last observations of episodes that end."""
    group = Simulation(config, len(worlds), threads, max_steps=4)
    for i, key in enumerate(worlds):
        group.seed(i, key)
    group.reset()
    results = [group.step(np.ascontiguousarray(row), kernels.STEP_AND_RESET) for row in actions]
    group.close()
    return results
