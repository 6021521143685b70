"""Numbers moved about in memory: views that cost nothing, and rows of a tile turned into lines and back.

Two things that Numba does not do by itself. It counts a reference for every view of an array,
atomically, and reshapes by a call: 20 to 40 ns each, more than the work on a small view. And a tile has
lane after lane of one number side by side, where results have the numbers of one world side by side:
copied one by one that costs more than computing them; with a square of numbers held in vector registers
it is a few shuffles for each.
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.np import arrayobj

from formation_env._jit import builtin, device, loop
from formation_env.memory.lowering import data_of, lengths_of, view_of, word_of
from formation_env.memory.records import LANES

_BYTES = 64  # of a vector, and of a line of the cache
_LANES = np.uint64(LANES)


def _build_carve(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    start = word_of(context, builder, signature, arguments, 1)
    first = builder.gep(data_of(context, builder, signature, arguments, 0), [start])
    lengths = lengths_of(context, builder, signature.args[2], arguments[2])
    return view_of(context, builder, signature.return_type, first, lengths)


@builtin(lambda flat, start, shape: types.Array(flat.dtype, len(shape), "C"), _build_carve)
def carve(flat: Any, start: int, shape: tuple[int, ...]) -> Any:
    """A C-contiguous view of the numbers of a C-contiguous array from `start` on.

    Compiled, it owns nothing, checks nothing and is not counted: for kernels whose caller holds the
    memory.
    """
    return flat.reshape(-1)[start : start + prod(shape)].reshape(shape)


def _build_reinterpret(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    view = signature.return_type
    source = arrayobj.make_array(signature.args[0])(context, builder, arguments[0])
    number = context.get_data_type(view.dtype)
    wide = context.get_abi_sizeof(context.get_data_type(signature.args[0].dtype))
    times = wide // context.get_abi_sizeof(number)
    count = builder.mul(source.nitems, context.get_value_type(types.intp)(times))
    data = builder.bitcast(source.data, number.as_pointer())
    return view_of(context, builder, view, data, [count])


@builtin(lambda block, kind: types.Array(kind.dtype, 1, "C"), _build_reinterpret)
def reinterpret(block: Any, kind: Any) -> Any:
    """The memory of a row of numbers as numbers of another kind, no wider: `block.view(kind)`.

    Compiled, it is not counted, as with `carve`, and does not bring the error messages of `view` along,
    which take seconds to compile.
    """
    return block.view(kind)


def _vector_at(builder: Any, data: Any, offset: Any, number: Any, width: int) -> Any:
    """A pointer to a vector of so many numbers, `offset` numbers behind `data`."""
    vector = ir.VectorType(number, width).as_pointer()
    return builder.bitcast(builder.gep(data, [offset]), vector)


def _shuffled(builder: Any, rows: list[Any], width: int) -> list[Any]:
    """The transpose of a square of vectors: swap ever larger off-diagonal blocks."""
    kind = ir.VectorType(ir.IntType(32), width)
    step = 1
    while step < width:
        low = ir.Constant(kind, [j if not j & step else width + j - step for j in range(width)])
        high = ir.Constant(kind, [j + step if not j & step else width + j for j in range(width)])
        turned = list(rows)
        for i in (i for i in range(width) if not i & step):
            turned[i] = builder.shuffle_vector(rows[i], rows[i + step], low)
            turned[i + step] = builder.shuffle_vector(rows[i], rows[i + step], high)
        rows = turned
        step *= 2
    return rows


def _width(source: Any) -> int:
    """Numbers of an array's kind in a vector."""
    return _BYTES // (int(source.dtype.bitwidth) // 8)


