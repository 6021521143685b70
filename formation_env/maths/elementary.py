"""Elementary functions that the compiler can vectorise: polynomials, no calls, no branches.

The library's own are called one number at a time, which keeps a loop over worlds from becoming vector
code. `sin_cos` has the coefficients of Sun's fdlibm (`k_sin.c`, `k_cos.c`); it and `tanh` are good to the
last digits of float64. The other two serve the normal numbers and are in float32, of which a register
holds twice as many: polynomials through the Chebyshev nodes, evaluated in pairs of terms, since the next
number waits for a long chain. No sum in them is of two products, of which the compiler would fuse now
one and now the other: they round alike in every loop, to which a digit of float32 matters.
"""

from __future__ import annotations

from math import log, pi

import numpy as np

from formation_env._jit import device

Single = np.float32

# The layout of float32.
_FRACTION_BITS, _FRACTION = np.int32(23), np.int32(0x007FFFFF)
_ROOT_HALF = np.int32(0x3F3504F3)  # the bits of sqrt(1/2)

_HALF_PI_HIGH = 1.57079632673412561417  # the first 33 bits of pi / 2
_HALF_PI_LOW = 6.07710050650619224932e-11  # and what is left

_LOG_2_HIGH = 6.93147180369123816490e-01  # the first 33 bits of log(2)
_LOG_2_LOW = 1.90821492927058770002e-10  # and what is left

# Added to a number of up to 51 bits, it leaves the whole number next to it in the last bits.
_ROUNDER = 6755399441055744.0  # 1.5 * 2^52
# The layout of float64.
_MANTISSA_BITS, _BIAS = np.int64(52), np.int64(1023)


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


@device
def phase(x: float) -> complex:
    """`exp(j x)`, the unit complex number of the angle `x` rad, for `|x|` up to some thousands."""
    s, c = sin_cos(x)
    return complex(c, s)


@device
def _exponential_minus_one(x: float) -> float:
    """`exp(x) - 1` for `-50 < x <= 0`, relative to itself good to the last digits.

    With `x = n log(2) + r` it is `2^n (exp(r) - 1) + (2^n - 1)`, without cancellation, and `2^n` is
    put together from its bits. The polynomial is that of `(exp(r) - 1 - r) / r^2`, `|r| <= log(2) / 2`.
    """
    shifted = x * (1.0 / log(2.0)) + _ROUNDER
    n = shifted - _ROUNDER
    r = (x - n * _LOG_2_HIGH) - n * _LOG_2_LOW
    z = r * r
    low = (0.5 + 1.6666666666666669e-01 * r) + z * (
        4.166666666662399e-02 + 8.333333333330051e-03 * r
    )
    high = (1.3888888917281794e-03 + 1.9841269863105968e-04 * r) + z * (
        (2.480152119021773e-05 + 2.7557268378684192e-06 * r)
        + z * (2.7620138719734004e-07 + 2.5100424157005073e-08 * r)
    )
    less_one = r + z * (low + (z * z) * high)
    exponent = np.int64(np.float64(shifted).view(np.int64) + _BIAS)
    power = np.int64(exponent << _MANTISSA_BITS).view(np.float64)
    return power * less_one + (power - 1.0)


@device
def tanh(x: float) -> float:
    """Hyperbolic tangent, `-m / (m + 2)` of `|x|` with `m = exp(-2 |x|) - 1`; from 20 on it is 1."""
    size = abs(x)
    m = _exponential_minus_one(-2.0 * pick(size > 20.0, 20.0, size))
    t = -m / (m + 2.0)
    return pick(x < 0.0, -t, t)
