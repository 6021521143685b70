"""The classical Runge-Kutta step, written once for every state that is a record of numbers.

    a = f(x, u_0)    b = f(x + h/2 a, u_1)    c = f(x + h/2 b, u_1)    e = f(x + h c, u_2)
    x(t + h) = x + h/6 a + h/3 b + h/3 c + h/6 e

for `x_dot = f(x, u)`, with `u_0`, `u_1`, `u_2` what drives the state at the start, in the middle and at
the end of the step. Fourth order, error of one step of order `h^5`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from formation_env._jit import device
from formation_env.memory.records import build, define, parts


def along(kind: type) -> Any:
    """`along(kind)(x, h, rate)` is `x + h rate`, number by number; compiled code made from the fields."""
    names: dict[str, Any] = {}
    sums = [f"x{path} + h * rate{path}" for path, _ in parts(kind)]
    name = f"along_{kind.__name__}"
    source = f"def {name}(x, h, rate):\n    return {build(kind, sums, names)}\n"
    return device(define(name, source, names))


def runge_kutta(rate: Callable[..., Any], kind: type) -> Any:
    """`step(x, h, start, middle, end, *constants)`: the state `h` seconds later; compiled code.

    `rate(x, u, *constants)` is the time derivative of a state of type `kind`, of the same type; `start`,
    `middle` and `end` are `u` at the three instants.
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
