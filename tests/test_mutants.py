"""The list of mutants must keep fitting the sources; `python tests/mutants.py` runs them."""

from __future__ import annotations

import ast

import pytest
from mutants import MUTANTS, ROOT, Mutant, apply


def test_there_are_enough_different_mutants() -> None:
    assert len(set(MUTANTS)) == len(MUTANTS) >= 30


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: f"{m.module}: {m.new}")
def test_mutant_changes_the_source_and_still_parses(mutant: Mutant) -> None:
    """Found exactly once, and what it changes is code, not a comment or a docstring."""
    source = (ROOT / "formation_env" / f"{mutant.module}.py").read_text()
    assert code(apply(mutant)) != code(source)


def code(source: str) -> str:
    """The syntax tree without docstrings, as text."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(
            node
        ):
            node.body = node.body[1:]
    return ast.dump(tree)
