"""How the leader's path may lie in an episode: how that is drawn, and when a path repeats itself."""

from __future__ import annotations

from math import cos, inf, pi, sin
from typing import Any

import numpy as np
import pytest
from closed_loop import PROPERTY, agree, numbers, vectors
from courses import matrix, uniform_angles
from hypothesis import given
from hypothesis import strategies as st
from paths import angles, heights, paths, random_ones, sines, sizes, speeds
from scipy import stats

from formation_env import configure, splines, trajectories
from formation_env.paths.course import Course, Courses, draw_course, lay, lay_direction, lay_point
from formation_env.paths.references import TrajectoryPoint, by_name
from formation_env.trajectories import Trajectory

# -- the law --------------------------------------------------------------------------------------------

DRAWS = 4000


def test_courses_are_drawn_uniformly_and_independently() -> None:
    """Every angle alike, one half mirrored, every tick of the period alike."""
    drawn = [draw_course(key, Courses(1, 1, 1257)) for key in range(DRAWS)]
    angle = np.angle([course.turn for course, _ in drawn])
    side = np.array([course.side for course, _ in drawn])
    first = np.array([tick for _, tick in drawn])
    agree(np.abs([course.turn for course, _ in drawn]), 1.0, 1e-15)
    assert uniform_angles(angle)
    assert set(side) == {-1.0, 1.0}
    assert stats.binomtest(int((side < 0.0).sum()), DRAWS).pvalue > 1e-3
    assert 0 <= first.min() < 5
    assert 1252 <= first.max() <= 1256
    assert stats.kstest((first + 0.5) / 1257, "uniform").pvalue > 1e-3
    for x in (angle, np.abs(angle)):
        assert np.abs(np.corrcoef([x, side, first]) - np.eye(3)).max() < 0.06


def test_few_phases_are_all_drawn_alike() -> None:
    counts = np.bincount([draw_course(key, Courses(1, 0, 5))[1] for key in range(DRAWS)])
    assert len(counts) == 5
    assert stats.chisquare(counts).pvalue > 1e-3


def test_without_a_period_a_path_begins_at_its_first_tick() -> None:
    """And none is mirrored where the mirror image is not allowed; their angles stay the same."""
    for key in range(200):
        course, first = draw_course(key, Courses(1, 0, 0))
        assert (course.side, first) == (1.0, 0)
        assert course.turn == draw_course(key, Courses(1, 1, 99))[0].turn


COURSES = st.builds(
    lambda angle, side: Course(complex(cos(angle), sin(angle)), side),
    numbers(pi),
    st.sampled_from((-1.0, 1.0)),
)


@PROPERTY
@given(COURSES, st.tuples(*[vectors(5.0)] * 5))
def test_a_point_and_its_derivatives_are_mirrored_and_turned(course: Course, x: Any) -> None:
    M = matrix(course)
    for found, given_ in zip(lay_point(course, TrajectoryPoint(*x)), x, strict=True):
        agree(found, M @ given_, 1e-14)
    agree(lay(course, x[0]), M @ x[0], 1e-14)
    z = lay_direction(course, complex(*x[1][:2]))
    agree([z.real, z.imag], (M @ x[1])[:2], 1e-14)


@PROPERTY
@given(COURSES, vectors(5.0), vectors(5.0))
def test_lengths_stay_and_a_mirror_image_turns_the_other_way(course: Course, a: Any, b: Any):
    """So that speeds, accelerations and the size of curvatures stay; its sign is that of the side."""
    x, y = (np.array(lay(course, v)) for v in (a, b))
    agree(x @ y, np.dot(a, b), 1e-13)
    agree(np.cross(x, y)[2], course.side * np.cross(a, b)[2], 1e-13)


# -- periods --------------------------------------------------------------------------------------------

PERIODIC = st.one_of(
    st.builds(trajectories.figure_eight, st.tuples(sizes, sizes), st.floats(0.1, 1.0), heights),
    st.builds(trajectories.lemniscate, sizes, speeds, heights, angles),
    st.builds(trajectories.circle, sizes, speeds | st.floats(-3.0, -0.05), heights),
)


@PROPERTY
@given(PERIODIC, st.floats(0.0, 50.0))
def test_a_path_repeats_itself_after_its_period_and_not_before(curve: Trajectory, t: float) -> None:
    T = curve.period
    assert 0.0 < T < inf
    size = np.abs(curve(np.linspace(0.0, T, 50))).max(axis=(0, 2))[:, None]
    assert (np.abs(curve(t + T) - curve(t)) < 1e-9 * size).all()
    for part in (2, 3, 4, 5):
        at = t + np.linspace(0.0, T, 20)
        moved = np.abs(curve(at + T / part) - curve(at)).max(axis=(0, 2))
        assert moved[0] > 1e-2 * np.ptp(by_name(curve(at))["p"], axis=0).max()


def along_north(*waves: tuple[float, float, float], drift: float = 0.0) -> Trajectory:
    """Sines along north alone: amplitude, rate, phase."""
    return sines(waves, [(0.0, 1.0, 0.0)] * len(waves), drift)


def test_the_period_of_several_sines_is_their_least_common_one() -> None:
    """What has no amplitude or does not swing has no say."""
    two, three = (1.0, 2.0, 0.1), (1.0, 3.0, 0.2)
    assert along_north(two, three).period == pytest.approx(2.0 * pi)
    assert along_north(two, (1.0, -5.0, 0.0)).period == pytest.approx(2.0 * pi)
    assert along_north(two, (1.0, 4.0, 0.0)).period == pytest.approx(pi)
    assert along_north(two, (0.0, 7.3, 0.0), (3.0, 0.0, 1.0)).period == pytest.approx(pi)
    assert along_north((1.0, 1.0, 0.0), (1.0, 1.01, 0.0)).period == pytest.approx(200.0 * pi)
    assert along_north((1.0, 1.0, 0.0), (1.0, 2.0**0.5, 0.0)).period == inf
    assert along_north(two, three, drift=0.1).period == inf


@PROPERTY
@given(
    st.one_of(
        paths(),
        random_ones(),
        st.builds(trajectories.line, st.tuples(angles, angles), heights),
        st.just(trajectories.hover()),
        st.just(splines.from_function(lambda t: (2.0 * cos(t), sin(t), -1.5), 13.0, 0.1)),
    )
)
def test_a_path_that_does_not_repeat_itself_has_no_period(curve: Trajectory) -> None:
    assert curve.period == inf
    ends = Trajectory("ends", "lemniscate", trajectories.lemniscate().table, 60.0)
    assert ends.period == inf
    bounds = trajectories.random_smooth(harmonics=1).random
    circle = trajectories.circle().table  # which a drawn path replaces
    assert Trajectory("drawn", "sines", circle, random=bounds).period == inf
    assert configure(trajectory=trajectories.line()).phases == 0


def test_phases_are_the_ticks_of_a_period() -> None:
    config = configure()
    assert config.trajectory.period == pytest.approx(8.0 * pi)
    assert config.phases == 1257
    assert config.span == pytest.approx(config.duration + 1257 * 0.02)
    assert config.world.courses == Courses(1, 1, 1257)
    given_ = configure(path="as given")
    assert (given_.phases, given_.span) == (0, given_.duration)
    assert given_.world.courses == Courses(0, 0, 0)
