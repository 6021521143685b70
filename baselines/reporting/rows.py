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

    Each of its runs scores more, seed by seed, than each run of every other policy, with an interval above
    zero; and it is neither a policy file nor a law with searched gains, or there are `SEEDS` runs of it: one
    search, as one training, says nothing of another one.
    """
    results = scenario.results
    best = scenario.best
    if (best in scenario.sources or searched(best)) and len(results[best].runs) < SEEDS:
        return None
    own = stacked(list(results[best].runs.values()), "score")
    others = [
        each["score"] for name, r in results.items() if name != best for each in r.runs.values()
    ]
    pairs = {f"{i} {k}": a - b for i, a in enumerate(own) for k, b in enumerate(others)}
    if not pairs:
        return None
    return best if all(e.low > 0.0 for e in estimates(pairs).values()) else None


def hardest(report: Report) -> str | None:
    """The scenario whose best score is the lowest; None where fewer than two have been flown."""
    best = {
        name: s.results[s.best].score.value for name, s in report.scenarios.items() if s.results
    }
    return min(best, key=lambda name: best[name]) if len(best) > 1 else None
