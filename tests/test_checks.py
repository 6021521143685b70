"""Numbers and arrays are converted and checked in one place, and refused by name in few words."""

from __future__ import annotations

from decimal import Decimal
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation_env.validation.checks import (
    LONGEST,
    array,
    boolean,
    choice,
    integer,
    number,
    refuse,
    shown,
    unexpected_keyword,
    vector,
)

NOT_NUMBERS: tuple[Any, ...] = (
    *(True, np.True_, "1", b"1", None, 1j, np.complex128(1.0), Decimal(1), [1.0], np.zeros(())),
    *(nan, inf, -inf, np.float32(nan), np.longdouble("1e4000"), 10**400),
    *(np.timedelta64(3), np.timedelta64(3, "s"), np.datetime64("2020")),
)


@pytest.mark.parametrize("value", NOT_NUMBERS, ids=lambda x: repr(x).partition(" at 0x")[0][:20])
def test_what_is_not_a_finite_number_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^size = .*: expected a finite number above 0$"):
        number("size", value, 0.0)


@pytest.mark.parametrize("value", [2, 2.0, np.int8(2), np.uint64(2), np.float16(2), 2**64, 10**20])
def test_a_number_becomes_a_float(value: Any) -> None:
    result = number("size", value, 0.0)
    assert type(result) is float
    assert result == float(value)


def test_bounds_of_a_number() -> None:
    assert number("x", 0.0, 0.0, strict=False) == 0.0
    assert number("x", 3, 0.0, 3.0) == 3.0
    with pytest.raises(ValueError, match=r"^x = 0\.0: expected a finite number above 0$"):
        number("x", 0.0, 0.0)
    with pytest.raises(ValueError, match=r"expected a finite number of at least 0 and at most 3$"):
        number("x", 4, 0.0, 3.0, strict=False)
    with pytest.raises(ValueError, match=r"expected a finite number of at most 3$"):
        number("x", 4, high=3.0)


@pytest.mark.parametrize(
    "value", [True, 1.0, "1", None, np.float64(1), 0, -1, 9, 2**64, 10**400, np.timedelta64(3, "s")]
)
def test_what_is_not_an_integer_in_range_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^n = .*: expected an integer from 1 to 8$"):
        integer("n", value, 1, 8)


@pytest.mark.parametrize("value", [3, np.int8(3), np.uint64(3)])
def test_an_integer_becomes_an_int(value: Any) -> None:
    assert type(integer("n", value, 1)) is int


def test_a_choice_and_a_boolean() -> None:
    assert choice("action", "b", {"a": 1, "b": 2}) == "b"
    with pytest.raises(ValueError, match=r"^action = 'c': expected one of 'a', 'b'$"):
        choice("action", "c", ("a", "b"))
    assert boolean("flag", np.False_) is False
    for value in (0, 1, "True", None):
        with pytest.raises(ValueError, match=r"^flag = .*: expected True or False$"):
            boolean("flag", value)


