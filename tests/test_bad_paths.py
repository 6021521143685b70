"""What may be given for a trajectory: checked when it is made, and named where it is wrong."""

from __future__ import annotations

import inspect
import pickle
import re
from collections.abc import Callable
from math import inf, nan
from time import perf_counter
from typing import Any

import numpy as np
import pytest
from closed_loop import PROPERTY
from hostile import NOT_COUNTS, NOT_NUMBERS, NOT_ROWS
from hypothesis import given, settings
from hypothesis import strategies as st

from formation_env import splines, trajectories
from formation_env.paths import references
from formation_env.paths.references import Floats
from formation_env.trajectories import Trajectory
from formation_env.validation.checks import LONGEST

POINTS = [[0.0, 0.0, -1.0], [1.0, 0.0, -1.0]]


# -- what a trajectory may be --------------------------------------------------------------------------


def table_of(make: Callable[..., Trajectory], index: int, value: float) -> Floats:
    """A good table with one entry replaced."""
    table = make().table.copy()
    table[index] = value
    return table


def two_pieces() -> Trajectory:
    return splines.waypoints([0.0, 1.0, 2.0], [[0, 0, -1], [1, 0, -1], [0, 0, -1]])


SINES, LEMNISCATE, SPLINE = references.SINES, references.LEMNISCATE, references.SPLINE
NO_TRAJECTORIES: list[tuple[str, tuple[Any, ...]]] = [
    # The two of the issue: an index beyond the table, and foreign memory.
    (r"table\[0\] = 1000000000.0: expected the number of pieces", ("x", 2, [1e9, 0, 1, 2])),
    (r"table = 1 numbers: expected 16, for 1 sines", ("x", 0, [1.0])),
    (r"name = 7", (7, 0, [1.0])),
    (r"name = 'x+ \.\.\.", ("x" * 1000, 0, [1.0])),
    (r"kind = 3: expected an integer from 0 to 2", ("x", 3, [1.0])),
    (r"kind = -1", ("x", -1, [1.0])),
    (r"kind = True", ("x", True, [1.0])),
    (r"kind = 0.0", ("x", 0.0, [1.0])),
    (r"kind = 'sine': expected one of 'sines'", ("x", "sine", [1.0])),
    (r"table = \[\]", ("x", 0, [])),
    (r"table = ", ("x", 0, None)),
    (r"table = ", ("x", 0, [[1.0]])),
    (r"table = ", ("x", 0, "1.0")),
    (r"table\[0\] = nan", ("x", 0, [nan] * 16)),
    (r"table\[0\] = 0.0: expected the number of sines", ("x", 0, np.zeros(7))),
    (r"table\[0\] = 1.5", ("x", 0, [1.5] * 16)),
    (r"table\[0\] = -1.0", ("x", 0, [-1.0] * 16)),
    (r"table\[0\] = 2.0|table = 16 numbers", ("x", 0, [2.0] * 16)),
    (r"table = 17 numbers", ("x", 0, [1.0] * 17)),
    (r"table\[8\] = 1e\+200", ("x", 0, table_of(trajectories.hover, 8, 1e200))),
    (r"table\[4\] = 1e\+200", ("x", 0, table_of(trajectories.line, 4, 1e200))),
    (r"snap of path 'x' = ", ("x", 0, table_of(trajectories.circle, 8, 1e4))),
    (r"table = 4 numbers: expected 5", ("x", 1, [1.0, 1.0, 1.0, 1.0])),
    (r"table\[0\] \(size\) = 0.0", ("x", 1, [0.0, 1.0, 1.0, 1.0, 0.0])),
    (r"table\[1\] \(speed\) = -1.0", ("x", 1, [1.0, -1.0, 1.0, 1.0, 0.0])),
    (r"table\[3:5\] = \[1.0, 1.0\]: expected cos and sin", ("x", 1, [1.0] * 5)),
    (r"table = 51 numbers: expected 52", ("x", 2, two_pieces().table[:-1])),
    (r"table\[2\] = 5.0|table\[3\] = 2.0: expected rising", ("x", 2, table_of(two_pieces, 2, 5.0))),
    (r"table\[9\] = 1e\+301", ("x", 2, table_of(two_pieces, 9, 1e301))),
    (r"position of path 'x' = ", ("x", 2, table_of(two_pieces, 9, 1e200))),
    (r"duration = 0.0", ("x", 0, trajectories.hover().table, 0.0)),
    (r"duration = nan", ("x", 0, trajectories.hover().table, nan)),
    (r"duration = -inf", ("x", 0, trajectories.hover().table, -inf)),
    (r"duration = '1'", ("x", 0, trajectories.hover().table, "1")),
    (r"duration = 10+ ", ("x", 0, trajectories.hover().table, 10**400)),
    (r"random = 'fast': expected the six numbers", ("x", 0, [1.0, *[0.0] * 15], inf, "fast")),
    (r"random.speed = -1.0", ("x", 0, [1.0, *[0.0] * 15], inf, (-1.0, 0.5, 1.0, 1.0, 0.5, 1))),
    (r"random.fast = 1", ("x", 0, [1.0, *[0.0] * 15], inf, {"fast": 1})),
    (r"random.harmonics = 3", ("x", 0, [1.0, *[0.0] * 15], inf, (1.0, 0.5, 1.0, 1.0, 0.5, 3))),
    (r"random.harmonics = 1", ("x", 2, two_pieces().table, inf, (1.0, 0.5, 1.0, 1.0, 0.5, 1))),
    (r"random.harmonics = 1.0", ("x", 0, [1.0] * 16, inf, (1.0, 0.5, 1.0, 1.0, 0.5, 1.0))),
]


