"""What several tests share: numbers to draw, a smooth leader, and how fast something changes.

The closed loops themselves are written out in the test modules, from the paper's equations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from hypothesis import settings
from hypothesis import strategies as st

Array = npt.NDArray[np.float64]
Flow = Callable[[Array], Array]

PROPERTY = settings(max_examples=40)


def numbers(limit: float) -> st.SearchStrategy[float]:
    """Floats in [-limit, limit], without denormals."""
    return st.floats(-limit, limit, allow_subnormal=False)


def vectors(limit: float) -> st.SearchStrategy[tuple[float, float, float]]:
    return st.tuples(numbers(limit), numbers(limit), numbers(limit))


def quaternions() -> st.SearchStrategy[Any]:
    """Unit quaternions, the half-way and the upside-down ones among them."""
    raw = st.tuples(numbers(1.0), numbers(1.0), numbers(1.0), numbers(1.0))
    large = raw.filter(lambda q: float(np.linalg.norm(q)) > 0.1)
    return large.map(lambda q: vector(np.array(q) / np.linalg.norm(q)))


def vector(a: Any) -> Any:
    """A tuple of floats of the length of `a`, as the kernels take vectors and quaternions."""
    return tuple(float(x) for x in a)


def hat(a: Any) -> Array:
    """The matrix `S(a)`."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def rate(quantity: Flow, x: Array, x_dot: Array, h: float = 1e-3) -> Array:
    """Time derivative of `quantity` at `x` while the state moves with velocity `x_dot`.

    A central difference of fourth order along the tangent. The motion itself curves away from it
    only at second order, which the derivative at `x` does not see.
    """

    def at(s: float) -> Array:
        return np.asarray(quantity(x + s * x_dot), dtype=float)

    return (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h)


def agree(measured: Any, expected: Any, tolerance: float = 1e-7) -> None:
    """Equal up to `tolerance` of the largest entry, or of one where all are smaller."""
    a, b = np.asarray(measured, dtype=float), np.asarray(expected, dtype=float)
    np.testing.assert_allclose(a, b, rtol=0.0, atol=tolerance * max(1.0, float(np.abs(b).max())))


class Sines:
    """A point moving on sums of two sines per axis: every derivative in one line."""

    def __init__(self, seed: int, size: float = 1.0) -> None:
        draw = np.random.default_rng(seed)
        self.amplitude = size * draw.uniform(0.4, 1.0, (3, 2))
        self.frequency = draw.uniform(0.4, 1.4, (3, 2))
        self.phase = draw.uniform(0.0, 2.0 * np.pi, (3, 2))

    def at(self, t: float) -> tuple[Any, ...]:
        """Position and its first four derivatives, m, s."""
        w = self.frequency
        angle = w * t + self.phase
        terms = [self.amplitude * w**n * np.sin(angle + 0.5 * np.pi * n) for n in range(5)]
        return tuple(vector(term.sum(axis=1)) for term in terms)
