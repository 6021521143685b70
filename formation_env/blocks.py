"""Blocks of memory: views that cost nothing, and numbers turned from lanes to rows.

Two things that Numba does not do by itself. It counts a reference for every view of an array,
atomically, and reshapes by a call: 20 to 40 ns each, more than the work on a small view. And a tile has
lane after lane of one number side by side, where results have the numbers of one world side by side:
copied one by one that costs more than computing them; with a square of numbers held in vector registers
it is a few shuffles for each.
"""

from __future__ import annotations

from math import prod
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload
from numba.np import arrayobj

from formation_env._jit import device

LANES = 16  # worlds side by side in a tile: two vectors of doubles, one of single precision
_BYTES = 64  # of a vector


@intrinsic  # type: ignore[untyped-decorator]
def _carve(typing: Any, flat: Any, start: Any, shape: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = context.get_value_type(types.intp)
        data = arrayobj.make_array(flat)(context, builder, arguments[0]).data
        block = arrayobj.make_array(view)(context, builder)
        lengths = [
            context.cast(builder, builder.extract_value(arguments[2], k), kind, types.intp)
            for k, kind in enumerate(shape)
        ]
        size = word(context.get_abi_sizeof(context.get_data_type(flat.dtype)))
        strides = [size]
        for length in lengths[:0:-1]:
            strides.insert(0, builder.mul(strides[0], length))
        first = builder.gep(data, [context.cast(builder, arguments[1], start, types.intp)])
        arrayobj.populate_array(block, first, lengths, strides, size, None)
        return block._getvalue()

    view = types.Array(flat.dtype, len(shape), "C")
    return view(flat, start, shape), build


def carve(flat: Any, start: int, shape: tuple[int, ...]) -> Any:
    """A C-contiguous view of the numbers of a C-contiguous array from `start` on.

    Compiled, it owns nothing, checks nothing and is not counted: for kernels whose caller holds the
    memory.
    """
    return flat.reshape(-1)[start : start + prod(shape)].reshape(shape)


@overload(carve)  # type: ignore[untyped-decorator]
def _carve_compiled(flat: Any, start: Any, shape: Any) -> Any:
    def implementation(flat: Any, start: Any, shape: Any) -> Any:
        return _carve(flat, start, shape)

    return implementation


@intrinsic  # type: ignore[untyped-decorator]
def _reinterpret(typing: Any, block: Any, kind: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source = arrayobj.make_array(block)(context, builder, arguments[0])
        sink = arrayobj.make_array(view)(context, builder)
        number = context.get_data_type(view.dtype)
        width = context.get_abi_sizeof(number)
        size = context.get_value_type(types.intp)(width)
        wide = context.get_abi_sizeof(context.get_data_type(block.dtype))
        many = builder.mul(source.nitems, size.type(wide // width))
        data = builder.bitcast(source.data, number.as_pointer())
        arrayobj.populate_array(sink, data, [many], [size], size, None)
        return sink._getvalue()

    view = types.Array(kind.dtype, 1, "C")
    return view(block, kind), build


def reinterpret(block: Any, kind: Any) -> Any:
    """The memory of a row of numbers as numbers of another kind, no wider: `block.view(kind)`.

    Compiled, it is not counted, as with `carve`, and does not bring the error messages of `view` along,
    which take seconds to compile.
    """
    return block.view(kind)


@overload(reinterpret)  # type: ignore[untyped-decorator]
def _reinterpret_compiled(block: Any, kind: Any) -> Any:
    def implementation(block: Any, kind: Any) -> Any:
        return _reinterpret(block, kind)

    return implementation


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


@intrinsic  # type: ignore[untyped-decorator]
def _turn_square(typing: Any, source: Any, at: Any, sink: Any, to: Any, stride: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        size = signature.args[0].dtype.bitwidth // 8
        width, number = _BYTES // size, context.get_data_type(signature.args[0].dtype)
        word = context.get_value_type(types.int64)
        tile, sunk = (
            arrayobj.make_array(signature.args[k])(context, builder, arguments[k]).data
            for k in (0, 2)
        )
        rows = []
        for k in range(width):
            offset = builder.add(arguments[1], word(k * LANES))
            place = _vector_at(builder, tile, offset, number, width)
            rows.append(builder.load(place, align=size))
        for k, row in enumerate(_shuffled(builder, rows, width)):
            offset = builder.add(arguments[3], builder.mul(arguments[4], word(k)))
            builder.store(row, _vector_at(builder, sunk, offset, number, width), align=size)
        return context.get_dummy_value()

    return types.void(source, types.int64, sink, types.int64, types.int64), build


def turn_square(source: Any, at: int, sink: Any, to: int, stride: int) -> None:
    """`sink[to + j stride + k] = source[at + k LANES + j]` for a vector's worth of `j` and `k`."""
    width = _BYTES // source.itemsize
    for j in range(width):
        for k in range(width):
            sink[to + j * stride + k] = source[at + k * LANES + j]


@overload(turn_square)  # type: ignore[untyped-decorator]
def _turn_square_compiled(source: Any, at: Any, sink: Any, to: Any, stride: Any) -> Any:
    def implementation(source: Any, at: Any, sink: Any, to: Any, stride: Any) -> Any:
        return _turn_square(source, at, sink, to, stride)

    return implementation


@intrinsic  # type: ignore[untyped-decorator]
def _turn_lines(typing: Any, source: Any, starts: Any, first: Any, row: Any, sink: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        size = signature.args[0].dtype.bitwidth // 8
        width, number = _BYTES // size, context.get_data_type(signature.args[0].dtype)
        word = context.get_value_type(types.int64)
        lines, begins, sunk = (
            arrayobj.make_array(signature.args[k])(context, builder, arguments[k]).data
            for k in (0, 1, 4)
        )

        rows = []
        for k in range(width):
            begin = builder.load(builder.gep(begins, [builder.add(arguments[2], word(k))]))
            place = _vector_at(builder, lines, builder.add(begin, arguments[3]), number, width)
            rows.append(builder.load(place, align=size))
        to = builder.add(builder.mul(arguments[3], word(LANES)), arguments[2])
        for k, line in enumerate(_shuffled(builder, rows, width)):
            offset = builder.add(to, word(k * LANES))
            builder.store(line, _vector_at(builder, sunk, offset, number, width), align=size)
        return context.get_dummy_value()

    return types.void(source, starts, types.int64, types.int64, sink), build


def turn_lines(source: Any, starts: Any, first: int, row: int, sink: Any) -> None:
    """A square of rows `row`, ... and lanes `first`, ... of a tile, from lines of `source`.

    The line of a lane begins at `starts[lane]`.
    """
    width = _BYTES // source.itemsize
    for lane in range(first, first + width):
        for k in range(row, row + width):
            sink[k * LANES + lane] = source[starts[lane] + k]


@overload(turn_lines)  # type: ignore[untyped-decorator]
def _turn_lines_compiled(source: Any, starts: Any, first: Any, row: Any, sink: Any) -> Any:
    def implementation(source: Any, starts: Any, first: Any, row: Any, sink: Any) -> Any:
        return _turn_lines(source, starts, first, row, sink)

    return implementation


_FOUR = 4


@intrinsic  # type: ignore[untyped-decorator]
def _turn_fours(typing: Any, source: Any, at: Any, stride: Any, sink: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = ir.FloatType()
        word = context.get_value_type(types.int64)
        given, sunk = (
            arrayobj.make_array(signature.args[k])(context, builder, arguments[k]).data
            for k in (0, 3)
        )

        def shuffled(a: Any, b: Any, picks: list[int]) -> Any:
            kind = ir.VectorType(ir.IntType(32), len(picks))
            return builder.shuffle_vector(a, b, ir.Constant(kind, picks))

        parts = []
        for lane in range(LANES):
            offset = builder.add(arguments[1], builder.mul(arguments[2], word(lane)))
            place = _vector_at(builder, given, offset, number, _FOUR)
            parts.append(builder.load(place, align=4))
        # Vector j of four: lanes j, j + 4, ... one behind the other.
        mixed = parts
        while len(mixed) > _FOUR:
            half = len(mixed) // 2
            mixed = [
                shuffled(a, b, list(range(2 * a.type.count)))
                for a, b in zip(mixed[:half], mixed[half:], strict=True)
            ]
        # Lanes in the order 0, 4 | 8, 12 became 0, 8, 4, 12: put right on the way out.
        quarters = [0, 2, 1, 3]
        for k in range(_FOUR):
            pairs = [
                shuffled(
                    mixed[j],
                    mixed[j + 1],
                    [b * LANES + quarters[q] * _FOUR + k for q in range(_FOUR) for b in (0, 1)],
                )
                for j in (0, 2)
            ]
            picks = [8 * b + 2 * q + i for q in range(_FOUR) for b in (0, 1) for i in (0, 1)]
            row = shuffled(pairs[0], pairs[1], picks)
            place = _vector_at(builder, sunk, word(k * LANES), number, LANES)
            builder.store(row, place, align=4)
        return context.get_dummy_value()

    return types.void(source, types.int64, types.int64, sink), build


def turn_fours(source: Any, at: int, stride: int, sink: Any) -> None:
    """`sink[k LANES + lane] = source[at + lane stride + k]` for four `k` and all lanes, float32."""
    for lane in range(LANES):
        for k in range(_FOUR):
            sink[k * LANES + lane] = source[at + lane * stride + k]


@overload(turn_fours)  # type: ignore[untyped-decorator]
def _turn_fours_compiled(source: Any, at: Any, stride: Any, sink: Any) -> Any:
    def implementation(source: Any, at: Any, stride: Any, sink: Any) -> Any:
        return _turn_fours(source, at, stride, sink)

    return implementation


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


@intrinsic  # type: ignore[untyped-decorator]
def _fetch_line(typing: Any, block: Any, at: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = arrayobj.make_array(block)(context, builder, arguments[0]).data
        pointer = builder.gep(data, [arguments[1]])
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, number, number, number])
        prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        for_writing, near, data_cache = number(1), number(3), number(1)
        builder.call(prefetch, [pointer, for_writing, near, data_cache])
        return context.get_dummy_value()

    return types.void(block, types.int64), build


def fetch_line(block: Any, at: int) -> None:
    """Have the cache fetch the line in which number `at` of an array lies; it need not exist."""


@overload(fetch_line)  # type: ignore[untyped-decorator]
def _fetch_line_compiled(block: Any, at: Any) -> Any:
    def implementation(block: Any, at: Any) -> Any:
        return _fetch_line(block, at)

    return implementation


@device
def fetch(block: Any, first: int, count: int) -> None:
    """Have the cache fetch `count` numbers from `first` on, soon to be read or written."""
    for at in range(first, first + count, _BYTES // block.itemsize):
        fetch_line(block, at)


@intrinsic  # type: ignore[untyped-decorator]
def _stream_line(typing: Any, source: Any, at: Any, sink: Any, to: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = context.get_data_type(signature.args[0].dtype)
        width = _BYTES // context.get_abi_sizeof(number)
        given, sunk = (
            _vector_at(
                builder,
                arrayobj.make_array(signature.args[k])(context, builder, arguments[k]).data,
                arguments[k + 1],
                number,
                width,
            )
            for k in (0, 2)
        )
        line = builder.load(given, align=context.get_abi_sizeof(number))
        store = builder.store(line, sunk, align=_BYTES)
        store.set_metadata("nontemporal", builder.module.add_metadata([ir.IntType(32)(1)]))
        return context.get_dummy_value()

    return types.void(source, types.int64, sink, types.int64), build


def stream_line(source: Any, at: int, sink: Any, to: int) -> None:
    """A cache line of numbers from `at` on, past the cache to the line that begins at `sink[to]`."""
    width = _BYTES // source.itemsize
    sink[to : to + width] = source[at : at + width]


@overload(stream_line)  # type: ignore[untyped-decorator]
def _stream_line_compiled(source: Any, at: Any, sink: Any, to: Any) -> Any:
    def implementation(source: Any, at: Any, sink: Any, to: Any) -> Any:
        return _stream_line(source, at, sink, to)

    return implementation


@intrinsic  # type: ignore[untyped-decorator]
def _offset(typing: Any, block: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = arrayobj.make_array(block)(context, builder, arguments[0]).data
        address = builder.ptrtoint(data, context.get_value_type(types.int64))
        size = context.get_abi_sizeof(context.get_data_type(block.dtype))
        inside = builder.and_(address, address.type(_BYTES - 1))
        return builder.udiv(inside, address.type(size))

    return types.int64(block), build


def offset(block: Any) -> int:
    """How many numbers after the begin of a cache line an array begins."""
    return int(block.ctypes.data) % _BYTES // int(block.itemsize)


@overload(offset)  # type: ignore[untyped-decorator]
def _offset_compiled(block: Any) -> Any:
    def implementation(block: Any) -> Any:
        return _offset(block)

    return implementation


@intrinsic  # type: ignore[untyped-decorator]
def _drain(typing: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), build


def drain() -> None:
    """Have what was streamed arrive before whatever is written from now on."""


@overload(drain)  # type: ignore[untyped-decorator]
def _drain_compiled() -> Any:
    def implementation() -> Any:
        return _drain()

    return implementation


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
