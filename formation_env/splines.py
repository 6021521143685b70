"""Leader trajectories through points: splines of degree 7, continuous up to the sixth derivative.

The tracker wants a reference of class C4; degree 7 gives more, and it is what minimises snap
between way-points. SciPy builds them once; the kernels evaluate the table (`references`).
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, factorial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from formation_env.checks import require
from formation_env.references import SPLINE, TERMS, Floats
from formation_env.trajectory import Trajectory

_DEGREE = TERMS - 1
_AT_REST = [(order, np.zeros(3)) for order in (1, 2, 3)]


def waypoints(times: ArrayLike, points: ArrayLike) -> Trajectory:
    """The minimum-snap path through way-points, from rest to rest.

    `times` (s) start at 0 and rise, `points` (m, north-east-down) has shape `(n, 3)`, `n >= 2`. Of
    all curves through the points at those times with velocity, acceleration and jerk zero at both
    ends, it has the least integral of the squared snap; it is C6. After the last time the leader
    holds the last point. Raises `ValueError` for other input.
    """
    t, p = _table("times", times, "points", points, least=2)
    table = _spline_table(t, p, (_AT_REST, _AT_REST))
    # At rest exactly, not to rounding, so that the direction of departure is well defined.
    first = 2 + len(t) - 1
    table[first : first + 3 * TERMS].reshape(3, TERMS)[:, 1:4] = 0.0
    return Trajectory("waypoints", SPLINE, table, float(t[-1]))


def from_samples(times: ArrayLike, points: ArrayLike) -> Trajectory:
    """A smooth (C6) curve through a table of samples, with the not-a-knot condition at both ends.

    `times` (s) start at 0 and rise, `points` (m, north-east-down) has shape `(n, 3)`, `n >= 8`. The
    samples are met exactly, so they should be free of noise. After the last time the leader is
    asked to stand still at once: give more samples than the episode needs, or end at rest.
    """
    t, p = _table("times", times, "points", points, least=TERMS)
    return Trajectory("samples", SPLINE, _spline_table(t, p, None), float(t[-1]))


def from_function(
    f: Callable[[float], ArrayLike], duration: float, step: float = 0.05
) -> Trajectory:
    """`from_samples` of a function of time (s) that gives a point (m, north-east-down).

    `f` should have eight derivatives and change little within `step` (s): the error of the spline
    falls with the eighth power of the step. It is called here, never in a kernel.
    """
    for name, value in (("duration", duration), ("step", step)):
        require(bool(np.isfinite(value)) and value > 0.0, name, value, "a finite time above 0 s")
    count = max(TERMS, ceil(duration / step) + 1)
    times = np.linspace(0.0, duration, count)
    points = [np.asarray(f(float(t)), dtype=np.float64) for t in times]
    for t, point in zip(times, points, strict=True):
        good = point.shape == (3,) and bool(np.isfinite(point).all())
        require(good, f"f({t:g})", point, "3 finite numbers")
    curve = from_samples(times, points)
    return Trajectory("function", SPLINE, curve.table, curve.duration)


def _table(
    t_name: str, times: ArrayLike, p_name: str, points: ArrayLike, least: int
) -> tuple[Floats, Floats]:
    """Checked times `(n,)` and points `(n, 3)`."""
    t = _floats(t_name, times)
    require(t.ndim == 1 and len(t) >= least, t_name, times, f"a list of at least {least} times")
    require(bool(np.isfinite(t).all()), t_name, times, "finite times")
    require(t[0] == 0.0 and bool((np.diff(t) > 0.0).all()), t_name, times, "rising times from 0")
    p = _floats(p_name, points)
    require(p.shape == (len(t), 3), p_name, points, f"shape ({len(t)}, 3), a point for each time")
    require(bool(np.isfinite(p).all()), p_name, points, "finite coordinates")
    require(bool((p[:, 2] <= 0.0).all()), p_name, points, "points above the floor (p_z <= 0)")
    return t, p


def _floats(name: str, values: ArrayLike) -> Floats:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} = {values!r}: expected numbers") from error


def _spline_table(t: Floats, p: Floats, ends: Any) -> Floats:
    """The table of the interpolating spline of degree 7; `ends` as SciPy's `bc_type`."""
    # SciPy costs a tenth of a second to import; most users never build a spline.
    from scipy.interpolate import make_interp_spline

    # From the first point on: a coordinate that does not change then has derivatives exactly zero.
    spline = make_interp_spline(t, p - p[0], k=_DEGREE, bc_type=ends)
    breaks = spline.t[_DEGREE:-_DEGREE]
    # Powers of (t - t_i), from the derivatives at the left end of each piece (Taylor, exact).
    powers = [spline(breaks[:-1], nu=k) / factorial(k) for k in range(TERMS)]
    pieces = np.stack(powers, axis=-1)
    pieces[..., 0] += p[0]
    return np.concatenate([[len(breaks) - 1.0], breaks, pieces.ravel()])
