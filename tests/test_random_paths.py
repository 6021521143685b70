"""Random smooth paths as a distribution: phases, directions and rates, and bounds refused by name."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from closed_loop import PROPERTY, Array, agree
from hypothesis import given
from paths import keys, random_ones
from scipy import stats

from formation_env import trajectories
from formation_env.paths import random_paths
from formation_env.paths.random_paths import FASTEST, RandomSmooth
from formation_env.trajectories import Trajectory, path_start

BOUNDS = RandomSmooth(1.5, 0.75, 1.0, 1.5, 0.5, 3)


def waves(curve: Trajectory) -> Array:
    """Amplitude, rate and phase of each sine, `(3 axes, harmonics, 3)`."""
    return curve.table[7:].reshape(3, -1, 3)


def test_phases_and_directions_go_all_the_way_round() -> None:
    """Both are uniform on the circle, and no two axes or harmonics share a draw."""
    drawn = [trajectories.random_smooth().drawn(key) for key in range(1500)]
    phases = np.array([waves(curve)[..., 2].ravel() for curve in drawn]) / (2.0 * np.pi)
    for column in phases.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    assert np.abs(np.corrcoef(phases.T) - np.eye(9)).max() < 0.1
    drift = np.array([curve.table[4:7] for curve in drawn])
    angles = np.arctan2(drift[:, 1], drift[:, 0]) / (2.0 * np.pi) % 1.0
    assert stats.kstest(angles, "uniform").pvalue > 1e-3
    np.testing.assert_allclose(np.linalg.norm(drift, axis=1), 1.5)


@PROPERTY
@given(random_ones(), keys)
def test_either_the_speed_or_the_acceleration_is_at_its_bound(curve: Trajectory, key: int) -> None:
    """The sums that bound them, before the height is kept: at most each bound, one of them equal."""
    bounds = curve.random
    assert bounds is not None
    amplitude, rate, _ = np.moveaxis(waves(curve.drawn(key)), 2, 0)
    # The horizontal axes are scaled by speed and acceleration alone: their share is below the whole.
    reach = [np.linalg.norm((amplitude * rate**k).sum(axis=1)) for k in (1, 2)]
    assert reach[0] <= bounds.variation * (1.0 + 1e-12)
    assert reach[1] <= bounds.acceleration * (1.0 + 1e-12)
    fastest = min(2.0 * bounds.acceleration / max(bounds.variation, 1e-9), FASTEST)
    assert (0.2 * fastest <= rate).all() and (rate <= fastest).all()
    assert (amplitude[2].sum()) <= 0.5 * bounds.climb * (1.0 + 1e-12)
    if amplitude[2].sum() < 0.5 * bounds.climb * (1.0 - 1e-9) and bounds.variation > 1e-3:
        shares = np.divide(reach, (bounds.variation, bounds.acceleration))
        assert shares.max() == pytest.approx(1.0, rel=1e-9)


@PROPERTY
@given(random_ones(), keys)
def test_before_a_draw_the_table_holds_where_every_draw_starts(curve: Trajectory, key: int) -> None:
    assert curve.random is not None
    start = (0.0, 0.0, -curve.random.height)
    assert path_start(curve.kind, curve.table) == (1.0, start)
    agree(path_start(curve.kind, curve.drawn(key).table)[1], start, 1e-9)


def test_derived_bounds() -> None:
    assert (BOUNDS.speed_min, BOUNDS.speed_max) == (0.75, 2.25)
    assert BOUNDS.acceleration_max == 1.0
    assert BOUNDS.curvature_max == pytest.approx(1.0 / 0.75**2)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("variation", 1.5, r"at\.variation = 1\.5: expected from 0 to below the speed"),
        ("variation", -0.1, r"at\.variation = -0\.1"),
        ("climb", 1.5, r"at\.climb = 1\.5: expected from 0 to below the height"),
        ("climb", -0.1, r"at\.climb = -0\.1"),
        ("harmonics", 0, r"at\.harmonics = 0"),
        ("speed", 0.0, r"at\.speed = 0"),
        ("acceleration", 0.0, r"at\.acceleration = 0"),
        ("acceleration", 1e-16, r"at\.acceleration = 1e-16: expected more"),
        ("height", 0.0, r"at\.height = 0"),
    ],
)
def test_bounds_that_cannot_hold_are_named(field: str, value: float, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        random_paths.checked_bounds("at.", tuple(BOUNDS._replace(**{field: value})))


def test_a_leader_too_slow_for_its_acceleration_is_refused() -> None:
    crawling = BOUNDS._replace(speed=2e-8, variation=1e-8, acceleration=1.0)
    with pytest.raises(ValueError, match=r"^at\.speed - variation = 1e-08: expected a faster"):
        random_paths.checked_bounds("at.", tuple(crawling))


def test_bounds_at_their_ends_are_taken() -> None:
    for changed in ({"variation": 0.0}, {"climb": 0.0}, {"harmonics": 1}):
        bounds = BOUNDS._replace(**changed)
        assert random_paths.checked_bounds("", bounds) == bounds
        assert random_paths.checked_bounds("", bounds._asdict()) == bounds


def test_no_sine_repeats_another() -> None:
    table = np.sort(waves(trajectories.random_smooth(harmonics=5).drawn(3))[..., 1].ravel())
    assert all(a < b for a, b in pairwise(table))