def _build_turn_square(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    width, number = _width(signature.args[0]), context.get_data_type(signature.args[0].dtype)
    size, word = _BYTES // width, context.get_value_type(types.int64)
    given = (context, builder, signature, arguments)
    tile, at, sink, to, stride = (
        data_of(*given, k) if k in (0, 2) else word_of(*given, k) for k in range(5)
    )
    rows = []
    for k in range(width):
        place = _vector_at(builder, tile, builder.add(at, word(k * LANES)), number, width)
        rows.append(builder.load(place, align=size))
    for k, row in enumerate(_shuffled(builder, rows, width)):
        offset = builder.add(to, builder.mul(stride, word(k)))
        builder.store(row, _vector_at(builder, sink, offset, number, width), align=size)
    return context.get_dummy_value()


@builtin(lambda source, at, sink, to, stride: types.void, _build_turn_square)
def turn_square(source: Any, at: int, sink: Any, to: int, stride: int) -> None:
    """`sink[to + j stride + k] = source[at + k LANES + j]` for a vector's worth of `j` and `k`."""
    width = _BYTES // source.itemsize
    for j in range(width):
        for k in range(width):
            sink[to + j * stride + k] = source[at + k * LANES + j]


def _build_turn_lines(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    width, number = _width(signature.args[0]), context.get_data_type(signature.args[0].dtype)
    size, word = _BYTES // width, context.get_value_type(types.int64)
    given = (context, builder, signature, arguments)
    lines, starts, tile = (data_of(*given, k) for k in (0, 1, 4))
    first, row = word_of(*given, 2), word_of(*given, 3)
    rows = []
    for k in range(width):
        start = builder.load(builder.gep(starts, [builder.add(first, word(k))]))
        place = _vector_at(builder, lines, builder.add(start, row), number, width)
        rows.append(builder.load(place, align=size))
    to = builder.add(builder.mul(row, word(LANES)), first)
    for k, line in enumerate(_shuffled(builder, rows, width)):
        place = _vector_at(builder, tile, builder.add(to, word(k * LANES)), number, width)
        builder.store(line, place, align=size)
    return context.get_dummy_value()


@builtin(lambda source, starts, first, row, tile: types.void, _build_turn_lines)
def turn_lines(source: Any, starts: Any, first: int, row: int, tile: Any) -> None:
    """A square of rows `row`, ... and lanes `first`, ... of a tile, from lines of `source`.

    The line of a lane begins at `starts[lane]`.
    """
    width = _BYTES // source.itemsize
    for lane in range(first, first + width):
        for k in range(row, row + width):
            tile[k * LANES + lane] = source[starts[lane] + k]


def _build_fetch_line(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    at = word_of(context, builder, signature, arguments, 1)
    pointer = builder.gep(data_of(context, builder, signature, arguments, 0), [at])
    number = ir.IntType(32)
    kind = ir.FunctionType(ir.VoidType(), [pointer.type, number, number, number])
    prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
    for_writing, near, data_cache = number(1), number(3), number(1)
    builder.call(prefetch, [pointer, for_writing, near, data_cache])
    return context.get_dummy_value()


@builtin(lambda block, at: types.void, _build_fetch_line)
def fetch_line(block: Any, at: int) -> None:
    """Have the cache fetch the line in which number `at` of an array lies; it need not exist."""


@device
def fetch(block: Any, first: int, count: int) -> None:
    """Have the cache fetch `count` numbers from `first` on, soon to be read or written."""
    for at in range(first, first + count, _BYTES // block.itemsize):
        fetch_line(block, at)


@device
def scatter(tile: Any, rows: int, sink: Any, to: int, stride: int, lanes: int) -> None:
    """The first `rows` rows of a tile, lane by lane, to `sink[to]`, `sink[to + stride]`, ...

    Of `lanes` lanes; the last square overlaps the one before, so `rows` must be a vector's worth.
    """
    if lanes < LANES:
        for lane in range(lanes):
            for k in range(rows):
                sink[to + lane * stride + k] = tile[k * LANES + lane]
        return
    width = _BYTES // tile.itemsize
    for first in range(0, rows, width):
        k = min(first, rows - width)
        for lane in range(0, LANES, width):
            turn_square(tile, k * LANES + lane, sink, to + lane * stride + k, stride)


@device
def gather(lines: Any, starts: Any, tile: Any) -> None:
    """`LANES` lines of `LANES` numbers, that of each world from its start on, to the rows of a tile."""
    width = _BYTES // lines.itemsize
    for row in range(0, LANES, width):
        for lane in range(0, LANES, width):
            turn_lines(lines, starts, lane, row, tile)


def _build_stream_line(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    width, number = _width(signature.args[0]), context.get_data_type(signature.args[0].dtype)
    given = (context, builder, signature, arguments)
    source, at, sink, to = (
        data_of(*given, k) if k in (0, 2) else word_of(*given, k) for k in range(4)
    )
    place = _vector_at(builder, source, at, number, width)
    line = builder.load(place, align=context.get_abi_sizeof(number))
    store = builder.store(line, _vector_at(builder, sink, to, number, width), align=_BYTES)
    store.set_metadata("nontemporal", builder.module.add_metadata([ir.IntType(32)(1)]))
    return context.get_dummy_value()


@builtin(lambda source, at, sink, to: types.void, _build_stream_line)
def stream_line(source: Any, at: int, sink: Any, to: int) -> None:
    """A cache line of numbers from `at` on, past the cache to the line that begins at `sink[to]`."""
    width = _BYTES // source.itemsize
    sink[to : to + width] = source[at : at + width]


def _build_offset(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    data = data_of(context, builder, signature, arguments, 0)
    address = builder.ptrtoint(data, context.get_value_type(types.int64))
    size = context.get_abi_sizeof(context.get_data_type(signature.args[0].dtype))
    inside = builder.and_(address, address.type(_BYTES - 1))
    return builder.udiv(inside, address.type(size))


@builtin(lambda block: types.int64, _build_offset)
def offset(block: Any) -> int:
    """How many numbers after the begin of a cache line an array begins."""
    return int(block.ctypes.data) % _BYTES // int(block.itemsize)


def _build_drain(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    builder.fence("seq_cst")
    return context.get_dummy_value()


@builtin(lambda: types.void, _build_drain)
def drain() -> None:
    """Have what was streamed arrive before whatever is written from now on."""


@device
def stream(source: Any, sink: Any, to: int, count: int) -> None:
    """The first `count` numbers to `sink[to]`, ... past the cache.

    For what is larger than the cache anyway: a store would first fetch each line from memory.
    """
    width = _BYTES // source.itemsize
    ahead = min(count, (width - (offset(sink) + to) % width) % width)
    for k in range(ahead):
        sink[to + k] = source[k]
    whole = ahead + (count - ahead) // width * width
    for k in range(ahead, whole, width):
        stream_line(source, k, sink, to + k)
    for k in range(whole, count):
        sink[to + k] = source[k]


# -- loops that move numbers -----------------------------------------------------------------------------


@loop
def copy(source: Any, first: int, sink: Any, to: int, rows: int) -> None:
    """`rows` rows of a tile from `first` on, to `to` on."""
    a, b = np.uint64(first) * _LANES, np.uint64(to) * _LANES
    for k in range(np.uint64(rows) * _LANES):
        sink[b + k] = source[a + k]


@loop
def copy_numbers(source: Any, sink: Any, to: int, count: int) -> None:
    """The first `count` numbers, to `sink[to]`, ..."""
    a = np.uint64(to)
    for k in range(np.uint64(count)):
        sink[a + k] = source[k]


@loop
def restore(saved: Any, first: int, sink: Any, rows: int, active: Any) -> None:
    """Put `rows` rows of `sink` back where a lane is not active, from `saved`, row `first` on."""
    for row in range(rows):
        a, b = np.uint64(first + row) * _LANES, np.uint64(row) * _LANES
        for lane in range(_LANES):
            sink[b + lane] = sink[b + lane] if active[lane] > 0.0 else saved[a + lane]


@loop
def clear(row: Any) -> None:
    """Zero everywhere."""
    for k in range(np.uint64(len(row))):
        row[k] = 0.0


@loop
def count_finite(numbers: Any) -> int:
    """How many are neither infinite nor NaN."""
    count = 0
    for k in range(np.uint64(len(numbers))):
        count += abs(numbers[k]) < np.inf
    return count


@device
def clipped(a: float) -> float:
    """`a` within [-1, 1], as the entries of an action are executed."""
    return min(max(a, -1.0), 1.0)


@loop
def take_clipped(actions: Any, first: int, stride: int, executed: Any, row: int) -> None:
    """One entry of the actions of consecutive worlds, clipped, to a row of those executed."""
    a, b, step = np.uint64(first), np.uint64(row) * _LANES, np.uint64(stride)
    for lane in range(_LANES):
        executed[b + lane] = clipped(np.float64(actions[a + lane * step]))
