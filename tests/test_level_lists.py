"""Whatever lists the action levels derives from the one table, in all packages."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import get_args

import pytest

from baselines import files
from baselines.policies import gain_files
from baselines.scoring import options as scoring
from formation_env import config as configuration
from formation_env import configure
from formation_env.laws.levels import LEVELS, NAMES
from train import options as training


def listing(text: str) -> list[int]:
    """Lines of a source in which a tuple, list, set or dictionary names all levels."""
    tree = ast.parse(text)
    types = {
        id(node.slice)
        for node in ast.walk(tree)
        if isinstance(node, ast.Subscript) and ast.unparse(node.value) == "Literal"
    }
    found = []
    for node in ast.walk(tree):
        members: list[ast.expr | None] = []
        if isinstance(node, ast.Dict):
            members = node.keys
        elif isinstance(node, (ast.Tuple, ast.List, ast.Set)) and id(node) not in types:
            members = [*node.elts]
        names = {one.value for one in members if isinstance(one, ast.Constant)}
        if names.issuperset(NAMES):
            found.append(node.lineno)
    return found


def test_what_lists_the_levels_has_those_of_the_table() -> None:
    assert tuple(configuration.CHOICES["action"]) == NAMES
    assert (
        tuple(files.LEVEL_NAMES)
        == tuple(gain_files.LEVEL_NAMES)
        == tuple(scoring.LEVEL_NAMES)
        == NAMES
    )
    assert {level.name: level.exploration for level in LEVELS} == training.STD
    assert get_args(training.ActionLevel) == NAMES
    with pytest.raises(ValueError, match=r"action = 'flap': expected .*" + ".*".join(NAMES)):
        configure(action="flap")


@pytest.mark.parametrize("package", ["formation_env", "baselines", "train"])
def test_no_list_of_the_levels_is_written_by_hand(package: str, root: Path) -> None:
    """A tuple, list, set or dictionary that names all of them stands in the table alone.

    But for the type of an option, which type checkers do not compute.
    """
    found = []
    for path in sorted((root / package).rglob("*.py")):
        lines = listing(path.read_text(encoding="utf-8"))
        found += [f"{path.relative_to(root)}:{line}" for line in lines]
    assert not found


def test_no_help_text_names_all_levels(root: Path) -> None:
    """Help lists the choices of an option by its type, and the table knows what depends on a level."""
    for path in (root / "train").rglob("options.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert not all(name in node.value for name in NAMES), f"{path}:{node.lineno}"


@pytest.mark.parametrize(
    "text",
    [
        'a = ("wrench", "rates", "reference")',
        'a = {"reference": (), "wrench": (1, 2), "rates": [3]}',
        'if action in {"wrench", "rates", "reference"}:\n    pass',
    ],
)
def test_a_list_is_noticed(text: str) -> None:
    assert listing(text) == [1]


def test_the_type_of_an_option_is_none() -> None:
    assert listing('a: Literal["wrench", "rates", "reference"] = "wrench"') == []
