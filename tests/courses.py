"""What the tests of courses share: how a path lies in an episode."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from formation_env.paths.course import Course

Floats = npt.NDArray[np.float64]


def matrix(course: Course) -> Floats:
    """Mirrored, east for west, and then turned about the vertical."""
    c, s = course.turn.real, course.turn.imag
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ np.diag([1.0, course.side, 1.0]))


def uniform_angles(angle: Any) -> bool:
    x = np.ravel(angle) / (2.0 * pi) % 1.0
    return bool(stats.kstest(x, "uniform").pvalue > 1e-3)
