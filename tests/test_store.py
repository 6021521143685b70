"""Arrays in one flat piece of memory: where they lie, their lengths, and what compiled code sees."""

from __future__ import annotations

from math import prod
from typing import Any, NamedTuple

import numpy as np
import pytest
from states import compiled

from formation_env import configure
from formation_env._jit import kernel, plain
from formation_env.core import arrays
from formation_env.core.simulation import Simulation
from formation_env.memory.store import Store, size_reader


class Lengths(NamedTuple):
    """Sizes, two of which no shape depends on."""

    rows: int
    columns: int
    flag: int
    depth: int


STORE = Store(Lengths)
plane = STORE.field("plane", lambda z: (z.rows, z.columns))
line = STORE.field("line", lambda z: (2 * z.columns,))
cube = STORE.field("cube", lambda z: (z.depth, z.rows, z.columns))
singles = STORE.field("singles", lambda z: (z.rows, 2 * z.columns), np.float32)
whole = STORE.field("whole", lambda z: (z.rows + 1,), np.int64)
signs = STORE.field("signs", lambda z: (z.rows, 16), np.bool_)
four = STORE.field("four", lambda z: (2, z.depth, z.rows, z.columns), np.uint64)
VIEWS = {"plane": plane, "line": line, "cube": cube, "singles": singles, "whole": whole,
         "signs": signs, "four": four}  # fmt: skip
KINDS = {"singles": np.float32, "whole": np.int64, "signs": np.bool_, "four": np.uint64}
COMPILED = {name: compiled(view) for name, view in VIEWS.items()}
SIZES = Lengths(rows=3, columns=5, flag=9, depth=4)
read_rows, read_flag = size_reader(Lengths, "rows"), size_reader(Lengths, "flag")


def row(name: str, memory: Any, *indices: int) -> Any:
    """A view as compiled code has it, and as Python has it; both in place."""
    found = VIEWS[name](memory, *indices)
    again = COMPILED[name](memory, *indices)
    np.testing.assert_array_equal(again, found)
    assert again.dtype == found.dtype
    assert again.ctypes.data == found.ctypes.data
    return found


@pytest.mark.parametrize("name", VIEWS)
def test_arrays_have_their_shape_and_kind_and_are_zero(name: str) -> None:
    memory = STORE.allocate(SIZES)
    found = STORE.views(memory)[name]
    assert found.shape == STORE.fields[name].shape(SIZES)
    assert found.dtype == KINDS.get(name, np.float64)
    assert not found.any()


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("sizes", [SIZES, Lengths(1, 1, 0, 1), Lengths(4, 7, 1, 2)])
def test_every_row_is_the_one_of_the_view(name: str, sizes: Lengths) -> None:
    """By all indices but the last: the strides are those of the shape."""
    memory = STORE.allocate(sizes)
    views = STORE.views(memory)
    for k, array in enumerate(views.values()):
        array[...] = (np.arange(array.size).reshape(array.shape) + 1000 * k) % 2**20
    array = views[name]
    for indices in np.ndindex(array.shape[:-1]):
        found = row(name, memory, *indices)
        assert found.dtype == array.dtype
        np.testing.assert_array_equal(found, array[indices])


def test_arrays_lie_one_behind_the_other_and_nowhere_overlap() -> None:
    """Filled one by one each leaves the others as they were, and together they are all the memory."""
    memory = STORE.allocate(SIZES)
    views = STORE.views(memory)
    words = sum(prod(a.shape) * a.itemsize for a in views.values()) // 8
    head = len(Lengths._fields) + sum(len(one.shape(SIZES)) + 1 for one in STORE.fields.values())
    assert len(memory) == head + words
    before = memory.copy()
    for name, array in views.items():
        array[...] = 1
        others = [other for one, other in views.items() if one != name]
        assert not any(other.any() for other in others)
        array[...] = 0
    np.testing.assert_array_equal(memory.view(np.int64), before.view(np.int64))


def test_views_are_in_place() -> None:
    memory = STORE.allocate(SIZES)
    for name, array in STORE.views(memory).items():
        index = tuple(length - 1 for length in array.shape[:-1])
        row(name, memory, *index)[-1] = 1
        assert array[(*index, -1)] == 1
        assert np.count_nonzero(array) == 1


@kernel
def _fill(memory: Any, row: int, column: int) -> Any:
    plane(memory, row)[column] = 2.5
    whole(memory)[row] = 7
    return read_rows(memory) * 100 + read_flag(memory)


def test_compiled_code_writes_in_place_and_reads_sizes() -> None:
    memory = STORE.allocate(SIZES)
    assert _fill(memory, 2, 3) == 309
    views = STORE.views(memory)
    assert np.argwhere(views["plane"]).tolist() == [[2, 3]]
    assert views["whole"].tolist() == [0, 0, 7, 0]
    assert views["plane"][2, 3] == 2.5


def test_sizes_are_read_and_those_of_no_shape_set() -> None:
    memory = STORE.allocate(SIZES)
    assert STORE.sizes(memory) == SIZES
    assert plain(read_rows)(memory) == 3
    assert plain(read_flag)(memory) == 9
    STORE.set_size(memory, "flag", 2**40)
    assert STORE.sizes(memory) == SIZES._replace(flag=2**40)
    assert plain(read_flag)(memory) == 2**40
    assert not any(array.any() for array in STORE.views(memory).values())


def test_what_does_not_fill_words_is_refused() -> None:
    store = Store(Lengths)
    store.field("odd", lambda z: (z.columns,), np.float32)
    with pytest.raises(TypeError, match=r"5 numbers of float32: expected whole words of 8 bytes"):
        store.allocate(SIZES)


@pytest.mark.parametrize("scenario", ["nominal", "paper", "agile"])
def test_a_simulation_has_the_arrays_that_are_declared(scenario: str) -> None:
    flight = Simulation(configure(scenario), 19)
    views = arrays.MEMORY.views(flight._memory)
    assert set(arrays.State._fields) | set(arrays.CONSTANTS) == set(views)
    for name, array in flight._state._asdict().items():
        assert np.shares_memory(array, views[name]) or not array.size
        assert array.shape == views[name].shape
    sizes = arrays.MEMORY.sizes(flight._memory)
    assert (sizes.worlds, sizes.tiles) == (19, 2)
    assert arrays.ROOM.sizes(flight._rooms[0]) == sizes
    for name in ("worlds", "vehicles", "entries", "action_size", "level", "measuring"):
        for read in (plain(getattr(arrays, name)), compiled(getattr(arrays, name))):
            assert read(flight._memory) == getattr(sizes, name)
