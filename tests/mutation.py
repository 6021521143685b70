"""Break one symbol of a law at a time in a copy of the package, and see whether its tests notice.

A mutant is run against the tests that `docs/tests.md` names as the module's own, with the compiler
off. The list is in `mutants`, which is also the command.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from tables_in_docs import ROOT, own_tests

PACKAGE = "formation_env"

# Hypothesis without shrinking: here only whether a test fails counts, not how.
RUN = """
import sys, pytest

class Quick:
    def pytest_sessionstart(self):
        from hypothesis import Phase, settings
        settings.register_profile("quick", settings(), phases=(Phase.explicit, Phase.generate))
        settings.load_profile("quick")

code = pytest.main(["-x", "-q", "-p", "no:cacheprovider", *sys.argv[1:]], plugins=[Quick()])
sys.exit({0: 40, 1: 41, 2: 42}.get(code, code))
"""
# Distinct from the status of a run that never came to testing. A mutant whose package refuses to be
# imported, as by a default that breaks a condition, is killed too.
PASSED, FAILED, REFUSED = 40, 41, 42
# A mutant that makes a loop blow up can stall SciPy's solver: after so many times what the tests take
# without any mutant, and this many seconds more, it counts as killed.
TIMES, MORE = 5.0, 30.0


class Mutant(NamedTuple):
    """One change: `old`, found exactly once in the module, becomes `new`.

    White space matches white space of any kind, so that a line that is broken elsewhere still fits.
    """

    module: str  # its last name: "planner" is found in whatever folder of the package it lies
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.module:13} {self.old}  ->  {self.new}"


def source(module: str, package: Path = ROOT / PACKAGE) -> Path:
    """The one file of a module; raises `ValueError` unless there is exactly one of that name."""
    found = sorted(package.rglob(f"{module}.py"))
    if len(found) != 1:
        raise ValueError(f"{len(found)} modules of {package.name} are named {module}")
    return found[0]


def apply(mutant: Mutant, package: Path = ROOT / PACKAGE) -> str:
    """The mutated source; raises `ValueError` unless `old` occurs exactly once."""
    text = source(mutant.module, package).read_text(encoding="utf-8")
    pattern = r"\s+".join(re.escape(part) for part in mutant.old.split())
    changed, found = re.subn(pattern, lambda _: mutant.new, text)
    if found != 1:
        raise ValueError(f"{mutant}: found {found} times, expected once")
    return changed


def misfits(mutants: Sequence[Mutant]) -> list[str]:
    """What is wrong with those mutants that no longer fit the sources."""
    problems = []
    for mutant in mutants:
        try:
            apply(mutant)
        except ValueError as problem:
            problems.append(str(problem))
    return problems


def watchers(module: str) -> list[str]:
    """The test files of the module's own, as paths from the root; `ValueError` if there are none."""
    for name, tests in own_tests().items():
        if name.startswith(PACKAGE) and name.rpartition(".")[2] == module and tests:
            return [f"tests/{test}" for test in tests]
    raise ValueError(f"docs/tests.md names no tests of {module}'s own")


def tests_pass(module: str, mutant: Mutant | None, patience: float | None) -> bool:
    """Whether the module's own tests pass on a copy of the package, mutated or not."""
    with tempfile.TemporaryDirectory() as folder:
        for name in (PACKAGE, "tests"):
            ignore = shutil.ignore_patterns("__pycache__", ".*")
            shutil.copytree(ROOT / name, Path(folder, name), ignore=ignore)
        shutil.copy(ROOT / "pyproject.toml", folder)
        if mutant is not None:
            copy = source(module, Path(folder, PACKAGE))
            copy.write_text(apply(mutant), encoding="utf-8")
        try:
            result = subprocess.run(
                [sys.executable, "-B", "-c", RUN, *watchers(module)],
                cwd=folder,
                env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": folder},
                capture_output=True,
                text=True,
                check=False,
                timeout=patience,
            )
        except subprocess.TimeoutExpired:
            return False
    known = (PASSED, FAILED) if mutant is None else (PASSED, FAILED, REFUSED)
    if result.returncode not in known:
        raise RuntimeError(f"{mutant or module}\n{result.stdout}{result.stderr}")
    return result.returncode == PASSED


def time_alone(module: str) -> float:
    """Seconds that the module's own tests take without any mutant; infinite if they fail."""
    started = time.perf_counter()
    passed = tests_pass(module, None, None)
    return time.perf_counter() - started if passed else float("inf")


def arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command's options."""
    parser = argparse.ArgumentParser(description=__doc__)
    text = "Mutants tried at the same time. (default: 2)"
    parser.add_argument("--jobs", type=int, default=2, help=text)
    text = "Modules whose mutants are tried. (default: all)"
    parser.add_argument("--only", nargs="+", metavar="MODULE", help=text)
    return parser.parse_args(argv)


def try_all(mutants: Sequence[Mutant], jobs: int) -> tuple[list[Mutant], list[str]]:
    """The mutants that survive, and the modules whose own tests fail without any mutant."""
    with ThreadPoolExecutor(jobs) as pool:
        modules = sorted({m.module for m in mutants})
        alone = dict(zip(modules, pool.map(time_alone, modules), strict=True))
        broken = [module for module in modules if alone[module] == float("inf")]
        for module in broken:
            print(f"the tests of {module} fail without any mutant: its mutants are left out")
        tried = [m for m in mutants if m.module not in broken]

        def survives(mutant: Mutant) -> bool:
            return tests_pass(mutant.module, mutant, TIMES * alone[mutant.module] + MORE)

        alive = []
        for mutant, survived in zip(tried, pool.map(survives, tried), strict=True):
            alive += [mutant] if survived else []
            print(f"{'SURVIVED' if survived else 'killed':9} {mutant}", flush=True)
    print(f"{len(tried) - len(alive)} of {len(mutants)} mutants killed", end=" ")
    return alive, broken


def main(mutants: Sequence[Mutant], argv: Sequence[str] | None = None) -> int:
    """The command: 0 if every mutant is killed, 1 if some survive, 2 if not all could be tried."""
    options = arguments(argv)
    chosen = [m for m in mutants if options.only is None or m.module in options.only]
    problems = misfits(chosen) or ([] if chosen else [f"no mutants of {options.only}"])
    if problems:
        print("\n".join(problems))
        return 2
    started = time.perf_counter()
    alive, broken = try_all(chosen, options.jobs)
    print(f"in {time.perf_counter() - started:.0f} s, {options.jobs} at a time")
    for mutant in alive:
        print(f"SURVIVED  {mutant}")
    return 2 if broken else 1 if alive else 0