MASKED = np.ma.masked_array([[1.0, 2.0, 3.0]], mask=[[False, True, False]])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([[0, 0, 0], [0, nan, -1]], r"^p\[1\] = \[0.0, nan, -1.0\]: expected finite numbers$"),
        ([[0, 0, 0], [0, True, -1]], r"^p\[1\] = \[0, True, -1\]: expected rows of 3"),
        ([[0, 0, 0], [0, "1", -1]], r"^p\[1\] = \[0, '1', -1\]: expected rows of 3"),
        ([[0, 0, 0], [0, 1j, -1]], r"^p\[1\] = \[0, 1j, -1\]: expected rows of 3"),
        ([[0, 0, 0], [0, 0]], r"^p\[1\] = \[0, 0\]: expected rows of 3"),
        ([1.0, [1.0, 2.0], [3.0]], r"^p\[2\] = \[3.0\]: expected rows of 3"),
        ([np.zeros(()), [0, True, 0]], r"^p\[1\] = \[0, True, 0\]: expected rows of 3"),
        ([[0, 0, 0], [0, 10**400, 0]], r"^p\[1\] = \[0.0, inf, 0.0\]: expected finite"),
        ([], r"^p = \[\]: expected rows of 3 finite numbers$"),
        ([0.0, 0.0, 0.0], r"^p = \[0.0, 0.0, 0.0\]: expected rows of 3"),
        (np.zeros((9, 2)), r"^p = numbers of shape \(9, 2\): expected rows of 3"),
        (np.zeros((2, 3), bool), r"^p = .*: expected rows of 3"),
        (np.zeros((2, 3), complex), r"^p = .*: expected rows of 3"),
        (np.full((1, 3), np.longdouble("1e4000")), r"^p\[0\] = \[inf, inf, inf\]"),
        (MASKED, r"^p = .*: expected rows of 3"),
        (list(MASKED), r"^p\[0\] = .*: expected rows of 3"),
        (np.ma.zeros((6000, 3)), r"^p = masked array of shape \(6000, 3\), .*: expected rows of 3"),
        ([[0, 0, 0], bytearray(b"abc")], r"^p\[1\] = bytearray.*: expected rows of 3"),
        ([memoryview(b"abc")], r"^p\[0\] = .*: expected rows of 3"),
        ([[0, 0, np.timedelta64(3, "s")]], r"^p\[0\] = .*: expected rows of 3"),
        (np.zeros((0, 3)), r"^p = .*: expected rows of 3"),
        ("abc", r"^p = 'abc': expected rows of 3"),
        ({"a": 1}, r"^p = \{'a': 1\}: expected rows of 3"),
        (None, r"^p = None: expected rows of 3"),
    ],
    ids=lambda x: repr(x).partition(" at 0x")[0][:20],
)
def test_a_table_is_refused_by_its_row(value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        array("p", value, (None, 3))


def test_an_array_is_a_new_one_of_float64() -> None:
    given_ = np.arange(3.0)
    result = vector("v", given_, 3)
    assert result.dtype == np.float64
    assert not np.shares_memory(result, given_)
    np.testing.assert_array_equal(vector("v", (2**64, np.int8(1), 0.5), 3), [2.0**64, 1.0, 0.5])
    with pytest.raises(ValueError, match=r"^v\[1\] = 0.0: expected finite numbers above 0$"):
        vector("v", (1.0, 0.0, 1.0), 3, 0.0)
    with pytest.raises(ValueError, match=r"^v = \[1.0\]: expected 3 finite numbers$"):
        vector("v", [1.0], 3)


class Unshowable:
    def __repr__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    "value",
    [
        np.zeros((6000, 3)),
        [[0.0, nan, 0.0]] * 6000,
        "x" * 10**6,
        10**5000,
        Unshowable(),
        {"x": [0] * 999},
    ],
    ids=lambda x: type(x).__name__,
)
def test_no_message_prints_a_table(value: Any) -> None:
    for check in (
        lambda: number("x", value),
        lambda: integer("x", value, 0, 3),
        lambda: array("x", value, (None, 2)),
        lambda: choice("x", value, ["a"]),
        lambda: boolean("x", value),
        lambda: refuse("x", value, "y" * 600),
    ):
        with pytest.raises(ValueError, match=r"^x(\[\d+\])? = ") as caught:
            check()
        assert len(str(caught.value)) <= LONGEST


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), st.lists))
def test_any_value_is_converted_or_refused(value: Any) -> None:
    assert len(shown(value)) <= LONGEST
    try:
        result: Any = array("x", value, (None, None))
    except ValueError as error:
        result = str(error)
    if isinstance(result, str):
        assert result.startswith("x")
        assert len(result) <= LONGEST
    else:
        assert np.isfinite(result).all()
        assert result.ndim == 2


def test_an_unknown_keyword_reads_like_pythons_own() -> None:
    def f() -> None: ...

    with pytest.raises(TypeError) as caught:
        f(frameskip=1)  # type: ignore[call-arg]
    own = str(unexpected_keyword("f", "frameskip", ("a", "b")))
    assert own.startswith(str(caught.value).split(".")[-1])
    assert own.endswith("known are a, b")
