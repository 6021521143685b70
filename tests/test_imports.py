"""Who may import whom, what an import costs, and that every module says what it is."""

from __future__ import annotations

import ast
import importlib
import json
import shutil
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("formation_env", "baselines", "train")
PUBLIC = sorted(
    path
    for package in PACKAGES
    for path in (ROOT / package).rglob("*.py")
    if path.name == "__init__.py" or not path.name.startswith("_")
)
LINT = (
    "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
)


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the contracts of pyproject.toml on the packages in `folder`."""
    command = [sys.executable, "-c", LINT]
    return subprocess.run(
        command, cwd=folder, capture_output=True, encoding="utf-8", errors="replace", check=False
    )


def modules_after(statement: str) -> set[str]:
    """Names of the modules that a fresh interpreter has loaded after `statement`."""
    code = f"{statement}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    return set(json.loads(run.stdout.splitlines()[-1]))


def test_imports_keep_the_contracts() -> None:
    run = lint_imports(ROOT)
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.parametrize(
    ("importer", "statement", "broken"),
    [
        (
            "formation_env/maths/so3.py",
            "import formation_env.laws.planner",
            "Layers of formation_env",
        ),
        ("formation_env/vector.py", "import formation_env.env", "Layers of formation_env"),
        ("formation_env/physics/quadrotor.py", "import baselines", "Packages"),
        ("baselines/__init__.py", "import torch", "need no learning library"),
        ("formation_env/helpers.py", "", "Layers of formation_env"),
        ("formation_env/laws/helpers.py", "", "Layers of formation_env.laws"),
        (
            "formation_env/laws/slots.py",
            "import formation_env.laws.world",
            "Layers of formation_env.laws",
        ),
        (
            "formation_env/memory/store.py",
            "import formation_env.maths.so3",
            "Layers of formation_env",
        ),
        ("baselines/policies/base.py", "import baselines.scoring.rollout", "Layers of baselines "),
        ("baselines/policies/base.py", "import baselines.policies.expert", "baselines.policies"),
        ("baselines/scoring/metrics.py", "import baselines.scoring.rollout", "baselines.scoring"),
        ("baselines/system/reading.py", "import baselines.system.text", "baselines.system"),
        ("baselines/reporting/cells.py", "import baselines.reporting.board", "baselines.reporting"),
        ("baselines/reproduction/helpers.py", "", "baselines.reproduction"),
    ],
)
def test_contracts_notice_a_wrong_import(
    tmp_path: Path, importer: str, statement: str, broken: str
) -> None:
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for package in PACKAGES:
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignore)
    with (tmp_path / importer).open("a", encoding="utf-8") as file:
        file.write(f"\n{statement}\n")
    run = lint_imports(tmp_path)
    verdicts = [line for line in run.stdout.splitlines() if broken in line]
    assert run.returncode == 1, run.stdout + run.stderr
    assert any("BROKEN" in line for line in verdicts), run.stdout + run.stderr


# -- circles --------------------------------------------------------------------------------------


def module_paths(folder: Path) -> dict[str, Path]:
    """The modules of the packages in a folder, by name."""
    paths = {}
    for path in (path for package in PACKAGES for path in (folder / package).rglob("*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        paths[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return paths


def imported_modules(path: Path, modules: Collection[str]) -> set[str]:
    """Those of the modules that a file imports anywhere, at its top or in a function.

    Imports for the type checker alone do not count, nor does it that importing a module runs its package.
    """
    names: set[str] = set()
    nodes: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            nodes += node.orelse
            continue
        nodes += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= inner if inner <= set(modules) else {node.module, *inner}
    return names & set(modules)


def circles(folder: Path) -> list[list[str]]:
    """Groups of modules each of which imports all others of its group, directly or by way of others."""
    paths = module_paths(folder)
    imports = {name: imported_modules(path, paths) for name, path in paths.items()}

    def reached(start: str) -> set[str]:
        found: set[str] = set()
        stack = [start]
        while stack:
            new = imports[stack.pop()] - found
            found |= new
            stack += new
        return found

    reach = {name: reached(name) for name in imports}
    groups = {
        tuple(sorted(other for other in reach[name] if name in reach[other]))
        for name in imports
        if name in reach[name]
    }
    return [list(group) for group in sorted(groups)]


def test_no_module_imports_itself_by_way_of_others() -> None:
    """Neither at the top of a file nor within a function."""
    assert len(module_paths(ROOT)) > 100
    assert circles(ROOT) == []


@pytest.mark.parametrize(
    ("importer", "statement", "circle"),
    [
        (
            "formation_env/maths/so3.py",
            "import formation_env.laws.planner",
            "formation_env.laws.planner",
        ),
        (
            "train/scales.py",
            "def f() -> None:\n    from train.ppo import networks",
            "train.ppo.networks",
        ),
        (
            "baselines/scoring/intervals.py",
            "from baselines.scoring.results import Report",
            "baselines.scoring.results",
        ),
    ],
)
def test_a_circle_is_found(tmp_path: Path, importer: str, statement: str, circle: str) -> None:
    for package in PACKAGES:
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignore)
    with (tmp_path / importer).open("a", encoding="utf-8") as file:
        file.write(f"\n{statement}\n")
    ((*found,),) = circles(tmp_path)
    assert circle in found and importer.removesuffix(".py").replace("/", ".") in found


def test_importing_the_environment_is_light() -> None:
    heavy = {"torch", "matplotlib", "pygame", "scipy.stats", "stable_baselines3", "baselines"}
    assert not heavy & modules_after("import formation_env")


@pytest.mark.parametrize("module", ["baselines", "baselines.evaluate"])
def test_scoring_needs_base_dependencies_only(module: str) -> None:
    extras = {"torch", "matplotlib", "pygame", "stable_baselines3", "tensorboard", "train"}
    assert not extras & modules_after(f"import {module}")


@pytest.mark.parametrize("path", PUBLIC, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_public_module_says_what_it_is(path: Path) -> None:
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    assert docstring
    assert docstring.splitlines()[0].endswith((".", ":")), "the first line is a whole sentence"


def test_console_scripts_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for target in project["scripts"].values():
        module, function = target.split(":")
        assert callable(getattr(importlib.import_module(module), function))
