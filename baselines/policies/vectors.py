"""Vectors in the last axis of arrays `(..., 3)`, and planar headings.

Element by element rather than by matrix routines, whose rounding depends on the number of rows: a world's
actions are then the same bit for bit, however many worlds are flown beside it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import plain
from formation_env.laws import slots

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_in_frame: Any = plain(slots.in_frame)
_out_of_frame: Any = plain(slots.out_of_frame)


def components(a: Floats) -> Any:
    """Vectors as a tuple of their components, as the scalar laws take them."""
    return tuple(np.moveaxis(a, -1, 0))


def joined(a: Any) -> Floats:
    """The inverse of `components`."""
    return np.stack(a, axis=-1)


def dot(a: Floats, b: Floats) -> Floats:
    """Scalar products."""
    product: Floats = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return product


def cross(a: Floats, b: Floats) -> Floats:
    """Vector products."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.stack((x, y, z), axis=-1)


def norm(a: Floats) -> Floats:
    """Lengths."""
    length: Floats = np.sqrt(dot(a, a))
    return length


def each(s: Any) -> Any:
    """Numbers `(...)` as factors of vectors `(..., 3)`."""
    return s[..., None]


def unit(a: Floats, otherwise: Floats) -> Floats:
    """Vectors divided by their length; `otherwise` where that is 0."""
    length = each(norm(a))
    return np.where(length > 0.0, a / np.where(length > 0.0, length, 1.0), otherwise)


def to_body(R: Floats, a: Floats) -> Floats:
    """`R^T a`, with the body axes as the columns of `R` `(..., 3, 3)`."""
    return np.stack([dot(R[..., :, k], a) for k in range(3)], axis=-1)


def to_inertial(R: Floats, a: Floats) -> Floats:
    """`R a`."""
    return np.stack([dot(R[..., k, :], a) for k in range(3)], axis=-1)


def in_frame(heading: Complexes, a: Floats) -> Floats:
    """Inertial components as those in {F}, whose heading is `exp(j theta)`; height unchanged."""
    return joined(_in_frame(heading, components(a)))


def out_of_frame(heading: Complexes, a: Floats) -> Floats:
    """Components in {F} as inertial ones; height unchanged."""
    return joined(_out_of_frame(heading, components(a)))
