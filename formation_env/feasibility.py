"""Which paths of the leader a follower can copy: the inner dynamics of section II-C.

With all errors at zero a follower's heading still moves. Its angle to the leader's direction of
motion, `theta_d`, obeys

    theta_d_dot = -(V_L / d_x) (sin theta_d + d_x kappa_L)                              (26)

where `V_L` is the leader's planar speed and `kappa_L` the curvature of its path. Two conditions are
told apart here. If `|d_x kappa_L| > 1` no heading is stable. If everywhere

    arcsin |d_x kappa_L| < arctan |d_x / d_y|                                           (29)-(30)

the follower never moves backwards; that is sufficient only, so the path is integrated too, by the
zero dynamics of `slots` that also moves the slots of the environment.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from math import asin, atan2, ceil, degrees, hypot, isfinite
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from formation_env._jit import kernel
from formation_env.checks import require
from formation_env.references import Floats
from formation_env.slots import advance_heading
from formation_env.trajectories import Trajectory, path_start

Complexes = NDArray[np.complex128]

STILL = 0.01  # m/s; a slower leader has no direction to compare with
STEP = 0.01  # s, of the integration
_MOST_STEPS = 100_000
_MOST_SHOWN = 4  # reports in a message
_DRAWS = 8  # paths of a random trajectory that are integrated


class FeasibilityWarning(UserWarning):
    """A follower may have to move backwards: only the sufficient condition (29)-(30) fails."""


def equilibrium(d_x: float, curvature: float) -> float:
    """The stable angle of a follower to the leader's direction, rad: `-arcsin(d_x kappa_L)` (28).

    `d_x` in m, the path's curvature in 1/m (positive when it turns from north to east). Raises
    `ValueError` for `|d_x kappa_L| > 1`, where the leader's circle is smaller than `d_x` and no
    heading is stable.
    """
    product = d_x * curvature
    require(abs(product) <= 1.0, "d_x * curvature", product, "at most 1 in size (28)")
    return -asin(product)


def max_curvature(offset: ArrayLike) -> float:
    """The curvature of the leader's path below which (29)-(30) rules out inversion, 1/m.

    (29)-(30) ask for `arcsin(d_x kappa) < arctan |d_x / d_y|`; the sine of both sides gives
    `kappa < 1 / |(d_x, d_y)|`: the leader's circle must be larger than the follower's distance.
    """
    d = np.asarray(offset, dtype=np.float64)
    return 1.0 / hypot(d[0], d[1])


def no_inversion(offset: ArrayLike, curvature: float) -> bool:
    """Whether the bound (29)-(30) holds for the largest curvature of the path, 1/m."""
    return abs(curvature) < max_curvature(offset)


@final
@dataclass(frozen=True)
class Feasibility:
    """What the leader's path means for one follower."""

    follower: int  # index, from 0
    offset: tuple[float, float, float]  # m
    curvature_max: float  # 1/m, of the leader's path in the plane
    product_max: float  # d_x kappa_L at its largest
    exists: bool  # somewhere on the path a heading is stable: |d_x kappa_L| <= 1
    bound_holds: bool  # (29)-(30)
    worst_theta_d: float  # rad, largest |theta_d| found by integrating (26)
    least_speed_ratio: float  # smallest u / V_L found (25)

    @property
    def inverts(self) -> bool:
        """Whether the follower was found to stop or move backwards while the leader moves."""
        return self.least_speed_ratio <= 0.0

    def __str__(self) -> str:
        d_x, d_y, d_z = self.offset
        limit = degrees(atan2(abs(d_x), abs(d_y)))
        solvable = self.product_max <= 1.0
        bound = f"{degrees(asin(self.product_max)):.1f} deg" if solvable else "undefined"
        stable = "somewhere" if self.exists else "nowhere"
        return "\n".join(
            (
                f"follower {self.follower}, d = ({d_x:.3g}, {d_y:.3g}, {d_z:.3g}) m, "
                f"largest curvature of the leader's path {self.curvature_max:.3g} 1/m:",
                f"  (28)      |d_x kappa_L| up to {self.product_max:.3g}; "
                f"a heading is stable {stable} (at most 1)",
                f"  (29)-(30) arcsin|d_x kappa_L| up to {bound}, arctan|d_x/d_y| = "
                f"{limit:.1f} deg: no inversion {'' if self.bound_holds else 'not '}guaranteed",
                f"  (26)      integrated: |theta_d| up to {degrees(self.worst_theta_d):.1f} deg, "
                f"u/V_L down to {self.least_speed_ratio:.3g}: "
                f"{'inverts' if self.inverts else 'does not invert'}",
            )
        )


class _Path(NamedTuple):
    """The leader's motion in the plane at equal steps."""

    step: float  # s
    velocity: Complexes  # m/s
    curvature: Floats  # 1/m where it moves
    direction: complex  # at the start


@kernel
def _deviations(v: Complexes, step: float, d_x: float, start: complex, out: Complexes) -> None:
    """`exp(j theta_d)` along a path, by the zero dynamics (23); only where the leader moves."""
    R = start
    n = 0
    for i in range(v.shape[0]):
        speed = abs(v[i])
        if speed > STILL:
            out[n] = R * v[i].conjugate() / speed
            n += 1
        if i + 1 < v.shape[0]:
            R = advance_heading(R, v[i], v[i + 1], d_x, step)


