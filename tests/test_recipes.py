"""The recipes of CONTRIBUTING.md do what they say: carried out as the page has them, seen from all faces.

Each is carried out on a copy of the package, in plain Python, in a process of its own; then nearly all of
them together, compiled.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import recipe_faces
import recipes
from recipes import Edit, carry_out, copy_to, edits, files

RECIPES = recipes.recipes()
WORDS = {1: "One file.", 2: "Two files:"}


def check(folder: Path, *names: str, compiled: bool = False) -> subprocess.CompletedProcess[str]:
    """Run the checks of recipes on the package in `folder`."""
    path = os.pathsep.join([str(folder), str(recipes.ROOT)])
    return subprocess.run(
        [sys.executable, "-W", "error", recipe_faces.__file__, *names],
        env={**os.environ, "PYTHONPATH": path, "NUMBA_DISABLE_JIT": "0" if compiled else "1"},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
    )


def test_the_page_has_a_recipe_for_each_capability() -> None:
    assert list(RECIPES) == [
        "Reward term",
        "Observation entry",
        "Law and gain",
        "Trajectory family",
        "Virtual vehicle",
        "Action level",
        "Sensor",
        "Disturbance",
    ]
    assert set(RECIPES) == set(recipe_faces.CHECKS)


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_takes_as_many_files_as_it_says(name: str) -> None:
    """One or two; where two, it says why."""
    words = re.sub(r"\s+", " ", recipes.prose()[name]).strip()
    assert words.startswith(WORDS[len(files(RECIPES[name]))])


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_does_what_it_says(name: str, tmp_path: Path) -> None:
    folder = copy_to(tmp_path)
    carry_out(RECIPES[name], folder)
    run = check(folder, name)
    assert run.returncode == 0, run.stderr[-3000:]
    assert Path(run.stdout.splitlines()[0]).is_relative_to(folder), "not the copy was imported"


@pytest.mark.parametrize("name", RECIPES)
def test_without_the_recipe_there_is_no_effect(name: str) -> None:
    """The checks can fail: they do on the package as it is."""
    assert check(recipes.ROOT, name).returncode != 0


@pytest.mark.slow
def test_recipes_compile_and_do_the_same_together(tmp_path: Path) -> None:
    """All on one copy, but the observation entry, which stands where the sensor's does."""
    names = [name for name in RECIPES if name != "Observation entry"]
    folder = copy_to(tmp_path)
    for name in names:
        carry_out(RECIPES[name], folder)
    run = check(folder, *names, compiled=True)
    assert run.returncode == 0, run.stderr[-3000:]


def test_an_edit_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("x = 1\ny = 2\nz = 1\ny = 2\n", encoding="utf-8")
    for old in ("x = 2\n", "y = 2\n", " = 1\n"):
        with pytest.raises(ValueError, match="expected once"):
            carry_out([Edit("a.py", old, "")], tmp_path)
    carry_out([Edit("a.py", "z = 1\ny = 2\n", "z = 3\n")], tmp_path)
    assert (tmp_path / "a.py").read_text(encoding="utf-8") == "x = 1\ny = 2\nz = 3\n"


def test_hunks_are_read_as_they_stand() -> None:
    block = "```diff\n--- a.py\n x\n-y\n+z\n@@\n+w\n v\n```\n"
    assert edits(block) == [Edit("a.py", "x\ny\n", "x\nz\n"), Edit("a.py", "v\n", "w\nv\n")]
    for wrong in (
        "```diff\n x\n```\n",
        "```diff\n--- a.py\n x\n```\n",
        "```diff\n--- a.py\n*x\n```\n",
    ):
        with pytest.raises(ValueError, match=r"block begins|no hunk"):
            edits(wrong)
