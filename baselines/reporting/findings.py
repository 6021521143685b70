"""What the figures of a board say in a few sentences, computed; one without a subject is left out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from baselines.registry import POLICIES
from baselines.reporting.cells import listed, scored
from baselines.scoring.intervals import estimates, stacked
from baselines.scoring.results import Report, Scenario
from baselines.scoring.suite import Matrix, probability_of_improvement, suite_score

PAPER = "expert"  # the paper's law
TUNED = "-tuned"  # ends the name of a law with searched gains
NO_LAWS = ("hover", "random")
SEEDS = 5  # training runs, at least, of a learned policy that may be called the best


def laws(policies: Iterable[str]) -> list[str]:
    """Those of the policies that are programmed control laws."""
    return [name for name in policies if name in POLICIES and name not in NO_LAWS]


def agreed_best(scenario: Scenario) -> str | None:
    """The policy that every pair of training runs agrees is the best, if there is one.

    Each of its runs scores more, seed by seed, than each run of every other policy, with an interval above
    zero; and it is no policy file, or there are `SEEDS` training runs of it.
    """
    results = scenario.results
    best = scenario.best
    if best in scenario.sources and len(results[best].runs) < SEEDS:
        return None
    own = stacked(list(results[best].runs.values()), "score")
    others = [
        each["score"] for name, r in results.items() if name != best for each in r.runs.values()
    ]
    pairs = {f"{i} {k}": a - b for i, a in enumerate(own) for k, b in enumerate(others)}
    if not pairs:
        return None
    return best if all(e.low > 0.0 for e in estimates(pairs).values()) else None


def findings(report: Report, matrix: Matrix) -> list[str]:
    """At most five sentences or pairs of them."""
    found = [
        _paper_among_laws(report, matrix),
        _tuning(report),
        _learned(report),
        _transfer(report),
        _hardest(report),
    ]
    return [text for text in found if text]


def _paper_among_laws(report: Report, matrix: Matrix) -> str:
    """Where the paper's law stands among the textbook's, over the scenarios that all of them fly."""
    names = laws(report.policies)
    own = [name for name in names if not name.endswith(TUNED)]
    searched = [name for name in names if name.endswith(TUNED)]
    parts = []
    for law, rivals, words in ((PAPER, own, "own"), (PAPER + TUNED, searched, "searched")):
        scenarios = matrix.flown(*rivals) if law in rivals and len(rivals) > 1 else ()
        if scenarios:
            parts.append(_ranking(matrix, law, rivals, scenarios, words))
    return f"**The paper's law among the textbook's.** {' '.join(parts)}" if parts else ""


def _ranking(
    matrix: Matrix, law: str, rivals: Sequence[str], scenarios: Sequence[str], gains: str
) -> str:
    scores = {name: suite_score(matrix, name, scenarios).interquartile_mean for name in rivals}
    order = sorted(rivals, key=lambda name: -scores[name].value)
    best = next(name for name in order if name != law)
    p = probability_of_improvement(matrix, best, law, scenarios)
    ranking = ", ".join(f"`{name}` {scores[name].value:.3f}" for name in order)
    return (
        f"With {gains} gains, over {_counted(scenarios)}, the interquartile mean is {ranking}: `{law}` is "
        f"number {order.index(law) + 1} of {len(order)}. An episode of `{best}` scores above one of `{law}` "
        f"with probability {p.value:.2f} ({p.low:.2f} .. {p.high:.2f})."
    )


def _counted(scenarios: Sequence[str]) -> str:
    return "1 scenario" if len(scenarios) == 1 else f"{len(scenarios)} scenarios"


def _tuning(report: Report) -> str:
    """What searched gains bring each law, in the mean over the scenarios, and which laws have none."""
    gains = {}
    for name in report.policies:
        plain = name.removesuffix(TUNED)
        both = [
            s.results[name].score.value - s.results[plain].score.value
            for s in report.scenarios.values()
            if name in s.results and plain in s.results
        ]
        if plain != name and both:
            gains[plain] = float(np.mean(both))
    if not gains:
        return ""
    each = ", ".join(f"`{name}` {gain:+.3f}" for name, gain in gains.items())
    bare = [name for name in report.policies if name + TUNED in POLICIES and name not in gains]
    without = f" {', '.join(f'`{name}`' for name in bare)}: none searched yet." if bare else ""
    return (
        f"**Searched gains.** In the mean over scenarios they change the score of {each}.{without}"
    )


def _cells(report: Report, own: bool) -> list[tuple[Scenario, str, str]]:
    """Scenario, its name and policy of the learned cells that were trained for their task, or were not."""
    return [
        (s, name, policy)
        for name, s in report.scenarios.items()
        for policy, source in s.sources.items()
        if source.differs != own
    ]


def _learned(report: Report) -> str:
    """How often methods that were trained for a task beat the paper's law there, and its tuned form."""
    own = _cells(report, own=True)
    if not own:
        return ""
    counts = []
    for other in (PAPER, PAPER + TUNED):
        known = [
            r.differences[other]["score"]
            for r in (s.results[policy] for s, _, policy in own)
            if other in r.differences
        ]
        if known:
            above, below = sum(e.low > 0 for e in known), sum(e.high < 0 for e in known)
            counts.append(f"{above} above `{other}`, {below} below")
    runs = [len(s.results[policy].runs) for s, _, policy in own]
    number = "one training run" if max(runs) == 1 else f"{_range(runs)} training runs"
    return (
        f"**Learned, for the task flown.** Of {len(own)} cells, of {number} each, by the interval of the "
        f"paired difference: {'; '.join(counts)}."
    )


def _range(counts: Sequence[int]) -> str:
    low, high = min(counts), max(counts)
    return f"{low}" if low == high else f"{low} to {high}"


def _transfer(report: Report) -> str:
    """Scores and failures of policies on tasks that they were not trained for, beside those that were."""
    parts = []
    for own, words in ((True, "trained for the task"), (False, "trained for another one")):
        results = [s.results[policy] for s, _, policy in _cells(report, own)]
        if not results:
            return ""
        score = np.median([r.score.value for r in results])
        failed = np.mean([r.summary["failed"].value for r in results])
        parts.append(f"{words} {score:.3f} and {100.0 * failed:.0f} %")
    return f"**Transfer.** Median score and mean failures of learned cells: {', '.join(parts)}."


def _hardest(report: Report) -> str:
    """The scenario whose best score is the lowest, and what is left to gain there."""
    best = {name: s.best for name, s in report.scenarios.items() if s.results}
    if len(best) < 2:
        return ""
    scores = {name: report.scenarios[name].results[policy] for name, policy in best.items()}
    name = min(scores, key=lambda each: scores[each].score.value)
    late = scores[name].summary["slot_error_late"].value
    missing = [each for each in report.scenarios if each not in _agreed(report)]
    shared = f" No policy is agreed to be the best on {listed(missing)}." if missing else ""
    return (
        f"**What is left.** The best score is lowest on `{name}`: {scored(scores[name].score)} by "
        f"`{best[name]}`, {late:.3f} m off in the second half.{shared}"
    )


def _agreed(report: Report) -> list[str]:
    return [name for name, s in report.scenarios.items() if s.results and agreed_best(s)]
