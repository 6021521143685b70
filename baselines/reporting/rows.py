"""What the rows of a board are: the paper's law and its rivals, searched gains, and which one is the best."""

from __future__ import annotations

from collections.abc import Iterable

from baselines.registry import POLICIES
from baselines.scoring.intervals import estimates, stacked
from baselines.scoring.results import NO_LAWS, Report, Scenario

PAPER = "expert"  # the paper's law
TUNED = "-tuned"  # ends the name of a law with searched gains
SEEDS = 5  # runs, at least, of what was trained or searched and may be called the best


def laws(policies: Iterable[str]) -> list[str]:
    """Those of the policies that are programmed control laws."""
    return [name for name in policies if name in POLICIES and name not in NO_LAWS]


def searched(policy: str) -> bool:
    """Whether the policy is a law with gains that were searched."""
    return policy in POLICIES and policy.endswith(TUNED)


def agreed_best(scenario: Scenario) -> str | None:
    """The policy that every pair of runs agrees is the best, if there is one.

    It is separated from every other policy; and it is neither a policy file nor a law with searched gains, or
    there are `SEEDS` runs of it: one search, as one training, says nothing of another one.
    """
    results = scenario.results
    best = scenario.best
    if (best in scenario.sources or searched(best)) and len(results[best].runs) < SEEDS:
        return None
    return best if len(results) > 1 and not unseparated(scenario) else None


def unseparated(scenario: Scenario) -> list[str]:
    """The policies from which the one with the highest score is not separated, the highest first.

    It is from those of whose runs each scores less, seed by seed, than each of its own runs, with an interval
    of the difference above zero.
    """
    results, best = scenario.results, scenario.best
    own = stacked(list(results[best].runs.values()), "score")
    pairs = {
        (name, run, k): mine - columns["score"]
        for name, r in results.items()
        if name != best
        for run, columns in r.runs.items()
        for k, mine in enumerate(own)
    }
    found = estimates({str(i): x for i, x in enumerate(pairs.values())}) if pairs else {}
    near = {name for (name, _, _), e in zip(pairs, found.values(), strict=True) if not e.low > 0.0}
    return sorted(near, key=lambda name: -results[name].score.value)


def hardest(report: Report) -> str | None:
    """The scenario whose best score is the lowest; None where fewer than two have been flown."""
    best = {
        name: s.results[s.best].score.value for name, s in report.scenarios.items() if s.results
    }
    return min(best, key=lambda name: best[name]) if len(best) > 1 else None
