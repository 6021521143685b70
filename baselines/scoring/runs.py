"""Several training runs of one method, flown and judged together: NAME#0, NAME#1, ...

What flies is a run; what is reported is a row, of one run or of several. Rows of several runs come from names
that end in `#` and a number, from a list of sources, or from the policy files of training runs, whose cards
say method, task and training seed.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, final

from baselines import files
from baselines.files import SUFFIX, Card
from baselines.policies.learned import Misfit
from baselines.registry import METHODS, USUAL, Recipe, Unshipped, recipe
from formation_env import FormationConfig

BEST = "best.safetensors"  # the policy of a training run's folder
_IMITATION = "train-imitate"  # is in the name of the command that clones
USUAL_TEACHER = "expert"  # of that command where it names none
_MEMBER = re.compile(r"(.+)#(\d+)")

Task = tuple[str, str]  # scenario and action level


@final
@dataclass(frozen=True)
class TrainingRuns:
    """The policy files of one method's training runs, by the task trained for and the training seed."""

    method: str
    files: dict[Task, dict[int, Path]]

    def recipes(self, config: FormationConfig) -> dict[str, Recipe]:
        """How to make the policies that fly a configuration, by the names of their runs.

        The runs that were trained for its scenario and level; else the file that ships for it; else the
        runs of `nominal` at its level; else the file that ships for that. Raises `ValueError` as
        `registry.recipe` does.
        """
        own = self._of((config.scenario, config.action), config)
        if own:
            return own
        shipped = self._shipped(config)
        if shipped and shipped.card and shipped.card.scenario == config.scenario:
            return {self.method: shipped}
        usual = self._of((USUAL, config.action), config)
        if usual:
            return usual
        if shipped is None:
            raise Unshipped(
                f"policy = {self.method!r}: no training run for action level {config.action!r} on scenario "
                f"{config.scenario!r} or {USUAL!r}"
            )
        return {self.method: shipped}

    def _shipped(self, config: FormationConfig) -> Recipe | None:
        """The method's policy in the registry, if it has one that fits."""
        try:
            return recipe(self.method, config) if self.method in METHODS else None
        except Misfit:
            return None

    def _of(self, task: Task, config: FormationConfig) -> dict[str, Recipe]:
        found = sorted(self.files.get(task, {}).items())
        return {f"{self.method}#{seed}": recipe(str(path), config) for seed, path in found}


def find_runs(paths: Iterable[Path]) -> dict[str, TrainingRuns]:
    """The training runs by method: policy files, and every `best.safetensors` below a folder.

    Raises `ValueError` naming a path that has none, a bad file, or two files of the same run.
    """
    found: dict[str, TrainingRuns] = {}
    for path in paths:
        for file in _policy_files(path):
            card, _ = files.load(file)
            runs = found.setdefault(card.method, TrainingRuns(card.method, {}))
            seeds = runs.files.setdefault((card.scenario, card.action), {})
            if seeds.setdefault(card.seed, file) != file:
                raise ValueError(
                    f"{file}: of the same method, scenario, level and seed as {seeds[card.seed]}"
                )
    return found


def _policy_files(path: Path) -> Sequence[Path]:
    if path.name.endswith(SUFFIX):
        return [path]
    inside = sorted(path.rglob(BEST))
    if not inside:
        raise ValueError(f"{path}: expected a policy file, or a folder with some {BEST} in it")
    return inside


def rows_of(policies: Mapping[str, Any]) -> dict[str, Any]:
    """The rows of a report: one for each name, names that end in `#` and a number together.

    A row's source is what `make_row` takes. Raises `ValueError` where a name is both a row and a run of it.
    """
    rows: dict[str, Any] = {}
    for name, source in policies.items():
        member = _MEMBER.fullmatch(name)
        row = member[1] if member else name
        if row in rows and (member is None or row in policies):
            raise ValueError(f"policies: {row!r} and {name!r}: expected one of them")
        if member:
            rows.setdefault(row, {})[name] = source
        elif isinstance(source, (list, tuple)):
            if not source:
                raise ValueError(f"policy {name!r}: no training run: expected at least one")
            rows[row] = {f"{name}#{i}": each for i, each in enumerate(source)}
        else:
            rows[row] = source
    return rows


def teacher_of(card: Card) -> str:
    """The policy that a policy file is a clone of, by the command that trained it; empty if it is none.

    A clone that was trained on by another method, as `dagger-ppo`, starts from a file and has no teacher.
    """
    script, given = options_of(card.command)
    return given.get("--teacher", USUAL_TEACHER) if _IMITATION in script else ""


def options_of(command: str) -> tuple[str, dict[str, str]]:
    """The script of a command line, and what follows each of its words, for options that take a value."""
    words = command.replace("=", " ").split()
    return words[0] if words else "", dict(pairwise(words))


def make_row(name: str, source: Any, config: FormationConfig) -> dict[str, Recipe]:
    """How to make the runs of a row for a configuration, by name. Raises `ValueError` as `recipe` does."""
    if isinstance(source, TrainingRuns):
        return source.recipes(config)
    if isinstance(source, Mapping):
        return {run: recipe(each, config) for run, each in source.items()}
    return {name: recipe(source, config)}


def run_names(rows: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Every row with each of its runs."""
    return ((row, run) for row, runs in rows.items() for run in runs)
