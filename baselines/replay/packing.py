"""Columns of numbers made small, for a page that unpacks them with `DecompressionStream`.

Each array is counted in steps of its own size, from row to row the differences are taken, signs are folded
in (0, -1, 1, -2, ... become 0, 1, 2, 3, ...) and the four bytes of the numbers are laid out one kind after
the other, column by column: smooth motion leaves mostly zeros, which deflate removes. `web/data.js` is
the inverse.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_LARGEST = 2**30  # steps from zero, which differences of two still hold


class Packed(NamedTuple):
    """Arrays as text, and how to read them."""

    blocks: list[dict[str, Any]]  # of each array: name, rows, columns, step
    text: str  # base64 of all of them deflated, in order


def pack(arrays: Mapping[str, tuple[NDArray[Any], float]]) -> Packed:
    """Arrays `(rows, ...)` and their steps by name; a number is off by at most half a step.

    A number that is not finite is taken as the one before it, or 0.
    """
    blocks, parts = [], []
    for name, (array, step) in arrays.items():
        table = np.asarray(array, dtype=np.float64).reshape(len(array), -1)
        blocks.append({"name": name, "rows": len(table), "columns": table.shape[1], "step": step})
        parts.append(_bytes(_filled(table), step))
    data = zlib.compress(b"".join(parts), 9)
    return Packed(blocks, base64.b64encode(data).decode("ascii"))


def _filled(table: NDArray[np.float64]) -> NDArray[np.float64]:
    good = np.isfinite(table)
    if good.all():
        return table
    last = np.maximum.accumulate(np.where(good, np.arange(len(table))[:, None], 0), axis=0)
    filled = np.take_along_axis(table, last, axis=0)
    return np.where(np.isfinite(filled), filled, 0.0)


def _bytes(table: NDArray[np.float64], step: float) -> bytes:
    counts = np.clip(np.rint(table / step), -_LARGEST, _LARGEST).astype(np.int32)
    steps = np.diff(counts, axis=0, prepend=np.zeros((1, counts.shape[1]), dtype=np.int32)).T
    folded = ((steps << 1) ^ (steps >> 31)).astype("<u4")
    return folded.reshape(-1, 1).view(np.uint8).T.tobytes()


def deflated(text: str) -> str:
    """A text in UTF-8, deflated, as base64."""
    return base64.b64encode(zlib.compress(text.encode("utf-8"), 9)).decode("ascii")
