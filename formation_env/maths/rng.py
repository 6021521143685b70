"""Random numbers inside the kernels: a counter-based generator, Philox4x32-10.

A draw is a pure function of a 64-bit key (one per episode of a world) and a counter that says what
the draw is for. Nothing is stored and nothing is drawn in sequence, so the numbers a world sees do
not depend on how many worlds there are, on threads, or on which noise is switched on.

Source: J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as
1, 2, 3", SC11, 2011. Tested against the known-answer vectors published with it.
"""

from __future__ import annotations

from functools import partial
from math import pi
from typing import Any

import numpy as np

from formation_env._jit import cold, device
from formation_env.maths.elementary import Single, log_of_unit, sin_cos_of_octant

Four = tuple[float, float, float, float]

# Purposes: the third word of the counter, so that no two uses share a draw.
START, TRAJECTORY, MEASUREMENT, GUST, POLICY, COURSE = 0, 1, 2, 3, 4, 5

_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_EIGHT = np.uint64(8)
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


@partial(device, literal=False)
def words(key: int, purpose: int, who: int, when: int, block: int) -> tuple[Any, Any, Any, Any]:
    """Four random words of 32 bits.

    `key` identifies the episode, `purpose` what for, `who` the vehicle (each below 2^32), `when` the tick or
    sample (below 2^56) and `block` (below 2^8) distinguishes several draws of the same kind. What of `when`
    exceeds 32 bits goes into the word of `block`, which holds it above its own 8 bits.
    """
    k, t = np.uint64(key), np.uint64(when)
    # Where it is evident that a word has 32 bits its product is one instruction, else many.
    return philox(
        t & _LOW,
        np.uint64(who) & _LOW,
        np.uint64(purpose) & _LOW,
        (((t >> _HALF) << _EIGHT) | np.uint64(block)) & _LOW,
        k & _LOW,
        k >> _HALF,
    )


@cold
def uniforms(key: int, purpose: int, who: int, when: int, block: int) -> Four:
    """Four numbers uniform in (0, 1), never 0 or 1: the words of this draw."""
    a, b, c, d = words(key, purpose, who, when, block)
    return (
        (float(a) + 0.5) * _UNIT,
        (float(b) + 0.5) * _UNIT,
        (float(c) + 0.5) * _UNIT,
        (float(d) + 0.5) * _UNIT,
    )


@device
def as_single(word: Any) -> Any:
    """A word as the nearest float32; through int64, from which there is a vector instruction."""
    return Single(np.int64(word))


@device
def normal_pair(a: Any, b: Any) -> tuple[Any, Any]:
    """Two independent standard normal numbers in float32 from two words `as_single` (Box and Muller).

    With `u`, `v` uniform the radius is `sqrt(-2 log u)`. The angle is that of the middle of a quadrant
    plus a `turn` of up to 45 degrees: its cosine and sine are `(cos -+ sin) / sqrt(2)` of the turn with
    a sign each, and nothing has to be reduced or swapped. The signs are those of `v - 1/2` and of
    `|v - 1/2| - 1/4`, and what is left is the turn. A `u` near zero keeps its digits in float32, so
    that the tails are those of 32 bits: 6.7 standard deviations.
    """
    u, v = (a + Single(0.5)) * Single(_UNIT), (b + Single(0.5)) * Single(_UNIT)
    y = v - Single(0.5)
    x = abs(y) - Single(0.25)
    sine, cosine = sin_cos_of_octant((abs(x) - Single(0.125)) * Single(2.0 * pi))
    r = np.sqrt(-log_of_unit(u))
    return np.copysign(r * (cosine - sine), x), np.copysign(r * (cosine + sine), y)


@cold
def normals(key: int, purpose: int, who: int, when: int, block: int) -> Four:
    """Four standard normal numbers, of the resolution of float32."""
    a, b, c, d = words(key, purpose, who, when, block)
    w, x = normal_pair(as_single(a), as_single(c))
    y, z = normal_pair(as_single(b), as_single(d))
    return (np.float64(w), np.float64(x), np.float64(y), np.float64(z))
