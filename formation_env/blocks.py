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
        number = context.get_data_type(view.dtype).as_pointer()
        size = context.get_value_type(types.intp)(view.dtype.bitwidth // 8)
        many = builder.mul(source.nitems, size.type(block.dtype.bitwidth // view.dtype.bitwidth))
        data = builder.bitcast(source.data, number)
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
        number = signature.args[0].dtype
        size = number.bitwidth // 8
        width = _BYTES // size
        vector = ir.VectorType(context.get_data_type(number), width).as_pointer()
        word = context.get_value_type(types.int64)

        def pointer(k: int, offset: Any) -> Any:
            data = arrayobj.make_array(signature.args[k])(context, builder, arguments[k]).data
            return builder.bitcast(builder.gep(data, [offset]), vector)

        rows = []
        for k in range(width):
            offset = builder.add(arguments[1], word(k * LANES))
            rows.append(builder.load(pointer(0, offset), align=size))
        for k, row in enumerate(_shuffled(builder, rows, width)):
            offset = builder.add(arguments[3], builder.mul(arguments[4], word(k)))
            builder.store(row, pointer(2, offset), align=size)
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
def gather(lines: Any, tile: Any) -> None:
    """`LANES` lines of `LANES` numbers, one of each world, to the rows of a tile."""
    width = _BYTES // lines.itemsize
    for row in range(0, LANES, width):
        for lane in range(0, LANES, width):
            turn_square(lines, lane * LANES + row, tile, row * LANES + lane, LANES)
