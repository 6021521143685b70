"""Converting and checking what a user gives, in one voice: `name = value: expected ...`.

Every number and array of a public function passes through here, and what is returned, a plain `float`
or `int` or a float64 array, is what has to be stored: a NumPy scalar of eight bits would overflow
later. Values of another kind than asked for are refused, not guessed at: booleans, strings and complex
numbers are not numbers, and a masked entry is not one either. All raise `ValueError`; a keyword that
does not exist is a `TypeError`, as in Python itself. No message is longer than `LONGEST` characters.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, isfinite
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

LONGEST = 500  # characters of a message
_SHOWN = 120  # of a value in it

# By inheritance alone these are integers too.
_NO_INTEGERS = (bool, np.bool_, np.timedelta64)
_BYTES = (str, bytes, bytearray, memoryview)


class Within(NamedTuple):
    """The bounds of a number that users set: they annotate the field of a record, `Annotated[float, ...]`."""

    low: float
    high: float
    strict: bool = False  # whether `low` itself is excluded
    unit: str = "1"


class Unit(NamedTuple):
    """The unit of a number whose bounds are checked elsewhere: `Annotated[float, Unit("m/s^2")]`."""

    unit: str


def shown(value: object) -> str:
    """`value` for a message: its `repr` if that is short, else its beginning, or an array's shape."""
    if isinstance(value, np.ndarray) and value.size > 8:
        kind = "masked array" if isinstance(value, np.ma.MaskedArray) else "array"
        return f"{kind} of shape {value.shape}, dtype {value.dtype}"
    if isinstance(value, (list, tuple)) and len(value) > 32:
        kind = type(value).__name__
        return f"{kind} of {len(value)} entries, the first {shown(value[0])}"
    try:
        text = repr(value)
    except Exception:  # whatever a foreign `__repr__` or an integer of 10,000 digits raises
        text = f"<{type(value).__name__}>"
    text = " ".join(line.strip() for line in text.splitlines())  # an array's has several
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 4]} ..."


def shortened(message: str) -> str:
    """`message`, cut to `LONGEST` characters."""
    return message if len(message) <= LONGEST else f"{message[: LONGEST - 4]} ..."


def refuse(name: str, value: object, expected: str) -> NoReturn:
    """Raise the `ValueError` that names an argument, its value and what was expected."""
    raise ValueError(shortened(f"{name} = {shown(value)}: expected {expected}"))


def require(condition: bool, name: str, value: object, expected: str) -> None:
    """`refuse` unless the condition holds."""
    if not condition:
        refuse(name, value, expected)


def refuse_where(bad: NDArray[np.bool_], name: str, values: NDArray[Any], expected: str) -> None:
    """`refuse` the first of the `values` that is `bad`, with its index; nothing if none is."""
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        refuse(name + "".join(f"[{i}]" for i in index), values[index].item(), expected)


def unexpected_keyword(function: str, name: str, known: Iterable[str]) -> TypeError:
    """The error that Python itself raises for an unknown keyword, with the known ones after it."""
    message = f"{function}() got an unexpected keyword argument {name!r}: known are "
    return TypeError(shortened(message + ", ".join(known)))


def number(
    name: str, value: Any, low: float = -inf, high: float = inf, *, strict: bool = True
) -> float:
    """`value` as a finite `float` above `low`, or at least `low` where not `strict`, up to `high`."""
    real = _real(value)
    good = real is not None and (real > low if strict else real >= low) and real <= high
    if real is None or not good:
        refuse(name, value, "a finite number" + _limits(low, high, strict))
    return real


