"""Trajectories: every derivative is the slope of the one before, and each curve is what it says."""

from __future__ import annotations

import copy
import pickle
from itertools import pairwise
from math import cos, pi, sin

import numpy as np
import pytest
from closed_loop import PROPERTY
from hypothesis import given
from hypothesis import strategies as st
from paths import angles, closed_forms, heights, keys, paths, random_ones, sizes, speeds
from scipy.special import ellipk, ellipkinc

from formation_env import splines, trajectories
from formation_env.paths import references
from formation_env.paths.references import Floats, by_name
from formation_env.trajectories import Trajectory


def slopes(curve: Trajectory, t: Floats) -> Floats:
    """Central differences (fourth order) of derivatives 0 to 3, `(n, 4, 3)`."""
    h = 1e-3
    near = curve(t + h) - curve(t - h)
    far = curve(t + 2 * h) - curve(t - 2 * h)
    return ((8.0 * near - far) / (12.0 * h))[:, :4]


@PROPERTY
@given(closed_forms)
def test_each_derivative_is_the_slope_of_the_one_before(curve: Trajectory) -> None:
    t = np.linspace(0.0, min(curve.duration, 20.0), 41)[1:-1] + 0.01
    exact = np.stack([by_name(curve(t))[name] for name in "vajs"], axis=1)
    scale = 1.0 + np.abs(curve(t)).max()
    np.testing.assert_allclose(slopes(curve, t), exact, rtol=1e-5, atol=1e-6 * scale)


@PROPERTY
@given(st.tuples(sizes, sizes), st.floats(0.1, 1.0), heights, st.floats(0.0, 100.0))
def test_figure_eight_is_31(size: tuple[float, float], rate: float, height: float, t: float):
    expected = (size[0] * cos(rate * t), size[1] * sin(2.0 * rate * t), -height)
    p = trajectories.figure_eight(size, rate, height)(t)[0]
    np.testing.assert_allclose(p, expected, atol=1e-12)


def test_the_defaults_are_the_papers() -> None:
    np.testing.assert_allclose(
        trajectories.figure_eight()(3.0)[0], [2.0 * cos(0.75), sin(1.5), -1.5], atol=1e-14
    )
    tip = 1.5 * np.exp(0.25j * pi)
    p, v = trajectories.lemniscate()(0.0)[:2]
    np.testing.assert_allclose(p, [tip.real, tip.imag, -1.6], atol=1e-14)
    assert np.hypot(*v[:2]) == pytest.approx(0.5, abs=1e-14)


def test_amplitude_inverts_the_elliptic_integral_at_m_minus_one() -> None:
    u = np.linspace(-30.0, 30.0, 301)
    phi = np.array([references.amplitude(x) for x in u])
    np.testing.assert_allclose(ellipkinc(phi, -1.0), u, rtol=0.0, atol=2e-14)
    assert references.amplitude(ellipk(-1.0)) == pytest.approx(0.5 * pi, abs=1e-15)


@PROPERTY
@given(sizes, speeds, heights, angles, st.floats(0.0, 200.0))
def test_lemniscate_is_bernoullis_at_constant_speed(
    a: float, V: float, height: float, turn: float, t: float
) -> None:
    p, v = trajectories.lemniscate(a, V, height, turn)(t)[:2]
    assert np.linalg.norm(v) == pytest.approx(V, rel=1e-12)
    assert p[2] == -height
    z = complex(p[0], p[1]) * np.exp(-1j * turn)
    # |z|^4 = a^2 Re(z^2), and the printed parametrisation (70) at the angle that goes with it.
    assert abs(z) ** 4 == pytest.approx(a * a * (z * z).real, abs=1e-11 * a**4)
    phi = references.amplitude(V * t / a)
    printed = a * complex(cos(phi), 0.5 * sin(2.0 * phi)) / (1.0 + sin(phi) ** 2)
    assert abs(z - printed) < 1e-12 * a


