"""Arrays of many shapes in one flat piece of memory, which begins with where each of them lies.

Compiled code is handed the flat array alone and opens what it needs where it needs it: handed over one by
one, some forty arrays of ten numbers each made most of what the compiler had to do. A statement declares
an array; how long the memory is, where the array lies, and the views of Python and of compiled code follow.
"""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from typing import Any, NamedTuple, final

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numpy.typing import NDArray

from formation_env._jit import builtin
from formation_env.memory.lowering import data_of, view_of, word_of
from formation_env.memory.records import define
from formation_env.memory.shuffles import carve

Floats = NDArray[np.float64]

_WORD = 8  # bytes


class Field(NamedTuple):
    """An array of a `Store`."""

    name: str
    shape: Callable[[Any], tuple[int, ...]]  # of the sizes
    kind: Any
    at: int  # where in the head its begin and strides are said
    rank: int


@final
class Store:
    """Arrays in one flat array of float64, by the sizes that say how long they are.

    `sizes` is the NamedTuple of whole numbers that their shapes follow from; those of the memory itself
    are its first numbers, as int64.
    """

    def __init__(self, sizes: Any) -> None:
        self._sizes = sizes
        self._head = len(sizes._fields)
        self.fields: dict[str, Field] = {}

    def field(
        self, name: str, shape: Callable[[Any], tuple[int, ...]], kind: Any = np.float64
    ) -> Any:
        """Declare an array. Returns `view(memory, ...)`, compiled: a row, by all indices but the last.

        The last index runs over a whole number of words of 8 bytes.
        """
        rank = len(shape(self._sizes(*[1] * len(self._sizes._fields))))
        self.fields[name] = Field(name, shape, kind, self._head, rank)
        indices = [f"i{k}" for k in range(rank - 1)]
        place = [f"head[{self._head}]"]
        place += [f"{i} * head[{self._head + 1 + k}]" for k, i in enumerate(indices)]
        view = f"carve(x, {' + '.join(place)}, (head[{self._head + rank}],))"
        source = f"def {name}({', '.join(['x', *indices])}):\n    head = x.view(integer)\n"
        source += f"    return {view}.view(kind)\n"
        function = define(name, source, {"carve": carve, "kind": kind, "integer": np.int64})
        give = builtin(_takes(rank, types.Array(from_dtype(np.dtype(kind)), 1, "C")), self._build())
        self._head += rank + 1
        return give(function)

    def _build(self) -> Any:
        """What LLVM is to do for a view of the field whose head comes next."""
        at = self._head

        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            given = (context, builder, signature, arguments)
            data, view = data_of(*given, 0), signature.return_type
            place = _head_word(builder, data, at)
            for k in range(1, len(arguments)):
                stride = _head_word(builder, data, at + k)
                place = builder.add(place, builder.mul(word_of(*given, k), stride))
            count = _head_word(builder, data, at + len(arguments))
            number = context.get_data_type(view.dtype)
            first = builder.bitcast(builder.gep(data, [place]), number.as_pointer())
            per_word = _WORD // context.get_abi_sizeof(number)
            return view_of(
                context, builder, view, first, [builder.mul(count, count.type(per_word))]
            )

        return build

    def allocate(self, sizes: Any) -> Floats:
        """Memory for all arrays, zeros but for its head."""
        head: list[int] = list(sizes)
        start = self._head
        for one in self.fields.values():
            lengths = [*one.shape(sizes)]
            lengths[-1] = _words(lengths[-1], one.kind)
            strides = [prod(lengths[k + 1 :]) for k in range(one.rank - 1)]
            head += [start, *strides, lengths[-1]]
            start += prod(lengths)
        memory = np.zeros(start)
        memory[: self._head].view(np.int64)[:] = head
        return memory

    def sizes(self, memory: Floats) -> Any:
        """The sizes that memory was allocated for."""
        count = len(self._sizes._fields)
        return self._sizes(*memory[:count].view(np.int64).tolist())

    def views(self, memory: Floats) -> dict[str, NDArray[Any]]:
        """All arrays by name, in place."""
        sizes, found = self.sizes(memory), {}
        for one in self.fields.values():
            shape = one.shape(sizes)
            start = int(memory[one.at : one.at + 1].view(np.int64)[0])
            words = prod(shape[:-1]) * _words(shape[-1], one.kind)
            found[one.name] = memory[start : start + words].view(one.kind).reshape(shape)
        return found

    def set_size(self, memory: Floats, name: str, value: int) -> None:
        """Say another size, of those that no array's shape depends on."""
        memory[: len(self._sizes._fields)].view(np.int64)[self._sizes._fields.index(name)] = value


def _words(count: int, kind: Any) -> int:
    words, rest = divmod(count * np.dtype(kind).itemsize, _WORD)
    if rest:
        raise TypeError(
            f"{count} numbers of {np.dtype(kind)}: expected whole words of {_WORD} bytes"
        )
    return int(words)


def size_reader(sizes: Any, name: str) -> Any:
    """`size(memory)`: one of the sizes, in compiled code."""
    k = sizes._fields.index(name)

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _head_word(builder, data_of(context, builder, signature, arguments, 0), k)

    source = f"def {name}(x):\n    return x.view(integer)[{k}]\n"
    return builtin(_takes(1, types.int64), build)(define(name, source, {"integer": np.int64}))


def _head_word(builder: Any, data: Any, k: int) -> Any:
    """Word `k` of the memory at `data`, as int64."""
    head = builder.bitcast(data, ir.IntType(64).as_pointer())
    return builder.load(builder.gep(head, [ir.IntType(64)(k)]))


def _takes(count: int, result: Any) -> Any:
    """A function of so many arguments that returns `result`, as Numba reads their number off it."""
    arguments = ", ".join(f"a{k}" for k in range(count))
    return define("typed", f"def typed({arguments}):\n    return result\n", {"result": result})
