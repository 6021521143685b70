"""What the tables of trajectories may hold, and the bounds of a path that follow from its terms."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from closed_loop import PROPERTY
from hypothesis import given
from hypothesis import strategies as st
from paths import closed_forms, sizes, speeds

from formation_env import splines, trajectories
from formation_env.paths import tables
from formation_env.paths.references import LEMNISCATE, SINES, SPLINE, Floats
from formation_env.paths.tables import LARGEST, MOST_HARMONICS
from formation_env.trajectories import Trajectory


def found(curve: Trajectory, duration: float) -> Floats:
    """The largest norms of position to snap on the path."""
    motion = curve(np.linspace(0.0, duration, 2001))
    return np.asarray(np.linalg.norm(motion, axis=2).max(axis=0))


@PROPERTY
@given(closed_forms, st.floats(0.0, 30.0))
def test_the_reach_bounds_the_path(curve: Trajectory, duration: float) -> None:
    bounds = tables.reach(curve.kind, curve.table, duration)
    assert (found(curve, duration) <= bounds * (1.0 + 1e-9) + 1e-9).all()


@PROPERTY
@given(sizes, st.floats(0.1, 2.0), st.floats(0.0, 2.0 * pi))
def test_the_reach_of_one_sine_is_reached(a: float, rate: float, phase: float) -> None:
    """Amplitude times powers of the rate, in every derivative."""
    table = np.zeros(16)
    table[0], table[7:10] = 1.0, (a, rate, phase)
    curve = Trajectory("one", SINES, table)
    bounds = tables.reach(SINES, curve.table)
    np.testing.assert_allclose(bounds, a * rate ** np.arange(5), rtol=1e-12)
    np.testing.assert_allclose(found(curve, 2.0 * pi / rate), bounds, rtol=1e-5)


def test_the_reach_of_a_line_is_reached() -> None:
    """Away from the origin, `drift t` further away; a derivative that is zero has the bound zero."""
    curve = trajectories.line((3.0, 4.0), 1.0, (0.0, 0.0))
    bounds = tables.reach(curve.kind, curve.table, 10.0)
    np.testing.assert_allclose(bounds, [1.0 + 50.0, 5.0, 0.0, 0.0, 0.0])
    assert found(curve, 10.0)[0] == pytest.approx(np.hypot(50.0, 1.0))


@PROPERTY
@given(sizes, speeds, st.floats(0.5, 10.0))
def test_the_reach_of_a_lemniscate_is_near(a: float, V: float, height: float) -> None:
    """Position, speed and acceleration are reached, jerk and snap within a factor of two."""
    curve = trajectories.lemniscate(a, V, height)
    bounds = tables.reach(curve.kind, curve.table)
    shares = found(curve, 6.0 * a / V) / bounds
    np.testing.assert_allclose(shares[:3], 1.0, rtol=1e-4)
    assert (shares[3:] > 0.5).all()


def test_the_reach_of_a_power_is_reached_at_the_end_of_its_piece() -> None:
    """One piece of `t^m` on [0, 2]: every derivative is largest at 2; of two pieces the larger counts."""
    for m in range(8):
        table = np.zeros(3 + 24)
        table[0], table[2], table[3 + m] = 1.0, 2.0, 1.0
        power = np.polynomial.Polynomial([0.0] * m + [1.0])
        expected = [power.deriv(k)(2.0) if k else power(2.0) for k in range(5)]
        np.testing.assert_allclose(tables.reach(SPLINE, table), expected)
        longer = np.concatenate([[2.0, 0.0, 2.0, 3.0], table[3:], 0.5 * table[3:]])
        np.testing.assert_allclose(tables.reach(SPLINE, longer), expected)


def test_the_reach_of_a_spline_is_a_norm_over_the_axes() -> None:
    """`(2, 3, 6) t`: at most `7 t` away, at 7 m/s."""
    table = np.zeros(3 + 24)
    table[0], table[2] = 1.0, 5.0
    table[[4, 12, 20]] = 2.0, 3.0, 6.0
    np.testing.assert_allclose(tables.reach(SPLINE, table), [35.0, 7.0, 0.0, 0.0, 0.0])


def test_a_path_beyond_the_largest_numbers_is_refused() -> None:
    table = trajectories.hover().table.copy()
    table[7:9] = 1e3, 1e3
    tables.require_finite("mine", SINES, table)  # snap: 1e15
    table[7] = 1.1e4
    with pytest.raises(
        ValueError, match=r"^snap of path mine = 1\.1e\+16: expected at most 1e\+15"
    ):
        tables.require_finite("mine", SINES, table)


EIGHT = trajectories.figure_eight().table
LEAF = trajectories.lemniscate().table
PATH = splines.waypoints([0.0, 1.0, 2.0], [[0, 0, -1], [1, 0, -1], [2, 0, -1]]).table


def changed(table: Floats, index: int, value: float) -> Floats:
    other = table.copy()
    other[index] = value
    return other


@pytest.mark.parametrize(
    ("kind", "table", "message"),
    [
        (SINES, changed(EIGHT, 0, 0.0), r"t\[0\] = 0\.0: expected the number of sines per axis"),
        (SINES, changed(EIGHT, 0, 1.5), r"t\[0\] = 1\.5: expected the number"),
        (SINES, changed(EIGHT, 0, MOST_HARMONICS + 1.0), r"t\[0\] = 1001\.0: expected the number"),
        (SINES, changed(EIGHT, 0, 2.0), r"t = 16 numbers: expected 25, for 2 sines per axis"),
        (SINES, changed(EIGHT, 9, 30.0 * LARGEST), r"t\[9\] = 3e\+16: expected at most 1e\+15"),
        (SINES, changed(EIGHT, 9, -30.0 * LARGEST), r"t\[9\] = -3e\+16"),
        (LEMNISCATE, LEAF[:4], r"t = 4 numbers: expected 5"),
        (LEMNISCATE, changed(LEAF, 0, 0.0), r"t\[0\] \(size\)"),
        (LEMNISCATE, changed(LEAF, 1, -1.0), r"t\[1\] \(speed\)"),
        (LEMNISCATE, changed(LEAF, 2, 0.0), r"t\[2\] \(height\)"),
        (LEMNISCATE, changed(LEAF, 3, 0.7072), r"t\[3:5\] = .*: expected cos and sin"),
        (SPLINE, PATH[:-1], rf"t = {len(PATH) - 1} numbers: expected {len(PATH)}"),
        (SPLINE, changed(PATH, 2, 0.0), r"t\[2\] = 0\.0: expected rising break points"),
        (SPLINE, changed(PATH, 1, -30.0 * LARGEST), r"t: last break point = 3e\+16"),
        (SPLINE, changed(PATH, int(PATH[0]) + 1, 30.0 * LARGEST), r"t: last break point = 3e\+16"),
        (SPLINE, changed(PATH, -1, -2e300), rf"t\[{len(PATH) - 1}\] = -2e\+300: expected at most"),
    ],
)
def test_what_is_no_table_is_refused_by_its_entry(kind: int, table: Floats, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        tables.checked("t", kind, table)


def test_kinds_have_a_number_and_a_name() -> None:
    for name, kind in (("sines", SINES), ("lemniscate", LEMNISCATE), ("spline", SPLINE)):
        assert tables.checked_kind("kind", name) == tables.checked_kind("kind", kind) == kind
    for bad in ("sine", -1, 3, 0.5):
        with pytest.raises(ValueError, match=r"^kind = "):
            tables.checked_kind("kind", bad)
