"""The results of an evaluation: what every policy reached on every scenario, and as text for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from baselines.scoring.intervals import Estimate, difference, estimate, normalised, summarise
from baselines.scoring.metrics import KINDS
from baselines.scoring.rollout import Episodes
from baselines.system.console import width
from baselines.system.text import table, wrapped
from formation_env import FormationConfig

# The metrics that are compared with the expert's seed by seed.
COMPARED = ("return", "slot_error_rms")
ELSEWHERE = "*"  # marks the score of a policy file on a task that it was not trained for


class Result(NamedTuple):
    """One policy on one scenario."""

    score: Estimate
    summary: dict[str, Estimate]  # by the names of `metrics.EPISODE`
    differences: dict[str, Estimate]  # to the expert, of the metrics `COMPARED`
    failures: dict[str, int]  # episodes by kind of failure
    to_tuned: dict[str, Estimate]  # differences to the expert with searched gains, if it has flown


class Source(NamedTuple):
    """The file that a policy was flown from."""

    file: str  # name without the folder
    method: str
    scenario: str  # trained on
    action: str  # at this level
    differs: bool  # whether the task flown is another one than it was trained for


class Scenario(NamedTuple):
    """All policies on one scenario."""

    config: FormationConfig
    results: dict[str, Result]
    span: float  # the expert's mean return minus hover's, the unit of the score
    measuring: dict[str, Estimate] | None  # the expert's, with velocity and acceleration measured
    sources: dict[str, Source]  # of those policies that are files
    absent: dict[str, str]  # policies that cannot fly here, and why

    def untrained(self, policy: str) -> bool:
        """Whether the policy is a file that was trained for another task: `transfer.differences`."""
        source = self.sources.get(policy)
        return source is not None and source.differs


class Report(NamedTuple):
    """A whole evaluation."""

    seed: int  # of the first episode of each scenario
    episodes: int  # of each policy on each scenario
    scenarios: dict[str, Scenario]

    @property
    def policies(self) -> list[str]:
        """The policies that have flown at least one scenario."""
        return list(dict.fromkeys(p for s in self.scenarios.values() for p in s.results))

    def __str__(self) -> str:
        """What the command prints: scores and failures."""
        return summary(self)


def judge(
    columns: Episodes, hover: Episodes, expert: Episodes, tuned: Episodes | None = None
) -> Result:
    """A policy's result from its episodes and those of the policies it is compared with on the same
    seeds."""
    returns = [each["return"] for each in (columns, hover, expert)]
    kinds = np.bincount(columns["failure"].astype(np.int64), minlength=len(KINDS))
    return Result(
        estimate(normalised, *returns),
        summarise(columns),
        {name: difference(columns, expert, name) for name in COMPARED},
        {kind: int(kinds[k]) for k, kind in enumerate(KINDS) if k > 0},
        {} if tuned is None else {name: difference(columns, tuned, name) for name in COMPARED},
    )


def above_expert(results: dict[str, Result]) -> list[str]:
    """The policies with a score above the expert's."""
    return [p for p, r in results.items() if r.differences["return"].value > 0.0]


# -- as text --------------------------------------------------------------------------------------


def summary(report: Report, columns: int | None = None) -> str:
    """Scores, failures and what the marks mean, at most `columns` wide (by default: the terminal)."""
    columns = width() if columns is None else columns
    count = f"{report.episodes} episode{'s' if report.episodes > 1 else ''}"
    head = f"score of {count}: hover is 0, the expert 1, higher is better"
    parts = [f"{wrapped(head, columns)}\n{_table(report, _score, columns)}"]
    if any(_failed(s, policy) for s in report.scenarios.values() for policy in report.policies):
        failed = _table(report, _failed, columns, skip_empty=True)
        parts.append(f"failed episodes, of {report.episodes} (none where empty)\n{failed}")
    notes = list(_notes(report))
    if notes:
        parts.append("\n".join(wrapped(note, columns) for note in notes))
    return "\n\n".join(parts)


def _table(
    report: Report, cell: Callable[[Scenario, str], str], columns: int, skip_empty: bool = False
) -> str:
    """A line for each policy and a column for each scenario."""
    scenarios = report.scenarios
    return table(
        "policy",
        report.policies,
        list(scenarios),
        lambda policy, name: cell(scenarios[name], policy),
        columns,
        skip_empty,
    )


def _notes(report: Report) -> Iterable[str]:
    scenarios = report.scenarios
    if any(s.untrained(policy) for s in scenarios.values() for policy in s.results):
        yield f"{ELSEWHERE} trained for another task"
    if any(policy in s.absent for s in scenarios.values() for policy in report.policies):
        yield "- does not fly this scenario: the full report says why"
    useless = [name for name, s in scenarios.items() if not s.span > 0.0]
    if useless:
        yield f"scores on {', '.join(useless)} mean nothing: the expert is no better than hover there"


def _score(scenario: Scenario, policy: str) -> str:
    if policy not in scenario.results:
        return "- "
    mark = ELSEWHERE if scenario.untrained(policy) else " "
    return f"{scenario.results[policy].score.value:.3f}{mark}"


def _failed(scenario: Scenario, policy: str) -> str:
    if policy not in scenario.results:
        return ""
    number = sum(scenario.results[policy].failures.values())
    return f"{number}" if number else ""
