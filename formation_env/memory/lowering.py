"""What the functions are made of that are written for LLVM and not in Python: see `_jit.builtin`."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.np import arrayobj


def data_of(context: Any, builder: Any, signature: Any, arguments: Any, k: int) -> Any:
    """A pointer to the numbers of an array among the arguments."""
    return arrayobj.make_array(signature.args[k])(context, builder, arguments[k]).data


def word_of(context: Any, builder: Any, signature: Any, arguments: Any, k: int) -> Any:
    """A whole number among the arguments, as int64."""
    return context.cast(builder, arguments[k], signature.args[k], types.int64)


def view_of(context: Any, builder: Any, view: Any, data: Any, lengths: list[Any]) -> Any:
    """A C-contiguous array of type `view` at a pointer; it owns nothing and is not counted."""
    block = arrayobj.make_array(view)(context, builder)
    word = context.get_value_type(types.intp)
    size = word(context.get_abi_sizeof(context.get_data_type(view.dtype)))
    strides = [size]
    for length in lengths[:0:-1]:
        strides.insert(0, builder.mul(strides[0], length))
    arrayobj.populate_array(block, data, lengths, strides, size, None)
    return block._getvalue()


def lengths_of(context: Any, builder: Any, shape: Any, value: Any) -> list[Any]:
    """The whole numbers of a tuple."""
    return [
        context.cast(builder, builder.extract_value(value, k), kind, types.intp)
        for k, kind in enumerate(shape)
    ]


def number_type(kind: Any) -> Any:
    """Numba's type of a number: float, int, bool."""
    return {float: types.float64, int: types.int64, bool: types.boolean}[kind]


def record_type(parts: Any, record: Any = None) -> Any:
    """Numba's type of a tuple of values of the types `parts`, or of the NamedTuple `record` of them."""
    return types.BaseTuple.from_types(tuple(parts), record)


def make(context: Any, builder: Any, kind: Any, numbers: list[Any]) -> Any:
    """The value of Numba's type `kind` whose numbers come first in `numbers`, which it takes from there."""
    if isinstance(kind, types.BaseTuple):
        parts = [make(context, builder, one, numbers) for one in kind]
        return context.make_tuple(builder, kind, parts)
    if isinstance(kind, types.Complex):
        value = context.make_complex(builder, kind)
        value.real, value.imag = numbers.pop(0), numbers.pop(0)
        return value._getvalue()
    return numbers.pop(0)


def numbers_of(context: Any, builder: Any, kind: Any, value: Any) -> list[tuple[Any, Any]]:
    """The numbers of a value of Numba's type `kind` in order, each with its type."""
    if isinstance(kind, types.BaseTuple):
        found = []
        for k, one in enumerate(kind):
            found += numbers_of(context, builder, one, builder.extract_value(value, k))
        return found
    if isinstance(kind, types.Complex):
        both = context.make_complex(builder, kind, value)
        return [(kind.underlying_float, both.real), (kind.underlying_float, both.imag)]
    return [(kind, value)]


def load_number(context: Any, builder: Any, array: Any, place: Any, kind: Any) -> Any:
    """A number of an array, as Python's float, int, or whether it exceeds zero."""
    number = builder.load(place)
    if kind is bool:
        wide = context.cast(builder, number, array.dtype, types.float64)
        return builder.fcmp_ordered(">", wide, ir.Constant(wide.type, 0.0))
    return context.cast(builder, number, array.dtype, number_type(kind))


def store_number(
    context: Any, builder: Any, array: Any, place: Any, kind: Any, number: Any
) -> None:
    """Store a number in an array, a truth value as 1 or 0."""
    if isinstance(kind, types.Boolean):
        number = context.cast(builder, number, types.boolean, types.int64)
        kind = types.int64
    builder.store(context.cast(builder, number, kind, array.dtype), place)


def pick_number(builder: Any, condition: Any, a: Any, b: Any) -> Any:
    """`a` where a truth value holds, else `b`."""
    return builder.select(cgutils.as_bool_bit(builder, condition), a, b)
