"""Splines at their edges: exactly at rest, on the floor, as many rows as there may be, gaps too uneven."""

from __future__ import annotations

import numpy as np
import pytest

from formation_env import splines
from formation_env.paths.references import by_name


@pytest.mark.parametrize("seed", range(20))
def test_way_points_start_exactly_at_rest(seed: int) -> None:
    """Velocity, acceleration and jerk are zero, not zero to rounding: the first that is not zero counts."""
    draw = np.random.default_rng(seed)
    times = np.cumsum([0.0, *draw.uniform(0.3, 3.0, 4)])
    curve = splines.waypoints(times, -1.0 - draw.uniform(0.0, 5.0, (5, 3)))
    first = by_name(curve(0.0))
    assert not any(first[name].any() for name in "vaj")
    assert first["s"].all()


def test_a_path_may_touch_the_floor_and_not_pass_it() -> None:
    times, points = np.arange(9.0), np.zeros((9, 3))
    assert splines.waypoints(times, points)(8.0)[0, 2] == 0.0
    assert splines.from_samples(times, points)(8.0)[0, 2] == 0.0
    assert splines.from_function(lambda t: (t, 0.0, 0.0), 1.0)(1.0)[0, 2] == pytest.approx(0.0)
    points[4, 2] = 1e-9
    with pytest.raises(ValueError, match=r"^points\[4\] = .*: expected a point above the floor"):
        splines.waypoints(times, points)


def test_a_function_is_sampled_at_least_once_in_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """At both ends, at equal times, at most `MOST_ROWS` in all."""
    monkeypatch.setattr(splines, "MOST_ROWS", 20)
    asked: list[float] = []

    def f(t: float) -> tuple[float, float, float]:
        asked.append(t)
        return (t, 0.0, -1.0)

    for steps in (7.0, 12.5, 19.0):
        asked.clear()
        splines.from_function(f, 6.0, 6.0 / steps)
        assert (asked[0], asked[-1]) == (0.0, 6.0)
        gaps = np.diff(asked)
        assert gaps.max() <= 6.0 / steps * (1.0 + 1e-9)
        np.testing.assert_allclose(gaps, gaps[0])
    assert len(asked) == 20
    for steps in (19.5, 20.0, 20.9):
        with pytest.raises(
            ValueError, match=r"^duration / step = .*: expected fewer than 20 steps"
        ):
            splines.from_function(f, 6.0, 6.0 / steps)


@pytest.mark.parametrize("seed", range(5))
def test_gaps_that_the_numbers_cannot_bridge_are_refused(seed: int) -> None:
    """What is accepted meets its points."""
    points = -1.0 - np.random.default_rng(seed).uniform(size=(9, 3))
    even = np.cumsum([0.0, 1.0, 1e-4, 1.0, 1e-4, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(splines.from_samples(even, points)(even)[:, 0], points, atol=1e-6)
    uneven = np.cumsum([0.0, 1.0, 1e-10, 1.0, 1e-10, 1.0, 1.0, 1.0, 1.0])
    with pytest.raises(ValueError, match=r"^gaps between the times = '1e-10 to 1 s'"):
        splines.from_samples(uneven, points)
