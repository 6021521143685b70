"""What episodes draw of how their path lies, and that the same flight is asked for there."""

from __future__ import annotations

import warnings
from math import cos, sin
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from courses import matrix, uniform_angles
from numba import config as numba_config
from paths import begun
from states import counters, outcome

from formation_env import FeasibilityWarning, configure, formation_v0, splines, trajectories
from formation_env.core import arrays
from formation_env.core.simulation import Simulation
from formation_env.env import FormationEnv
from formation_env.memory.records import LANES
from formation_env.paths.course import Course, draw_course
from formation_env.paths.references import by_name
from formation_env.vector import FormationVectorEnv

Floats = npt.NDArray[np.float64]


Floats = npt.NDArray[np.float64]

flies = pytest.mark.skipif(bool(numba_config.DISABLE_JIT), reason="takes minutes in plain Python")

CALM: dict[str, Any] = {"gust": 0.0}


def started(worlds: int = 1, scenario: str = "nominal", **options: Any) -> Simulation:
    """Worlds at their first tick, each of a stream of its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FeasibilityWarning)
        simulation = Simulation(configure(scenario, **options), worlds)
    for w in range(worlds):
        simulation.seed(w, 300 + w)
    simulation.reset()
    return simulation


def course_of(simulation: Simulation, world: int) -> tuple[Course, int]:
    """How the path lies in one world, and the tick of it that its episode began with."""
    tile, lane = divmod(world, LANES)
    found = arrays.rows(simulation._state.courses, Course)
    first = counters(simulation._state.counters)["first"]
    turn = complex(*found["turn"][tile, :, lane])
    return Course(turn, float(found["side"][tile, 0, lane])), int(first[tile, lane])


def yaws(simulation: Simulation) -> Floats:
    """Angles about the vertical of all level vehicles, `(worlds, vehicles)`, rad."""
    q = simulation.attitudes
    return np.asarray(np.angle((q[..., 0] + 1j * q[..., 3]) ** 2))


# -- what episodes draw ---------------------------------------------------------------------------------

SLOW_CIRCLE = trajectories.circle(2.0, 0.8)


@flies
@pytest.mark.parametrize(
    ("scenario", "options"),
    [
        ("nominal", {}),
        ("nominal", {"duration": 3000.0}),
        ("nominal", {"trajectory": SLOW_CIRCLE}),
        ("experiment", {}),
        ("agile", {}),
        ("swarm", {"followers": 4}),
    ],
    ids=["nominal", "long", "circle", "experiment", "agile", "swarm"],
)
def test_the_reference_is_the_given_path_mirrored_turned_and_begun_later(
    scenario: str, options: dict[str, Any]
) -> None:
    simulation = started(20, scenario, **options)
    config, seen = simulation.config, set()
    t = np.linspace(0.0, 19.0, 96)
    keys = arrays.MEMORY.views(simulation._memory)["episode_keys"].reshape(-1)
    for w in range(20):
        course, first = course_of(simulation, w)
        assert (course, first) == draw_course(keys[w], config.world.courses)
        begun_at = first * config.control_period
        assert 0.0 <= begun_at < (config.trajectory.period if config.phases else 1e-9)
        path = config.trajectory.drawn(int(keys[w]))(t + begun_at)[:, 0]
        np.testing.assert_allclose(simulation.reference(t, w), path @ matrix(course).T, atol=1e-9)
        seen.add((course.turn, first))
    assert len(seen) == 20
    assert {course_of(simulation, w)[0].side for w in range(20)} == {-1.0, 1.0}


@flies
@pytest.mark.parametrize("options", [{}, {"duration": 3000.0}], ids=["tabulated", "long"])
@pytest.mark.parametrize("scenario", ["nominal", "agile"])
def test_the_leader_flies_along_it(scenario: str, options: dict[str, Any]) -> None:
    """It starts on it, trimmed, so that without noise and gusts it stays on it."""
    simulation = started(20, scenario, **CALM, **options, limits={"lost": 1e3, "collision": 1e-3})
    hover = np.zeros((20, 2, 4), np.float32)
    for _ in range(150):
        simulation.step(hover)
        for w in range(20):
            there = simulation.reference(simulation.clock[w : w + 1], w)[0]
            assert np.linalg.norm(simulation.leaders[w] - there) < 0.02
    assert not simulation.over.any()


@flies
@pytest.mark.parametrize("scenario", ["nominal", "paper"])
def test_every_vehicle_begins_with_a_yaw_of_its_own(scenario: str) -> None:
    """Uniform; not that of another vehicle, nor the angle of its path."""
    hovering = {"trajectory": trajectories.hover()}  # where a leader in flight is level, too
    simulation = started(3000, scenario, **hovering, follower_starts=None, leader_start=None)
    yaw = yaws(simulation)
    for vehicle in range(3):
        assert uniform_angles(yaw[:, vehicle])
    turn = np.angle([course_of(simulation, w)[0].turn for w in range(3000)])
    for one, other in ((yaw[:, 0], yaw[:, 1]), (yaw[:, 1], yaw[:, 2]), (yaw[:, 0], turn)):
        assert uniform_angles(one - other)
        assert uniform_angles(one + other)


@flies
@pytest.mark.parametrize("scenario", ["nominal", "paper", "agile"])
def test_as_given_nothing_of_it_is_drawn(scenario: str) -> None:
    simulation = started(40, scenario, path="as given")
    for w in range(40):
        assert course_of(simulation, w) == (Course(1.0 + 0.0j, 1.0), 0)
    assert (simulation.attitudes[:, 1:] == (1.0, 0.0, 0.0, 0.0)).all()
    if scenario != "agile":
        t = np.linspace(0.0, 20.0, 50)
        path = by_name(simulation.config.trajectory(t))["p"]
        np.testing.assert_array_equal(simulation.reference(t, 39), path)
        np.testing.assert_array_equal(simulation.leaders, simulation.leaders[:1].repeat(40, 0))
    if scenario == "paper":
        stood = np.array(simulation.config.ground_starts())
        np.testing.assert_array_equal(simulation.positions, stood[None].repeat(40, 0))


@flies
@pytest.mark.parametrize("scenario", ["paper", "experiment"])
@pytest.mark.parametrize("followers", [2, 5])
def test_ground_starts_lie_along_the_path(scenario: str, followers: int) -> None:
    """As far from its first point as on the given path, and in the same directions from its own."""
    simulation = started(30, scenario, followers=followers)
    config = simulation.config
    given = by_name(config.trajectory(0.0))
    p, v = given["p"], given["v"]
    stood = np.array(config.ground_starts())
    z = (stood[:, 0] - p[0]) + 1j * (stood[:, 1] - p[1])
    expected = z * abs(complex(*v[:2])) / complex(*v[:2])
    h = 1e-5
    for w in range(30):
        begin, ahead = simulation.reference(np.array([0.0, h]), w)
        x, y, height = (simulation.positions[w] - begin).T
        along = complex(*(ahead - begin)[:2])
        np.testing.assert_allclose((x + 1j * y) * abs(along) / along, expected, atol=1e-4)
        np.testing.assert_allclose(height, -p[2], atol=1e-12)
        np.testing.assert_allclose(np.hypot(x, y), np.abs(z), atol=1e-12)


# A follower beside the leader, further from it than its circle's radius of 1 m: outside of it it moves
# forwards, but inside, which the mirror image has, backwards.
BESIDE = {"trajectory": trajectories.circle(1.0, 0.5), "offsets": ((0.4, 1.2, -0.3),)}


@flies
def test_a_mirror_image_that_cannot_be_followed_is_not_drawn() -> None:
    sides = {}
    for d_y in (1.2, -1.2, 0.4):
        simulation = started(60, **{**BESIDE, "offsets": ((0.4, d_y, -0.3),)})
        inverts = [report.inverts for report in simulation.config.feasibility()]
        sides[d_y] = inverts, {course_of(simulation, w)[0].side for w in range(60)}
    assert sides[1.2] == ([False], {1.0})
    assert sides[-1.2] == ([True], {-1.0, 1.0})  # as given it inverts, which a warning tells
    assert sides[0.4] == ([False], {-1.0, 1.0})


def slowest_slots(simulation: Simulation, ticks: int) -> Floats:
    """Least speed of the first follower's slot along its heading in so many ticks, m/s, by world."""
    d, period = complex(*simulation.config.offsets[0][:2]), simulation.config.control_period
    hover = np.zeros((simulation.num_worlds, simulation.config.followers, 4), np.float32)
    slots, headings = [], []
    for _ in range(ticks):
        simulation.step(hover)
        slots.append(simulation.slots[:, 0, :2] @ (1.0, 1.0j))
        headings.append((simulation.leaders[:, :2] @ (1.0, 1.0j) - slots[-1]) / d)
    assert not simulation.over.any()
    speeds = np.diff(slots, axis=0) * np.conj(headings[1:]) / period
    return np.asarray(speeds.real.min(axis=0))


