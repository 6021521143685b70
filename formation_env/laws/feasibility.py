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

from collections.abc import Iterable
from dataclasses import dataclass
from math import asin, atan2, ceil, degrees, hypot
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from formation_env._jit import kernel
from formation_env.laws.slots import advance_heading
from formation_env.paths.references import Floats, by_name
from formation_env.paths.tables import LARGEST
from formation_env.paths.trajectory import Trajectory, path_start
from formation_env.validation.checks import array, number, refuse, require, vector
from formation_env.validation.warning import warn_user

Complexes = NDArray[np.complex128]

STILL = 0.01  # m/s; a slower leader has no direction to compare with
STEP = 0.01  # s, of the integration
_MOST_STEPS = 100_000  # a longer flight is integrated for as long as these last
_MOST_NAMED = 8  # followers in a message
_DRAWS = 8  # paths of a random trajectory that are integrated


class FeasibilityWarning(UserWarning):
    """A follower may have to move backwards: only the sufficient condition (29)-(30) fails."""


def equilibrium(d_x: float, curvature: float) -> float:
    """The stable angle of a follower to the leader's direction, rad: `-arcsin(d_x kappa_L)` (28).

    `d_x` in m, the path's curvature in 1/m (positive when it turns from north to east). Raises
    `ValueError` for `|d_x kappa_L| > 1`, where the leader's circle is smaller than `d_x` and no
    heading is stable.
    """
    product = number("d_x", d_x) * number("curvature", curvature)
    require(abs(product) <= 1.0, "d_x * curvature", product, "at most 1 in size (28)")
    return -asin(product)


def max_curvature(offset: ArrayLike) -> float:
    """The curvature of the leader's path below which (29)-(30) rules out inversion, 1/m.

    (29)-(30) ask for `arcsin(d_x kappa) < arctan |d_x / d_y|`; the sine of both sides gives
    `kappa < 1 / |(d_x, d_y)|`: the leader's circle must be larger than the follower's distance.
    `offset` has shape `(3,)`, m. Raises `ValueError` where it is not finite, or level with the leader.
    """
    d = vector("offset", offset, 3)
    apart = hypot(d[0], d[1])
    require(apart >= 1e-9, "offset", d.tolist(), "(d_x, d_y) other than 0")
    return 1.0 / apart


def no_inversion(offset: ArrayLike, curvature: float) -> bool:
    """Whether the bound (29)-(30) holds for the largest curvature of the path, 1/m."""
    return abs(number("curvature", curvature)) < max_curvature(offset)


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
        verdict = "moves backwards" if self.inverts else "moves forward everywhere"
        stable = "somewhere" if self.exists else "nowhere"
        solvable = self.product_max <= 1.0
        angle = f"{degrees(asin(self.product_max)):.1f} deg" if solvable else "undefined"
        limit = f"arctan|d_x/d_y| = {degrees(atan2(abs(d_x), abs(d_y))):.1f} deg"
        bound = f"below {limit}: never backwards" if self.bound_holds else f"not below {limit}"
        worst = f"{degrees(self.worst_theta_d):.1f} deg"
        return "\n".join(
            (
                f"follower {self.follower}, d = ({d_x:.3g}, {d_y:.3g}, {d_z:.3g}) m, {verdict}",
                f"  (28)      |d_x kappa_L| up to {self.product_max:.3g}: a heading is stable {stable}",
                f"  (29)-(30) arcsin|d_x kappa_L| up to {angle}, {bound}",
                f"  (26)      |theta_d| up to {worst}, u/V_L down to {self.least_speed_ratio:.3g}",
            )
        )


class _Path(NamedTuple):
    """The leader's motion in the plane at equal steps."""

    step: float  # s
    velocity: Complexes  # m/s
    curvature: Floats  # 1/m where it moves
    direction: complex  # at the start


@kernel
def _deviations(
    v: Complexes, step: float, d_x: float, start: complex, last: int, side: float, out: Complexes
) -> None:
    """`exp(j theta_d)` along a path, by the zero dynamics (23); only where the leader moves.

    Of all headings that begin along the path, at its first sample or at one up to number `last`, the one
    furthest to a `side`: 1 where `theta_d` is largest, -1 where it is least. By (26), of first order, no
    heading overtakes another. So the furthest one stays so until it crosses the path's direction; from then
    on one that begins there is further.
    """
    R = start
    n = 0
    for i in range(v.shape[0]):
        speed = abs(v[i])
        if speed > STILL:
            out[n] = R * v[i].conjugate() / speed
            if 0 < i <= last and side * out[n].imag < 0.0 < out[n].real:
                R = v[i] / speed
            n += 1
        if i + 1 < v.shape[0]:
            R = advance_heading(R, v[i], v[i + 1], d_x, step)


def _path(trajectory: Trajectory, duration: float, step: float, widest: float) -> _Path:
    """The motion in steps of `step` s, longer where there would be too many, but not above `widest`."""
    count = ceil(min(duration / step, _MOST_STEPS))
    duration = min(duration, count * max(step, widest))
    motion = by_name(trajectory(np.linspace(0.0, duration, count + 1)))
    v, a = (motion[name][:, 0] + 1j * motion[name][:, 1] for name in ("v", "a"))
    moving = np.abs(v) > STILL
    v_moving = v[moving]
    curvature = (v_moving.conj() * a[moving]).imag / np.abs(v_moving) ** 3
    direction, _ = path_start(trajectory.kind, trajectory.table)
    return _Path(duration / count, v, curvature, direction)