@pytest.mark.parametrize(("message", "fields"), NO_TRAJECTORIES)
def test_what_is_no_trajectory_is_refused(message: str, fields: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match=rf"^{message}") as caught:
        Trajectory(*fields)
    assert len(str(caught.value)) <= LONGEST


class Forged:
    """Pickles as a trajectory of given fields."""

    def __init__(self, *fields: Any) -> None:
        self.fields = fields

    def __reduce__(self) -> tuple[Any, ...]:
        return (Trajectory, self.fields)


@pytest.mark.parametrize(("message", "fields"), NO_TRAJECTORIES[:2])
def test_a_pickle_is_checked(message: str, fields: tuple[Any, ...]) -> None:
    with pytest.raises(ValueError, match=rf"^{message}"):
        pickle.loads(pickle.dumps(Forged(*fields)))


def test_a_trajectory_keeps_plain_numbers() -> None:
    table = trajectories.hover().table
    curve = Trajectory("x", np.int8(0), table, np.float32(2.0))  # type: ignore[arg-type]
    assert (type(curve.kind), type(curve.duration)) == (int, float)
    assert curve == Trajectory("x", "sines", table, 2)  # type: ignore[arg-type]
    assert curve.duration == 2.0 and Trajectory("x", 0, table).duration == inf
    bounds = (np.float32(1.0), 0, 1, 2, 0, np.int8(100))
    random = Trajectory("x", 0, [100.0, *[0.0] * 906], inf, bounds).random  # type: ignore[arg-type]
    assert random is not None
    assert [type(x) for x in random] == [float] * 5 + [int]


# -- whatever a helper takes, its path is finite -------------------------------------------------------

