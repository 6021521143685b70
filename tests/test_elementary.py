"""The vectorisable logarithm, sine and cosine against the library's own."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from formation_env._jit import kernel
from formation_env.elementary import Single, log_of_unit, sin_cos, sin_cos_of_octant
from formation_env.references import Floats

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