def _paths(trajectory: Trajectory, duration: float, d_x: float) -> list[_Path]:
    """The path, or some drawn ones; the step suits the fastest heading, `d_x / V_L`."""
    keys = range(_DRAWS if trajectory.random is not None else 1)
    curves = [trajectory.drawn(key) for key in keys]
    coarse = [_path(curve, duration, STEP, 4.0 * STEP) for curve in curves]
    fastest = max(float(np.abs(path.velocity).max()) for path in coarse)
    if max(path.step for path in coarse) * fastest <= 0.1 * d_x:
        return coarse
    wanted = 0.1 * d_x / fastest
    return [_path(curve, duration, min(STEP, wanted), 4.0 * wanted) for curve in curves]


def _headings(paths: list[_Path], d_x: float, starts: float) -> Complexes:
    """`exp(j theta_d)` of a follower at its furthest to both sides, on all paths, one after the other."""
    runs = []
    for path in paths:
        last = int(starts / path.step)
        for side in (1.0, -1.0) if last > 0 else (1.0,):
            out = np.empty(len(path.curvature), dtype=np.complex128)
            _deviations(path.velocity, path.step, d_x, path.direction, last, side, out)
            runs.append(out)
    return np.concatenate(runs)


def check(
    offsets: ArrayLike, trajectory: Trajectory, duration: float, starts: float = 0.0
) -> tuple[Feasibility, ...]:
    """A report per follower on the leader's path over `duration` seconds.

    `offsets` has shape `(followers, 3)`, m, with `d_x > 0`. Raises `ValueError` naming the argument.

    Each heading starts along the reference, as in II-E: at its first point, or at any time of the first
    `starts` seconds, of which the worst counts, since what is left of one turn may help in the next. A random
    trajectory is judged by the bound of its curvature and by a few of its draws, always the same ones.
    `u / V_L` is the first row of (25), `cos theta_d - (d_y / d_x) sin theta_d`. Moments in which the leader
    stands still are left out; just before and after them the curvature of a path may be large without harm.
    """
    d = array("offsets", offsets, (None, 3), -LARGEST, LARGEST)
    behind = np.flatnonzero(d[:, 0] < 1e-9)
    if len(behind):
        first = int(behind[0])
        refuse(f"offsets[{first}]", d[first].tolist(), "d_x > 0, a leader ahead of every follower")
    require(isinstance(trajectory, Trajectory), "trajectory", trajectory, "a Trajectory")
    duration = number("duration", duration, 0.0, LARGEST)
    starts = number("starts", starts, 0.0, LARGEST, strict=False)
    paths = _paths(trajectory, duration, float(d[:, 0].min()))
    curvature = np.abs(np.concatenate([path.curvature for path in paths]))
    least, largest = (float(curvature.min()), float(curvature.max())) if len(curvature) else (0, 0)
    if trajectory.random is not None:
        largest = trajectory.random.curvature_max
    reports: dict[int, Feasibility] = {}
    for d_x in np.unique(d[:, 0]):
        headings = _headings(paths, float(d_x), starts)
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


def _named(reports: list[Feasibility]) -> str:
    """The followers of the reports by number; of many only the worst."""
    worst = sorted(reports, key=lambda report: report.least_speed_ratio)[:_MOST_NAMED]
    names = ", ".join(str(i) for i in sorted(report.follower for report in worst))
    rest = f" and {len(reports) - len(worst)} more" if len(reports) > len(worst) else ""
    return f"follower{'s' if len(reports) > 1 else ''} {names}{rest}"


def require_feasible(reports: Iterable[Feasibility]) -> None:
    """Refuse what cannot work, warn of what may not, in one line.

    Raises `ValueError` if for some follower no heading is stable anywhere on the path (28); warns
    with `FeasibilityWarning` if for some only the sufficient bound (29)-(30) fails, and says for which
    the integration of (26) finds an inversion.
    """
    reports = tuple(reports)
    lost = [report for report in reports if not report.exists]
    if lost:
        worst = max(lost, key=lambda report: report.offset[0])
        raise ValueError(
            f"no stable heading exists for {_named(lost)}: the leader's circle is smaller than "
            f"d_x = {worst.offset[0]:.3g} m everywhere on its path (28); reduce d_x or take a wider path"
        )
    doubtful = [report for report in reports if not report.bound_holds]
    if doubtful:
        warn_user(_doubt(doubtful), FeasibilityWarning)


def _doubt(reports: list[Feasibility]) -> str:
    """Which followers fail the bound (29)-(30), by how much, and what integrating (26) found."""
    worst = max(reports, key=lambda report: hypot(*report.offset[:2]))
    return (
        f"the bound (29)-(30) against moving backwards does not hold for {_named(reports)}: "
        f"|(d_x, d_y)| up to {hypot(*worst.offset[:2]):.3g} m, the leader turns with a radius of "
        f"{1.0 / worst.curvature_max:.3g} m. The bound is sufficient only; by integrating (26), "
        f"{_integrated(reports)}"
    )


def _integrated(reports: list[Feasibility]) -> str:
    """What integrating (26) found of the reports' followers, as the end of a sentence."""
    inverting, several = [report for report in reports if report.inverts], len(reports) > 1
    if not inverting:
        return "none moves backwards" if several else "it does not move backwards"
    if len(inverting) == len(reports):
        return "they all move backwards" if several else "it moves backwards"
    return f"{_named(inverting)} move{'' if len(inverting) > 1 else 's'} backwards"
