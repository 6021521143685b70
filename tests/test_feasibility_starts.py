"""Section II-C where an episode begins anywhere on the leader's path, or flies its mirror image."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from paths import begun, sines
from scipy.integrate import solve_ivp

from formation_env import FeasibilityWarning, FormationConfig, configure
from formation_env.laws import feasibility
from formation_env.laws.feasibility import Feasibility
from formation_env.paths.references import by_name
from formation_env.trajectories import Trajectory, circle, figure_eight

Offset = tuple[float, float, float]
FLOWN = 13.0  # s


def one(d: Offset, curve: Trajectory, starts: float = 0.0) -> Feasibility:
    """The report of one follower, begun at the path's first point or within `starts` seconds of it."""
    (report,) = feasibility.check([d], curve, FLOWN + starts, starts)
    return report


def by_scipy(d: Offset, curve: Trajectory) -> float:
    """Least `u / V_L` (25) on a path, of the zero dynamics (23) for the heading itself."""

    def velocity(t: float) -> complex:
        north, east, _ = by_name(curve(t))["v"]
        return complex(north, east)

    def rate(t: float, theta: np.ndarray) -> np.ndarray:
        return np.imag(np.exp(-1j * theta) * velocity(t)) / d[0]

    t = np.linspace(0.0, FLOWN, 1301)
    start = [np.angle(velocity(0.0))]
    theta = solve_ivp(rate, (0.0, FLOWN), start, t_eval=t, rtol=1e-8, atol=1e-10).y[0]
    z = np.exp(1j * theta) / np.array([velocity(x) / abs(velocity(x)) for x in t])
    return float((z.real - d[1] / d[0] * z.imag).min())


def swung(north: list[tuple[float, float]], east: list[tuple[float, float]]) -> Trajectory:
    """Amplitudes (m) and phases (rad) of a wave of 0.25 rad/s and of one twice as fast, on both axes."""
    rates = (0.25, 0.5)
    return sines(*([(a, w, p) for w, (a, p) in zip(rates, x, strict=True)] for x in (north, east)))


LOOP = swung([(1.3, 0.5), (0.6, -1.8)], [(1.4, 1.6), (0.75, -0.4)])
# On each of them the follower moves forwards from the path's first point on.
ELSEWHERE: dict[str, tuple[Trajectory, Offset]] = {
    "(31) from 14 s on": (begun(figure_eight(), 14.0), (1.0, 0.2, -0.3)),
    "bent": (swung([(1.5, 2.0), (0.0, 0.0)], [(2.0, -3.0), (1.0, 2.0)]), (1.0, -0.4, -0.3)),
    "loop": (LOOP, (0.8, -0.3, -0.3)),
}


@pytest.mark.parametrize("case", ELSEWHERE)
def test_all_starts_are_as_bad_as_the_worst_of_them(case: str) -> None:
    """From the first point none inverts; SciPy finds at the worst start what all are told."""
    curve, d = ELSEWHERE[case]
    starts = np.linspace(0.0, curve.period, 48, endpoint=False)
    each = [one(d, begun(curve, at)) for at in starts]
    least = np.array([report.least_speed_ratio for report in each])
    together = one(d, curve, curve.period)
    assert least[0] > 0.05 and together.inverts
    assert together.least_speed_ratio == pytest.approx(least.min(), abs=0.01)
    assert together.least_speed_ratio <= least.min() + 1e-3
    assert together.worst_theta_d >= max(report.worst_theta_d for report in each) - 1e-3
    worst = by_scipy(d, begun(curve, float(starts[least.argmin()])))
    assert worst == pytest.approx(least.min(), abs=2e-3)
    assert by_scipy(d, curve) == pytest.approx(least[0], abs=2e-3)


@pytest.mark.parametrize("case", ELSEWHERE)
def test_only_the_starts_that_are_asked_for_count(case: str) -> None:
    """More starts are never better, and those up to the worst one suffice."""
    curve, d = ELSEWHERE[case]
    whole = one(d, curve, curve.period).least_speed_ratio
    parts = [one(d, curve, part * curve.period).least_speed_ratio for part in (0.0, 0.3, 0.6, 1.0)]
    assert all(a >= b - 1e-3 for a, b in itertools.pairwise(parts)), parts
    assert parts[0] > 0.0 > parts[-1] == whole


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_on_a_circle_every_start_is_the_same(side: float) -> None:
    """The first one's angle grows to (28), and no other goes beyond."""
    curve, d = circle(1.0, side), (0.5, 0.4, -0.3)
    first, all_ = one(d, curve), one(d, curve, curve.period)
    assert all_.worst_theta_d == pytest.approx(first.worst_theta_d, abs=1e-4)
    assert all_.least_speed_ratio == pytest.approx(first.least_speed_ratio, abs=1e-4)


def told(**options: Any) -> tuple[FormationConfig, str]:
    """A configuration and what it has warned of."""
    with pytest.warns(FeasibilityWarning) as caught:
        config = configure(start_offset=0.0, duration=26.0, **options)
    (one_,) = caught
    return config, str(one_.message)


@pytest.mark.parametrize("case", ELSEWHERE)
def test_a_configuration_tells_of_the_starts_that_episodes_have(case: str) -> None:
    curve, d = ELSEWHERE[case]
    drawn, warned = told(trajectory=curve, offsets=(d,))
    assert warned.endswith("(26), it moves backwards")
    assert [report.inverts for report in drawn.feasibility()] == [True]
    given, warned = told(trajectory=curve, offsets=(d,), path="as given")
    assert warned.endswith("(26), it does not move backwards")
    assert [report.inverts for report in given.feasibility()] == [False]


def test_a_mirror_image_that_inverts_from_some_start_is_not_flown() -> None:
    """On the loop a follower on one side never inverts, and on the other side only from some starts."""
    x, y, z = ELSEWHERE["loop"][1]
    inside, outside, behind = (x, y, z), (x, -y, z), (0.3, 0.0, 0.4)
    flown = {
        "outside": ((outside,), 0, "it does not move backwards"),
        "inside": ((inside,), 1, "it moves backwards"),
        "both": ((inside, outside), 0, "follower 0 moves backwards"),
        "behind": ((behind,), 1, "it does not move backwards"),  # its own image
        "outside, behind": ((outside, behind), 0, "none moves backwards"),
    }
    for name, (offsets, mirrored, found) in flown.items():
        config, warned = told(trajectory=LOOP, offsets=offsets)
        assert (name, config.world.courses.mirrored) == (name, mirrored)
        assert warned.endswith(found)