any_number = st.floats(allow_nan=False, allow_infinity=False)
extremes = st.sampled_from([1e308, -1e308, 5e-324, 1e-300, 1e15, 1e-9, 1e9, 0.5, 1.0, 3.0])
wild = extremes | any_number
FACTORIES = (
    st.builds(lambda *x: lambda: trajectories.figure_eight(x[:2], *x[2:]), wild, wild, wild, wild),
    st.builds(lambda *x: lambda: trajectories.lemniscate(*x), wild, wild, wild, wild),
    st.builds(lambda *x: lambda: trajectories.circle(*x[:3], x[3:]), wild, wild, wild, wild, wild),
    st.builds(lambda *x: lambda: trajectories.line(x[:2], x[2], x[3:]), *[wild] * 5),
    st.builds(lambda *x: lambda: trajectories.hover(x), wild, wild, wild),
    st.builds(lambda *x: lambda: trajectories.random_smooth(*x), *[wild] * 5, st.integers(1, 4)),
    st.builds(
        lambda t, *x: lambda: splines.waypoints((0.0, *t), np.reshape(x, (3, 3)).tolist()),
        st.tuples(wild, wild),
        *[wild] * 9,
    ),
    st.builds(
        lambda t, x: lambda: splines.from_samples(t, np.reshape(x, (-1, 3)).tolist()),
        st.lists(wild, min_size=7, max_size=7).map(lambda t: [0.0, *sorted(map(abs, t))]),
        st.lists(wild, min_size=24, max_size=24),
    ),
    st.builds(
        lambda d, s, *x: (
            lambda: splines.from_function(lambda t: (x[0] * t, x[1], -abs(x[2])), d, s)
        ),
        *[wild] * 5,
    ),
)


def made(make: Callable[[], Trajectory]) -> tuple[Trajectory | None, str]:
    try:
        return make(), ""
    except ValueError as error:
        return None, str(error)


@settings(PROPERTY, max_examples=1000)
@given(st.one_of(FACTORIES), st.lists(extremes | st.floats(0.0, 1e15), min_size=1, max_size=4))
def test_a_path_is_finite_or_refused(make: Callable[[], Trajectory], times: list[float]) -> None:
    curve, refusal = made(make)
    if curve is None:
        assert re.match(r"[\w /().+-]+(\[\d+\])?( of path .*)? = .*: expected ", refusal), refusal
        assert len(refusal) <= LONGEST
        return
    times = [t for t in times if abs(t) <= 1e15]
    for path in (curve.drawn(0), curve.drawn(7)):
        assert np.isfinite(path(times)).all()
        assert np.isfinite(path(np.linspace(0.0, min(path.duration, 20.0), 101))).all()
        direction, p = trajectories.path_start(path.kind, path.table)
        assert np.isfinite([direction, *p]).all()


def numbers_of() -> list[tuple[str, str]]:
    """Every function of numbers here with each of its arguments that is one number."""
    made = {name: inspect.signature(make).parameters for name, make in FUNCTIONS.items()}
    return [
        (name, key)
        for name, known in made.items()
        for key, one in known.items()
        if isinstance(one.default, (int, float)) or key == "duration"
    ]


FUNCTIONS: dict[str, Callable[..., object]] = {
    **trajectories.FACTORIES,
    "from_function": splines.from_function,
}


def called(name: str, **given_: Any) -> object:
    if name == "from_function":
        given_ = {"f": lambda t: (t, 0.0, -1.0), "duration": 1.0, **given_}
    return FUNCTIONS[name](**given_)


@pytest.mark.parametrize(("name", "key"), numbers_of())
def test_hostile_numbers_are_named(name: str, key: str) -> None:
    for value in NOT_COUNTS if key == "harmonics" else NOT_NUMBERS:
        with pytest.raises(ValueError, match=rf"^{key} = .*: expected") as caught:
            called(name, **{key: value})
        assert len(str(caught.value)) <= LONGEST


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("figure_eight", "amplitude"),
        ("circle", "centre"),
        ("line", "velocity"),
        ("line", "start"),
        ("hover", "position"),
    ],
)
@pytest.mark.parametrize("value", NOT_ROWS, ids=lambda x: repr(x).partition(" at 0x")[0][:20])
def test_hostile_vectors_are_named(name: str, key: str, value: Any) -> None:
    with pytest.raises(ValueError, match=rf"^{key}(\[\d+\])? = .*: expected") as caught:
        called(name, **{key: value})
    assert len(str(caught.value)) <= LONGEST


@pytest.mark.parametrize("value", NOT_ROWS, ids=lambda x: repr(x).partition(" at 0x")[0][:20])
@pytest.mark.parametrize("name", ["waypoints", "from_samples"])
def test_hostile_tables_are_named(name: str, value: Any) -> None:
    rows = {"points": np.tile([0.0, 0.0, -1.0], (9, 1)), "times": np.arange(9.0)}
    for key in rows:
        with pytest.raises(ValueError, match=rf"^{key}(\[\d+\])? = .*: expected") as caught:
            called(name, **{**rows, key: value})
        assert len(str(caught.value)) <= LONGEST


