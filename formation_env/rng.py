"""Random numbers inside the kernels: a counter-based generator, Philox4x32-10.

A draw is a pure function of a 64-bit key (one per episode of a world) and a counter that says what
the draw is for. Nothing is stored and nothing is drawn in sequence, so the numbers a world sees do
not depend on how many worlds there are, on threads, or on which noise is switched on.

Source: J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as
1, 2, 3", SC11, 2011. Tested against the known-answer vectors published with it.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from formation_env._jit import device
from formation_env.elementary import log_of_unit, sin_cos_of_turn

Four = tuple[float, float, float, float]

# Purposes: the third word of the counter, so that no two uses share a draw.
START, TRAJECTORY, MEASUREMENT, GUST, POLICY = 0, 1, 2, 3, 4

_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_UNIT = 1.0 / 4294967296.0


@device
def philox(c0: Any, c1: Any, c2: Any, c3: Any, k0: Any, k1: Any) -> tuple[Any, Any, Any, Any]:
    """Ten rounds of Philox4x32 on 32-bit words held in uint64; returns four of them."""
    for _ in range(10):
        a, b = _M0 * c0, _M1 * c2
        c0, c1, c2, c3 = (b >> _HALF) ^ c1 ^ k0, b & _LOW, (a >> _HALF) ^ c3 ^ k1, a & _LOW
        k0, k1 = (k0 + _W0) & _LOW, (k1 + _W1) & _LOW
    return c0, c1, c2, c3


@device
def uniforms(key: int, purpose: int, who: int, when: int, block: int) -> Four:
    """Four numbers uniform in (0, 1), never 0 or 1.

    `key` identifies the episode, `purpose` what for, `who` the vehicle, `when` the tick or sample
    (each below 2^32) and `block` distinguishes several draws of the same kind.
    """
    k = np.uint64(key)
    a, b, c, d = philox(
        np.uint64(when),
        np.uint64(who),
        np.uint64(purpose),
        np.uint64(block),
        k & _LOW,
        k >> _HALF,
    )
    return (
        (float(a) + 0.5) * _UNIT,
        (float(b) + 0.5) * _UNIT,
        (float(c) + 0.5) * _UNIT,
        (float(d) + 0.5) * _UNIT,
    )


@device
def normals(key: int, purpose: int, who: int, when: int, block: int) -> Four:
    """Four standard normal numbers (Box-Muller on `uniforms`)."""
    a, b, c, d = uniforms(key, purpose, who, when, block)
    r, s = sqrt(-2.0 * log_of_unit(a)), sqrt(-2.0 * log_of_unit(b))
    sin_x, cos_x = sin_cos_of_turn(c)
    sin_y, cos_y = sin_cos_of_turn(d)
    return (r * cos_x, r * sin_x, s * cos_y, s * sin_y)
