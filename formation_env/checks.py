"""Refusing bad arguments in one voice: `name = value: expected ...`, always a `ValueError`."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def require(condition: bool, name: str, value: object, expected: str) -> None:
    """Raise the `ValueError` that names an argument, its value and what was expected."""
    if not condition:
        raise ValueError(f"{name} = {value!r}: expected {expected}")


def number(name: str, value: Any, low: float = -inf, *, strict: bool = True) -> float:
    """`value` as a finite number above `low`, or at least `low` where not `strict`."""
    bound = "" if low == -inf else f" {'above' if strict else 'of at least'} {low:g}"
    real = isinstance(value, (int, float, np.integer, np.floating))
    good = real and not isinstance(value, bool) and bool(np.isfinite(value))
    good = good and bool(value > low if strict else value >= low)
    require(good, name, value, f"a finite number{bound}")
    return float(value)


def integer(name: str, value: Any, low: int, high: int | None = None) -> int:
    """`value` as a whole number from `low` to `high`."""
    real = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    good = real and value >= low and (high is None or value <= high)
    limits = f"of at least {low}" if high is None else f"from {low} to {high}"
    require(good, name, value, f"an integer {limits}")
    return int(value)


def vector(name: str, value: ArrayLike, size: int) -> NDArray[np.float64]:
    """`value` as `size` finite numbers."""
    expected = f"{size} finite numbers"
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} = {value!r}: expected {expected}") from error
    require(array.shape == (size,) and bool(np.isfinite(array).all()), name, value, expected)
    return array
