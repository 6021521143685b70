"""Logarithm, sine and cosine that the compiler can vectorise: polynomials, no calls, no branches.

The library's own are called one number at a time, which keeps a loop over worlds from becoming vector
code. `sin_cos` has the coefficients of Sun's fdlibm (`k_sin.c`, `k_cos.c`), good to the last digit or two
of float64. The other two serve the normal numbers and are in float32, of which a register holds twice
as many: polynomials through the Chebyshev nodes, evaluated in pairs of terms, since the next number
waits for a long chain. No sum in them is of two products, of which the compiler would fuse now one and
now the other: they round alike in every loop, to which a digit of float32 matters.
"""

from __future__ import annotations

from math import pi

import numpy as np

from formation_env._jit import device

Single = np.float32

# The layout of float32.
_FRACTION_BITS, _FRACTION = np.int32(23), np.int32(0x007FFFFF)
_ROOT_HALF = np.int32(0x3F3504F3)  # the bits of sqrt(1/2)

_HALF_PI_HIGH = 1.57079632673412561417  # the first 33 bits of pi / 2
_HALF_PI_LOW = 6.07710050650619224932e-11  # and what is left


@device
def pick(condition: bool, a: float, b: float) -> float:
    """`a` if the condition holds, else `b`; both are computed, so that the compiler can vectorise it."""
    return a if condition else b


@device
def log_of_unit(u: Single) -> Single:
    """Natural logarithm of `u` in (0, 1], to a relative error of some 1e-7.

    `u = 2^e (1 + f)` with `1 + f` between the roots of 1/2 and 2, read off the bits of `u`. The
    polynomial is that of `(log(1 + f) - f) / f^2`, and `e` is zero near `u = 1`: the error stays relative.
    """
    bits = np.int32(Single(u).view(np.int32) - _ROOT_HALF)
    e = Single(np.int32(bits >> _FRACTION_BITS))
    f = np.int32((bits & _FRACTION) + _ROOT_HALF).view(np.float32) - Single(1.0)
    z = f * f
    low = (Single(-0.49999997133) + Single(0.33333670610) * f) + z * (
        Single(-0.25001147678) + Single(0.19972049710) * f
    )
    high = (Single(-0.16588488532) + Single(0.14834786820) * f) + z * (
        Single(-0.14159647010) + Single(0.08787265491) * f
    )
    return e * Single(0.69314718056) + (f + z * (low + (z * z) * high))


@device
def sin_cos_of_octant(a: Single) -> tuple[Single, Single]:
    """Sine and cosine of `a`, `|a| <= pi / 4`, to an absolute error of some 1e-7."""
    z = a * a
    s = z * (Single(-0.16666664662) + z * (Single(0.00833274827) - Single(0.00019587890880) * z))
    c = (Single(-0.49999999969) + Single(0.04166665064) * z) + (z * z) * (
        Single(-0.0013887589156) + Single(0.00002446378829) * z
    )
    return a + a * s, Single(1.0) + z * c


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
def sin_cos(x: float) -> tuple[float, float]:
    """Sine and cosine of `x` rad, for `|x|` up to some thousands."""
    n = np.floor(x * (2.0 / pi) + 0.5)
    s, c = _sin_cos_near_zero((x - n * _HALF_PI_HIGH) - n * _HALF_PI_LOW)
    return _turn_quarters(s, c, n)
