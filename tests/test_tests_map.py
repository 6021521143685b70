"""The map from module to its tests, `docs/tests.md`: complete, and nothing in it has gone."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest
import tables_in_docs
from tables_in_docs import ROOT, names, rows

PACKAGES = ("formation_env", "baselines", "train", "benchmarks")
MAP = rows("tests.md", 3)
OTHERS = rows("tests.md", 2)


def modules() -> dict[str, Path]:
    """The dotted names of all modules, and their files."""
    found = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()
HELPERS = {path.stem: path for path in (ROOT / "tests").glob("*.py")}


@cache
def imported(path: Path) -> frozenset[Path]:
    """The modules and the helpers of tests that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    known = HELPERS | MODULES
    return frozenset(known[name] for name in found & set(known))


def reached(test: Path) -> set[Path]:
    """The test and all that it imports, directly or not."""
    found, new = {test}, {test}
    while new:
        new = {path for file in new for path in imported(file)} - found
        found |= new
    return found


def test_every_module_has_one_row() -> None:
    listed = [name for module, _, _ in MAP for name in names(module)]
    missing, gone = sorted(set(MODULES) - set(listed)), sorted(set(listed) - set(MODULES))
    assert not missing, f"modules without a row in docs/tests.md: {missing}"
    assert not gone, f"rows of docs/tests.md without a module: {gone}"
    assert len(listed) == len(MAP) == len(set(listed)), "a module has two rows"


def test_every_row_names_tests() -> None:
    for module, own, other in MAP:
        assert names(own), f"docs/tests.md names no tests of {module}"
        both = names(own) + names(other)
        assert len(both) == len(set(both)), f"a test stands twice in the row of {module}"


@pytest.mark.parametrize("row", MAP, ids=lambda row: row[0].strip("`"))
def test_a_test_of_its_own_reaches_the_module(row: tuple[str, ...]) -> None:
    """By imports, or by its name, where a process is started: `python -m train.ppo` for its `__main__`."""
    (module,) = names(row[0])
    tests = [ROOT / "tests" / test for test in names(row[1])]
    files = {path for test in tests if test.exists() for path in reached(test)}
    name = module.removesuffix(".__main__")
    by_name = any(name in path.read_text(encoding="utf-8") for path in files)
    assert MODULES[module] in files or by_name, f"{row[1]} never reach {module}"


def test_every_test_is_named_and_exists() -> None:
    listed = {test for row in (*MAP, *OTHERS) for cell in row[1:] for test in names(cell)}
    tests = ROOT / "tests"
    found = {path.relative_to(tests).as_posix() for path in tests.rglob("test_*.py")}
    assert not listed - found, f"docs/tests.md names files that are not there: {listed - found}"
    assert not found - listed, f"docs/tests.md does not name {sorted(found - listed)}"


def test_tables_are_read_without_their_headers() -> None:
    """All rows have two or three cells; none is a header, a ruler or left out."""
    text = (ROOT / "docs" / "tests.md").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.startswith("|")]
    headers = sum("---" in line for line in lines)
    assert len(lines) == len(MAP) + len(OTHERS) + 2 * headers
    assert all("tests" not in row for row in OTHERS)
    assert tables_in_docs.own_tests()["formation_env.laws.planner"] == ["test_planner.py"]