def integer(name: str, value: Any, low: int, high: int | None = None) -> int:
    """`value` as a whole number from `low` to `high`, an `int`."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, _NO_INTEGERS)
    if not whole or int(value) < low or (high is not None and int(value) > high):
        limits = f"of at least {low}" if high is None else f"from {low} to {high}"
        refuse(name, value, f"an integer {limits}")
    return int(value)


def boolean(name: str, value: Any) -> bool:
    """`value` as True or False; numbers are refused."""
    require(isinstance(value, (bool, np.bool_)), name, value, "True or False")
    return bool(value)


def choice(name: str, value: Any, allowed: Iterable[str]) -> str:
    """`value` as one of some names."""
    names = tuple(allowed)
    known = isinstance(value, str) and value in names
    require(known, name, value, "one of " + ", ".join(map(repr, names)))
    return str(value)


def array(
    name: str,
    value: Any,
    shape: tuple[int | None, ...] | None,
    low: float = -inf,
    high: float = inf,
    *,
    strict: bool = True,
) -> NDArray[np.float64]:
    """`value` as a new float64 array of finite numbers within bounds, as `number` has them.

    `shape` has None where any length from 1 is allowed, and is None where any shape is. An entry that
    is refused is named with its index, in a table with that of its row:
    `points[4000] = [0.0, nan, -1.0]: expected ...`.
    """
    expected = _shaped(shape)
    numbers = _floats(value)
    if numbers is None:
        index = _first_not_real(value)
        found = value
        for i in index[:1]:
            found, name = found[i], f"{name}[{i}]"
        refuse(name, found, expected)
    fits = shape is None or (
        numbers.ndim == len(shape)
        and all(x > 0 if n is None else x == n for x, n in zip(numbers.shape, shape, strict=True))
    )
    if not fits:
        found = value if numbers.size <= 8 else f"numbers of shape {numbers.shape}"
        message = f"{name} = {shown(found) if found is value else found}: expected {expected}"
        raise ValueError(message)
    good = np.isfinite(numbers) & (numbers > low if strict else numbers >= low) & (numbers <= high)
    if not good.all():
        first = tuple(int(i) for i in np.argwhere(~good)[0])
        where = first[:1] if numbers.ndim > 1 else first
        name += "".join(f"[{i}]" for i in where)
        refuse(name, numbers[where].tolist(), "finite numbers" + _limits(low, high, strict))
    return numbers


def vector(
    name: str, value: Any, size: int, low: float = -inf, high: float = inf, *, strict: bool = True
) -> NDArray[np.float64]:
    """`value` as `size` finite numbers within bounds: `array` of one axis."""
    return array(name, value, (size,), low, high, strict=strict)


def _shaped(shape: tuple[int | None, ...] | None) -> str:
    """What an array of some shape consists of, in words."""
    if shape is None:
        return "finite numbers"
    if len(shape) == 1 and shape[0] is not None:
        return f"{shape[0]} finite numbers"
    if len(shape) == 2 and shape[0] is None:
        return f"rows of {shape[1]} finite numbers"
    lengths = ", ".join("any" if n is None else str(n) for n in shape)
    return f"finite numbers of shape ({lengths}{',' if len(shape) == 1 else ''})"


def _limits(low: float, high: float, strict: bool) -> str:
    """Bounds in words."""
    text = "" if low == -inf else f" {'above' if strict else 'of at least'} {low:g}"
    above = "" if high == inf else f"{' and' if text else ''} at most {high:g}"
    return text + (above if text or not above else f" of{above}")


def _real(value: Any) -> float | None:
    """A real, finite number as `float`; None for anything else."""
    if isinstance(value, _NO_INTEGERS) or not isinstance(
        value, (int, float, np.integer, np.floating)
    ):
        return None
    try:
        real = float(value)
    except OverflowError:  # an integer beyond the range of float
        return None
    return real if isfinite(real) else None


def _floats(value: Any) -> NDArray[np.float64] | None:
    """`value` as a new float64 array, not checked for NaN and infinity; None if it is not of numbers."""
    rows = value if isinstance(value, (list, tuple)) else ()
    if _opaque(value) or any(map(_opaque, rows)):
        return None
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        with np.errstate(over="ignore"):  # a long double can be beyond the range of float64
            return np.array(value, dtype=np.float64, order="C", subok=False)
    try:
        numbers = np.array(value, dtype=object)
    except (TypeError, ValueError):  # rows of unequal length
        return None
    leaves = [_leaf(leaf) for leaf in numbers.ravel()]
    if any(leaf is None for leaf in leaves):
        return None
    return np.array(leaves, dtype=np.float64).reshape(numbers.shape)


def _opaque(value: Any) -> bool:
    """Whether NumPy would make numbers of what is none: of bytes, and of what a mask hides."""
    return isinstance(value, (*_BYTES, np.ma.MaskedArray))


def _leaf(value: Any) -> float | None:
    """A number as `float`, NaN and infinity included; None for what is not a number."""
    if isinstance(value, (float, np.floating)):
        return float(value)
    if isinstance(value, (int, np.integer)) and not isinstance(value, _NO_INTEGERS):
        try:
            return float(value)
        except OverflowError:
            return inf
    return None


def _first_not_real(value: Any) -> tuple[int, ...]:
    """Index of the first entry of a list of lists that is not made of numbers, or ()."""
    if not isinstance(value, (list, tuple)):
        return ()
    widths = [len(row) for row in value if _listed(row)]
    for i, row in enumerate(value):
        if _floats(row) is None or (_listed(row) and len(row) != widths[0]):
            return (i,)
    return ()


def _listed(row: Any) -> bool:
    """Whether an entry has entries of its own; an array without axes has none."""
    return isinstance(row, (list, tuple)) or (isinstance(row, np.ndarray) and row.ndim > 0)