@PROPERTY
@given(sizes, speeds | st.floats(-3.0, -0.05), st.tuples(angles, angles), st.floats(0.0, 50.0))
def test_circle_keeps_radius_and_speed(
    r: float, V: float, centre: tuple[float, float], t: float
) -> None:
    curve = trajectories.circle(r, V, 2.0, centre)
    p, v, a, *_ = curve(t)
    assert np.hypot(p[0] - centre[0], p[1] - centre[1]) == pytest.approx(r, rel=1e-12)
    # A positive speed turns from north to east: positive rotation about the axis pointing down.
    assert np.cross(p - [*centre, p[2]], v)[2] == pytest.approx(r * V, rel=1e-12)
    np.testing.assert_allclose(a, -((V / r) ** 2) * (p - [*centre, -2.0]), atol=1e-11)
    np.testing.assert_allclose(
        by_name(curve(0.0))["p"], [centre[0] + r, centre[1], -2.0], atol=1e-12
    )


def test_line_and_hover() -> None:
    p, v, *rest = trajectories.line((3.0, -4.0), 2.0, (1.0, 5.0))(2.0)
    assert p.tolist() == [7.0, -3.0, -2.0]
    assert v.tolist() == [3.0, -4.0, 0.0]
    assert not np.any(rest)
    still = trajectories.hover((1.0, 2.0, -3.0))([0.0, 9.0])
    assert still[:, 0].tolist() == [[1.0, 2.0, -3.0]] * 2
    assert not still[:, 1:].any()


def directions() -> list[tuple[Trajectory, complex]]:
    to_east = [[0.0, 0.0, -1.0], [0.0, 3.0, -2.0]]
    return [
        (trajectories.circle(), 1j),
        (trajectories.circle(speed=-0.5), -1j),
        (trajectories.line((3.0, -4.0)), 0.6 - 0.8j),
        (trajectories.figure_eight(), 1j),
        (trajectories.lemniscate(), 1j * np.exp(0.25j * pi)),
        (trajectories.lemniscate(turn=0.0), 1j),
        (trajectories.hover(), 1.0),
        (splines.from_function(lambda t: (3.1, -4.7, -1.5 - t), 9.0, 0.02), 1.0),
        (splines.from_function(lambda t: (3.1, 1.0 - cos(t), -1.5), 9.0, 0.02), 1j),
        # At rest: where it is about to go; straight up: north.
        (splines.waypoints([0.0, 2.0], to_east), 1j),
        (splines.waypoints([0.0, 2.0], [[0.0, 0.0, -1.0], [0.0, 0.0, -2.0]]), 1.0),
    ]


@pytest.mark.parametrize(("curve", "expected"), directions(), ids=lambda x: getattr(x, "name", ""))
def test_start_direction(curve: Trajectory, expected: complex) -> None:
    assert trajectories.start_direction(curve.kind, curve.table, 0.0) == pytest.approx(expected)


@PROPERTY
@given(closed_forms, st.floats(0.0, 5.0))
def test_a_path_that_is_begun_later_leaves_along_its_velocity(curve: Trajectory, t: float) -> None:
    vx, vy, _ = by_name(curve(t))["v"]
    if np.hypot(vx, vy) > 1e-3:
        expected = complex(vx, vy) / np.hypot(vx, vy)
        assert trajectories.start_direction(curve.kind, curve.table, t) == pytest.approx(expected)


