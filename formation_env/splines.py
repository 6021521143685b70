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

from formation_env.paths.references import SPLINE, TERMS, Floats
from formation_env.paths.tables import ABOVE_FLOOR, LARGEST, MOST_ROWS
from formation_env.paths.trajectory import Trajectory
from formation_env.validation.checks import array, number, refuse, require, vector

_DEGREE = TERMS - 1
_AT_REST = [(order, np.zeros(3)) for order in (1, 2, 3)]


def waypoints(times: ArrayLike, points: ArrayLike) -> Trajectory:
    """The minimum-snap path through way-points, from rest to rest.

    `times` (s) start at 0 and rise, `points` (m, north-east-down) has shape `(n, 3)`, `n >= 2`. Of
    all curves through the points at those times with velocity, acceleration and jerk zero at both
    ends, it has the least integral of the squared snap; it is C6. After the last time the leader
    holds the last point. Raises `ValueError` for other input, naming the row.
    """
    t, p = _rows("times", times, "points", points, least=2)
    table = _spline_table(t, p, (_AT_REST, _AT_REST))
    # At rest exactly, not to rounding, so that the direction of departure is well defined.
    first = 2 + len(t) - 1
    table[first : first + 3 * TERMS].reshape(3, TERMS)[:, 1:4] = 0.0
    return Trajectory("waypoints", SPLINE, table, float(t[-1]))


def from_samples(times: ArrayLike, points: ArrayLike) -> Trajectory:
    """A smooth (C6) curve through a table of samples, with the not-a-knot condition at both ends.

    `times` (s) start at 0 and rise, `points` (m, north-east-down) has shape `(n, 3)`, `n >= 8`. The
    samples are met exactly, so they should be free of noise: a micrometre of it at 100 Hz asks for turns
    that no vehicle makes (smooth a measured log, or give fewer of its rows). After the last time the
    leader is asked to stand still at once: give more samples than the episode needs, or end at rest.
    Raises `ValueError` for other input, naming the row.
    """
    t, p = _rows("times", times, "points", points, least=TERMS)
    return Trajectory("samples", SPLINE, _spline_table(t, p, None), float(t[-1]))


def from_function(
    f: Callable[[float], ArrayLike], duration: float, step: float = 0.05
) -> Trajectory:
    """`from_samples` of a function of time (s) that gives a point (m, north-east-down).

    `f` should have eight derivatives and change little within `step` (s): the error of the spline
    falls with the eighth power of the step. It is called here, never in a kernel, at most 100,000
    times: `duration / step` stays below that. Raises `ValueError` naming the argument, or the time at
    which `f` gives no point above the floor.
    """
    require(callable(f), "f", f, "a function of time that gives a point")
    duration = number("duration", duration, 0.0, LARGEST)
    steps = duration / number("step", step, 0.0)
    if not steps <= MOST_ROWS - 1:
        refuse("duration / step", steps, f"fewer than {MOST_ROWS} steps: a longer step")
    times = np.linspace(0.0, duration, max(TERMS, ceil(steps) + 1))
    points = [_point(f"f({t:g})", f(float(t))) for t in times]
    return Trajectory("function", SPLINE, _spline_table(times, np.array(points), None), duration)


def _point(name: str, value: Any) -> Floats:
    """What a user's function gave, as a point above the floor."""
    point = vector(name, value, 3, -LARGEST, LARGEST)
    require(bool(point[2] <= 0.0), name, point.tolist(), ABOVE_FLOOR)
    return point


def _rows(
    t_name: str, times: ArrayLike, p_name: str, points: ArrayLike, least: int
) -> tuple[Floats, Floats]:
    """Checked times `(n,)` and points `(n, 3)`."""
    t = array(t_name, times, (None,), -LARGEST, LARGEST)
    if not least <= len(t) <= MOST_ROWS:
        raise ValueError(f"{t_name} = {len(t)} times: expected from {least} to {MOST_ROWS}")
    require(bool(t[0] == 0.0), f"{t_name}[0]", float(t[0]), "0 s, where times start")
    flat = np.flatnonzero(np.diff(t) <= 0.0)
    if len(flat):
        i = int(flat[0])
        refuse(f"{t_name}[{i + 1}]", float(t[i + 1]), f"later than {t_name}[{i}] = {float(t[i])} s")
    p = array(p_name, points, (None, 3), -LARGEST, LARGEST)
    if len(p) != len(t):
        raise ValueError(f"{p_name} = {len(p)} rows: expected {len(t)}, a point for each time")
    low = np.flatnonzero(p[:, 2] > 0.0)
    if len(low):
        refuse(f"{p_name}[{low[0]}]", p[low[0]].tolist(), ABOVE_FLOOR)
    return t, p


def _spline_table(t: Floats, p: Floats, ends: Any) -> Floats:
    """The table of the interpolating spline of degree 7; `ends` as SciPy's `bc_type`."""
    # SciPy costs a tenth of a second to import; most users never build a spline.
    from scipy.interpolate import make_interp_spline

    # From the first point on: a coordinate that does not change then has derivatives exactly zero.
    from_first = p - p[0]
    try:
        with np.errstate(all="ignore"):  # what comes out is looked at below
            spline = make_interp_spline(t, from_first, k=_DEGREE, bc_type=ends)
            miss = np.abs(spline(t) - from_first).max()
            breaks = spline.t[_DEGREE:-_DEGREE]
            # Powers of (t - t_i), from the derivatives at the left end of each piece (Taylor, exact).
            powers = [spline(breaks[:-1], nu=k) / factorial(k) for k in range(TERMS)]
    except (ValueError, np.linalg.LinAlgError):
        miss, powers = np.inf, []
    met = miss <= 1e-6 * (1.0 + np.abs(from_first).max())
    if not met or not np.isfinite(powers).all():
        gap = np.diff(t)
        expected = "gaps that a curve of degree 7 can bridge: longer, or more alike"
        refuse("gaps between the times", f"{gap.min():g} to {gap.max():g} s", expected)
    pieces = np.stack(powers, axis=-1)
    pieces[..., 0] += p[0]
    return np.concatenate([[len(breaks) - 1.0], breaks, pieces.ravel()])
