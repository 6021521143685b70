"""The policies of a report on its tasks at their own level, flown again under each change of `CHANGES`.

A policy flies a cell, one task under one change, where it flies the task itself, and a policy file where it
was trained for the task; of several training runs the median one flies. The seeds are the first ones of the
report, so that both scores of a cell are of the same episodes where the change leaves paths and starts alone.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.policies.gain_files import UntunedWarning
from baselines.policies.simple import Hover
from baselines.policies.transfer import transfer_unwarned
from baselines.registry import Recipe
from baselines.scoring.changes import CHANGES, Change, changed
from baselines.scoring.evaluation import Flight, Flyable, fly_all
from baselines.scoring.results import NO_LAWS, Report, Result
from baselines.scoring.rollout import fly
from formation_env import FormationConfig
from formation_env.core.simulation import Simulation

EPISODES = 20  # the first of a report
LEADER = "the leader, which the environment flies, does not get to its start"


class Cell(NamedTuple):
    """A policy on one task under one change, or as it is."""

    score: float
    failed: float  # share of the episodes


class Robustness(NamedTuple):
    """Scores of the same policies as they are and under each change."""

    seeds: range
    tasks: tuple[str, ...]
    changes: tuple[Change, ...]
    plain: dict[tuple[str, str], Cell]  # by policy and task, as it is
    cells: dict[tuple[str, str, str], Cell]  # by policy, task and change
    void: dict[tuple[str, str], str]  # tasks and changes that say nothing of a policy, and why
    refused: dict[tuple[str, str, str], str]  # cells that a policy cannot fly, and why

    @property
    def policies(self) -> list[str]:
        """The policies that have flown a task, in the report's order."""
        return list(dict.fromkeys(policy for policy, _ in self.plain))

    def mean(self, policy: str) -> tuple[float, int]:
        """The mean score over the tasks as they are, and their number."""
        each = [cell.score for (name, _), cell in self.plain.items() if name == policy]
        return float(np.mean(each)), len(each)

    def difference(self, policy: str, change: str) -> float:
        """What a change adds to the score, in the mean over the tasks that the policy flies both ways.

        NaN where there is none."""
        each = [
            cell.score - self.plain[policy, task].score
            for (name, task, what), cell in self.cells.items()
            if (name, what) == (policy, change)
        ]
        return float(np.mean(each)) if each else float("nan")


def leader_starts(config: FormationConfig, seeds: range) -> bool:
    """Whether the leader gets to the first point of its path, within the trigger's distance (40) and in
    time, in at least half of the episodes; True where none waits for it."""
    if config.start != "ground":
        return True
    first = np.zeros((len(seeds), 3))
    arrived = np.zeros(len(seeds), dtype=np.bool_)

    def watch(simulation: Simulation, live: NDArray[np.bool_], _: NDArray[np.float32]) -> None:
        if not first.any():
            first[:] = [simulation.reference(np.zeros(1), i)[0] for i in range(len(seeds))]
        off = np.linalg.norm(simulation.leaders - first, axis=-1)
        arrived[live & (off <= config.trigger)] = True

    fly(Hover(config), seeds, most=config.deadline_steps, watch=watch)
    return bool(arrived.mean() >= 0.5)


def fly_changes(
    report: Report,
    flyable: Mapping[str, Flyable],
    threads: int = 1,
    quiet: bool = True,
    changes: Sequence[Change] = CHANGES,
) -> Robustness:
    """All cells; `flyable` is what the report was flown with. Raises as `evaluation.fly_all` does."""
    seeds = range(report.seed, report.seed + min(EPISODES, report.episodes))
    found = Robustness(seeds, report.native, tuple(changes), {}, {}, {}, {})
    recipes = _recipes(report, flyable)
    for (policy, task), (result, _) in recipes.items():
        columns = result.runs[result.median]
        found.plain[policy, task] = _cell(columns, len(seeds))
    flights: dict[tuple[str, str, str], Flight] = {}
    for task in found.tasks:
        for change in changes:
            world = _world(report.scenarios[task].config, change, seeds)
            if isinstance(world, str):
                found.void[task, change.name] = world
                continue
            told = world if change.told else report.scenarios[task].config
            for (policy, name), (_, recipe) in recipes.items():
                if name == task:
                    key = policy, task, change.name
                    problem = _refusal(recipe, told)
                    if problem:
                        found.refused[key] = problem
                    else:
                        flights[key] = Flight(told, recipe, seeds, world)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UntunedWarning)  # the report's own flights have said it
        flown = fly_all(flights, threads, quiet, title="flying changed tasks")
    # In the order of the report's policies, whatever order they were flown in.
    cells = {key: _cell(columns, len(seeds)) for key, columns in flown.items()}
    order = {policy: i for i, policy in enumerate(report.policies)}
    found.cells.update(sorted(cells.items(), key=lambda item: order[item[0][0]]))
    return found


def _recipes(
    report: Report, flyable: Mapping[str, Flyable]
) -> dict[tuple[str, str], tuple[Result, Recipe]]:
    """By policy and task the result and how the median run is made, policy by policy."""
    return {
        (policy, task): (result, flyable[task].recipes[policy][result.median])
        for policy in report.policies
        if policy not in NO_LAWS
        for task in report.native
        if (result := report.scenarios[task].results.get(policy))
        and not report.scenarios[task].untrained(policy)
    }


def _cell(columns: Mapping[str, NDArray[np.float64]], episodes: int) -> Cell:
    return Cell(*(float(columns[name][:episodes].mean()) for name in Cell._fields))


def _world(config: FormationConfig, change: Change, seeds: range) -> FormationConfig | str:
    """The changed task, or why it says nothing."""
    try:
        world = changed(config, change)
    except ValueError as problem:
        return str(problem)
    return world if leader_starts(world, seeds) else LEADER


def _refusal(recipe: Recipe, config: FormationConfig) -> str:
    """Why a policy does not take a configuration; empty where it does."""
    try:
        with transfer_unwarned(), warnings.catch_warnings():
            warnings.simplefilter("ignore", UntunedWarning)
            recipe.make(config)
    except ValueError as problem:
        return str(problem)
    return ""