@PROPERTY
@given(random_ones(), keys)
def test_random_smooth_keeps_its_bounds(curve: Trajectory, key: int) -> None:
    bounds = curve.random
    assert bounds is not None
    flown = by_name(curve.drawn(key)(np.linspace(0.0, 60.0, 2001)))
    p, v, a = (flown[name] for name in "pva")
    slack = 1e-9
    planar = np.hypot(v[:, 0], v[:, 1])
    for speed in (planar, np.linalg.norm(v, axis=1)):
        assert bounds.speed_min - slack <= speed.min()
        assert speed.max() <= bounds.speed_max + slack
    assert np.linalg.norm(a, axis=1).max() <= bounds.acceleration_max + slack
    jerk = np.linalg.norm(flown["j"], axis=1)
    assert jerk.max() <= trajectories.FASTEST * bounds.acceleration_max + slack
    curvature = np.abs(v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / planar**3
    assert curvature.max() <= bounds.curvature_max + slack
    assert np.abs(p[:, 2] + bounds.height).max() <= bounds.climb + slack
    assert p[:, 2].max() < 0.0
    np.testing.assert_allclose(p[0], [0.0, 0.0, -bounds.height], atol=1e-9)


def test_random_smooth_uses_its_bounds() -> None:
    """Over many draws the worst comes near what is allowed: the bounds are not merely vast."""
    curve = trajectories.random_smooth()
    t = np.linspace(0.0, 60.0, 1201)
    motion = np.stack([curve.drawn(key)(t) for key in range(200)])
    speed = np.linalg.norm(motion[:, :, 1], axis=2)
    acceleration = np.linalg.norm(motion[:, :, 2], axis=2)
    drop = np.abs(motion[:, :, 0, 2] + 1.5)
    assert speed.min() < 0.75 + 0.2
    assert speed.max() > 2.25 - 0.2
    assert acceleration.max() > 0.8
    assert drop.max() > 0.4
    directions = np.angle(motion[:, :, 1, 0].mean(axis=1) + 1j * motion[:, :, 1, 1].mean(axis=1))
    quarters = np.histogram(directions, bins=4, range=(-pi, pi))[0]
    assert quarters.min() > 30


def test_random_smooth_differs_by_key_and_only_by_key() -> None:
    curve = trajectories.random_smooth()
    tables = {curve.drawn(key).table.tobytes() for key in (0, 1, 2**32, 2**33, 2**64 - 1)}
    assert len(tables) == 5
    assert curve.drawn(7) == trajectories.random_smooth().drawn(7)
    one = curve.drawn(7).table[7:].reshape(3, 3, 3)
    assert len(np.unique(one)) == 27


@PROPERTY
@given(paths())
def test_waypoints_are_met_from_rest_to_rest(curve: Trajectory) -> None:
    pieces = int(curve.table[0])
    times = curve.table[1 : pieces + 2]
    assert curve.duration == times[-1]
    ends = by_name(curve([times[0], times[-1]]))
    np.testing.assert_allclose([ends[name] for name in "vaj"], 0.0, atol=1e-7)
    first = by_name(curve(0.0))
    assert not any(first[name].any() for name in "vaj")
    # Continuous up to snap, and beyond: the slope of snap too.
    before, after = curve(times[1:-1] - 1e-9), curve(times[1:-1] + 1e-9)
    np.testing.assert_allclose(before, after, atol=1e-5)


def test_waypoints_pass_through_the_points_in_order() -> None:
    times = [0.0, 1.0, 2.5, 3.0, 6.0]
    points = [[0, 0, -1], [1, 0, -2], [1, 1, -3], [0, 1, -2], [-2, 0, -1]]
    curve = splines.waypoints(times, points)
    np.testing.assert_allclose(by_name(curve(times))["p"], points, atol=1e-12)
    mixed = by_name(curve(np.array([[6.0, 1.0], [2.5, 0.0]])))["p"]
    np.testing.assert_allclose(mixed, [[points[4], points[1]], [points[2], points[0]]], atol=1e-12)


def test_two_waypoints_give_the_known_polynomial() -> None:
    """From rest to rest: `35 s^4 - 84 s^5 + 70 s^6 - 20 s^7`."""
    s = np.linspace(0.0, 1.0, 11)
    curve = splines.waypoints([0.0, 2.0], [[0.0, 1.0, -1.0], [1.0, 1.0, -3.0]])
    blend = 35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7
    expected = np.stack([blend, np.ones(11), -1.0 - 2.0 * blend], axis=1)
    np.testing.assert_allclose(by_name(curve(2.0 * s))["p"], expected, atol=1e-13)


@PROPERTY
@given(paths(), st.integers(0, 3))
def test_waypoints_have_the_least_snap(curve: Trajectory, power: int) -> None:
    """No change that keeps the points and the ends at rest lowers the cost.

    For the minimiser the snap is orthogonal to that of every such change, so the cost of the sum is
    the sum of the costs. The change here is `t^k` times factors that vanish at the points.
    """
    pieces = int(curve.table[0])
    times = curve.table[1 : pieces + 2]
    roots = [*times[1:-1], *[times[0]] * 4, *[times[-1]] * 4]
    change = np.polynomial.Polynomial.fromroots(roots) * np.polynomial.Polynomial([0, 1]) ** power
    extra = change.deriv(4)
    x, weights = np.polynomial.legendre.leggauss(20)
    cross = cost = own = 0.0
    for a, b in pairwise(times):
        t, w = 0.5 * (a + b) + 0.5 * (b - a) * x, 0.5 * (b - a) * weights
        snap = by_name(curve(t))["s"][:, 0]
        cross += w @ (snap * extra(t))
        cost += w @ snap**2
        own += w @ extra(t) ** 2
    assert abs(cross) <= 1e-7 * np.sqrt(cost * own) + 1e-12 * np.sqrt(own)


def test_a_function_becomes_a_spline_of_eighth_order() -> None:
    exact = trajectories.figure_eight(rate=1.0)
    t = np.linspace(10.0, 20.0, 501)  # away from the ends, whose error is larger

    def error(step: float) -> float:
        curve = splines.from_function(lambda x: by_name(exact(x))["p"], 30.0, step)
        return float(np.abs(by_name(curve(t))["p"] - by_name(exact(t))["p"]).max())

    coarse, fine = error(0.2), error(0.1)
    assert 7.7 < np.log2(coarse / fine) < 8.6
    curve = splines.from_function(lambda x: by_name(exact(x))["p"], 30.0)
    t = np.linspace(0.0, 30.0, 501)
    worst = np.abs(curve(t) - exact(t)).max(axis=(0, 2))
    assert (worst < [1e-11, 1e-8, 1e-6, 1e-4, 4e-3]).all()


def test_samples_at_uneven_times_reproduce_a_polynomial() -> None:
    """Degree 7 is in the space of the spline, so it comes back exactly."""
    times = np.cumsum([0.0, 0.3, 0.5, 0.4, 0.6, 0.2, 0.5, 0.3, 0.4, 0.7])
    curves = [np.polynomial.Polynomial(c) for c in ([1, -2, 0, 1, 0, 0.3, 0, -0.1], [2], [-9, 0.1])]
    points = np.stack([f(times) for f in curves], axis=1)
    curve = splines.from_samples(times, points)
    t = np.linspace(0.0, times[-1], 33)
    expected = np.stack(
        [np.stack([f.deriv(k)(t) for f in curves], axis=1) for k in range(5)], axis=1
    )
    np.testing.assert_allclose(curve(t), expected, atol=1e-7)


def test_splines_hold_their_ends() -> None:
    times, points = np.arange(9.0), np.stack([np.arange(9.0) ** 2, np.ones(9), -np.ones(9)], axis=1)
    curve = splines.from_samples(times, points)
    assert by_name(curve(8.0))["v"][0] == pytest.approx(16.0)
    for t, k in ((-0.1, 0), (-50.0, 0), (8.0 + 1e-9, -1), (99.0, -1)):
        np.testing.assert_allclose(by_name(curve(t))["p"], points[k], atol=1e-9)
        assert not any(by_name(curve(t))[name].any() for name in "vajs")


def test_a_trajectory_is_compared_and_copied_by_content() -> None:
    curve = trajectories.random_smooth()
    for twin in (
        trajectories.random_smooth(),
        pickle.loads(pickle.dumps(curve)),
        copy.deepcopy(curve),
    ):
        assert twin == curve
        assert hash(twin) == hash(curve)
        assert not twin.table.flags.writeable
    others = {trajectories.random_smooth(climb=0.4), curve.drawn(0), curve.drawn(1), curve}
    assert len(others) == 4
    assert trajectories.figure_eight() != trajectories.figure_eight(rate=0.3)
    assert curve != "random-smooth"
    with pytest.raises(ValueError, match="read-only"):
        curve.table[0] = 1.0


def test_a_trajectory_owns_its_table() -> None:
    table = trajectories.hover().table.copy()
    curve = Trajectory("mine", trajectories.SINES, table)
    table[3] = 9.0
    assert by_name(curve(0.0))["p"][2] == -1.5