@flies
def test_what_inverts_on_the_given_path_is_flown_there_and_not_on_its_image() -> None:
    """As the user has been warned; half of the episodes are without."""
    options = {
        **BESIDE,
        "offsets": ((0.4, -1.2, -0.3),),
        "limits": {"lost": 1e3, "collision": 1e-3},
    }
    simulation = started(40, **options, start_offset=0.0, **CALM)
    sides = [course_of(simulation, w)[0].side for w in range(40)]
    slowest = slowest_slots(simulation, 300)
    assert (slowest[np.equal(sides, 1.0)] < -0.05).all()
    assert (slowest[np.equal(sides, -1.0)] > 0.05).all()


@flies
@pytest.mark.parametrize("path", ["drawn", "as given"])
def test_what_is_told_of_inversions_is_what_episodes_fly(path: str) -> None:
    """This follower moves forwards from the first point of the path on, and backwards from most others."""
    curve, d = begun(trajectories.figure_eight(), 14.0), (1.0, 0.2, -0.3)
    options = {"trajectory": curve, "offsets": (d,), "path": path, "start_offset": 0.0}
    options["duration"] = 26.0  # as given it would invert later
    simulation = started(40, **options, **CALM, limits={"lost": 1e3, "collision": 1e-3})
    (report,) = simulation.config.feasibility()
    backwards = (slowest_slots(simulation, 1000) < 0.0).mean()
    assert (report.inverts, backwards > 0.5, backwards > 0.0) == (path == "drawn",) * 3


