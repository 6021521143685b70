"""The list of mutants must keep fitting the sources; `python tests/mutants.py` runs them."""

from __future__ import annotations

import ast
from pathlib import Path

import mutation
import pytest
from mutants import MUTANTS
from mutation import Mutant, apply, source

# Modules of laws: of each, some symbols are broken.
LAWS = (
    *("planner", "slots", "tracker", "quadrotor", "so3", "turning", "elementary", "gains"),
    *("world", "sensors", "task", "rng", "levels", "disturbances"),
    *(
        "records",
        "store",
        "tiles",
        "shuffles",
        "flight",
        "judging",
        "measuring",
        "disturbing",
        "neighbours",
        "nearest",
    ),
    *("references", "course", "random_paths", "splines", "trajectories"),
    *("feasibility", "formations"),
)


def test_there_are_enough_different_mutants() -> None:
    assert len(set(MUTANTS)) == len(MUTANTS) >= 300


@pytest.mark.parametrize("module", LAWS)
def test_every_module_of_laws_has_some(module: str) -> None:
    assert sum(mutant.module == module for mutant in MUTANTS) >= 5


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: f"{m.module}: {m.new}")
def test_mutant_changes_the_source_and_still_parses(mutant: Mutant) -> None:
    """Found exactly once, and what it changes is code, not a comment or a docstring."""
    text = source(mutant.module).read_text(encoding="utf-8")
    assert code(apply(mutant)) != code(text)


def test_every_mutated_module_has_tests_to_run() -> None:
    for module in {mutant.module for mutant in MUTANTS}:
        assert all((mutation.ROOT / test).is_file() for test in mutation.watchers(module))


def test_what_no_longer_fits_fails_the_run_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is run then: a list that has come apart from the sources tells nothing."""
    lost = Mutant("slots", "theta_dot = nowhere", "theta_dot = 0")
    twice = Mutant("slots", "return", "yield")
    gone = Mutant("slotted", "a", "b")
    assert mutation.main([lost, twice, gone, MUTANTS[0]], []) == 2
    said = capsys.readouterr().out
    assert "slots         theta_dot = nowhere  ->  theta_dot = 0: found 0 times" in said
    assert "return  ->  yield: found" in said
    assert "0 modules of formation_env are named slotted" in said
    assert mutation.main(MUTANTS, ["--only", "slotted"]) == 2


def test_white_space_fits_any(tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text("x = (a +\n     b)\n", encoding="utf-8")
    assert apply(Mutant("law", "a + b", "a - b"), tmp_path) == "x = (a - b)\n"


def code(source: str) -> str:
    """The syntax tree without docstrings, as text."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(
            node
        ):
            node.body = node.body[1:]
    return ast.dump(tree)
