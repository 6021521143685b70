"""Logarithm, sine and cosine that the compiler can vectorise: polynomials, no calls, no branches.

The library's own are called one number at a time, which keeps a loop over worlds from becoming vector
code. The coefficients are those of Sun's fdlibm (`e_log.c`, `k_sin.c`, `k_cos.c`), good to the last digit
or two of float64.
"""

from __future__ import annotations

from math import pi

import numpy as np

from formation_env._jit import device
from formation_env.so3 import pick

_HALF_PI_HIGH = 1.57079632673412561417  # the first 33 bits of pi / 2
_HALF_PI_LOW = 6.07710050650619224932e-11  # and what is left


@device
def log_of_unit(u: float) -> float:
    """Natural logarithm of `u` in `[2^-33, 1]`."""
    e = 0.0
    for bits in (16.0, 8.0, 4.0, 2.0, 1.0, 1.0):
        small = u < 2.0**-bits
        u = pick(small, u * 2.0**bits, u)
        e = pick(small, e - bits, e)
    low = u < 0.70710678118654752440
    u = pick(low, 2.0 * u, u)
    e = pick(low, e - 1.0, e)
    f = u - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    even = w * (
        3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01)
    )
    odd = z * (
        6.666666666666735130e-01
        + w
        * (2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01))
    )
    half = 0.5 * f * f
    return e * 0.69314718055994530942 - ((half - s * (half + even + odd)) - f)


@device
def _sin_cos_near_zero(y: float) -> tuple[float, float]:
    """For `|y| <= pi / 4`."""
    z = y * y
    s = y + y * z * (
        -1.66666666666666324348e-01
        + z
        * (
            8.33333333332248946124e-03
            + z
            * (
                -1.98412698298579493134e-04
                + z
                * (
                    2.75573137070700676789e-06
                    + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
                )
            )
        )
    )
    c = (
        1.0
        - 0.5 * z
        + z
        * z
        * (
            4.16666666666666019037e-02
            + z
            * (
                -1.38888888888741095749e-03
                + z
                * (
                    2.48015872894767294178e-05
                    + z
                    * (
                        -2.75573143513906633035e-07
                        + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)
                    )
                )
            )
        )
    )
    return s, c


@device
def _turn_quarters(s: float, c: float, n: float) -> tuple[float, float]:
    """Sine and cosine after `n` quarter turns, a whole number."""
    quarter = n - 4.0 * np.floor(0.25 * n)
    odd = (quarter == 1.0) | (quarter == 3.0)
    a, b = pick(odd, c, s), pick(odd, s, c)
    return pick(quarter >= 2.0, -a, a), pick((quarter == 1.0) | (quarter == 2.0), -b, b)


@device
def sin_cos_of_turn(u: float) -> tuple[float, float]:
    """Sine and cosine of `2 pi u`, of a share `u` of a full turn; the reduction is exact."""
    n = np.floor(4.0 * u + 0.5)
    s, c = _sin_cos_near_zero((4.0 * u - n) * (0.5 * pi))
    return _turn_quarters(s, c, n)


@device
def sin_cos(x: float) -> tuple[float, float]:
    """Sine and cosine of `x` rad, for `|x|` up to some thousands."""
    n = np.floor(x * (2.0 / pi) + 0.5)
    s, c = _sin_cos_near_zero((x - n * _HALF_PI_HIGH) - n * _HALF_PI_LOW)
    return _turn_quarters(s, c, n)
