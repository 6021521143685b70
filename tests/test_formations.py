"""Formations: distances, rigidity, and that every follower is behind the leader."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from math import cos, inf, nan, pi, sin
from typing import Any

import numpy as np
import pytest
from closed_loop import PROPERTY
from hostile import NOT_COUNTS, NOT_NUMBERS, NOT_ROWS
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from formation_env import formations, trajectories
from formation_env._jit import plain
from formation_env.configuration.placement import MAX_FOLLOWERS
from formation_env.laws import feasibility, slots
from formation_env.paths.references import Floats, by_name
from formation_env.validation.checks import LONGEST

counts = st.integers(1, 256)
Maker = Callable[[int], Floats]

MAKERS: dict[str, Maker] = {
    "line": formations.line,
    "wedge": formations.wedge,
    "column": formations.column,
    "grid xy": lambda n: formations.grid(n, 5),
    "grid yz": lambda n: formations.grid(n, 5, plane="yz"),
    "circle xy": formations.circle,
    "circle yz": lambda n: formations.circle(n, plane="yz"),
}
# The largest number of followers for which each is rigid, as its docstring says.
RIGID_UP_TO = {
    "line": inf,
    "wedge": 2,
    "column": 1,
    "grid xy": 5,
    "grid yz": inf,
    "circle xy": 1,
    "circle yz": inf,
}
anyone = st.sampled_from(sorted(MAKERS))


def distances(offsets: Floats) -> Floats:
    """Between all followers, and from each to the leader, by SciPy."""
    return pdist(np.vstack([-offsets, np.zeros(3)]))


@PROPERTY
@given(anyone, counts)
def test_followers_are_distinct_and_behind(name: str, n: int) -> None:
    d = MAKERS[name](n)
    assert d.shape == (n, 3) and d.dtype == np.float64
    assert (d[:, 0] > 0.0).all()
    assert distances(d).min() > (0.3 if name != "circle xy" else 0.0) / (
        n if "circle" in name else 1
    )
    assert formations.min_separation(d) == pytest.approx(distances(d).min(), rel=1e-9)


@PROPERTY
@given(anyone, counts)
def test_rigid_is_what_the_docstrings_say(name: str, n: int) -> None:
    assert formations.is_rigid(MAKERS[name](n)) == (n <= RIGID_UP_TO[name])


@pytest.mark.parametrize("name", sorted(MAKERS))
def test_rigid_formations_keep_their_distances_on_a_curve(name: str) -> None:
    """II-D: the slots of equal `d_x` keep their distances; others come closer or drift apart."""
    d, curve = MAKERS[name](6), trajectories.figure_eight()
    t, h = np.arange(0.0, 10.0, 0.01), 0.01
    motion = by_name(curve(t))
    v = motion["v"][:, 0] + 1j * motion["v"][:, 1]
    spread = []
    for offset in d:
        R, path = v[0] / abs(v[0]), []
        for p, v0, v1 in zip(motion["p"][:-1], v[:-1], v[1:], strict=True):
            path.append(plain(slots.slot)(R, tuple(p), (v0.real, v0.imag, 0.0), tuple(offset)).p)
            R = plain(slots.advance_heading)(R, v0, v1, offset[0], h)
        spread.append(path)
    where = np.array(spread)
    between = np.array([pdist(where[:, k]) for k in range(0, where.shape[1], 50)])
    change = np.ptp(between, axis=0).max()
    assert (change < 1e-9) if formations.is_rigid(d) else (change > 0.05)


def test_paper_pair_is_III_C() -> None:
    expected = [[0.35, 0.35, -0.3], [0.35, -0.35, -0.3]]
    assert formations.paper_pair().tolist() == expected
    np.testing.assert_allclose(formations.line(2), expected, atol=1e-15)
    assert distances(formations.paper_pair()).max() == pytest.approx(0.7)


@PROPERTY
@given(counts, st.floats(0.1, 5.0), st.floats(0.1, 5.0), st.floats(-2.0, 2.0))
def test_line(n: int, spacing: float, ahead: float, below: float) -> None:
    d = formations.line(n, spacing, ahead, below)
    assert (d[:, 0] == ahead).all() and (d[:, 2] == -below).all()
    np.testing.assert_allclose(np.diff(d[:, 1]), -spacing, rtol=1e-9)
    np.testing.assert_allclose(d[:, 1] + d[::-1, 1], 0.0, atol=1e-9)


@PROPERTY
@given(counts, st.floats(0.1, 5.0), st.floats(0.1, 5.0), st.floats(-2.0, 2.0))
def test_stack(n: int, spacing: float, ahead: float, below: float) -> None:
    """Pairs abreast, each pair `spacing` m above the last; the first `below` the leader."""
    d = formations.stack(n, spacing, ahead, below)
    for i, (d_x, d_y, d_z) in enumerate(d):
        assert (d_x, d_y) == (ahead, 0.5 * spacing if i % 2 == 0 else -0.5 * spacing)
        # The leader is below by `d_z`, z points down: a pair higher up sees it lower.
        assert d_z == pytest.approx(spacing * (i // 2) - below)
    np.testing.assert_allclose(formations.stack(2), formations.paper_pair())


@PROPERTY
@given(counts, st.floats(0.1, 5.0), st.floats(0.1, 1.4), st.floats(-2.0, 2.0))
def test_wedge(n: int, spacing: float, half_angle: float, below: float) -> None:
    d = formations.wedge(n, spacing, half_angle, below)
    left, right = d[::2], d[1::2]
    for arm, side in ((left, 1.0), (right, -1.0)):
        step = np.diff(np.vstack([[0.0, 0.0, -below], arm]), axis=0)
        expected = [spacing * cos(half_angle), side * spacing * sin(half_angle), 0.0]
        np.testing.assert_allclose(step, np.tile(expected, (len(arm), 1)), atol=1e-9)


def test_column() -> None:
    expected = [[0.5, 0.0, -0.2], [1.0, 0.0, -0.2], [1.5, 0.0, -0.2]]
    np.testing.assert_allclose(formations.column(3, 0.5, 0.2), expected, atol=1e-15)


def test_grid() -> None:
    flat = formations.grid(5, 3, 0.5, 0.4, 0.1)
    rows = [[0.4, 0.5], [0.4, 0.0], [0.4, -0.5], [0.9, 0.25], [0.9, -0.25]]
    np.testing.assert_allclose(flat, [[*row, -0.1] for row in rows], atol=1e-15)
    upright = formations.grid(5, 3, 0.5, 0.4, 0.1, plane="yz")
    height = [0.15, 0.15, 0.15, -0.35, -0.35]  # d_z, down: the first row sees the leader lowest
    expected = [[0.4, row[1], z] for row, z in zip(rows, height, strict=True)]
    np.testing.assert_allclose(upright, expected, atol=1e-15)


@PROPERTY
@given(counts, st.floats(0.2, 3.0), st.floats(0.1, 2.0), st.floats(-2.0, 2.0))
def test_circle(n: int, radius: float, gap: float, below: float) -> None:
    centre = np.array([radius + gap, 0.0, -below])
    for plane, normal in (("xy", 2), ("yz", 0)):
        spokes = formations.circle(n, radius, radius + gap, below, plane) - centre  # type: ignore[arg-type]
        np.testing.assert_allclose(np.linalg.norm(spokes, axis=1), radius, rtol=1e-9)
        assert np.abs(spokes[:, normal]).max() < 1e-12
        # Evenly filled: all neighbours at the same angle.
        cosines = (spokes * np.roll(spokes, 1, axis=0)).sum(axis=1) / radius**2
        np.testing.assert_allclose(cosines, cos(2.0 * pi / n), atol=1e-9)
    assert feasibility.no_inversion(centre, 0.9 / (radius + gap))


def test_min_separation_counts_the_leader() -> None:
    near = [(0.2, 0.0, 0.0), (2.0, 0.0, 0.0), (4.0, 1.0, 0.0)]
    assert formations.min_separation(near) == pytest.approx(0.2)
    assert formations.min_separation([(3.0, 4.0, 12.0)]) == pytest.approx(13.0)
    pair = [(5.0, 1.0, 0.0), (5.0, 1.0, 0.3)]
    assert formations.min_separation(pair) == pytest.approx(0.3)


def test_rigidity_ignores_side_and_height() -> None:
    assert formations.is_rigid([(0.3, 1.0, 0.0), (0.3, -2.0, 5.0)])
    assert not formations.is_rigid([(0.3, 1.0, 0.0), (0.3001, 1.0, 0.0)])


CALLS: dict[str, Callable[..., object]] = {
    "line": formations.line,
    "stack": formations.stack,
    "wedge": formations.wedge,
    "column": formations.column,
    "grid": lambda n=4, columns=2, **options: formations.grid(n, columns, **options),
    "circle": formations.circle,
}


def arguments() -> list[tuple[str, str]]:
    """Every formation with each of its arguments but the plane."""
    parameters = {name: inspect.signature(getattr(formations, name)).parameters for name in CALLS}
    return [(f, name) for f in CALLS for name in parameters[f] if name != "plane"]


@pytest.mark.parametrize(("formation", "name"), arguments())
def test_hostile_arguments_are_named(formation: str, name: str) -> None:
    counts = name in ("n", "columns")
    for value in NOT_COUNTS if counts else NOT_NUMBERS:
        given_ = {"n": 4, name: value}
        with pytest.raises(ValueError, match=rf"^{name} = .*: expected") as caught:
            CALLS[formation](**given_)
        assert len(str(caught.value)) <= LONGEST


@pytest.mark.parametrize("formation", CALLS)
def test_the_number_of_followers_has_an_upper_bound(formation: str) -> None:
    assert np.shape(CALLS[formation](n=formations.MAX_FOLLOWERS)) == (4096, 3)
    with pytest.raises(ValueError, match=r"^n = 4097: expected an integer from 1 to 4096$"):
        CALLS[formation](n=4097)
    assert formations.MAX_FOLLOWERS == MAX_FOLLOWERS  # what a configuration takes


@pytest.mark.parametrize("value", NOT_ROWS, ids=lambda x: repr(x).partition(" at 0x")[0][:20])
def test_hostile_offsets_are_named(value: Any) -> None:
    for call in (formations.is_rigid, formations.min_separation):
        with pytest.raises(ValueError, match=r"^offsets(\[\d+\])? = .*: expected") as caught:
            call(value)
        assert len(str(caught.value)) <= LONGEST


def test_numbers_of_few_bits_count() -> None:
    """What is stored is a plain number: 100 x 2 does not fit in eight bits."""
    np.testing.assert_array_equal(
        formations.column(np.int8(3), np.int8(100)), formations.column(3, 100.0)
    )
    np.testing.assert_array_equal(
        formations.grid(np.uint8(200), np.int8(100)), formations.grid(200, 100)
    )
    assert formations.min_separation(np.array([[100, 0, 0], [0, 100, 0]], np.int8)) == 100.0


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("n", lambda: formations.line(0)),
        ("n", lambda: formations.column(2.0)),
        ("spacing", lambda: formations.line(2, 0.0)),
        ("spacing", lambda: formations.wedge(2, -0.1)),
        ("ahead", lambda: formations.line(2, ahead=0.0)),
        ("ahead", lambda: formations.grid(2, 2, ahead=inf)),
        ("below", lambda: formations.column(2, below=nan)),
        ("half_angle", lambda: formations.wedge(2, half_angle=0.5 * pi)),
        ("half_angle", lambda: formations.wedge(2, half_angle=0.0)),
        ("columns", lambda: formations.grid(4, 0)),
        ("plane", lambda: formations.grid(4, 2, plane="xz")),
        ("plane", lambda: formations.circle(4, plane="")),
        ("radius", lambda: formations.circle(4, 0.0)),
        ("ahead", lambda: formations.circle(4, 1.0, 1.0)),
        ("offsets", lambda: formations.is_rigid([(0.3, 1.0)])),
        ("offsets", lambda: formations.min_separation(np.empty((0, 3)))),
        ("offsets", lambda: formations.min_separation([(nan, 1.0, 0.0)])),
    ],
)
def test_a_bad_argument_is_named(name: str, make: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match=rf"^{name}(\[\d+\])? = .*: expected"):
        make()
