"""Families of trajectories: position and four derivatives in closed form, and what their tables may hold.

A trajectory is a kind, the number of a row of `FAMILIES`, and a table of numbers, so that a kernel can
evaluate another one per world:

| kind         | table                                                                    |
|--------------|--------------------------------------------------------------------------|
| `SINES`      | `K`, centre (3), drift (3), then `K` x (amplitude, rate, phase) per axis  |
| `LEMNISCATE` | size `a`, speed `V`, height, `cos` and `sin` of the turn                  |
| `SPLINE`     | `n`, `n + 1` break points, then per piece and axis 8 powers of `t - t_i`  |

Everything is in the inertial frame (north, east, down): metres, seconds, radians; a height of 1.5 m
is `p_z = -1.5`. The tables are made by `trajectories` and `splines`. `tables` checks them, by the functions
that stand here beside the formulas.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, exp, inf, perm, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device, device_as_generated
from formation_env.maths.so3 import ZERO, Vector
from formation_env.memory.records import define
from formation_env.validation.checks import number, refuse, require

Floats = NDArray[np.float64]
Five = tuple[float, float, float, float, float]

LARGEST = 1e15  # m, m/s, m/s^2, m/s^3, m/s^4, rad/s and s
MOST_HARMONICS = 1000  # sines per axis
MOST_ROWS = 100_000  # break points of a spline: a thousand seconds at 100 Hz
TERMS = 8  # coefficients of a piece of a spline: degree 7


class TrajectoryPoint(NamedTuple):
    """A point of a trajectory and its time derivatives, inertial frame."""

    p: Vector  # m
    v: Vector  # m/s
    a: Vector  # m/s^2
    j: Vector  # m/s^3
    s: Vector  # m/s^4


def by_name(points: Floats) -> dict[str, Floats]:
    """The fields of `TrajectoryPoint` as views `(..., 3)` of what a trajectory returns, `(..., 5, 3)`."""
    return {name: points[..., k, :] for k, name in enumerate(TrajectoryPoint._fields)}


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


@device
def _by_derivative(x: Five, y: Five, z: Five) -> TrajectoryPoint:
    """Derivatives 0 to 4 of each axis, regrouped as vectors."""
    return TrajectoryPoint(
        (x[0], y[0], z[0]),
        (x[1], y[1], z[1]),
        (x[2], y[2], z[2]),
        (x[3], y[3], z[3]),
        (x[4], y[4], z[4]),
    )


@device
def _sines_axis(table: Floats, axis: int, t: float) -> Five:
    harmonics = int(table[0])
    p, v = table[1 + axis] + table[4 + axis] * t, table[4 + axis]
    a = j = s = 0.0
    for k in range(harmonics):
        i = 7 + 3 * (axis * harmonics + k)
        amplitude, rate, phase = table[i], table[i + 1], table[i + 2]
        angle = rate * t + phase
        x, y = amplitude * sin(angle), amplitude * rate * cos(angle)
        square = rate * rate
        p += x
        v += y
        a -= square * x
        j -= square * y
        s += square * square * x
    return (p, v, a, j, s)


@device_as_generated  # by the random paths of recorded flights
def _sines(table: Floats, t: float) -> TrajectoryPoint:
    """`centre + drift t + sum of amplitude sin(rate t + phase)`, axis by axis."""
    return _by_derivative(
        _sines_axis(table, 0, t), _sines_axis(table, 1, t), _sines_axis(table, 2, t)
    )


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


_MOST_LOOPS = 100  # of the slowest sine in a path's period


def _period_of_sines(table: Floats) -> float:
    """The least time after which all sines begin anew; infinite with a drift, or where none is found."""
    waves = np.abs(table[7:].reshape(-1, 3))
    rates = np.unique(waves[waves[:, 0] * waves[:, 1] > 0.0, 1])
    if len(rates) == 0 or np.any(table[4:7] != 0.0):
        return inf
    for loops in range(1, _MOST_LOOPS + 1):
        turns = loops * rates / rates[0]
        if np.all(np.abs(turns - np.round(turns)) <= 1e-9 * turns):
            return float(2.0 * pi * loops / rates[0])
    return inf


def _fastest_sine(table: Floats) -> float:
    waves = np.abs(table[7:].reshape(-1, 3))
    return float(waves[waves[:, 0] > 0.0, 1].max(initial=0.0))


# Jacobi's amplitude for the parameter m = -1: its quarter period K(-1), half of the lemniscate
# constant, and the coefficients 2 q^n / (n (1 + q^2n)) of its Fourier series, with the nome
# q = exp(-pi K(1 - m) / K(m)) = -exp(-pi). The thirteenth is below 1e-18.
_QUARTER = 1.3110287771460599
_FOURIER = tuple(2.0 * (-exp(-pi)) ** n / (n * (1.0 + exp(-2.0 * pi * n))) for n in range(1, 13))


@device
def amplitude(u: float) -> float:
    """`am(u | m = -1)`: the solution of `phi' = sqrt(1 + sin^2 phi)`, `phi(0) = 0`.

    Fourier series `pi u / 2K + sum c_n sin(n pi u / K)`, summed as a polynomial in
    `exp(j pi u / K)` (Horner); exact to rounding for every `u`, unlike an integration.
    """
    x = pi * u / _QUARTER
    turn = complex(cos(x), sin(x))
    total = 0j
    for n in range(len(_FOURIER) - 1, -1, -1):
        total = (total + _FOURIER[n]) * turn
    return 0.5 * x + total.imag


@device
def _lemniscate(table: Floats, t: float) -> TrajectoryPoint:
    """The lemniscate (70), as corrected in the errata, at constant speed `V`.

    With `phi = gamma / 3`, `s = sin phi` and `c = V / a` the curve is
    `z = a cos(phi) (1 + j s) / (1 + s^2)` and `phi' = c sqrt(1 + s^2)`. Its polar angle `h` has
    `exp(j h) = (1 + j s) / sqrt(1 + s^2)` and its signed radius is `a w`,
    `w = cos(phi) / sqrt(1 + s^2)`, `w^2 = cos 2h`. Then, with `E = exp(3j h)`,

        h' = c w        w' = -c sin 2h        w'' = -2 c^2 w^3
        z' = j V E      z'' = -3 V c w E      z''' = -3 V c (w' + 3j c w^2) E
        z'''' = -3 V c (9j c w w' - 11 c^2 w^3) E
    """
    a, V = table[0], table[1]
    c = V / a
    phi = amplitude(c * t)
    s = sin(phi)
    n = sqrt(1.0 + s * s)
    w = cos(phi) / n
    e = complex(1.0 / n, s / n)
    turn = complex(table[3], table[4])
    w1 = -2.0 * c * e.real * e.imag
    E = turn * e * e * e
    p = a * w * turn * e
    v = 1j * V * E
    k = -3.0 * V * c
    acceleration = k * w * E
    jerk = k * complex(w1, 3.0 * c * w * w) * E
    snap = k * complex(-11.0 * c * c * w * w * w, 9.0 * c * w * w1) * E
    return TrajectoryPoint(
        (p.real, p.imag, -table[2]),
        (v.real, v.imag, 0.0),
        (acceleration.real, acceleration.imag, 0.0),
        (jerk.real, jerk.imag, 0.0),
        (snap.real, snap.imag, 0.0),
    )


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


def _period_of_lemniscate(table: Floats) -> float:
    """Four quarter periods of the amplitude are one turn of `phi`."""
    return float(4.0 * _QUARTER * table[0] / table[1])


def _fastest_turn(table: Floats) -> float:
    return float(3.0 * table[1] / table[0])


@device
def _piece(table: Floats, t: float) -> int:
    """Which piece of a spline holds `t` (binary search); the first or last one beyond its ends."""
    low, high = 0, int(table[0])
    while high - low > 1:
        middle = (low + high) // 2
        if t < table[1 + middle]:
            high = middle
        else:
            low = middle
    return low


@device
def _powers(table: Floats, start: int, x: float) -> Five:
    """A polynomial and its derivatives at `x`, from 8 coefficients in rising powers (Horner)."""
    p = v = a = j = s = 0.0
    for k in range(TERMS - 1, -1, -1):
        s = s * x + j
        j = j * x + a
        a = a * x + v
        v = v * x + p
        p = p * x + table[start + k]
    # Horner's scheme carries the k-th derivative divided by k!.
    return (p, v, 2.0 * a, 6.0 * j, 24.0 * s)


@device
def _spline(table: Floats, t: float) -> TrajectoryPoint:
    """Piecewise polynomial of degree 7; at rest at its end points before and after its time."""
    pieces = int(table[0])
    first, last = table[1], table[1 + pieces]
    inside = min(max(t, first), last)
    i = _piece(table, inside)
    x = inside - table[1 + i]
    start = 2 + pieces + 3 * TERMS * i
    r = _by_derivative(
        _powers(table, start, x),
        _powers(table, start + TERMS, x),
        _powers(table, start + 2 * TERMS, x),
    )
    if t < first or t > last:
        return TrajectoryPoint(r.p, ZERO, ZERO, ZERO, ZERO)
    return r


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


class Family(NamedTuple):
    """A row of the table: a kind of trajectory."""

    name: str
    point: Any  # (table, t): a `TrajectoryPoint`; compiled
    check: Callable[[str, Floats], None]  # (name, table): refuses what is none of its tables
    reach: Callable[[Floats, float], Floats]  # (table, duration): see `tables.reach`
    fastest: (
        Callable[[Floats], float] | None
    )  # (table): rad/s, of all that swings; None: it has pieces
    period: Callable[[Floats], float]  # (table): s, after which the path repeats itself; inf: never


FAMILIES = (
    Family("sines", _sines, _check_sines, _reach_sines, _fastest_sine, _period_of_sines),
    Family(
        "lemniscate",
        _lemniscate,
        _check_lemniscate,
        _reach_lemniscate,
        _fastest_turn,
        _period_of_lemniscate,
    ),
    Family("spline", _spline, _check_spline, _reach_spline, None, lambda table: inf),
)
SINES, LEMNISCATE, SPLINE = range(3)


def _by_kind() -> Any:
    """`evaluate(kind, table, t)`: the trajectory at time `t` (s), position and derivatives; compiled code."""
    head = "def evaluate(kind, table, t):\n"
    head += (
        '    """The trajectory at time `t` (s): position and its derivatives up to the fourth."""\n'
    )
    others = [
        f"    if kind == {kind}:\n        return point_{kind}(table, t)\n"
        for kind in range(1, len(FAMILIES))
    ]
    points = {f"point_{kind}": family.point for kind, family in enumerate(FAMILIES)}
    source = head + "".join(others) + "    return point_0(table, t)\n"
    return device(define("evaluate", source, points))


evaluate = _by_kind()

_AT_REST = 1e-6  # m/s, m/s^2, ...; a spline of samples is at rest only to its own accuracy


@device
def start_direction(kind: int, table: Floats, t: float) -> complex:
    """Unit vector of the planar direction in which the trajectory leaves at `t` (s) (II-E).

    Along the velocity, or, where it starts at rest, along the first derivative that is not zero,
    which is the limit of the direction from later times. North if the trajectory stands still.
    """
    r = evaluate(kind, table, t)
    for x in (r.v, r.a, r.j, r.s):
        size = sqrt(x[0] * x[0] + x[1] * x[1])
        if size > _AT_REST:
            return complex(x[0] / size, x[1] / size)
    return complex(1.0, 0.0)
