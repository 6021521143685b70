"""The JSON form of values: what it is for each kind, and that JSON keeps it."""

from __future__ import annotations

import json
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from hypothesis import given
from hypothesis import strategies as st

from formation_env import Limits, Noise, PlannerGains, Vehicle
from formation_env.validation.plain_form import plain


@pytest.mark.parametrize(
    ("value", "form"),
    [
        (None, None),
        (True, True),
        (np.True_, True),
        ("circle", "circle"),
        (np.str_("circle"), "circle"),
        (3, 3),
        (np.int8(3), 3),
        (2**64, 2**64),
        (0.1, 0.1),
        (np.float64(0.1), 0.1),
        (np.float32(0.5), 0.5),
        (np.longdouble(0.5), 0.5),
        (inf, None),
        (np.float32(-inf), None),
        ((1, 2.0), [1, 2.0]),
        ([(0.1, 0.2)], [[0.1, 0.2]]),
        ([], []),
        (np.zeros((2, 0)), [[], []]),
        (np.array(2.0), 2.0),
        (np.array([[1, 2]], np.int8), [[1, 2]]),
        (np.array([1.0, inf]), [1.0, None]),
        (np.array([0.5], np.longdouble), [0.5]),
        (np.array([True]), [True]),
        (np.array(["a"]), ["a"]),
        (np.array([[0.5, np.int8(1)]], object), [[0.5, 1]]),
        (AutoresetMode.SAME_STEP, "SAME_STEP"),
        ({"a": (1, {"b": np.int64(2)})}, {"a": [1, {"b": 2}]}),
        (
            Limits(0.2, np.float32(1.0), 0.5, 10, 15.0),
            {"collision": 0.2, "impact": 1.0, "tilt": 0.5, "lost": 10, "deadline": 15.0},
        ),
        ([Noise(0.0, 0.0, 0.0, 0.0, 0.5)._replace(position=0.25)], None),
    ],
    ids=lambda x: repr(x).partition(" at 0x")[0][:30],
)
def test_forms(value: Any, form: Any) -> None:
    if isinstance(value, list) and value and isinstance(value[0], Noise):
        form = [{**dict.fromkeys(Noise._fields, 0.0), "position": 0.25, "angular_velocity": 0.5}]
    result = plain(value)
    assert result == form
    assert repr(result) == repr(form)  # of the very types: True is not 1, 1 not 1.0
    assert json.loads(json.dumps(result, allow_nan=False)) == form


def test_dataclasses_are_dictionaries_of_their_fields() -> None:
    form = plain(Vehicle(mass=0.2, thrust_max=None))
    assert form["mass"] == 0.2
    assert form["thrust_max"] is None
    assert form["inertia"] == [1e-3, 1e-3, 2e-3]
    assert PlannerGains(**plain(PlannerGains(k1=0.3))) == PlannerGains(k1=0.3)


@pytest.mark.parametrize(
    ("value", "name"),
    [
        (lambda t: t, "value"),
        (nan, "value"),
        (1j, "value"),
        (b"x", "value"),
        ({1, 2}, "value"),
        ({1: 2}, "value"),
        (Vehicle, "value"),
        (np.zeros(2, complex), "value"),
        (np.ma.masked_array([1.0, 2.0], mask=[False, True]), "value"),
        (np.array(["2026-11-26"], "datetime64[D]"), "value"),
        ([0.0, [nan]], r"value\[1\]\[0\]"),
        ({"path": {"points": [np.array([0.0, nan])]}}, r"value\.path\.points\[0\]\[1\]"),
        (Noise(0.0, nan, 0.0, 0.0, 0.0), r"value\.velocity"),
    ],
    ids=lambda x: repr(x).partition(" at 0x")[0][:30],
)
def test_what_has_no_form_is_named(value: Any, name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} = .*: expected a value that JSON can hold"):
        plain(value)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
        lambda inner: st.lists(inner) | st.tuples(inner) | st.dictionaries(st.text(), inner),
        max_leaves=12,
    )
)
def test_json_keeps_it_and_it_is_its_own_form(value: Any) -> None:
    form = plain(value)
    assert plain(form) == form
    assert json.loads(json.dumps(form, allow_nan=False)) == form
