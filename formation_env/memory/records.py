"""NamedTuples as numbers in memory: the only place that knows at which row or column a number lies.

A record is a `NamedTuple` whose fields are numbers, complex numbers, tuples of fixed length or records.
Its numbers, in the order of its fields, are the rows of a tile (row `k` of lane `l` at `k LANES + l`),
or follow each other in a line (settings, results of one follower). From the fields' types this module
makes the functions that load and store a record; the code they consist of can be read in tracebacks and
the debugger.

A record can also be loaded from, or stored into, the rows of a larger one that has fields of the same
names: a `Body` of the rows of a vehicle's measurement.
"""

from __future__ import annotations

import linecache
from functools import cache
from math import inf
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np
from llvmlite import ir
from numba import types

from formation_env._jit import builtin, step
from formation_env.memory.lowering import (
    data_of,
    load_number,
    make,
    number_type,
    numbers_of,
    pick_number,
    record_type,
    store_number,
    word_of,
)

LANES = 16  # worlds side by side in a tile: two vectors of doubles, one of single precision

_NUMBERS = (float, int, bool)


class Quantity(NamedTuple):
    """What annotates a field that users see: `slot: Annotated[Vector, Quantity("m", "inertial", ...)]`."""

    unit: str
    frame: str
    meaning: str
    bound: float = inf  # that its numbers are clipped to
    typical: float = 1.0  # how far they are from their mean while a formation is kept, for networks


@cache
def fields(kind: Any) -> dict[str, Any]:
    """The types of a record's fields by name, without what annotates them."""
    return {name: _bare(hint) for name, hint in get_type_hints(kind, include_extras=True).items()}


@cache
def notes(kind: Any) -> dict[str, Any]:
    """What annotates each field of a record (`Annotated[type, note]`); empty where none has a note.

    Raises `TypeError` where only some have one: bounds, or a row of the manual, would be missing.
    """
    hints = get_type_hints(kind, include_extras=True)
    found = {n: get_args(h)[1] for n, h in hints.items() if get_origin(h) is Annotated}
    if found and len(found) < len(hints):
        bare = ", ".join(f"{kind.__name__}.{n}" for n in hints if n not in found)
        raise TypeError(f"{bare}: expected Annotated[type, note], as other fields of it are")
    return found