# -- the flight is the same ------------------------------------------------------------------------------


def flown(simulation: Simulation, ticks: int) -> Floats:
    """Slot errors in m, `(ticks, worlds, followers)`, of the paper's expert."""
    from baselines import make_policy  # here, since mutants are tried on a copy without it

    policy = make_policy("expert", simulation.config)
    policy.reset(worlds=simulation.num_worlds)
    results, errors = simulation.look(), []
    for _ in range(ticks):
        results = simulation.step(policy.act(results.observations))
        errors.append(np.linalg.norm(outcome(results, "slot_error"), axis=-1))
    assert not simulation.over.any()
    return np.array(errors)


@flies
@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
def test_on_a_turned_path_the_expert_flies_the_turned_flight(action: str) -> None:
    """Its errors are the same whatever the angle, and on a mirror image those of the mirrored pair."""
    # (31), but as a spline, which has no period: all worlds begin at the same point of it.
    path = splines.from_function(
        lambda t: (2.0 * cos(0.25 * t), sin(0.5 * t), -1.5), 30.0, step=0.1
    )
    simulation = started(24, action=action, trajectory=path, start_offset=0.0, **CALM)
    courses = [course_of(simulation, w)[0] for w in range(24)]
    angle = np.angle([course.turn for course in courses])
    assert np.ptp(angle) > 4.0
    assert {course.side for course in courses} == {-1.0, 1.0}
    errors = flown(simulation, 400)
    assert errors.max() > 1e-3, "nothing disturbs this flight, so there is nothing to compare"
    for w, course in enumerate(courses):
        own = errors[:, w] if course.side > 0.0 else errors[:, w, ::-1]
        reference = next(v for v in range(24) if courses[v].side > 0.0)
        np.testing.assert_allclose(own, errors[:, reference], rtol=0.0, atol=1e-6)


