"""Strategies of Hypothesis that draw trajectories of every kind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import strategies as st

from formation_env import splines, trajectories
from formation_env.trajectories import Trajectory

sizes = st.floats(0.2, 5.0)
speeds = st.floats(0.05, 3.0)
heights = st.floats(0.5, 10.0)
angles = st.floats(-7.0, 7.0)
keys = st.integers(0, 2**64 - 1)
coordinates = st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-9, -1))


@st.composite
def random_ones(draw: st.DrawFn) -> Trajectory:
    speed, height = draw(speeds), draw(heights)
    return trajectories.random_smooth(
        speed,
        draw(st.floats(0.0, 0.95)) * speed,
        draw(st.floats(0.1, 5.0)),
        height,
        draw(st.floats(0.0, 0.95)) * height,
        draw(st.integers(1, 5)),
    )


@st.composite
def paths(draw: st.DrawFn) -> Trajectory:
    """Way-points one to three seconds apart."""
    count = draw(st.integers(2, 6))
    gaps = draw(st.lists(st.floats(1.0, 3.0), min_size=count - 1, max_size=count - 1))
    points = draw(st.lists(coordinates, min_size=count, max_size=count))
    return splines.waypoints(np.cumsum([0.0, *gaps]), points)


Waves = Sequence[tuple[float, float, float]]  # amplitude (m), rate (rad/s), phase (rad)


def sines(north: Waves, east: Waves, drift: float = 0.0) -> Trajectory:
    """Equally many sines along north and east, at 2 m, drifting north (m/s)."""
    level = [(0.0, 1.0, 0.0)] * len(north)
    table = [len(north), 0.0, 0.0, -2.0, drift, 0.0, 0.0, *np.ravel([*north, *east, *level])]
    return Trajectory("sines", "sines", np.array(table, dtype=float))


def begun(curve: Trajectory, at: float) -> Trajectory:
    """A path of sines that begins at another of its points."""
    table = curve.table.copy()
    amplitude_rate_phase = table[7:].reshape(-1, 3)
    amplitude_rate_phase[:, 2] += amplitude_rate_phase[:, 1] * at
    return Trajectory(curve.name, curve.kind, table)


closed_forms = st.one_of(
    st.builds(trajectories.figure_eight, st.tuples(sizes, sizes), st.floats(0.1, 1.0), heights),
    st.builds(trajectories.lemniscate, sizes, speeds, heights, angles),
    st.builds(trajectories.circle, sizes, speeds | st.floats(-3.0, -0.05), heights),
    st.builds(trajectories.line, st.tuples(angles, angles), heights),
    st.builds(trajectories.hover, coordinates),
    st.builds(lambda curve, key: curve.drawn(key), random_ones(), keys),
    paths(),
)
