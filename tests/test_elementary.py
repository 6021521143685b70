"""The vectorisable logarithm, sine and cosine against the library's own."""

from __future__ import annotations

import math

import numpy as np
import pytest

from formation_env._jit import kernel
from formation_env.elementary import log_of_unit, sin_cos, sin_cos_of_turn
from formation_env.references import Floats


@kernel
def _evaluate(u: Floats, x: Floats) -> Floats:
    out = np.empty((5, len(u)))
    for k in range(len(u)):
        out[0, k] = log_of_unit(u[k])
        out[1, k], out[2, k] = sin_cos_of_turn(u[k])
        out[3, k], out[4, k] = sin_cos(x[k])
    return out


def test_they_agree_to_the_last_digits() -> None:
    rng = np.random.default_rng(0)
    edges = [2.0**-33, 2.0**-17, 2.0**-16, 0.25, 0.5, math.sqrt(0.5), 0.625, 1.0 - 2.0**-33]
    u = np.concatenate(
        [edges, rng.uniform(2.0**-33, 1.0, 20000), 2.0 ** -rng.uniform(0, 33, 20000)]
    )
    x = rng.uniform(-1000.0, 1000.0, len(u))
    log, sin_u, cos_u, sin_x, cos_x = _evaluate(u, x)
    np.testing.assert_allclose(log, np.log(u), rtol=4e-16, atol=1e-16)
    np.testing.assert_allclose(sin_u, np.sin(2 * np.pi * u), rtol=0, atol=2e-15)
    np.testing.assert_allclose(cos_u, np.cos(2 * np.pi * u), rtol=0, atol=2e-15)
    np.testing.assert_allclose(sin_x, np.sin(x), rtol=0, atol=5e-16)
    np.testing.assert_allclose(cos_x, np.cos(x), rtol=0, atol=5e-16)


@pytest.mark.parametrize("quarter", range(4))
def test_quarter_turns_are_exact(quarter: int) -> None:
    out = _evaluate(np.array([0.25 * quarter + (quarter == 0)]), np.array([0.0]))
    exact = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][quarter]
    assert (out[1, 0], out[2, 0]) == exact
    assert (out[3, 0], out[4, 0]) == (0.0, 1.0)
