"""A trajectory in kernels: position and derivatives up to the fourth, in closed form.

A trajectory is a kind and a table of numbers, so that a kernel can evaluate another one per world:

| kind         | table                                                                    |
|--------------|--------------------------------------------------------------------------|
| `SINES`      | `K`, centre (3), drift (3), then `K` x (amplitude, rate, phase) per axis  |
| `LEMNISCATE` | size `a`, speed `V`, height, `cos` and `sin` of the turn                  |
| `SPLINE`     | `n`, `n + 1` break points, then per piece and axis 8 powers of `t - t_i`  |

Everything is in the inertial frame (north, east, down): metres, seconds, radians; a height of 1.5 m
is `p_z = -1.5`. The tables are made by `trajectories` and `splines` and checked by `tables`.
"""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device, device_as_generated
from formation_env.so3 import ZERO, Vector

Floats = NDArray[np.float64]
Five = tuple[float, float, float, float, float]

SINES, LEMNISCATE, SPLINE = 0, 1, 2
TERMS = 8  # coefficients of a piece of a spline: degree 7


class TrajectoryPoint(NamedTuple):
    """A point of a trajectory and its time derivatives, inertial frame."""

    p: Vector  # m
    v: Vector  # m/s
    a: Vector  # m/s^2
    j: Vector  # m/s^3
    s: Vector  # m/s^4


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


@device
def evaluate(kind: int, table: Floats, t: float) -> TrajectoryPoint:
    """The trajectory at time `t` (s): position and its derivatives up to the fourth."""
    if kind == LEMNISCATE:
        return _lemniscate(table, t)
    if kind == SPLINE:
        return _spline(table, t)
    return _sines(table, t)


_AT_REST = 1e-6  # m/s, m/s^2, ...; a spline of samples is at rest only to its own accuracy


@device
def start_direction(kind: int, table: Floats) -> complex:
    """Unit vector of the planar direction in which the trajectory leaves at `t = 0` (II-E).

    Along the velocity, or, where it starts at rest, along the first derivative that is not zero,
    which is the limit of the direction for `t -> 0`. North if the trajectory stands still.
    """
    r = evaluate(kind, table, 0.0)
    for x in (r.v, r.a, r.j, r.s):
        size = sqrt(x[0] * x[0] + x[1] * x[1])
        if size > _AT_REST:
            return complex(x[0] / size, x[1] / size)
    return complex(1.0, 0.0)
