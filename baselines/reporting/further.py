"""What is flown for a board beside the scores: what scenarios ask, robustness, and what limits a score."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from baselines.reporting import demands
from baselines.reporting.rows import PAPER, hardest, laws
from baselines.scoring.evaluation import Flight, Flyable, fly_all
from baselines.scoring.results import Report
from baselines.scoring.robustness import EPISODES, Robustness, fly_changes
from formation_env import FormationConfig, configure
from formation_env.config import NO_NOISE
from formation_env.physics.quadrotor import MOMENT

PLAIN = "as it is"


class Ceiling(NamedTuple):
    """The highest score of a programmed law on a scenario as it is, and without what may limit it."""

    scenario: str
    episodes: int
    best: dict[str, float]  # as it is first, then without something


class Further(NamedTuple):
    """All of it; empty where nothing of a kind was flown."""

    demands: Mapping[str, demands.Flown] = {}  # by scenario
    robustness: Robustness | None = None
    calm: Mapping[str, float] = {}  # by scenario with gusts: the paper's law's score without them
    ceiling: Ceiling | None = None


def fly_further(
    report: Report, flyable: Mapping[str, Flyable], threads: int = 1, quiet: bool = False
) -> Further:
    """Fly all of it; `flyable` is what the report was flown with. Raises as `evaluation.fly_all` does."""
    return Further(
        demands.of_best(report, flyable, quiet),
        fly_changes(report, flyable, threads, quiet),
        _calm(report, flyable, threads, quiet),
        _ceiling(report, flyable, threads, quiet),
    )


def paper_level(report: Report, names: Iterable[str]) -> tuple[str, ...]:
    """Those of the scenarios at the action level whose tracker the paper prints: thrust and moments."""
    return tuple(n for n in names if report.scenarios[n].config.level.actuation == MOMENT)


def _calm(
    report: Report, flyable: Mapping[str, Flyable], threads: int, quiet: bool
) -> dict[str, float]:
    """The paper's law without gusts, on the report's episodes."""
    seeds = range(report.seed, report.seed + report.episodes)
    flights = {
        name: Flight(
            configure(s.config, gust=0.0), next(iter(flyable[name].recipes[PAPER].values())), seeds
        )
        for name, s in report.scenarios.items()
        if PAPER in s.results and s.config.gust > 0.0 and paper_level(report, [name])
    }
    flown = fly_all(flights, threads, quiet, title="flying without gusts")
    return {name: float(columns["score"].mean()) for name, columns in flown.items()}


def relieved(config: FormationConfig) -> dict[str, FormationConfig]:
    """The task without each thing that it has and that may limit a score, by words that follow "with"."""
    exact = configure(
        config, noise=NO_NOISE, estimator="direct", measurement_delay=0, measurement_period=None
    )
    calm = configure(config, gust=0.0)
    found = {"exact measurements": exact, "no gusts": calm}
    return {words: each for words, each in found.items() if each != config}


def _ceiling(
    report: Report, flyable: Mapping[str, Flyable], threads: int, quiet: bool
) -> Ceiling | None:
    """Of the scenario whose best score is the lowest, on the first of the report's episodes."""
    name = hardest(report)
    if name is None:
        return None
    scenario = report.scenarios[name]
    rivals = laws(scenario.results)
    if not rivals:
        return None
    seeds = range(report.seed, report.seed + min(EPISODES, report.episodes))
    flights = {
        (words, law): Flight(
            config, flyable[name].recipes[law][scenario.results[law].median], seeds
        )
        for words, config in relieved(scenario.config).items()
        for law in rivals
    }
    rows = [scenario.results[law] for law in rivals]
    plain = (float(row.runs[row.median]["score"][: len(seeds)].mean()) for row in rows)
    best = {PLAIN: max(plain)}
    flown = fly_all(flights, threads, quiet, title="flying without limits")
    for (words, _), columns in flown.items():
        best[words] = max(best.get(words, 0.0), float(np.mean(columns["score"])))
    return Ceiling(name, len(seeds), best)
