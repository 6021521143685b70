"""Layers of a network for many rows, each computed as if it were alone.

The matrix routines behind NumPy sum in an order that depends on how many rows they are given and on
which of them a row is, so a policy's action would depend on how many fly beside it. Here rows lie side by
side in lanes that are all computed alike, and a sum goes over the inputs from the first to the last.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import kernel, loop
from formation_env.memory.shuffles import carve

Singles = NDArray[np.float32]

LANES = 32  # rows side by side
_LANES = np.uint64(LANES)
STEP = 4  # inputs and outputs are taken in fours; what is missing is zero


@loop
def _add(w: Any, a: Any, b: Any, x: Any, y: Any) -> None:
    """Four inputs' share, `x (4 L,)`, of four outputs, `y (4 L,)`. `w` has the weights of the first
    output from `a` on, and those of the next each `b` further."""
    w00, w01, w02, w03 = w[a], w[a + np.uint64(1)], w[a + np.uint64(2)], w[a + np.uint64(3)]
    a += b
    w10, w11, w12, w13 = w[a], w[a + np.uint64(1)], w[a + np.uint64(2)], w[a + np.uint64(3)]
    a += b
    w20, w21, w22, w23 = w[a], w[a + np.uint64(1)], w[a + np.uint64(2)], w[a + np.uint64(3)]
    a += b
    w30, w31, w32, w33 = w[a], w[a + np.uint64(1)], w[a + np.uint64(2)], w[a + np.uint64(3)]
    for lane in range(_LANES):
        second, third, fourth = (
            lane + _LANES,
            lane + np.uint64(2) * _LANES,
            lane + np.uint64(3) * _LANES,
        )
        x0, x1, x2, x3 = x[lane], x[second], x[third], x[fourth]
        y[lane] = y[lane] + w00 * x0 + w01 * x1 + w02 * x2 + w03 * x3
        y[second] = y[second] + w10 * x0 + w11 * x1 + w12 * x2 + w13 * x3
        y[third] = y[third] + w20 * x0 + w21 * x1 + w22 * x2 + w23 * x3
        y[fourth] = y[fourth] + w30 * x0 + w31 * x1 + w32 * x2 + w33 * x3


@kernel
def layer(weight: Singles, bias: Singles, x: Singles, y: Singles) -> None:
    """`y = W x + b` in every lane: `x (tiles, in, L)`, `y (tiles, out, L)`, `weight (out, in)`; `in`
    and `out` are multiples of `STEP`."""
    outputs, inputs = weight.shape
    w = carve(weight, 0, (outputs * inputs,))
    four = STEP * LANES
    for t in range(len(x)):
        for j in range(0, outputs, STEP):
            own = carve(y, (t * outputs + j) * LANES, (four,))
            for i in range(STEP):
                for lane in range(LANES):
                    own[i * LANES + lane] = bias[j + i]
            for k in range(0, inputs, STEP):
                part = carve(x, (t * inputs + k) * LANES, (four,))
                _add(w, np.uint64(j * inputs + k), np.uint64(inputs), part, own)


def padded(x: Singles) -> Singles:
    """A copy with zeros up to the next multiple of `STEP` along every axis."""
    return np.pad(x, [(0, -n % STEP) for n in x.shape]).astype(np.float32, order="C")


def spread(rows: Singles) -> Singles:
    """Rows `(N, entries)` side by side in lanes, `(tiles, entries, L)`, filled up with zeros."""
    count, size = rows.shape
    tiles = -(-count // LANES)
    whole = np.zeros((tiles * LANES, size + -size % STEP), dtype=np.float32)
    whole[:count, :size] = rows
    return np.ascontiguousarray(whole.reshape(tiles, LANES, -1).transpose(0, 2, 1))


def gathered(x: Singles, count: int, size: int) -> Singles:
    """The reverse of `spread`: the first `size` entries of `count` rows."""
    return x[:, :size].transpose(0, 2, 1).reshape(-1, size)[:count]
