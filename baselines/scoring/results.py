"""The results of an evaluation: what every policy reached on every scenario, and as text for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from baselines.scoring.intervals import Estimate, estimates, median_run, stacked, summarise
from baselines.scoring.metrics import KINDS
from baselines.scoring.rollout import Episodes
from baselines.system.console import width
from baselines.system.text import table, wrapped
from formation_env import SCENARIOS, FormationConfig, configure

# The policies that others are compared with, episode by episode, where these fly, and in which metrics.
REFERENCES = ("expert", "expert-tuned", "ff")
COMPARED = ("score", "slot_error")
NO_LAWS = ("hover", "random")  # programmed, but no control laws: nothing is wanted of them
ELSEWHERE = "*"  # marks the score of a policy file on a task that it was not trained for
WIDEST = 78  # columns of the tables


class Result(NamedTuple):
    """One row on one scenario: a policy, or several training runs of a method.

    Of several runs a figure is the median of the runs' figures, its interval over runs and episodes.
    """

    summary: dict[str, Estimate]  # by the names of `metrics.EPISODE`
    differences: dict[str, dict[str, Estimate]]  # to one of `REFERENCES`: of the metrics `COMPARED`
    failures: dict[str, int]  # episodes of all runs together by kind of failure
    median: str  # name of the run whose score is the median
    runs: dict[str, Episodes]  # columns of `metrics.EPISODE` and `failure`, by the run's name

    @property
    def score(self) -> Estimate:
        """The score, 0 to 1."""
        return self.summary["score"]

    @property
    def scores(self) -> dict[str, float]:
        """Mean score of each run."""
        return {name: float(columns["score"].mean()) for name, columns in self.runs.items()}

    @property
    def failed(self) -> float:
        """The share of the episodes of all runs together that have failed."""
        return float(np.mean([columns["failed"] for columns in self.runs.values()]))


class Source(NamedTuple):
    """The file that a policy was flown from; of several runs the first one's."""

    file: str  # name without the folder; that of the file which ships, if it is one of the runs
    method: str
    scenario: str  # trained on
    action: str  # at this level
    differs: bool  # whether the task flown is another one than it was trained for
    teacher: str = ""  # the policy that was cloned, if any
    history: int = 1  # observations that the network sees
    hidden: tuple[int, ...] = ()  # widths of its hidden layers


class Scenario(NamedTuple):
    """All policies on one scenario."""

    config: FormationConfig
    results: dict[str, Result]
    sources: dict[str, Source]  # of those policies that are files
    absent: dict[str, str]  # policies that cannot fly here, and why

    @property
    def best(self) -> str:
        """The policy with the highest score. Raises `ValueError` where none has flown."""
        return max(self.results, key=lambda name: self.results[name].score.value)

    def untrained(self, policy: str) -> bool:
        """Whether the policy is a file that was trained for another task: `transfer.differences`."""
        source = self.sources.get(policy)
        return source is not None and source.differs


class Sweep(NamedTuple):
    """One scenario at several values of one field, the same episodes at each."""

    scenario: str  # perhaps with the values of further fields that are swept
    field: str  # with the name of a part of it after a dot
    unit: str
    values: tuple[Any, ...]  # in the order given
    texts: tuple[str, ...]  # of each value
    scenarios: tuple[str, ...]  # the report's name of each

    @property
    def numeric(self) -> bool:
        """Whether the values are numbers, so that they lie on an axis."""
        return all(type(x) in (int, float) for x in self.values)


class Report(NamedTuple):
    """A whole evaluation."""

    seed: int  # of the first episode of each scenario
    episodes: int  # of each policy on each scenario
    scenarios: dict[str, Scenario]
    sweeps: tuple[Sweep, ...] = ()  # the scenarios that belong together

    @property
    def policies(self) -> list[str]:
        """The policies that have flown at least one scenario."""
        return list(dict.fromkeys(p for s in self.scenarios.values() for p in s.results))

    @property
    def single(self) -> dict[str, Scenario]:
        """The scenarios that are no value of a sweep."""
        swept = {name for each in self.sweeps for name in each.scenarios}
        return {name: each for name, each in self.scenarios.items() if name not in swept}

    @property
    def native(self) -> tuple[str, ...]:
        """The scenarios at their own action level; all that have been flown, where there is none of them."""
        own = (n for n, s in self.scenarios.items() if n in SCENARIOS and _own_level(n, s.config))
        return tuple(own) or tuple(self.scenarios)

    def __str__(self) -> str:
        """What the command prints."""
        return summary(self)


