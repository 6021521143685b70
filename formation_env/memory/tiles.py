"""Loops over the worlds of a tile, made from laws: one vehicle in all lanes at once.

A law is a function of one vehicle in one world, as in `quadrotor` or `task`. `over_lanes` makes of its
signature the loop that the compiler turns into vector code: a loop becomes that only if nothing in it is
called or branches, if its row stride is a constant and if its indices are unsigned; `LOOPS` lists all of
them for the test that looks at the machine code. Each loop is a function of its own, so that every caller
runs the same code.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any, NamedTuple, get_args, get_type_hints

import numpy as np

from formation_env._jit import device, loop
from formation_env.memory.records import (
    LANES,
    define,
    is_record,
    keeper,
    line_loader,
    loader,
    parts,
    storer,
)

UNIT, FLAGS = "unit", "flags"  # layouts that are not a record: see `over_lanes`


class Loop(NamedTuple):
    """A loop that has been made, for the test of machine code."""

    name: str
    run: Any
    law: Any


LOOPS: list[Loop] = []


def over_lanes(
    law: Callable[..., Any],
    into: tuple[str, ...] = (),
    uniform: tuple[str, ...] = (),
    static: Mapping[str, tuple[int, ...]] | None = None,
    keep: str = "",
    bounds: tuple[float, ...] = (),
    **layouts: Any,
) -> Any:
    """The loop `run(...)` of `law` over the lanes of a tile.

    Its arguments are those of the law, and after them the arrays of `into` that are none of them:

    - an argument is an array of rows; what the law takes is loaded from it by its type, and a `bool` is
      whether a number exceeds zero. With `argument=Record` the rows are those of this larger record,
      with `argument=FLAGS` the array is one of booleans;
    - one in `uniform` is the same in all lanes: a number, or a line of numbers that a record is read from;
    - one of type `Any` is handed to the law as it is, with the lane if the law's first argument is `lane`;
    - one in `static` takes whole numbers, for each of which a loop of its own is compiled, in which it is a
      constant. The function returned calls the one asked for.

    What the law returns is stored in the arrays of `into`, in order: one value, or a tuple of as many.
    With `keep`, the name of a `bool` argument, only where that holds; with `bounds` clipped to them. What
    is returned beyond them is summed over the lanes and returned: a `bool` or `int`, or a record of them.
    """
    fixed = dict(static or {})
    hints = get_type_hints(getattr(law, "py_func", law))
    names = list(inspect.signature(getattr(law, "py_func", law)).parameters)
    made = _Maker(law, hints, names, into, uniform, keep, bounds, layouts, tuple(fixed))
    runs = {}
    for values in product(*fixed.values()):
        chosen = dict(zip(fixed, values, strict=True))
        runs[values] = made.loop(chosen)
    if not fixed:
        return runs[()]
    return _dispatch(made, list(fixed), runs)


class _Maker:
    """What the loops of one law have in common."""

    def __init__(
        self,
        law: Callable[..., Any],
        hints: dict[str, Any],
        names: list[str],
        into: tuple[str, ...],
        uniform: tuple[str, ...],
        keep: str,
        bounds: tuple[float, ...],
        layouts: dict[str, Any],
        static: tuple[str, ...],
    ) -> None:
        self.law = law if hasattr(law, "py_func") else device(law)
        self.name: str = getattr(law, "__name__", "law")
        self.by_lane = names[:1] == ["lane"]
        names = names[1:] if self.by_lane else names
        self.names, self.hints, self.into, self.static = names, hints, into, static
        self.uniform, self.keep, self.bounds, self.layouts = uniform, keep, bounds, layouts
        self.arguments = [*names, *(name for name in into if name not in names)]
        returned = hints["return"]
        summed = returned is not type(None) and not into
        self.results = (returned,) if len(into) == 1 or summed else get_args(returned)
        if len(into) == 1 and not is_record(returned) and len(get_args(returned)) == 2:
            self.results = get_args(returned)
        self.sums = self.results[len(into) :]
        self.of_lane = self.one()

    def one(self) -> Any:
        """The law of one lane: `one(lane, ...)` loads its arguments; compiled code.

        A function of its own, so that its formulas are optimised before they stand in a loop.
        """
        space: dict[str, Any] = {"law": self.law}
        calls = ", ".join(self._argument(name, space) for name in self.names)
        if self.by_lane:
            calls = f"lane, {calls}"
        source = f"def {self.name}_of_lane({', '.join(['lane', *self.names])}):\n"
        return device(define(f"{self.name}_of_lane", source + f"    return law({calls})\n", space))

    def loop(self, chosen: dict[str, int]) -> Any:
        """The loop in which some arguments are constants."""
        space: dict[str, Any] = {"law_of_lane": self.of_lane, "LANES": np.uint64(LANES), **chosen}
        head = [self._read(name, space) for name in self.uniform]
        given = [f"{name}_" if name in self.uniform else name for name in self.names]
        body = [f"r = law_of_lane({', '.join(['lane', *given])})"]
        values = ["r"] if len(self.results) == 1 else [f"r[{k}]" for k in range(len(self.results))]
        for sink, kind, value in zip(self.into, self.results, values, strict=False):
            body.append(self._store(sink, kind, value, space))
        tail = self._sum(values[len(self.into) :], head, body, space)
        arguments = [name for name in self.arguments if name not in chosen]
        name = "_".join([self.name, *map(str, chosen.values())])
        lines = [f"def {name}({', '.join(arguments)}):", *(f"    {line}" for line in head)]
        lines += ["    for lane in range(LANES):", *(f"        {line}" for line in body)]
        run = loop(
            define(name, "\n".join([*lines, *(f"    {line}" for line in tail)]) + "\n", space)
        )
        LOOPS.append(Loop(name, run, self.law))
        return run

    def _read(self, name: str, space: dict[str, Any]) -> str:
        """The statement that reads what is the same in all lanes, before the loop."""
        kind = self.hints[name]
        if not is_record(kind) and not get_args(kind):
            return f"{name}_ = {name}"
        space[f"read_{name}"] = line_loader(kind)
        return f"{name}_ = read_{name}({name})"

    def _argument(self, name: str, space: dict[str, Any]) -> str:
        """What stands for an argument in the call of the law."""
        kind, layout = self.hints[name], self.layouts.get(name)
        if name in self.uniform or name in self.static or kind is Any:
            return name
        if layout is FLAGS or kind is float or kind is int:
            return f"{name}[lane]"
        if kind is bool:
            return f"({name}[lane] > 0.0)"
        space[f"load_{name}"] = loader(kind, layout)
        return f"load_{name}({name}, lane)"

    def _store(self, sink: str, kind: Any, value: str, space: dict[str, Any]) -> str:
        if kind in (float, int):
            return f"{sink}[lane] = {value}"
        layout = self.layouts.get(sink)
        if self.keep:
            space[f"keep_{sink}"] = keeper(kind, layout)
            return f"keep_{sink}({sink}, lane, {self.keep}[lane] > 0.0, {value})"
        space[f"store_{sink}"] = storer(kind, layout, self.bounds)
        return f"store_{sink}({sink}, lane, {value})"

    def _sum(
        self, values: list[str], head: list[str], body: list[str], space: dict[str, Any]
    ) -> list[str]:
        """The statements that return sums over the lanes."""
        if not values:
            return []
        (kind,) = self.sums
        counts = [f"n{k}" for k in range(len(parts(kind)))]
        head.append(f"{' = '.join(counts)} = 0")
        for count, (path, _) in zip(counts, parts(kind), strict=True):
            body.append(f"{count} += {values[0]}{path}")
        if not is_record(kind):
            return ["return n0"]
        space[kind.__name__] = kind
        return [f"return {kind.__name__}({', '.join(counts)})"]


def _dispatch(made: _Maker, chosen: list[str], runs: dict[tuple[int, ...], Any]) -> Any:
    """The function that calls the loop of the constants given."""
    space: dict[str, Any] = {}
    rest = ", ".join(name for name in made.arguments if name not in chosen)
    lines, word = [f"def {made.name}({', '.join(made.arguments)}):"], "if"
    for k, (values, run) in enumerate(runs.items()):
        space[f"run_{k}"] = run
        if k + 1 < len(runs):
            test = " and ".join(f"{n} == {v}" for n, v in zip(chosen, values, strict=True))
            lines += [f"    {word} {test}:", f"        return run_{k}({rest})"]
        else:
            lines.append(f"    return run_{k}({rest})")
    return device(define(made.name, "\n".join(lines) + "\n", space))
