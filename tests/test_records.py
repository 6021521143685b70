"""Records in memory: what is stored is loaded again, from the places that the order of the fields says."""

from __future__ import annotations

import inspect
import linecache
import math
import os
import subprocess
import sys
import traceback
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from closed_loop import PROPERTY
from hypothesis import example, given
from hypothesis import strategies as st
from numba import config as numba_config
from states import as_python, compiled

from formation_env import task
from formation_env._jit import plain
from formation_env.core import arrays
from formation_env.laws import levels, world
from formation_env.memory import records
from formation_env.memory.records import LANES, Quantity
from formation_env.physics import sensors

Pair = tuple[float, float]

# Loaders and storers are code for LLVM in kernels, and a Python twin of it elsewhere.
FORMS = pytest.mark.parametrize("form", [as_python, compiled])


class Inner(NamedTuple):
    """A record within another."""

    z: complex
    n: int


class Mixed(NamedTuple):
    """One field of each kind."""

    a: float
    flag: bool
    q: tuple[float, float, float, float]
    inner: Inner
    count: int
    R: complex
    both: tuple[Inner, Pair]


class Half(NamedTuple):
    """One field has a note, one has none."""

    p: Annotated[float, "of p"]
    s: float


class Larger(NamedTuple):
    """A layout that `Mixed`, `Part` and `Order` are loaded from: more fields, in another order."""

    R: complex
    other: tuple[float, float, float]
    both: tuple[Inner, Pair]
    inner: Inner
    count: int
    q: tuple[float, float, float, float]
    flag: bool
    a: float
    last: float


class Part(NamedTuple):
    """Two fields of `Larger`, not side by side."""

    count: int
    R: complex


class Bounded(NamedTuple):
    """Annotated fields."""

    p: Annotated[tuple[float, float], Quantity("m", "inertial", "where", 2.0)]
    s: Annotated[float, Quantity("1", "-", "share", 0.5)]


class Free(NamedTuple):
    """A number with a bound, and one without."""

    s: Annotated[float, Quantity("1", "-", "share", 0.5)]
    free: Annotated[float, Quantity("1", "-", "anything")]


VALUE = Mixed(
    1.5, True, (2.0, 3.0, 4.0, 5.0), Inner(6.0 + 7.0j, 8), 9, 10.0 - 11.0j,
    (Inner(12.0 - 13.0j, -14), (15.0, 16.0)),
)  # fmt: skip
NUMBERS = [1.5, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, -11, 12, -13, -14, 15, 16]
OTHER = Mixed(
    -1.5, False, (0.0, -3.0, 1e300, 5e-324), Inner(-6.0j, -8), 0, 0j,
    (Inner(0.5 + 0j, 2**40), (0.25, math.inf)),
)  # fmt: skip
KINDS: dict[str, Any] = {
    "Mixed": Mixed,
    "Inner": Inner,
    "float": float,
    "int": int,
    "complex": complex,
    "tuple": tuple[float, float, float],
    "nested": tuple[Inner, Pair],
    **{k.__name__: k for k in (sensors.Measured, arrays.Touch, arrays.Counters, levels.Follower)},
    **{k.__name__: k for k in (task.Outcome, task.Observation, world.World)},
}


def numbered(kind: Any, start: float = 1.0) -> Any:
    """A value whose numbers are `start`, `start + 1`, ...; truth values are True."""
    reads = [f"{start + k}" for k in range(records.size(kind))]
    names: dict[str, Any] = {}
    kinds = [one for _, one in records.parts(kind)]
    reads = [f"{one.__name__}({text})" for one, text in zip(kinds, reads, strict=True)]
    return eval(records.build(kind, reads, names), names)


# -- sizes and places -------------------------------------------------------------------------------------


def test_numbers_lie_in_the_order_of_the_fields() -> None:
    assert records.size(Mixed) == len(NUMBERS)
    assert records.flatten(VALUE) == NUMBERS
    sizes = {"a": 1, "flag": 1, "q": 4, "inner": 3, "count": 1, "R": 2, "both": 5}
    where = records.slices(Mixed)
    assert list(where) == list(Mixed._fields)
    assert {name: s.stop - s.start for name, s in where.items()} == sizes
    for name, s in where.items():
        assert NUMBERS[s] == records.flatten(getattr(VALUE, name))
        assert records.at(Mixed, name) == s.start
    assert records.at(Mixed, "inner", "n") == where["inner"].start + 2
    assert records.fields(Mixed)["both"] == tuple[Inner, Pair]


def test_notes_and_bounds_are_those_of_the_annotations() -> None:
    assert records.bounds(Bounded) == (2.0, 2.0, 0.5)
    assert records.bounds(Free) == (0.5, math.inf)
    assert records.fields(Bounded) == {"p": tuple[float, float], "s": float}
    assert records.notes(Bounded)["s"] == Quantity("1", "-", "share", 0.5)
    assert records.notes(Mixed) == {}


def test_a_field_whose_note_was_forgotten_is_named() -> None:
    """What bounds a number or tells of it would be missing, and a user's value be left aside."""
    with pytest.raises(TypeError, match=r"^Half\.s: expected Annotated\[type, note\]"):
        records.notes(Half)


