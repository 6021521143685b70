"""Section II-C: the equilibrium (28), the bound (29)-(30), and what integrating (26) shows."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from math import asin, atan, nan, pi, sin
from typing import Any

import numpy as np
import pytest
from closed_loop import PROPERTY
from hostile import NOT_NUMBERS, NOT_ROWS
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from formation_env import configure, formations, splines, trajectories
from formation_env.laws import feasibility
from formation_env.laws.feasibility import Feasibility, FeasibilityWarning
from formation_env.trajectories import Trajectory
from formation_env.validation.checks import LONGEST

PAIR = formations.paper_pair()
lengths = st.floats(0.1, 2.0)


def one(offset: tuple[float, float, float], curve: Trajectory, duration: float) -> Feasibility:
    (report,) = feasibility.check([offset], curve, duration)
    return report


def integrated(d_x: float, d_y: float, curve: Trajectory, duration: float) -> tuple[float, float]:
    """Worst `|theta_d|` and least `u / V_L` by SciPy on (26), its `kappa` from the curve."""

    def planar(t: float) -> tuple[complex, complex]:
        _, v, a, _, _ = curve(t)
        return complex(v[0], v[1]), complex(a[0], a[1])

    def rate(t: float, theta_d: np.ndarray) -> np.ndarray:
        v, a = planar(t)
        kappa = (v.conjugate() * a).imag / abs(v) ** 3
        return -abs(v) / d_x * (np.sin(theta_d) + d_x * kappa)

    t = np.linspace(0.0, duration, 4001)
    theta = solve_ivp(rate, (0.0, duration), [0.0], t_eval=t, rtol=1e-9, atol=1e-11).y[0]
    return float(np.abs(theta).max()), float((np.cos(theta) - d_y / d_x * np.sin(theta)).min())


@PROPERTY
@given(lengths, st.floats(-1.0, 1.0))
def test_equilibrium_stands_still_and_is_stable(d_x: float, product: float) -> None:
    curvature = product / d_x
    if abs(d_x * curvature) > 1.0:
        return
    theta = feasibility.equilibrium(d_x, curvature)

    def rate(angle: float) -> float:
        return -(sin(angle) + d_x * curvature) / d_x

    assert rate(theta) == pytest.approx(0.0, abs=1e-12)
    assert rate(theta + 0.01) <= 0.0 or abs(product) > 0.99
    assert rate(theta - 0.01) >= 0.0 or abs(product) > 0.99


@pytest.mark.parametrize(("d_x", "curvature"), [(0.5, 2.1), (0.5, -2.1), (1e200, 1e200)])
def test_no_equilibrium_on_a_circle_smaller_than_d_x(d_x: float, curvature: float) -> None:
    with pytest.raises(ValueError, match=r"d_x \* curvature = .*at most 1"):
        feasibility.equilibrium(d_x, curvature)


@PROPERTY
@given(lengths, st.floats(-2.0, 2.0), st.floats(0.0, 8.0))
def test_the_bound_is_29_and_30_as_printed(d_x: float, d_y: float, curvature: float) -> None:
    product = abs(d_x * curvature)
    angle = atan(abs(d_x / d_y)) if d_y else 0.5 * pi
    if abs(curvature * feasibility.max_curvature((d_x, d_y, 0.0)) ** -1 - 1.0) < 1e-9:
        return
    printed = product <= 1.0 and asin(product) < angle
    assert feasibility.no_inversion((d_x, d_y, 0.0), curvature) == printed
    assert feasibility.no_inversion((d_x, d_y, 0.0), -curvature) == printed


@PROPERTY
@given(st.floats(0.5, 3.0), st.floats(0.3, 1.5), st.floats(0.05, 0.9), st.sampled_from([1.0, -1.0]))
def test_on_a_circle_the_angle_converges_to_28(
    radius: float, speed: float, part: float, side: float
) -> None:
    """From zero it grows towards (28) and never beyond, so the worst angle is the equilibrium."""
    d_x, curve = part * radius, trajectories.circle(radius, side * speed)
    report = one((d_x, 0.0, 0.0), curve, 40.0 * radius / speed)
    equilibrium = feasibility.equilibrium(d_x, side / radius)
    assert report.worst_theta_d == pytest.approx(abs(equilibrium), abs=1e-4)
    assert report.curvature_max == pytest.approx(1.0 / radius)
    assert report.product_max == pytest.approx(part)


def test_the_side_of_the_leader_matters_on_a_circle() -> None:
    """Turning towards east (kappa > 0), theta_d < 0: the follower with d_y > 0 is the outer one."""
    curve = trajectories.circle(1.0, 0.5)
    outer, inner = feasibility.check(PAIR, curve, 60.0)
    theta = feasibility.equilibrium(0.35, 1.0)
    assert inner.least_speed_ratio == pytest.approx(np.cos(theta) + np.sin(theta), abs=1e-4)
    assert outer.least_speed_ratio == pytest.approx(1.0, abs=1e-12)
    # By geometry: the follower's own circle, at constant distance from the leader.
    mirrored = feasibility.check(PAIR, trajectories.circle(1.0, -0.5), 60.0)
    assert mirrored[0].least_speed_ratio == pytest.approx(inner.least_speed_ratio, abs=1e-9)


@pytest.mark.parametrize(
    ("curve", "duration"),
    [
        (trajectories.figure_eight(), 30.0),
        (trajectories.lemniscate(), 30.0),
        (trajectories.random_smooth().drawn(3), 30.0),
    ],
    ids=lambda x: getattr(x, "name", ""),
)
@pytest.mark.parametrize("d", [(0.35, 0.35), (0.35, -0.35), (0.8, 0.2), (0.002, 0.0)])
def test_the_integration_is_scipys(
    curve: Trajectory, duration: float, d: tuple[float, float]
) -> None:
    report = one((*d, 0.0), curve, duration)
    worst, least = integrated(*d, curve, duration)
    assert report.worst_theta_d == pytest.approx(worst, rel=5e-3)
    assert report.least_speed_ratio == pytest.approx(least, abs=2e-3)


@PROPERTY
@given(
    st.tuples(st.floats(0.5, 3.0), st.floats(0.5, 3.0)),
    st.floats(0.1, 0.6),
    lengths,
    st.floats(-2.0, 2.0),
)
def test_the_bound_is_sufficient(
    size: tuple[float, float], rate: float, d_x: float, d_y: float
) -> None:
    """(29)-(30): the angle stays below `arcsin |d_x kappa|`, and below the bound none inverts."""
    report = one((d_x, d_y, 0.0), trajectories.figure_eight(size, rate), 2.0 * pi / rate)
    if report.product_max <= 1.0:
        assert report.worst_theta_d <= asin(report.product_max) + 1e-3
    if report.bound_holds:
        assert not report.inverts


@PROPERTY
@given(st.floats(0.95, 0.999), lengths, st.floats(-2.0, 2.0), st.sampled_from([1.0, -1.0]))
def test_the_bound_is_sharp_on_circles(near: float, d_x: float, d_y: float, side: float) -> None:
    """Below the largest curvature the inner follower still moves forward, above it not.

    Where some heading is stable; otherwise the heading turns round and round, and both invert.
    """
    limit = feasibility.max_curvature((d_x, d_y, 0.0))
    below = trajectories.circle(1.0 / (near * limit), side)
    above = trajectories.circle(near / limit, side)
    left, right = (d_x, d_y, 0.0), (d_x, -d_y, 0.0)
    assert all(report.bound_holds for report in feasibility.check([left, right], below, 20.0))
    assert not any(report.inverts for report in feasibility.check([left, right], below, 20.0))
    beyond = feasibility.check([left, right], above, 200.0)
    assert not any(report.bound_holds for report in beyond)
    if d_x * beyond[0].curvature_max < 0.98:
        assert sum(report.inverts for report in beyond) == 1


def test_the_papers_pair_on_31_fails_the_bound_and_never_inverts() -> None:
    """Sufficient only: the tight ends of (31) are too short for the heading to follow them."""
    reports = feasibility.check(PAIR, trajectories.figure_eight(), 60.0)
    assert not any(report.bound_holds or report.inverts for report in reports)
    with pytest.warns(FeasibilityWarning, match=r"\(29\)-\(30\).*does not hold") as caught:
        feasibility.require_feasible(reports)
    text = str(caught[0].message)
    assert "for followers 0, 1: |(d_x, d_y)| up to 0.495 m" in text
    assert "radius of 0.418 m" in text and text.endswith(
        "by integrating (26), none moves backwards"
    )


def test_one_of_two_followers_that_inverts_is_named() -> None:
    with pytest.warns(
        FeasibilityWarning, match=r"for followers 0, 1: .*\(26\), follower 1 moves backwards$"
    ):
        configure(offsets=((0.35, 0.35, -0.3), (2.5, 0.0, -0.3)))


def test_the_papers_pair_on_70_meets_the_bound() -> None:
    reports = feasibility.check(PAIR, trajectories.lemniscate(), 60.0)
    assert all(report.bound_holds and not report.inverts for report in reports)
    assert reports[0].curvature_max == pytest.approx(3.0 / 1.5, rel=1e-4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        feasibility.require_feasible(reports)


def test_a_far_follower_inverts() -> None:
    report = one((0.35, 3.0, 0.0), trajectories.figure_eight(), 30.0)
    assert report.inverts and not report.bound_holds
    assert report.least_speed_ratio < -0.5
    assert str(report).startswith("follower 0, d = (0.35, 3, 0) m, moves backwards\n")
    with pytest.warns(
        FeasibilityWarning, match=r"does not hold for follower 0: .*\(26\), it moves backwards$"
    ):
        feasibility.require_feasible([report])


def test_no_stable_heading_is_an_error() -> None:
    """On a circle of 1 m with the leader 1.2 m ahead; at 0.9 m it is possible."""
    curve = trajectories.circle(1.0, 0.5)
    reports = feasibility.check([(0.3, 0.0, 0.0), (1.2, 0.0, 0.0)], curve, 20.0)
    assert [report.exists for report in reports] == [True, False]
    with pytest.raises(
        ValueError, match=r"no stable heading exists for follower 1: .* d_x = 1\.2 m .*\(28\)"
    ):
        feasibility.require_feasible(reports)
    assert one((0.9, 0.0, 0.0), curve, 20.0).exists
    # Too tight at its ends, straight in its middle: stable somewhere.
    assert one((1.2, 0.0, 0.0), trajectories.figure_eight(), 30.0).exists


def test_a_leader_that_stands_still_asks_nothing() -> None:
    curves = [trajectories.hover(), splines.waypoints([0.0, 3.0], [[0, 0, -1], [0, 0, -2]])]
    for curve in curves:
        report = one((0.35, 0.35, 0.0), curve, 5.0)
        assert report.bound_holds and report.exists and not report.inverts
        assert (report.worst_theta_d, report.least_speed_ratio) == (0.0, 1.0)


def test_a_leader_that_turns_back_inverts_its_follower() -> None:
    """North, stop, south: at rest the heading cannot follow, so it starts backwards."""
    curve = splines.waypoints([0.0, 4.0, 8.0], [[0, 0, -1], [4, 0, -1], [0, 0, -1]])
    report = one((0.35, 0.0, 0.0), curve, 8.0)
    assert report.worst_theta_d == pytest.approx(pi, abs=1e-3)
    assert report.least_speed_ratio == pytest.approx(-1.0, abs=1e-3)


def test_random_smooth_is_judged_by_its_bound() -> None:
    curve = trajectories.random_smooth(1.5, 0.75, 1.0)
    (report,) = feasibility.check([(0.35, 0.35, -0.3)], curve, 20.0)
    assert report.curvature_max == pytest.approx(1.0 / 0.75**2)
    assert report.bound_holds and not report.inverts
    drawn = [one((0.35, 0.35, -0.3), curve.drawn(key), 20.0) for key in range(8)]
    assert report.worst_theta_d == max(path.worst_theta_d for path in drawn)
    assert report.least_speed_ratio == min(path.least_speed_ratio for path in drawn)
    tight = trajectories.random_smooth(1.0, 0.7, 3.0)
    assert not one((0.35, 0.35, -0.3), tight, 20.0).bound_holds


def test_many_followers_are_reported_in_order() -> None:
    offsets = formations.wedge(64, 0.1)
    curve = trajectories.figure_eight()
    reports = feasibility.check(offsets, curve, 20.0)
    assert [report.follower for report in reports] == list(range(64))
    np.testing.assert_array_equal([report.offset for report in reports], offsets)
    # Alone, a follower gets the same verdict as among many (the step may be finer among many).
    for i in (0, 1, 40, 63):
        alone = one(tuple(offsets[i]), curve, 20.0)
        assert reports[i].worst_theta_d == pytest.approx(alone.worst_theta_d, abs=1e-3)
        assert reports[i].least_speed_ratio == pytest.approx(alone.least_speed_ratio, abs=1e-3)
        assert reports[i].bound_holds == alone.bound_holds
    with pytest.warns(
        FeasibilityWarning, match=r"followers (\d+, ){7}\d+ and \d+ more: "
    ) as caught:
        feasibility.require_feasible(reports)
    assert len(str(caught[0].message)) <= LONGEST


def test_a_formation_of_seven_prints_one_line() -> None:
    with pytest.warns(FeasibilityWarning) as caught:
        configure(offsets=formations.wedge(7))
    (text,) = (str(one.message) for one in caught)
    assert "\n" not in text and len(text) <= 300
    assert text.endswith("(26), they all move backwards")


def test_the_report_reads_well() -> None:
    text = str(one((0.35, -0.35, -0.3), trajectories.figure_eight(), 30.0)).splitlines()
    assert text[0] == "follower 0, d = (0.35, -0.35, -0.3) m, moves forward everywhere"
    assert [line.split()[0] for line in text[1:]] == ["(28)", "(29)-(30)", "(26)"]
    assert text[2].endswith("up to 57.0 deg, not below arctan|d_x/d_y| = 45.0 deg")
    good = str(one((0.35, -0.35, -0.3), trajectories.lemniscate(), 30.0))
    assert (
        "arcsin|d_x kappa_L| up to 44.4 deg, below arctan|d_x/d_y| = 45.0 deg: never backwards"
        in good
    )
    assert "not" not in good.split() and "no" not in good.split()
    tight = str(one((1.5, 0.0, 0.0), trajectories.figure_eight(), 30.0))
    assert "up to undefined, not below" in tight
    for report in (good, tight, *text):
        assert max(map(len, report.splitlines())) <= 100


def test_a_flight_of_years_is_integrated_as_far_as_it_goes() -> None:
    """In steps that the headings can follow, not in steps of hours."""
    long = feasibility.check(PAIR, trajectories.figure_eight(), 1e9)
    short = feasibility.check(PAIR, trajectories.figure_eight(), 1000.0)
    for a, b in zip(long, short, strict=True):
        assert a.worst_theta_d == pytest.approx(b.worst_theta_d, rel=1e-2)
        assert a.least_speed_ratio == pytest.approx(b.least_speed_ratio, abs=1e-2)


CURVE = trajectories.circle()
ONE_NUMBER: list[tuple[str, Callable[[Any], object]]] = [
    ("d_x", lambda x: feasibility.equilibrium(x, 0.1)),
    ("curvature", lambda x: feasibility.equilibrium(0.1, x)),
    ("curvature", lambda x: feasibility.no_inversion((0.3, 0.3, 0.0), x)),
    ("duration", lambda x: feasibility.check(PAIR, CURVE, x)),
]


@pytest.mark.parametrize(("name", "call"), ONE_NUMBER)
@pytest.mark.parametrize("value", NOT_NUMBERS, ids=lambda x: repr(x).partition(" at 0x")[0][:20])
def test_what_is_not_a_number_is_named(
    name: str, call: Callable[[Any], object], value: object
) -> None:
    with pytest.raises(ValueError, match=rf"^{name} = .*: expected") as caught:
        call(value)
    assert len(str(caught.value)) <= LONGEST


@pytest.mark.parametrize("value", NOT_ROWS, ids=lambda x: repr(x).partition(" at 0x")[0][:20])
def test_what_is_not_an_array_is_named(value: Any) -> None:
    for call in (
        lambda: feasibility.check(value, CURVE, 1.0),
        lambda: feasibility.max_curvature(value),
        lambda: feasibility.no_inversion(value, 0.1),
    ):
        with pytest.raises(ValueError, match=r"^offsets?(\[\d+\])? = .*: expected") as caught:
            call()
        assert len(str(caught.value)) <= LONGEST


@pytest.mark.parametrize("value", [None, "circle", 3, {}])
def test_what_is_not_a_trajectory_is_named(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^trajectory = .*: expected a Trajectory"):
        feasibility.check(PAIR, value, 1.0)


def test_numbers_of_few_bits_count() -> None:
    few = np.array([[1, 1, 0], [1, -1, 0]], np.int8)
    wide = trajectories.circle(3.0)
    assert feasibility.check(few, wide, np.int8(9)) == feasibility.check(few * 1.0, wide, 9.0)
    # The product of what an int8 holds does not fit in one.
    assert feasibility.no_inversion(np.array([100, 100, 0], np.int8), np.float16(0.007))


@pytest.mark.parametrize(
    ("name", "offsets", "duration"),
    [
        ("offsets", [(0.0, 1.0, 0.0)], 1.0),
        ("offsets", [(0.3, 1.0, 0.0), (-0.3, 1.0, 0.0)], 1.0),
        ("offsets", [(0.3, nan, 0.0)], 1.0),
        ("offsets", (0.3, 1.0, 0.0), 1.0),
        ("offsets", np.empty((0, 3)), 1.0),
        ("duration", PAIR, 1e16),
        ("duration", PAIR, 0.0),
        ("duration", PAIR, nan),
    ],
)
def test_bad_arguments_are_named(name: str, offsets: object, duration: float) -> None:
    with pytest.raises(ValueError, match=rf"^{name}(\[\d+\])? = "):
        feasibility.check(offsets, trajectories.hover(), duration)  # type: ignore[arg-type]