def _own_level(name: str, config: FormationConfig) -> bool:
    return config.scenario == name and config.action == configure(name).action


def judge(runs: Mapping[str, Episodes], references: Mapping[str, Episodes]) -> Result:
    """A row's result from the episodes of its runs and those, on the same seeds, of the policies that it is
    compared with."""
    columns = list(runs.values())
    median = list(runs)[median_run(stacked(columns, "score"))]
    failures = stacked(columns, "failure").astype(np.int64)
    kinds = np.bincount(failures.ravel(), minlength=len(KINDS))
    return Result(
        summarise(columns),
        {
            name: estimates({m: stacked(columns, m) - other[m] for m in COMPARED})
            for name, other in references.items()
        },
        {kind: int(kinds[k]) for k, kind in enumerate(KINDS) if k > 0},
        median,
        dict(runs),
    )


# -- as text --------------------------------------------------------------------------------------

_MOST_TABLES = 6  # scenarios that are shown in a table each


def summary(report: Report, columns: int | None = None) -> str:
    """A table for each of a few scenarios, one of all scores, one for each sweep, and what the marks mean, at
    most `columns` wide (by default: the terminal, at most `WIDEST`)."""
    columns = min(width(), WIDEST) if columns is None else columns
    count = f"{report.episodes} episode{'s' if report.episodes > 1 else ''}"
    each = ", scenario and value, on the same seeds" if report.sweeps else " and scenario"
    head = f"{count} for each policy{each}; score: mean reward in the window, 0 to 1, 1 is exact"
    scenarios = report.single
    few = 0 < len(scenarios) <= _MOST_TABLES
    if few:
        head += ", with its 95 % interval; slot error in the window and in its second half"
    parts = [wrapped(head, columns)]
    if few:
        parts += [f"{name}\n{_figures(each, columns)}" for name, each in scenarios.items()]
    if len(scenarios) > 1:
        parts.append(f"scores\n{_scores(report, {name: name for name in scenarios}, columns)}")
    for sweep in report.sweeps:
        names = dict(zip(sweep.texts, sweep.scenarios, strict=True))
        unit = "" if sweep.unit == "1" else f", {sweep.unit}"
        title = wrapped(f"{sweep.scenario}: scores by {sweep.field}{unit}", columns)
        parts.append(f"{title}\n{_scores(report, names, columns)}")
    notes = list(_notes(report))
    if notes:
        parts.append("\n".join(wrapped(note, columns) for note in notes))
    return "\n\n".join(parts)


_COLUMNS: dict[str, Callable[[Result], str]] = {
    "slot error m": lambda r: f"{r.summary['slot_error'].value:.3f}",
    "late error m": lambda r: f"{r.summary['slot_error_late'].value:.3f}",
    "failed %": lambda r: f"{100.0 * r.summary['failed'].value:.0f}",
    "start s": lambda r: f"{r.summary['trigger_time'].value:.1f}",
}


def _figures(scenario: Scenario, columns: int) -> str:
    """One scenario: a line for each policy, a column for each of its most telling figures."""

    def cell(policy: str, name: str) -> str:
        result = scenario.results[policy]
        if name in _COLUMNS:
            return _COLUMNS[name](result)
        s = result.score
        return f"{s.value:.3f} ({s.low:.3f} .. {s.high:.3f}){_mark(scenario, policy)}"

    return table("policy", list(scenario.results), ["score", *_COLUMNS], cell, columns)


def _scores(report: Report, names: Mapping[str, str], columns: int) -> str:
    """A line for each policy and a column for each heading, of the scenario that it names."""

    def cell(policy: str, heading: str) -> str:
        scenario = report.scenarios[names[heading]]
        result = scenario.results.get(policy)
        return f"{result.score.value:.3f}{_mark(scenario, policy)}" if result else "- "

    return table("policy", report.policies, list(names), cell, columns)


def _mark(scenario: Scenario, policy: str) -> str:
    return ELSEWHERE if scenario.untrained(policy) else " "


def _notes(report: Report) -> Iterable[str]:
    scenarios = report.scenarios
    if any(s.untrained(policy) for s in scenarios.values() for policy in s.results):
        yield f"{ELSEWHERE} trained for another task"
    if any(policy in s.absent for s in scenarios.values() for policy in report.policies):
        yield "- does not fly this scenario: the full report says why"
    medians = {r.median: len(r.runs) for s in scenarios.values() for r in s.results.values()}
    several = {name: count for name, count in medians.items() if count > 1}
    if several:
        shown = ", ".join(f"{name} of {count}" for name, count in several.items())
        yield f"of several training runs the median is shown: {shown}"
