"""The Runge-Kutta step against solutions that are known, for every kind of state."""

from __future__ import annotations

import traceback
from math import cos, exp, sin
from typing import NamedTuple

import numpy as np
import pytest

from formation_env._jit import device
from formation_env.maths.runge_kutta import along, runge_kutta


class Inner(NamedTuple):
    """A pair of numbers within a state."""

    pair: tuple[float, float]


class Mixed(NamedTuple):
    """One field of each kind."""

    x: float
    z: complex
    inner: Inner


def numbers(m: Mixed) -> np.ndarray:
    return np.array([m.x, m.z.real, m.z.imag, *m.inner.pair])


@device
def powers(_x: Mixed, t: float, k: float) -> Mixed:
    """A rate of time alone: `k t^3` and lower powers."""
    return Mixed(k * t * t * t, complex(t * t, k * t), Inner((k, t * t * t - t)))


def test_a_step_integrates_cubics_exactly() -> None:
    """Simpson's rule, which the step is for a rate of time alone, is exact up to the third power."""
    step = runge_kutta(powers, Mixed)
    t, h, k = 0.7, 1.3, 2.5
    e = t + h
    found = step(Mixed(1.0, 2.0 - 3.0j, Inner((4.0, 5.0))), h, t, t + 0.5 * h, e, k)
    rise = [(e**n - t**n) / n for n in range(1, 5)]
    expected = [
        1.0 + k * rise[3],
        2.0 + rise[2],
        -3.0 + k * rise[1],
        4.0 + k * rise[0],
        5.0 + rise[3] - rise[1],
    ]
    np.testing.assert_allclose(numbers(found), expected, rtol=1e-13)


@device
def decay(m: Mixed, pull: float) -> Mixed:
    """`x_dot = -pull x`, `z_dot = j z`, and a harmonic oscillator."""
    a, b = m.inner.pair
    return Mixed(-pull * m.x, complex(-m.z.imag, m.z.real), Inner((b, -a)))


def test_of_fourth_order() -> None:
    step, errors, steps = runge_kutta(decay, Mixed), [], np.array([8, 16, 32])
    for n in steps:
        m = Mixed(1.0, 1.0 + 0.0j, Inner((1.0, 0.0)))
        for _ in range(n):
            m = step(m, 1.0 / n, 0.5, 0.5, 0.5)
        exact = [exp(-0.5), cos(1.0), sin(1.0), cos(1.0), -sin(1.0)]
        errors.append(np.abs(numbers(m) - exact))
    orders = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert orders == pytest.approx(np.full(5, 4.0), abs=0.2)


def test_along_adds_every_number() -> None:
    x, rate = Mixed(1.0, 2.0 + 3.0j, Inner((4.0, 5.0))), Mixed(6.0, 7.0 - 8.0j, Inner((9.0, -1.0)))
    assert along(Mixed)(x, 0.5, rate) == Mixed(4.0, 5.5 - 1.0j, Inner((8.5, 4.5)))


def test_what_is_no_state_is_refused() -> None:
    class Text(NamedTuple):
        name: str

    with pytest.raises(TypeError, match="expected numbers"):
        along(Text)


def test_its_source_shows_in_tracebacks() -> None:
    plain = getattr(along(Mixed), "py_func", along(Mixed))
    with pytest.raises(AttributeError) as caught:
        plain(None, 1.0, None)
    assert "x.x + h * rate.x" in "".join(traceback.format_exception(caught.value))
