"""The classical Runge-Kutta step, written once for every state that is a NamedTuple of numbers.

    a = f(x, u_0)    b = f(x + h/2 a, u_1)    c = f(x + h/2 b, u_1)    e = f(x + h c, u_2)
    x(t + h) = x + h/6 a + h/3 b + h/3 c + h/6 e

for `x_dot = f(x, u)`, with `u_0`, `u_1`, `u_2` what drives the state at the start, in the middle and at
the end of the step. Fourth order, error of one step of order `h^5`.
"""

from __future__ import annotations

import linecache
from collections.abc import Callable
from typing import Any, TypeVar, get_args, get_type_hints

from formation_env._jit import device

State = TypeVar("State")


def _moved(kind: Any, x: str, rate: str, types: dict[str, Any]) -> str:
    """The source of `x + h rate` for a value of type `kind`; the NamedTuples in it go into `types`."""
    if kind is float:
        return f"{x} + h * {rate}"
    if kind is complex:  # by parts: with a complex `h` the compiler would multiply by its zero
        return f"complex({x}.real + h * {rate}.real, {x}.imag + h * {rate}.imag)"
    if hasattr(kind, "_fields"):
        types[kind.__name__] = kind
        fields = get_type_hints(kind).items()
        parts = [_moved(part, f"{x}.{name}", f"{rate}.{name}", types) for name, part in fields]
        return f"{kind.__name__}({', '.join(parts)})"
    parts = [_moved(part, f"{x}[{k}]", f"{rate}[{k}]", types) for k, part in enumerate(get_args(kind))]
    if not parts:
        raise TypeError(f"{kind!r}: expected float, complex, a tuple or a NamedTuple of these")
    return f"({', '.join(parts)},)"


def along(kind: type[State]) -> Callable[[State, float, State], State]:
    """`along(State)(x, h, rate)` is `x + h rate`, number by number, made from the fields of `State`."""
    types: dict[str, Any] = {}
    source = f"def along(x, h, rate):\n    return {_moved(kind, 'x', 'rate', types)}\n"
    name = f"<along {kind.__qualname__}>"
    # For tracebacks and the debugger.
    linecache.cache[name] = (len(source), None, source.splitlines(keepends=True), name)
    exec(compile(source, name, "exec"), types)
    return device(types["along"])  # type: ignore[no-any-return]


def runge_kutta(rate: Callable[..., State], kind: type[State]) -> Callable[..., State]:
    """`step(x, h, start, middle, end, *constants)`: the state `h` seconds later.

    `rate(x, u, *constants)` is its time derivative, a `kind` as `x` is; `start`, `middle` and `end` are
    `u` at the three instants.
    """
    moved = along(kind)

    @device
    def step(x: Any, h: float, start: Any, middle: Any, end: Any, *constants: Any) -> Any:
        a = rate(x, start, *constants)
        b = rate(moved(x, 0.5 * h, a), middle, *constants)
        c = rate(moved(x, 0.5 * h, b), middle, *constants)
        e = rate(moved(x, h, c), end, *constants)
        return moved(moved(moved(moved(x, h / 6.0, a), h / 3.0, b), h / 3.0, c), h / 6.0, e)

    return step
