"""Loops made from laws: in every lane what the law gives for that lane, and nothing else is written."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import config as numba_config
from states import filled, lane_of, line

from formation_env._jit import device, kernel, plain
from formation_env.core.arrays import rows
from formation_env.memory import tiles
from formation_env.memory.records import LANES, build, fields, flatten, size
from formation_env.memory.tiles import FLAGS, LOOPS, over_lanes

Pair = tuple[float, float]


class Small(NamedTuple):
    """What the laws here take and return."""

    a: float
    pair: Pair


class Large(NamedTuple):
    """A layout that holds a `Small`."""

    z: complex
    pair: Pair
    other: float
    a: float


class Constant(NamedTuple):
    """The same in all lanes."""

    gain: float
    offset: Pair
    n: int


class Sums(NamedTuple):
    """Two counts."""

    many: int
    few: bool


CONSTANT = Constant(2.5, (0.5, -0.25), 3)


@pytest.fixture(autouse=True)
def _loops_of_this_test() -> Iterator[None]:
    """What is made here is not part of the package's list."""
    before = list(LOOPS)
    yield
    LOOPS[:] = before


def drawn(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def value(x: Any, kind: Any, lane: int, layout: Any = None) -> Any:
    """The record in one lane, read by NumPy alone."""
    named = lane_of(x, layout or kind, lane)
    numbers = [n for name in fields(kind) for n in np.atleast_1d(named[name])]
    reads = [f"{n!r}" for n in map(float, numbers)]
    return eval(build(kind, reads, names := {}), names)  # type: ignore[var-annotated]


def flags(seed: int) -> Any:
    return drawn(seed).integers(0, 2, LANES).astype(np.float64)


# -- what is loaded and stored ------------------------------------------------------------------------


def join(x: Small, u: Small, g: float, on: bool, n: int) -> Small:
    """Of no symmetry, so that no argument can stand for another."""
    s = 1.0 if on else -2.0
    return Small(x.a + 2.0 * u.a * g + s, (x.pair[1] * u.pair[0] - n, x.pair[0] - g * u.pair[1]))


def test_every_lane_is_the_law_of_its_numbers() -> None:
    """Records, numbers, whole numbers and truth values; the argument that is stored into is overwritten."""
    run, draw = over_lanes(join, into=("x",)), drawn()
    x, u, g, on = filled(Small, draw), filled(Small, draw), draw.normal(size=LANES), flags(1)
    n, before = draw.integers(0, 9, LANES), x.copy()
    rest = u.copy(), g.copy(), on.copy(), n.copy()
    run(x, u, g, on, n)
    for lane in range(LANES):
        given = value(before, Small, lane), value(u, Small, lane), g[lane], bool(on[lane]), n[lane]
        np.testing.assert_allclose(
            flatten(value(x, Small, lane)), flatten(join(*given)), rtol=1e-14
        )
    for one, was in zip((u, g, on, n), rest, strict=True):
        np.testing.assert_array_equal(one, was)


def test_a_new_array_comes_last_and_layouts_are_larger_records() -> None:
    """`out` is none of the law's arguments; `u` and `out` lie in rows of `Large`, the rest of which stays."""
    run, draw = over_lanes(join, into=("out",), u=Large, out=Large), drawn(1)
    x, u, out = filled(Small, draw), filled(Large, draw), filled(Large, draw)
    g, on, n, before = draw.normal(size=LANES), flags(2), draw.integers(0, 9, LANES), out.copy()
    run(x, u, g, on, n, out)
    named, was = rows(out, Large), rows(before, Large)
    for lane in range(LANES):
        given = value(x, Small, lane), value(u, Small, lane, Large)
        expected = join(*given, g[lane], bool(on[lane]), n[lane])
        np.testing.assert_allclose(
            flatten(value(out, Small, lane, Large)), flatten(expected), rtol=1e-14
        )
    for name in ("z", "other"):
        np.testing.assert_array_equal(named[name], was[name])


def test_flags_are_an_array_of_booleans() -> None:
    run, draw = over_lanes(join, into=("x",), on=FLAGS), drawn(2)
    x, u, g, n = filled(Small, draw), filled(Small, draw), draw.normal(size=LANES), np.arange(LANES)
    on, before = draw.integers(0, 2, LANES).astype(np.bool_), x.copy()
    run(x, u, g, on, n)
    for lane in range(LANES):
        expected = join(value(before, Small, lane), value(u, Small, lane), g[lane], on[lane], lane)
        np.testing.assert_allclose(flatten(value(x, Small, lane)), flatten(expected), rtol=1e-14)


def shifted(x: Small, gain: float, c: Constant, offset: Pair) -> Small:
    return Small(gain * x.a + c.n, (x.pair[0] * c.gain + offset[0], x.pair[1] + c.offset[1]))


def test_uniform_arguments_are_the_same_in_all_lanes() -> None:
    """A number as it is, a record and a tuple from the line of its numbers."""
    run = over_lanes(shifted, into=("x",), uniform=("gain", "c", "offset"))
    x, offset = filled(Small, drawn(3)), (0.75, -0.5)
    before = x.copy()
    run(x, 1.5, line(CONSTANT), np.array([*offset, 99.0]))
    for lane in range(LANES):
        expected = shifted(value(before, Small, lane), 1.5, CONSTANT, offset)
        np.testing.assert_allclose(flatten(value(x, Small, lane)), flatten(expected), rtol=1e-14)


# -- constants, conditions, bounds --------------------------------------------------------------------


def turned(x: Small, way: int, times: int) -> Small:
    if way == 2:
        return Small(-x.a * times, x.pair)
    return Small(x.a * times + way, (x.pair[1], x.pair[0]))


def test_a_static_argument_chooses_among_loops_of_its_constants() -> None:
    """One for each combination; in each the argument is a constant, for those given and no other."""
    before, static = len(LOOPS), {"way": (0, 2), "times": (1, 5)}
    run = over_lanes(turned, into=("out",), static=static)
    names = [one.name for one in LOOPS[before:]]
    assert names == ["turned_0_1", "turned_0_5", "turned_2_1", "turned_2_5"]
    x = filled(Small, drawn(4))
    for way in static["way"]:
        for times in static["times"]:
            out = np.zeros_like(x)
            run(x, way, times, out)
            for lane in range(LANES):
                expected = turned(value(x, Small, lane), way, times)
                np.testing.assert_allclose(flatten(value(out, Small, lane)), flatten(expected))
    for one, values in zip(LOOPS[before:], ((0, 1), (0, 5), (2, 1), (2, 5)), strict=True):
        space = plain(one.run).__globals__
        assert (space["way"], space["times"]) == values


def kept(x: Small, on: bool, g: float) -> Small:
    return Small(x.a + g, (x.pair[1], g))


@pytest.mark.parametrize("layout", [Small, Large])
def test_what_is_kept_where_a_condition_holds(layout: Any) -> None:
    run, draw = over_lanes(kept, into=("x",), keep="on", x=layout), drawn(5)
    x, g, on = filled(layout, draw), draw.normal(size=LANES), flags(6)
    before = x.copy()
    run(x, on, g)
    for lane in range(LANES):
        was, now = (value(one, Small, lane, layout) for one in (before, x))
        assert now == (kept(was, True, g[lane]) if on[lane] else was)
    if layout is Large:
        for name in ("z", "other"):
            np.testing.assert_array_equal(rows(x, Large)[name], rows(before, Large)[name])


def test_what_is_stored_is_clipped_to_bounds() -> None:
    limits = (0.5, 1.0, 2.0)
    run, draw = over_lanes(kept, into=("out",), bounds=limits), drawn(7)
    x, g, out = 3.0 * filled(Small, draw), draw.normal(size=LANES), np.zeros(3 * LANES, np.float32)
    rows(x, Small)["a"][0, 2] = np.nan
    run(x, flags(0), g, out)
    for lane in range(LANES):
        wanted = np.array(flatten(kept(value_or_nan(x, lane), True, g[lane])))
        expected = np.where(
            np.isnan(wanted), np.negative(limits), np.clip(wanted, np.negative(limits), limits)
        )
        np.testing.assert_array_equal(out.reshape(3, LANES)[:, lane], expected.astype(np.float32))


def value_or_nan(x: Any, lane: int) -> Small:
    a, *pair = x.reshape(3, LANES)[:, lane]
    return Small(a, tuple(pair))


# -- several results and sums -------------------------------------------------------------------------


def both(x: Small, g: float) -> tuple[float, Small]:
    return g * x.a, Small(x.pair[0], (g, x.a))


def counted(x: Small, limit: float) -> tuple[Small, Sums]:
    return Small(-x.a, x.pair), Sums(3 * int(x.a > 0.0), x.pair[0] > limit)


def noted(x: Small, limit: float) -> tuple[float, bool]:
    return x.a * 2.0, x.a > limit


def only(x: Small, limit: float) -> bool:
    return x.a > limit


def only_sums(x: Small, limit: float) -> Sums:
    return Sums(2 * int(x.a > limit), x.pair[1] > limit)


def test_several_results_go_to_several_arrays_in_order() -> None:
    run, draw = over_lanes(both, into=("first", "second"), second=Large), drawn(8)
    x, g = filled(Small, draw), draw.normal(size=LANES)
    first, second = np.zeros(LANES), np.zeros(size(Large) * LANES)
    assert run(x, g, first, second) is None
    for lane in range(LANES):
        a, b = both(value(x, Small, lane), g[lane])
        assert first[lane] == pytest.approx(a, rel=1e-15)
        assert value(second, Small, lane, Large) == b


def test_what_is_returned_beyond_the_arrays_is_summed() -> None:
    """A record of counts, a truth value, with arrays and without."""
    x, out = filled(Small, drawn(9)), np.zeros(3 * LANES)
    a, first = rows(x, Small)["a"][0], rows(x, Small)["pair"][0]
    sums = over_lanes(counted, into=("out",), uniform=("limit",))(x, 0.25, out)
    assert (sums.many, sums.few) == (3 * (a > 0.0).sum(), (first > 0.25).sum())
    np.testing.assert_array_equal(rows(out, Small)["a"][0], -a)
    run, doubled = over_lanes(noted, into=("out",), uniform=("limit",)), np.zeros(LANES)
    assert run(x, 0.25, doubled) == (a > 0.25).sum()
    np.testing.assert_array_equal(doubled, 2.0 * a)
    assert over_lanes(only, uniform=("limit",))(x, 0.25) == (a > 0.25).sum()
    sums = over_lanes(only_sums, uniform=("limit",))(x, 0.25)
    assert tuple(sums) == (2 * (a > 0.25).sum(), (rows(x, Small)["pair"][1] > 0.25).sum())


# -- laws that read for themselves --------------------------------------------------------------------


def own(lane: Any, x: Small, table: Any, g: float) -> float:
    return x.a + table[lane] * g  # type: ignore[no-any-return]


def first_of(x: Small, table: Any) -> float:
    return x.a * table[1]  # type: ignore[no-any-return]


def test_an_argument_of_any_type_is_handed_on_as_it_is() -> None:
    """With the lane, if the law's first argument is `lane`, which is none of the loop's."""
    x, draw, out = filled(Small, drawn(10)), drawn(11), np.zeros(LANES)
    table, g = draw.normal(size=LANES), draw.normal(size=LANES)
    over_lanes(own, into=("out",))(x, table, g, out)
    np.testing.assert_allclose(out, rows(x, Small)["a"][0] + table * g, rtol=1e-14)
    over_lanes(first_of, into=("out",))(x, table, out)
    np.testing.assert_allclose(out, rows(x, Small)["a"][0] * table[1], rtol=1e-14)


@device
def compiled_law(x: Small, g: float) -> float:
    return x.a - g


_RUN = over_lanes(compiled_law, into=("out",))


@kernel
def _of_kernels(x: Any, g: Any, out: Any) -> None:
    _RUN(x, g, out)


def test_kernels_call_the_loops() -> None:
    x, g, out = filled(Small, drawn(12)), drawn(13).normal(size=LANES), np.zeros(LANES)
    _of_kernels(x, g, out)
    np.testing.assert_array_equal(out, rows(x, Small)["a"][0] - g)


# -- the list of loops --------------------------------------------------------------------------------


def test_every_loop_made_is_listed_with_its_law() -> None:
    before = len(LOOPS)
    run = over_lanes(both, into=("first", "second"))
    (made,) = LOOPS[before:]
    assert made.run is run
    assert made.name == plain(run).__name__ == "both"
    assert plain(made.law) is both


def test_a_loop_is_a_call_of_its_law_in_a_function_of_its_own() -> None:
    """Formulas are optimised before they stand in a loop; the loop's indices are unsigned."""
    run = plain(over_lanes(kept, into=("x",), keep="on"))
    space = run.__globals__
    assert space["LANES"] == LANES
    assert isinstance(space["LANES"], np.uint64)
    assert plain(space["law_of_lane"]).__name__ == "kept_of_lane"


@pytest.mark.skipif(bool(numba_config.DISABLE_JIT), reason="nothing is compiled")
def test_loops_take_it_that_arrays_lie_apart() -> None:
    """Else each would compare all addresses first, and have a scalar twin."""
    run = over_lanes(shifted, into=("out",), uniform=("gain", "c", "offset"))
    x = filled(Small, drawn(14))
    run(x, 1.5, line(CONSTANT), np.array([0.75, -0.5]), np.zeros(3 * LANES))
    code = next(iter(run.inspect_llvm().values()))
    head = next(text for text in code.splitlines() if text.startswith("define"))
    assert head.count("noalias") >= 2 + 4  # results and errors have it anyway; four arrays


def test_the_package_has_a_loop_for_each_name() -> None:
    names = [
        one.name for one in tiles.LOOPS if plain(one.law).__module__.startswith("formation_env")
    ]
    assert len(names) == len(set(names)) > 30