# -- snapshots ------------------------------------------------------------------------------------------


def bad_course(state: dict[str, Any], name: str, value: Any) -> None:
    arrays.rows(state["courses"], Course)[name][0, :, 1] = value


def bad_phase(state: dict[str, Any], name: str, value: Any) -> None:
    arrays.rows(state["counters"], arrays.Counters)[name][0, 0, 1] = value


@flies
@pytest.mark.parametrize(
    ("change", "name", "value", "told"),
    [
        (bad_course, "turn", (1.1, 0.0), r"courses \(squared norm of a turn\)"),
        (bad_course, "turn", (np.nan, 0.0), r"courses \(squared norm of a turn\)"),
        (bad_course, "turn", (0.0, 0.0), r"courses \(squared norm of a turn\)"),
        (bad_course, "side", 0.5, r"courses \(side\)"),
        (bad_course, "side", np.nan, r"courses \(side\)"),
        (bad_phase, "first", -1, r"counters\[first\]"),
        (bad_phase, "first", 1257, r"counters\[first\]"),
    ],
)
def test_a_snapshot_with_a_course_that_is_none_is_refused(
    change: Any, name: str, value: Any, told: str
) -> None:
    simulation = started(3)
    saved, before = simulation.get_state(), simulation.reference(np.arange(5.0), 1)
    change(saved.state, name, value)
    with pytest.raises(ValueError, match=told):
        simulation.set_state(saved)
    np.testing.assert_array_equal(simulation.reference(np.arange(5.0), 1), before)


@flies
@pytest.mark.parametrize(
    ("options", "name", "value", "told"),
    [
        ({"path": "as given"}, "turn", (0.0, 1.0), r"courses \(turn\)"),
        ({"path": "as given"}, "side", -1.0, r"courses \(side\)"),
        (BESIDE, "side", -1.0, r"courses \(side\)"),
    ],
)
def test_a_snapshot_with_a_course_that_is_never_drawn_is_refused(
    options: dict[str, Any], name: str, value: Any, told: str
) -> None:
    simulation = started(3, **options)
    saved = simulation.get_state()
    simulation.set_state(saved)
    bad_course(saved.state, name, value)
    with pytest.raises(ValueError, match=told):
        simulation.set_state(saved)


@flies
def test_a_snapshot_keeps_the_course() -> None:
    simulation, other = started(3), started(3)
    saved = simulation.get_state()
    other.reset()
    changed = other.reference(np.arange(5.0), 1)
    other.set_state(saved)
    np.testing.assert_array_equal(
        other.reference(np.arange(5.0), 1), simulation.reference(np.arange(5.0), 1)
    )
    assert np.abs(changed - other.reference(np.arange(5.0), 1)).max() > 0.1


# -- three faces ----------------------------------------------------------------------------------------


@flies
@pytest.mark.parametrize("scenario", ["nominal", "paper", "agile"])
def test_the_same_seed_is_the_same_course_on_all_faces(scenario: str) -> None:
    single, many = FormationEnv(scenario), FormationVectorEnv(3, scenario)
    parallel = formation_v0.parallel_env(scenario=scenario)
    single.reset(seed=21), parallel.reset(seed=21), many.reset(seed=20)
    for _ in range(3):
        found = course_of(single.simulation, 0)
        assert course_of(many.simulation, 1) == found
        state = parallel.get_state().state
        lane = {name: part[0, :, 0] for name, part in arrays.rows(state["courses"], Course).items()}
        assert (complex(*lane["turn"]), float(lane["side"][0])) == found[0]
        assert counters(state["counters"])["first"][0, 0] == found[1]
        single.reset(), parallel.reset(), many.reset()
        assert course_of(single.simulation, 0) != found