@pytest.mark.parametrize("kind", [str, list[float], tuple[float, ...], dict, None])
def test_what_is_no_number_is_refused(kind: Any) -> None:
    with pytest.raises(TypeError, match="expected numbers, complex numbers, fixed tuples or Named"):
        records.size(kind)
    with pytest.raises(TypeError, match="expected numbers"):
        records.size(tuple[float, kind])


# -- rows of a tile ---------------------------------------------------------------------------------------


@FORMS
@pytest.mark.parametrize("name", KINDS)
def test_what_is_stored_is_loaded_and_lies_in_its_lane(name: str, form: Any) -> None:
    kind = KINDS[name]
    load, store = form(records.loader(kind)), form(records.storer(kind))
    x = np.full((records.size(kind), LANES), -1.0)
    for lane in (0, 5, LANES - 1):
        store(x.reshape(-1), np.uint64(lane), numbered(kind, 10.0 * lane + 1.0))
    expected = np.full_like(x, -1.0)
    for lane in (0, 5, LANES - 1):
        value = numbered(kind, 10.0 * lane + 1.0)
        assert load(x.reshape(-1), np.uint64(lane)) == value
        expected[:, lane] = records.flatten(value)
    np.testing.assert_array_equal(x, expected)


@FORMS
@pytest.mark.parametrize("value", [VALUE, OTHER])
def test_truth_values_and_whole_numbers_come_back_as_what_they_are(value: Mixed, form: Any) -> None:
    x = np.zeros(records.size(Mixed) * LANES)
    form(records.storer(Mixed))(x, np.uint64(3), value)
    found = form(records.loader(Mixed))(x, np.uint64(3))
    assert found == value
    assert isinstance(found.flag, bool | np.bool_)
    assert isinstance(found.count, int | np.int64)
    assert isinstance(found.both[0].n, int | np.int64)


@FORMS
def test_a_record_is_stored_where_a_condition_holds(form: Any) -> None:
    keep, before = form(records.keeper(Mixed)), np.arange(float(records.size(Mixed) * LANES))
    before.reshape(-1, LANES)[records.at(Mixed, "flag")] = 1.0
    x = before.copy()
    keep(x, np.uint64(2), False, VALUE)
    np.testing.assert_array_equal(x, before)
    keep(x, np.uint64(2), True, OTHER)
    expected = before.reshape(-1, LANES).copy()
    expected[:, 2] = records.flatten(OTHER)
    np.testing.assert_array_equal(x.reshape(-1, LANES), expected)


@FORMS
@pytest.mark.parametrize("kind", [Mixed, Part], ids=lambda kind: kind.__name__)
def test_a_record_lies_within_a_larger_one_by_the_names_of_its_fields(kind: Any, form: Any) -> None:
    larger = numbered(Larger)
    x = np.zeros(records.size(Larger) * LANES)
    at = np.uint64(7)
    form(records.storer(Larger))(x, at, larger)
    expected = kind(**{name: getattr(larger, name) for name in kind._fields})
    assert form(records.loader(kind, Larger))(x, at) == expected
    changed = numbered(kind, 100.0)
    form(records.storer(kind, Larger))(x, at, changed)
    assert form(records.loader(Larger))(x, at) == larger._replace(**changed._asdict())
    form(records.keeper(kind, Larger))(x, at, True, expected)
    form(records.keeper(kind, Larger))(x, at, False, changed)
    assert form(records.loader(Larger))(x, at) == larger
    assert not np.delete(x.reshape(-1, LANES), 7, axis=1).any()


class Elsewhere(NamedTuple):
    """A field that `Larger` does not have, and one that it has with another size."""

    a: float
    missing: float


class Longer(NamedTuple):
    R: tuple[float, float, float]


@pytest.mark.parametrize("make", [records.loader, records.storer, records.keeper])
def test_a_field_that_the_layout_lacks_is_named(make: Any) -> None:
    with pytest.raises(TypeError, match="Larger has no missing as in Elsewhere"):
        make(Elsewhere, Larger)
    with pytest.raises(TypeError, match="Larger has no R as in Longer"):
        make(Longer, Larger)


@PROPERTY
@given(st.tuples(*[st.floats()] * 3))
@example((math.nan, -math.inf, math.nan))
@example((2.5, math.inf, -0.75))
def test_stored_numbers_are_clipped_to_bounds_and_what_is_none_to_the_lower(given: Any) -> None:
    store = records.storer(Bounded, bounds=(2.0, 2.0, 0.5))
    x = np.zeros(records.size(Bounded) * LANES)
    store(x, np.uint64(1), Bounded(given[:2], given[2]))
    found = x.reshape(-1, LANES)[:, 1]
    for number, bound, got in zip(given, (2.0, 2.0, 0.5), found, strict=True):
        assert got == (-bound if math.isnan(number) else min(max(number, -bound), bound))


def test_a_number_without_a_bound_is_stored_as_it_is() -> None:
    store = records.storer(Free, bounds=records.bounds(Free))
    x = np.zeros(records.size(Free) * LANES)
    plain(store)(x, np.uint64(1), Free(3.0, -1e300))
    assert x.reshape(-1, LANES)[:, 1].tolist() == [0.5, -1e300]


