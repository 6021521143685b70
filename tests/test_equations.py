"""The index of the paper's equations, `docs/equations.md`: complete, and all that it names exists."""

from __future__ import annotations

import ast
import importlib
import re
from functools import cache
from math import asin, sin
from typing import Any, NamedTuple

import numpy as np
import pytest
from closed_loop import PROPERTY, agree, rate
from hypothesis import given
from hypothesis import strategies as st
from mutation import source
from tables_in_docs import ROOT, names, rows

WITHOUT_CODE = ("A definition", "An intermediate step", "A repetition of (")


class Equation(NamedTuple):
    """A section of the page."""

    number: int
    formula: str
    where: str  # what computes it, or what it is in the paper
    checked: str


def index() -> list[Equation]:
    """The sections of the page, in order."""
    text = (ROOT / "docs/equations.md").read_text(encoding="utf-8")
    found = re.findall(
        r"^### \((\d+)\) \S.*\n\n\$\$\n(.+)\n\$\$\n\n(.+?)(?: Checked by (.+)\.)?$", text, re.M
    )
    assert len(found) == len(re.findall(r"^### ", text, re.M)), "a section is of another form"
    return [Equation(int(n), *rest) for n, *rest in found]


INDEX = index()


def test_no_number_is_missing() -> None:
    assert [each.number for each in INDEX] == list(range(1, 71))


def test_repetitions_are_the_same_formula() -> None:
    formulas = {each.number: each.formula for each in INDEX}
    for each in INDEX:
        if again := re.match(r"A repetition of \((\d+)\)", each.where):
            assert each.formula == formulas[int(again[1])]


def test_errata_name_equations() -> None:
    errata = rows("equations.md", 3)
    assert len(errata) >= 6
    for number, _, _ in errata:
        assert numbers(number) <= {each.number for each in INDEX}


def found(name: str) -> tuple[Any, Any]:
    """The module, in whatever folder of `formation_env` it lies, and what it calls `name`."""
    module, *path = name.split(".")
    dotted = source(module).relative_to(ROOT).with_suffix("").parts
    imported = importlib.import_module(".".join(dotted))
    value: Any = imported
    for part in path:
        assert hasattr(value, part), f"docs/equations.md: there is no {name}"
        value = getattr(value, part)
    return imported, value


def numbers(text: str) -> set[int]:
    """The equations that a docstring mentions: `(21)`, and all of `(2)-(5)`."""
    ranges = re.findall(r"\((\d+)\)(?:-\((\d+)\))?", text)
    return {n for low, high in ranges for n in range(int(low), int(high or low) + 1)}


@pytest.mark.parametrize("each", INDEX, ids=lambda each: f"({each.number})")
def test_functions_exist_and_say_the_number(each: Equation) -> None:
    number, _, where, _ = each
    functions = [name for name in names(where) if re.fullmatch(r"[a-z_]\w*(\.\w+)+", name)]
    assert functions or where.startswith(WITHOUT_CODE), (
        f"({number}) is neither computed nor explained"
    )
    for name in functions:
        module, function = found(name)
        told = numbers(f"{module.__doc__} {function.__doc__}")
        assert number in told, f"no docstring of {name} mentions ({number})"


@cache
def defined_in(file: str) -> frozenset[str]:
    tree = ast.parse((ROOT / "tests" / file).read_text(encoding="utf-8"))
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef))


@pytest.mark.parametrize("each", INDEX, ids=lambda each: f"({each.number})")
def test_tests_exist(each: Equation) -> None:
    """What code computes some test checks."""
    number, _, where, checked = each
    assert names(checked) or where.startswith(WITHOUT_CODE), f"no test checks ({number})"
    for test in names(checked):
        file, _, name = test.partition("::")
        assert name in defined_in(file), f"docs/equations.md: there is no {test}"


@PROPERTY
@given(st.floats(0.1, 2.0), st.floats(-0.95, 0.95), st.floats(0.1, 2.0), st.floats(-1.5, 1.5))
def test_27_falls_on_circles(d_x: float, product: float, speed: float, theta: float) -> None:
    """`V_theta_dot = -2 (V_L / d_x) cos(theta_d) V_theta` along (26), and (28) is where it is zero."""

    def V(x: Any) -> Any:
        return 0.5 * (np.sin(x) + product) ** 2

    theta_dot = -speed / d_x * (sin(theta) + product)
    falling = -2.0 * speed / d_x * np.cos(theta) * V(theta)
    scale = 1e-3 / (1.0 + abs(theta_dot))
    agree(rate(V, np.array(theta), np.array(theta_dot), scale), falling, 1e-8)
    assert falling <= 0.0
    agree(V(-asin(product)), 0.0, 1e-14)