def _bare(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def is_record(kind: Any) -> bool:
    """Whether a type is a NamedTuple."""
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def size(kind: Any) -> int:
    """How many numbers a value of this type consists of."""
    return len(parts(kind))


@cache
def parts(kind: Any, value: str = "") -> tuple[tuple[str, Any], ...]:
    """The numbers of a value in order: how each is reached (`.p[0]`), and its type."""
    kind = _bare(kind)
    if kind in _NUMBERS:
        return ((value, kind),)
    if kind is complex:
        return ((f"{value}.real", float), (f"{value}.imag", float))
    if is_record(kind):
        pairs = [(f"{value}.{name}", one) for name, one in fields(kind).items()]
    elif get_origin(kind) is tuple and Ellipsis not in get_args(kind):
        pairs = [(f"{value}[{k}]", one) for k, one in enumerate(get_args(kind))]
    else:
        raise TypeError(f"{kind}: expected numbers, complex numbers, fixed tuples or NamedTuples")
    return tuple(number for name, one in pairs for number in parts(one, name))


@cache
def slices(kind: Any) -> dict[str, slice]:
    """Where the numbers of each field of a record lie among all of its numbers."""
    found, start = {}, 0
    for name, one in fields(kind).items():
        found[name] = slice(start, start + size(one))
        start += size(one)
    return found


def at(kind: Any, *path: str) -> int:
    """The number of the first row of a field, or of a field of a field."""
    row = 0
    for name in path:
        row += slices(kind)[name].start
        kind = fields(kind)[name]
    return row


def rows_in(kind: Any, layout: Any) -> tuple[int, ...]:
    """The rows of `layout` that hold the numbers of a record, field by field of the same name and size.

    Raises `TypeError` naming the field that `layout` lacks.
    """
    if kind is layout or not is_record(kind):
        return tuple(range(size(kind)))
    found: list[int] = []
    for name, one in fields(kind).items():
        there = slices(layout).get(name)
        if there is None or there.stop - there.start != size(one):
            raise TypeError(f"{layout.__name__} has no {name} as in {kind.__name__}")
        found += range(there.start, there.stop)
    return tuple(found)


def bounds(kind: Any) -> tuple[float, ...]:
    """The bounds of a record's numbers, from the `Quantity` of each field."""
    found = notes(kind)
    return tuple(found[n].bound for n, one in fields(kind).items() for _ in range(size(one)))


def flatten(value: Any) -> list[float]:
    """The numbers of a record, or of a nested tuple, in order, for `line_loader`."""
    if isinstance(value, tuple):
        return [x for item in value for x in flatten(item)]
    if isinstance(value, complex):
        return [value.real, value.imag]
    return [float(value)]


# -- code ---------------------------------------------------------------------------------------------


def build(kind: Any, reads: list[str], names: dict[str, Any]) -> str:
    """The expression that builds a value from the expressions of its numbers, which it takes from `reads`.

    The classes that it names are put into `names`.
    """
    kind = _bare(kind)
    if kind in _NUMBERS:
        return reads.pop(0)
    if kind is complex:
        return f"complex({reads.pop(0)}, {reads.pop(0)})"
    if is_record(kind):
        names[kind.__name__] = kind
        return (
            f"{kind.__name__}({', '.join(build(k, reads, names) for k in fields(kind).values())})"
        )
    return f"({', '.join(build(one, reads, names) for one in get_args(kind))},)"


def _read(kind: Any, place: str) -> str:
    """The expression of a number of this type that lies at a place."""
    if kind is bool:
        return f"({place} > 0.0)"
    return f"np.float64({place})" if kind is float else f"np.int64({place})"


def _written(path: str, kind: Any) -> str:
    return f"(1.0 if v{path} else 0.0)" if kind is bool else f"v{path}"


def _places(kind: Any, layout: Any, names: dict[str, Any]) -> list[str]:
    """Where the numbers of a lane lie in the rows of a tile; indices are unsigned, else no vector code."""
    rows = rows_in(kind, layout or kind)
    names.update({f"row_{row}": np.uint64(row * LANES) for row in rows})
    return [f"x[row_{row} + lane]" if row else "x[lane]" for row in rows]


def define(name: str, source: str, names: dict[str, Any]) -> Any:
    """The function `name` that `source` defines; tracebacks and the debugger find its lines."""
    file = f"<formation_env: {name} {len(linecache.cache)}>"
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
    space = {"np": np, "__name__": __name__, **names}
    exec(compile(source, file, "exec"), space)
    return space[name]


def _defined(verb: str, kind: Any, arguments: str, body: list[str], names: dict[str, Any]) -> Any:
    what = kind.__name__ if is_record(kind) else "".join(c for c in str(kind) if c.isalnum())
    source = f"def {verb}_{what}({arguments}):\n" + "".join(f"    {line}\n" for line in body)
    return define(f"{verb}_{what}", source, names)


def _function(verb: str, kind: Any, arguments: str, body: list[str], names: dict[str, Any]) -> Any:
    return step(_defined(verb, kind, arguments, body, names))


@cache
def numba_type(kind: Any) -> Any:
    """Numba's type of a value."""
    kind = _bare(kind)
    if kind in _NUMBERS:
        return number_type(kind)
    if kind is complex:
        return types.complex128
    if is_record(kind):
        return record_type((numba_type(one) for one in fields(kind).values()), kind)
    return record_type(numba_type(one) for one in get_args(kind))


@cache
def loader(kind: Any, layout: Any = None) -> Any:
    """`load(x, lane)`: the record in one lane of a tile's rows; compiled code.

    With `layout` the rows are those of that record, of which `kind` has some of the fields.
    """
    names: dict[str, Any] = {}
    places = _places(kind, layout, names)
    reads = [_read(one, place) for (_, one), place in zip(parts(kind), places, strict=True)]
    source = [f"return {build(kind, reads, names)}"]
    rows = rows_in(kind, layout or kind)

    def write(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given = (context, builder, signature, arguments)
        array, data, lane = signature.args[0], data_of(*given, 0), word_of(*given, 1)
        numbers = []
        for row, (_, one) in zip(rows, parts(kind), strict=True):
            place = builder.gep(data, [builder.add(lane, lane.type(row * LANES))])
            numbers.append(load_number(context, builder, array, place, one))
        return make(context, builder, signature.return_type, numbers)

    made = builtin(lambda x, lane: numba_type(kind), write)
    return made(_defined("load", kind, "x, lane", source, names))


@cache
def storer(kind: Any, layout: Any = None, bounds: tuple[float, ...] = ()) -> Any:
    """`store(x, lane, v)`: the inverse of `loader`; each number is clipped to its bound, if there are any.

    Clipped, what is not a number becomes the lower bound.
    """
    names: dict[str, Any] = {}
    places = _places(kind, layout, names)
    if not bounds:
        lines = [f"{x} = {_written(*one)}" for x, one in zip(places, parts(kind), strict=True)]
        made = _defined("store", kind, "x, lane, v", lines, names)
        return builtin(lambda x, lane, v: types.void, _store_rows(kind, layout))(made)
    lines = []
    for x, bound, one in zip(places, bounds, parts(kind), strict=True):
        clipped = f"min(max({-bound!r}, {_written(*one)}), {bound!r})"
        lines.append(f"{x} = {clipped if bound < inf else _written(*one)}")
    return _function("store", kind, "x, lane, v", lines, names)


@cache
def keeper(kind: Any, layout: Any = None) -> Any:
    """`keep(x, lane, on, v)`: `storer`, where `on` holds."""
    names: dict[str, Any] = {}
    places = _places(kind, layout, names)
    texts = [_written(path, one) for path, one in parts(kind)]
    lines = [f"{x} = {text} if on else {x}" for x, text in zip(places, texts, strict=True)]
    made = _defined("keep", kind, "x, lane, on, v", lines, names)
    return builtin(lambda x, lane, on, v: types.void, _store_rows(kind, layout))(made)


def _store_rows(kind: Any, layout: Any) -> Any:
    """What LLVM is to do to store the last argument in a lane; of four where the third holds."""
    rows = rows_in(kind, layout or kind)

    def write(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given = (context, builder, signature, arguments)
        array, data, lane = signature.args[0], data_of(*given, 0), word_of(*given, 1)
        found = numbers_of(context, builder, signature.args[-1], arguments[-1])
        for row, (one, number) in zip(rows, found, strict=True):
            place = builder.gep(data, [builder.add(lane, lane.type(row * LANES))])
            if len(arguments) == 4:
                before = context.cast(builder, builder.load(place), array.dtype, one)
                number = pick_number(builder, arguments[2], number, before)
            store_number(context, builder, array, place, one, number)
        return context.get_dummy_value()

    return write


@cache
def line_loader(kind: Any, first: int = 0) -> Any:
    """`load(x)`: the value whose numbers lie in a line from `first` on, the inverse of `flatten`."""
    names: dict[str, Any] = {}
    reads = [_read(one, f"x[{first + k}]") for k, (_, one) in enumerate(parts(kind))]
    source = [f"return {build(kind, reads, names)}"]

    def write(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, data = signature.args[0], data_of(context, builder, signature, arguments, 0)
        numbers = []
        for k, (_, one) in enumerate(parts(kind)):
            place = builder.gep(data, [ir.Constant(ir.IntType(64), first + k)])
            numbers.append(load_number(context, builder, array, place, one))
        return make(context, builder, signature.return_type, numbers)

    return builtin(lambda x: numba_type(kind), write)(_defined("read", kind, "x", source, names))


def part_loader(kind: Any, field: str) -> Any:
    """`load(x)`: one field of the record whose numbers a line begins with; compiled code."""
    return line_loader(fields(kind)[field], at(kind, field))


@cache
def line_storer(kind: Any) -> Any:
    """`store(x, v)`: the inverse of `line_loader`."""
    lines = [f"x[{k}] = v{path}" for k, (path, _) in enumerate(parts(kind))]
    return _function("write", kind, "x, v", lines, {})


@cache
def chooser(kind: Any) -> Any:
    """`choose(on, a, b)`: the record `a` if `on` holds, else `b`, number by number; compiled code."""
    names: dict[str, Any] = {}
    reads = [f"(a{path} if on else b{path})" for path, _ in parts(kind)]
    line = f"return {build(kind, reads, names)}"
    return _function("choose", kind, "on, a, b", [line], names)


@cache
def total(kind: Any) -> Any:
    """`total(v)`: the sum of a record's numbers, from the first to the last; compiled code."""
    text = " + ".join(f"v{path}" for path, _ in parts(kind))
    return _function("total", kind, "v", [f"return {text}"], {})