@pytest.mark.parametrize(
    "value", [True, "1", None, nan, inf, 1e16, 1j, [1.0, "2"], [[1.0], []], 10**400]
)
def test_hostile_times_are_named(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^t(\[\d+\])? = .*: expected finite numbers"):
        trajectories.hover()(value)


@pytest.mark.parametrize("value", [True, 1.0, "1", None, -1, 2**64])
def test_hostile_keys_are_named(value: Any) -> None:
    for curve in (trajectories.random_smooth(), trajectories.hover()):
        with pytest.raises(ValueError, match=r"^key = .*: expected an integer"):
            curve.drawn(value)


# -- tables are refused by their rows ------------------------------------------------------------------

POINTS_DOWN = (
    "expected a point above the floor: z points down, so that 1.5 m above it is p_z = -1.5"
)


def long_log() -> tuple[Floats, Floats]:
    t = np.linspace(0.0, 60.0, 6000)
    return t, np.stack([np.cos(t / 3.0), np.sin(t / 3.0), np.full_like(t, -1.5)], axis=1)


def test_a_log_is_refused_by_its_row() -> None:
    t, p = long_log()
    broken, above, late = p.copy(), p * [1.0, 1.0, -1.0], t.copy()
    broken[4000, 1], late[17] = nan, late[16]
    for times, points, start, end in (
        (t, broken, "points[4000] = [", "m"),
        (t, above, "points[0] = [1.0, 0.0, 1.5]: ", POINTS_DOWN),
        (late, p, f"times[17] = {late[17]}: expected later than times[16]", ""),
        (t, p[1:], "points = 5999 rows: expected 6000", ""),
        (t[:5], p[:5], "times = 5 times: expected from 8 to 100000", ""),
        (t + 1.0, p, "times[0] = 1.0: expected 0 s", ""),
    ):
        for rows in ((times, points), (times.tolist(), points.tolist())):
            with pytest.raises(ValueError, match="expected") as caught:
                splines.from_samples(*rows)
            text = str(caught.value)
            assert text.startswith(start) and (text.endswith(end) or end == "m")
            assert len(text) <= 200


def test_a_function_is_refused_by_its_time() -> None:
    for f, message in (
        (lambda t: (t, 0.0, 1.5), rf"f\(0\) = \[0.0, 0.0, 1.5\]: {POINTS_DOWN}"),
        (lambda t: (t, 0.0, t - 1.0), rf"f\(1.05\) = .*: {POINTS_DOWN}"),
        (lambda t: (0.0, nan if t > 2.0 else 0.0, -1.0), r"f\(2.05\)\[1\] = nan: expected finite"),
        (lambda t: (0.0, 0.0), r"f\(0\) = \(0.0, 0.0\): expected 3 finite numbers"),
        (lambda t: None, r"f\(0\) = None: expected 3 finite numbers"),
        (7, r"f = 7: expected a function of time"),
    ):
        with pytest.raises(ValueError, match=f"^{message}") as caught:
            splines.from_function(f, 30.0)  # type: ignore[arg-type]
        assert len(str(caught.value)) <= LONGEST


def test_a_function_is_sampled_a_bounded_number_of_times() -> None:
    asked: list[float] = []

    def f(t: float) -> tuple[float, float, float]:
        asked.append(t)
        return (t, 0.0, -1.0)

    for duration, step in ((1e9, 0.05), (1.0, 1e-300), (1e15, 1e-320), (6000.0, 0.05)):
        with pytest.raises(ValueError, match=r"^duration / step = .*: expected fewer than 100000"):
            splines.from_function(f, duration, step)
    assert not asked
    assert splines.from_function(f, 5.0, 100.0).duration == 5.0
    assert len(asked) == 8


def test_a_long_log_stays_quick() -> None:
    t, p = long_log()
    splines.from_samples(t[:9], p[:9])  # SciPy's import
    began = perf_counter()
    curve = splines.from_samples(t, p)
    pickle.loads(pickle.dumps(curve))
    assert perf_counter() - began < 1.0  # 0.03 s on two quiet cores


BAD: list[tuple[str, Callable[[], object]]] = [
    ("amplitude", lambda: trajectories.figure_eight((1.0, nan))),
    ("amplitude", lambda: trajectories.figure_eight((1.0,))),  # type: ignore[arg-type]
    ("rate", lambda: trajectories.figure_eight(rate=0.0)),
    ("height", lambda: trajectories.figure_eight(height=-1.5)),
    ("size", lambda: trajectories.lemniscate(0.0)),
    ("speed", lambda: trajectories.lemniscate(speed=-0.5)),
    ("turn", lambda: trajectories.lemniscate(turn=inf)),
    ("radius", lambda: trajectories.circle(-1.0)),
    ("speed", lambda: trajectories.circle(speed=0.0)),
    ("centre", lambda: trajectories.circle(centre=(0.0, 0.0, 0.0))),  # type: ignore[arg-type]
    ("velocity", lambda: trajectories.line("north")),  # type: ignore[arg-type]
    ("start", lambda: trajectories.line(start=(inf, 0.0))),
    ("position", lambda: trajectories.hover((0.0, 0.0, 1.0))),
    ("position", lambda: trajectories.hover((0.0, 0.0, 0.0))),
    ("speed", lambda: trajectories.random_smooth(speed=0.0)),
    ("speed", lambda: trajectories.random_smooth(speed="fast")),  # type: ignore[arg-type]
    ("variation", lambda: trajectories.random_smooth(1.0, 1.0)),
    ("variation", lambda: trajectories.random_smooth(1.0, -0.1)),
    ("acceleration", lambda: trajectories.random_smooth(acceleration=0.0)),
    ("climb", lambda: trajectories.random_smooth(height=1.0, climb=1.0)),
    ("climb", lambda: trajectories.random_smooth(climb=-0.1)),
    ("harmonics", lambda: trajectories.random_smooth(harmonics=0)),
    ("harmonics", lambda: trajectories.random_smooth(harmonics=1.5)),  # type: ignore[arg-type]
    ("key", lambda: trajectories.random_smooth().drawn(-1)),
    ("key", lambda: trajectories.random_smooth().drawn(2**64)),
    ("trajectory", lambda: trajectories.random_smooth()(0.0)),
    ("t", lambda: trajectories.hover()([0.0, nan])),
    ("times", lambda: splines.waypoints([0.0], [[0.0, 0.0, -1.0]])),
    ("times", lambda: splines.waypoints([0.0, 0.0], POINTS)),
    ("times", lambda: splines.waypoints([1.0, 2.0], POINTS)),
    ("times", lambda: splines.waypoints([0.0, inf], POINTS)),
    ("times", lambda: splines.waypoints(["now", "then"], POINTS)),  # type: ignore[arg-type]
    ("points", lambda: splines.waypoints([0.0, 1.0], POINTS[:1])),
    ("points", lambda: splines.waypoints([0.0, 1.0], [[0.0, 0.0, -1.0], [nan, 0.0, -1.0]])),
    ("points", lambda: splines.waypoints([0.0, 1.0], [[0.0, 0.0, -1.0], [1.0, 0.0, 0.1]])),
    ("times", lambda: splines.from_samples(np.arange(7.0), -np.ones((7, 3)))),
    ("duration", lambda: splines.from_function(lambda t: (0.0, 0.0, -1.0), inf)),
    ("step", lambda: splines.from_function(lambda t: (0.0, 0.0, -1.0), 1.0, 0.0)),
    (r"f\(0\)", lambda: splines.from_function(lambda t: (0.0, 0.0), 1.0)),
]


@pytest.mark.parametrize(("name", "make"), BAD)
def test_a_bad_argument_is_named(name: str, make: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match=rf"^{name}(\[\d+\])? = .*: expected"):
        make()