@FORMS
@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int64])
def test_numbers_become_those_of_the_array(kind: type, form: Any) -> None:
    """And are those of the record again when they are loaded."""
    value, at = numbered(Mixed, 3.0), np.uint64(5)
    x = np.full(records.size(Mixed) * LANES, 7).astype(kind)
    form(records.storer(Mixed))(x, at, value)
    assert form(records.loader(Mixed))(x, at) == value
    np.testing.assert_array_equal(x.reshape(-1, LANES)[:, 5], records.flatten(value))
    form(records.keeper(Mixed))(x, at, False, VALUE)
    assert form(records.loader(Mixed))(x, at) == value
    form(records.keeper(Mixed))(x, at, True, numbered(Mixed, 40.0))
    assert form(records.loader(Mixed))(x, at) == numbered(Mixed, 40.0)
    line = np.array(records.flatten(value)).astype(kind)
    assert form(records.line_loader(Mixed))(line) == value


# -- lines, parts, sums and choices -----------------------------------------------------------------------


@FORMS
@pytest.mark.parametrize("name", KINDS)
def test_lines_are_read_and_written(name: str, form: Any) -> None:
    kind = KINDS[name]
    value = numbered(kind, 3.0)
    x = np.full(records.size(kind) + 2, -1.0)
    form(records.line_storer(kind))(x, value)
    flat = records.flatten(value)
    np.testing.assert_array_equal(x, [*flat, -1.0, -1.0])
    assert form(records.line_loader(kind))(x) == value
    if records.is_record(kind):
        for field in kind._fields:
            assert form(records.part_loader(kind, field))(x) == getattr(value, field)


@FORMS
def test_lines_are_read_from_any_place(form: Any) -> None:
    for value in (VALUE, OTHER):
        line = np.array([1e9, -1e9, *records.flatten(value)])
        assert form(records.line_loader(Mixed, 2))(line) == value
    assert [type(one) for one in records.flatten(VALUE)] == [float] * len(NUMBERS)


@PROPERTY
@given(st.tuples(*[st.floats(-1e3, 1e3)] * 5), st.booleans())
def test_a_total_is_the_sum_and_a_choice_one_of_two(given: Any, on: bool) -> None:
    kind = task.Terms
    terms = kind(*given[: len(kind._fields)])
    total = 0.0
    for number in terms:
        total += number
    assert records.total(kind)(terms) == total
    assert records.chooser(Mixed)(on, VALUE, OTHER) == (VALUE if on else OTHER)
    pair = records.chooser(Pair)
    assert pair(on, given[:2], given[1:3]) == (given[:2] if on else given[1:3])


# -- what the generated code is ----------------------------------------------------------------------------


def test_functions_are_made_once() -> None:
    assert records.loader(Mixed) is records.loader(Mixed)
    assert records.storer(Part, Larger) is not records.storer(Part)


def test_generated_code_can_be_read() -> None:
    """In `linecache`, where tracebacks, `inspect` and the debugger find it; each under its own name."""
    files = set()
    made = [records.loader(Mixed), records.storer(Mixed), records.loader(Part, Larger)]
    for function in (*made, records.loader(Part)):
        code = plain(function).__code__
        lines = linecache.getlines(code.co_filename)
        assert lines[0].startswith(f"def {code.co_name}(")
        assert "".join(lines) == inspect.getsource(plain(function))
        files.add(code.co_filename)
        linecache.checkcache()
        assert linecache.getlines(code.co_filename) == lines
    assert len(files) == 4
    assert "row_" in "".join(inspect.getsource(plain(records.loader(Part, Larger))))


def test_tracebacks_show_the_line_of_generated_code() -> None:
    try:
        plain(records.loader(Mixed))(np.zeros(3), np.uint64(0))
    except IndexError:
        shown = traceback.format_exc()
    assert "return Mixed(" in shown
    assert "<formation_env: load_Mixed" in shown


def test_indices_are_unsigned() -> None:
    """Signed ones the compiler does not make vector code of."""
    names = vars(plain(records.loader(Mixed)))
    rows = {k: v for k, v in plain(records.loader(Mixed)).__globals__.items() if k[:4] == "row_"}
    assert not names
    assert set(map(type, rows.values())) == {np.uint64}
    assert {int(v) for v in rows.values()} == {k * LANES for k in range(len(NUMBERS))}


@pytest.mark.skipif(bool(numba_config.DISABLE_JIT), reason="it is")
def test_the_same_in_plain_python(root: Path) -> None:
    """With the compiler off, in a process of its own: this file, and the generated functions are Python's."""
    program = (
        "import sys, types, pytest\n"
        "from formation_env.memory import records\n"
        "from formation_env.physics import quadrotor\n"
        "assert type(records.loader(quadrotor.Wrench)) is types.FunctionType\n"
        "sys.exit(pytest.main(['-q', '-p', 'no:cacheprovider', *sys.argv[1:]]))\n"
    )
    path = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", program, str(Path(__file__))],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path},
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