def _path(trajectory: Trajectory, duration: float, step: float) -> _Path:
    count = min(ceil(duration / step), _MOST_STEPS)
    motion = trajectory(np.linspace(0.0, duration, count + 1))
    v = motion[:, 1, 0] + 1j * motion[:, 1, 1]
    a = motion[:, 2, 0] + 1j * motion[:, 2, 1]
    moving = np.abs(v) > STILL
    v_moving = v[moving]
    curvature = (v_moving.conj() * a[moving]).imag / np.abs(v_moving) ** 3
    direction, _ = path_start(trajectory.kind, trajectory.table)
    return _Path(duration / count, v, curvature, direction)


def _paths(trajectory: Trajectory, duration: float, d_x: float) -> list[_Path]:
    """The path, or some drawn ones; the step suits the fastest heading, `d_x / V_L`."""
    keys = range(_DRAWS if trajectory.random is not None else 1)
    curves = [trajectory.drawn(key) for key in keys]
    coarse = [_path(curve, duration, STEP) for curve in curves]
    fastest = max(float(np.abs(path.velocity).max()) for path in coarse)
    if STEP * fastest <= 0.1 * d_x:
        return coarse
    return [_path(curve, duration, 0.1 * d_x / fastest) for curve in curves]


def _headings(paths: list[_Path], d_x: float) -> Complexes:
    """`exp(j theta_d)` of a follower on all paths, one after the other."""
    runs = []
    for path in paths:
        out = np.empty(len(path.curvature), dtype=np.complex128)
        _deviations(path.velocity, path.step, d_x, path.direction, out)
        runs.append(out)
    return np.concatenate(runs)


def check(offsets: ArrayLike, trajectory: Trajectory, duration: float) -> tuple[Feasibility, ...]:
    """A report per follower on the leader's path over `duration` seconds; raises for bad arguments.

    Each heading starts along the reference, as in II-E. A random trajectory is judged by the bound
    of its curvature and by a few of its draws, always the same ones. `u / V_L` is the first row of
    (25), `cos theta_d - (d_y / d_x) sin theta_d`. Moments in which the leader stands still are left
    out; just before and after them the curvature of a path may be large without harm.
    """
    d = np.asarray(offsets, dtype=np.float64)
    good = d.ndim == 2 and d.shape[1] == 3 and len(d) > 0 and bool(np.isfinite(d).all())
    require(good, "offsets", offsets, "one row of 3 finite numbers per follower")
    require(bool((d[:, 0] > 0.0).all()), "offsets", offsets, "d_x > 0 for every follower")
    require(isfinite(duration) and duration > 0.0, "duration", duration, "a finite time above 0 s")
    paths = _paths(trajectory, duration, float(d[:, 0].min()))
    curvature = np.abs(np.concatenate([path.curvature for path in paths]))
    least, largest = (float(curvature.min()), float(curvature.max())) if len(curvature) else (0, 0)
    if trajectory.random is not None:
        largest = trajectory.random.curvature_max
    reports: dict[int, Feasibility] = {}
    for d_x in np.unique(d[:, 0]):
        headings = _headings(paths, float(d_x))
        for i in np.flatnonzero(d[:, 0] == d_x):
            reports[int(i)] = _report(int(i), d[i], headings, least, largest)
    return tuple(reports[i] for i in range(len(d)))


def _report(i: int, d: Floats, headings: Complexes, least: float, largest: float) -> Feasibility:
    d_x, d_y, d_z = (float(x) for x in d)
    # A leader that never moves leaves the heading where it starts: along the reference.
    ratios = headings.real - d_y / d_x * headings.imag if len(headings) else np.ones(1)
    worst = headings[np.argmin(headings.real)] if len(headings) else 1.0 + 0.0j
    return Feasibility(
        follower=i,
        offset=(d_x, d_y, d_z),
        curvature_max=largest,
        product_max=d_x * largest,
        exists=d_x * least <= 1.0,
        bound_holds=no_inversion(d, largest),
        worst_theta_d=abs(atan2(worst.imag, worst.real)),
        least_speed_ratio=float(ratios.min()),
    )


def _text(reports: list[Feasibility]) -> str:
    """The reports, worst first; of many followers only some."""
    ordered = sorted(reports, key=lambda report: report.least_speed_ratio)
    rest = len(ordered) - _MOST_SHOWN
    more = [f"and {rest} more followers"] if rest > 0 else []
    return "\n".join([str(report) for report in ordered[:_MOST_SHOWN]] + more)


def require_feasible(reports: Iterable[Feasibility]) -> None:
    """Refuse what cannot work, warn of what may not.

    Raises `ValueError` if for some follower no heading is stable anywhere on the path (28); warns
    with `FeasibilityWarning` if for some only the sufficient bound (29)-(30) fails.
    """
    reports = tuple(reports)
    lost = [report for report in reports if not report.exists]
    if lost:
        raise ValueError(
            "no stable heading exists: the leader's circle is smaller than d_x everywhere on its "
            "path (28); reduce d_x or take a wider path\n" + _text(lost)
        )
    doubtful = [report for report in reports if not report.bound_holds]
    if doubtful:
        warnings.warn(
            "the bound (29)-(30), which rules out that a follower moves backwards, does not hold\n"
            + _text(doubtful),
            FeasibilityWarning,
            stacklevel=2,
        )
