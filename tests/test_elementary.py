"""The vectorisable logarithm, sine and cosine against the library's own."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from formation_env._jit import kernel
from formation_env.maths.elementary import (
    Single,
    log_of_unit,
    phase,
    sin_cos,
    sin_cos_of_octant,
    tanh,
)
from formation_env.paths.references import Floats

Singles = npt.NDArray[np.float32]


@kernel
def _evaluate(u: Singles, a: Singles, x: Floats) -> Floats:
    out = np.empty((5, len(u)))
    for k in range(len(u)):
        out[0, k] = log_of_unit(u[k])
        out[1, k], out[2, k] = sin_cos_of_octant(a[k])
        out[3, k], out[4, k] = sin_cos(x[k])
    return out


def test_they_agree_to_the_last_digits() -> None:
    """Of float64 for `sin_cos`, of float32 for what the normal numbers are made of."""
    rng = np.random.default_rng(0)
    edges = [2.0**-33, 0.25, 0.5, math.sqrt(0.5), 0.625, 1.0 - 2.0**-24]
    u = np.concatenate(
        [edges, rng.uniform(2.0**-33, 1.0, 20000), 2.0 ** -rng.uniform(0, 33, 20000)]
    ).astype(np.float32)
    a = rng.uniform(-math.pi / 4, math.pi / 4, len(u)).astype(np.float32)
    x = rng.uniform(-1000.0, 1000.0, len(u))
    log, sin_a, cos_a, sin_x, cos_x = _evaluate(u, a, x)
    np.testing.assert_allclose(log, np.log(u.astype(np.float64)), rtol=3e-7)
    np.testing.assert_allclose(sin_a, np.sin(a.astype(np.float64)), rtol=0, atol=1.5e-7)
    np.testing.assert_allclose(cos_a, np.cos(a.astype(np.float64)), rtol=0, atol=1.5e-7)
    np.testing.assert_allclose(sin_x, np.sin(x), rtol=0, atol=5e-16)
    np.testing.assert_allclose(cos_x, np.cos(x), rtol=0, atol=5e-16)


def test_the_logarithm_of_one_and_the_sine_of_nothing_are_exact() -> None:
    """Else a radius were the root of a negative number."""
    log, sine, cosine, sin_x, cos_x = _evaluate(
        np.ones(1, np.float32), np.zeros(1, np.float32), np.zeros(1)
    )[:, 0]
    assert (log, sine, sin_x, cos_x) == (0.0, 0.0, 0.0, 1.0)
    assert abs(cosine - 1.0) < 1e-7
    below = np.nextafter(Single(1.0), Single(0.0))
    assert _evaluate(np.array([below]), np.zeros(1, np.float32), np.zeros(1))[0, 0] < 0.0


@kernel
def _saturate(x: Floats, out: Floats) -> None:
    for k in range(len(x)):
        out[k] = tanh(x[k])


def _tanh(x: npt.ArrayLike) -> Floats:
    x = np.array(x, dtype=np.float64)
    out = np.empty_like(x)
    _saturate(x, out)
    return out


def test_tanh_is_the_librarys_over_the_whole_range() -> None:
    """To three units in the last place, from the smallest denormal to where it is 1."""
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.uniform(-25.0, 25.0, 20000), 10.0 ** rng.uniform(-320.0, 1.5, 20000)])
    y, expected = _tanh(x), np.tanh(x)
    assert np.all(np.abs(y - expected) <= 4.0 * np.spacing(np.abs(expected)))
    assert np.array_equal(y, -_tanh(-x))


def test_tanh_at_the_ends() -> None:
    assert _tanh([0.0, 5e-324, 20.0, 1e308, np.inf]).tolist() == [0.0, 5e-324, 1.0, 1.0, 1.0]
    assert _tanh([-20.0, -np.inf]).tolist() == [-1.0, -1.0]
    assert np.isnan(_tanh([np.nan])).all()


def test_phase_is_the_complex_exponential() -> None:
    x = np.random.default_rng(2).uniform(-1000.0, 1000.0, 200)
    found = np.array([phase(float(a)) for a in x])
    np.testing.assert_allclose(found, np.exp(1j * x), rtol=0, atol=5e-16)
