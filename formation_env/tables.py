"""What a trajectory's kind and table may hold: lengths, signs, and a path that stays finite.

`references` evaluates the tables and never looks whether they are long enough, so every table passes
through `checked` first. A path counts as finite while its position and derivatives up to the fourth
stay within `LARGEST`, for all times up to that many seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from math import perm
from typing import Any

import numpy as np

from formation_env.checks import array, choice, integer, number, refuse, require
from formation_env.references import LEMNISCATE, SINES, SPLINE, TERMS, Floats

LARGEST = 1e15  # m, m/s, m/s^2, m/s^3, m/s^4, rad/s and s
MOST_HARMONICS = 1000  # sines per axis
MOST_ROWS = 100_000  # break points of a spline: a thousand seconds at 100 Hz
KINDS = {"sines": SINES, "lemniscate": LEMNISCATE, "spline": SPLINE}
ABOVE_FLOOR = "a point above the floor: z points down, so that 1.5 m above it is p_z = -1.5"

_ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")
_UNITS = ("m", "m/s", "m/s^2", "m/s^3", "m/s^4")


def checked_kind(name: str, value: Any) -> int:
    """A kind of trajectory, by its number or its name."""
    if isinstance(value, str):
        return KINDS[choice(name, value, KINDS)]
    return integer(name, value, min(KINDS.values()), max(KINDS.values()))


def checked(name: str, kind: int, value: Any) -> Floats:
    """`value` as a table of that kind, a new array; raises `ValueError` naming the entry at fault."""
    table = array(name, value, (None,))
    _CHECKS[kind](name, table)
    return table


def reach(kind: int, table: Floats, duration: float = 0.0) -> Floats:
    """Bounds of the norms of position (from the origin) to snap in the first `duration` seconds.

    From the sizes of all terms, without looking at the path: it may stay far below them.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return _REACH[kind](table, duration)


def require_finite(path: str, kind: int, table: Floats) -> None:
    """Refuse a checked table whose path has a derivative beyond `LARGEST`; `path` is its name."""
    for order, unit, most in zip(_ORDERS, _UNITS, reach(kind, table), strict=True):
        expected = f"at most {LARGEST:g} {unit}: a slower, wider or nearer path"
        require(bool(most <= LARGEST), f"{order} of path {path}", float(most), expected)


def _length(name: str, table: Floats, wanted: int, what: str) -> None:
    """Refuse a table of another length than its first entry says."""
    if len(table) != wanted:
        raise ValueError(f"{name} = {len(table)} numbers: expected {wanted}, for {what}")


def _count(name: str, table: Floats, most: int, what: str) -> int:
    """The whole number that a table begins with."""
    first = float(table[0])
    expected = f"the number of {what}, a whole number from 1 to {most}"
    require(first == int(first) and 1 <= first <= most, f"{name}[0]", first, expected)
    return int(first)


def _check_sines(name: str, table: Floats) -> None:
    harmonics = _count(name, table, MOST_HARMONICS, "sines per axis")
    _length(name, table, 7 + 9 * harmonics, f"{harmonics} sines per axis")
    # A rate or phase beyond them is none that a sine can be taken of, whatever its amplitude.
    large = np.flatnonzero(np.abs(table) > LARGEST)
    if len(large):
        refuse(f"{name}[{large[0]}]", float(table[large[0]]), f"at most {LARGEST:g} in size")


def _reach_sines(table: Floats, duration: float) -> Floats:
    """The sums of the amplitudes times powers of their rates, beside centre and drift."""
    waves = np.abs(table[7:].reshape(-1, 3))
    powers = waves[:, 1] ** np.arange(5.0)[:, None]
    sums: Floats = (waves[:, 0] * powers).sum(axis=1)
    drift = np.linalg.norm(table[4:7])
    sums[0] += np.linalg.norm(table[1:4]) + drift * duration
    sums[1] += drift
    return sums


def _check_lemniscate(name: str, table: Floats) -> None:
    _length(name, table, 5, "size, speed, height, cos and sin of the turn")
    for i, what in enumerate(("size", "speed", "height")):
        number(f"{name}[{i}] ({what})", float(table[i]), 0.0, LARGEST)
    turned = abs(np.hypot(table[3], table[4]) - 1.0) <= 1e-9
    require(turned, f"{name}[3:5]", table[3:5].tolist(), "cos and sin of the turn")


def _reach_lemniscate(table: Floats, duration: float) -> Floats:
    """`|z''| <= 3 V c`, and so on from the formulas of `references`, with `c = V / a`."""
    c = table[1] / table[0]
    rates = np.array([1.0, 3.0 * c, 12.0 * c * c, 60.0 * c * c * c])
    return np.append(np.hypot(table[0], table[2]), table[1] * rates)


def _check_spline(name: str, table: Floats) -> None:
    pieces = _count(name, table, MOST_ROWS, "pieces")
    wanted = 2 + pieces + 3 * TERMS * pieces
    _length(name, table, wanted, f"{pieces} pieces of 3 polynomials of degree {TERMS - 1}")
    steps = np.diff(table[1 : pieces + 2])
    at = int(np.argmin(steps))
    require(bool(steps[at] > 0.0), f"{name}[{at + 2}]", float(table[at + 2]), "rising break points")
    ends = max(-table[1], table[pieces + 1], 0.0)
    require(
        bool(ends <= LARGEST), f"{name}: last break point", float(ends), f"at most {LARGEST:g} s"
    )
    # Horner's scheme meets the coefficients without the powers that make them small.
    large = np.flatnonzero(np.abs(table) > 1e300)
    if len(large):
        refuse(f"{name}[{large[0]}]", float(table[large[0]]), "at most 1e300 in size")


def _reach_spline(table: Floats, duration: float) -> Floats:
    """The sums of the sizes of all terms at the ends of the pieces."""
    pieces = int(table[0])
    terms = np.abs(table[pieces + 2 :].reshape(pieces, 3, TERMS))
    powers = np.diff(table[1 : pieces + 2])[:, None] ** np.arange(TERMS)
    sums = []
    for k in range(5):
        factors = [perm(m, k) for m in range(k, TERMS)]  # the k-th derivative of t^m
        sizes = np.einsum("iam,im->ia", terms[:, :, k:], factors * powers[:, : TERMS - k])
        sums.append(np.sqrt((sizes * sizes).sum(axis=1)).max())
    return np.array(sums)


_CHECKS: dict[int, Callable[[str, Floats], None]] = {
    SINES: _check_sines,
    LEMNISCATE: _check_lemniscate,
    SPLINE: _check_spline,
}
_REACH: dict[int, Callable[[Floats, float], Floats]] = {
    SINES: _reach_sines,
    LEMNISCATE: _reach_lemniscate,
    SPLINE: _reach_spline,
}
