"""What the figures of a board say in a few sentences, computed; one without a subject is left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np

from baselines.registry import POLICIES
from baselines.reporting import budgets
from baselines.reporting.budgets import Budgets
from baselines.reporting.cells import listed, scored
from baselines.reporting.further import PLAIN, Ceiling, Further, paper_level
from baselines.reporting.rows import PAPER, TUNED, agreed_best, hardest, laws, searched, unseparated
from baselines.scoring.results import Report, Scenario
from baselines.scoring.suite import Matrix, probability_of_improvement, suite_score
from formation_env.physics.quadrotor import RATES

EXPERIMENT = "experiment"  # the scenario that docs/experiment.md is about


def findings(
    report: Report, matrix: Matrix, further: Further, spent: Budgets | None = None
) -> list[str]:
    """At most five sentences or groups of them. `spent` is what searches of gains have flown, by default
    what the files of gains say."""
    found = [
        _paper_among_laws(report, matrix, further),
        _tuning(report, budgets.read() if spent is None else spent),
        _learned(report),
        _transfer(report),
        _left(report, further.ceiling),
    ]
    return [text for text in found if text]


# -- the laws -------------------------------------------------------------------------------------


def _paper_among_laws(report: Report, matrix: Matrix, further: Further) -> str:
    """Where the paper's law stands among the textbook's, over the scenarios at its own action level that all
    of them fly, and what of that is not the paper's."""
    names = laws(report.policies)
    own = [name for name in names if not searched(name)]
    tuned = [name for name in names if searched(name)]
    parts = []
    for law, rivals, words in ((PAPER, own, "Own"), (PAPER + TUNED, tuned, "Searched")):
        flown = matrix.flown(*rivals) if law in rivals and len(rivals) > 1 else ()
        scenarios = paper_level(report, flown)
        if scenarios:
            parts.append(_ranking(matrix, law, rivals, scenarios, words))
    if not parts:
        return ""
    caveats = [_without_gusts(report, further), *_collisions(report), *_variant(report)]
    text = " ".join([MEANS, *parts, *filter(None, caveats)])
    return f"**The paper's law among the textbook's.** {text}"


MEANS = "Mean score (interquartile mean) at `wrench`, the level that it is printed for."


def _ranking(
    matrix: Matrix, law: str, rivals: Sequence[str], scenarios: Sequence[str], gains: str
) -> str:
    scores = {name: suite_score(matrix, name, scenarios) for name in rivals}
    order = sorted(rivals, key=lambda name: -scores[name].mean.value)
    best = next(name for name in order if name != law)
    p = probability_of_improvement(matrix, best, law, scenarios)
    ranking = ", ".join(
        f"`{name}` {scores[name].mean.value:.3f} ({scores[name].interquartile_mean.value:.3f})"
        for name in order
    )
    place = f"number {order.index(law) + 1} of {len(order)}"
    return (
        f"{gains} gains, {_counted(scenarios)}: {ranking}; `{law}` is {place}, and an episode of `{best}` "
        f"scores above one of `{law}` with probability {p.value:.2f} ({p.low:.2f} .. {p.high:.2f})."
    )


def _counted(scenarios: Collection[str]) -> str:
    return "1 scenario" if len(scenarios) == 1 else f"{len(scenarios)} scenarios"


def _without_gusts(report: Report, further: Further) -> str:
    """What the gusts, of which the paper has none, cost its law."""
    each = [
        f"{calm:.3f} instead of {report.scenarios[name].results[PAPER].score.value:.3f} on `{name}`"
        for name, calm in further.calm.items()
        if name in report.scenarios and PAPER in report.scenarios[name].results
    ]
    if not each:
        return ""
    return f"Without gusts, which are this package's, `{PAPER}` scores {', '.join(each)}."


def _collisions(report: Report) -> list[str]:
    """Where the paper's law fails on the experiment by the collision rule."""
    shares = {}
    for name, s in report.scenarios.items():
        result = s.results.get(PAPER)
        if s.config.scenario == EXPERIMENT and result and result.failures.get("collision"):
            episodes = sum(len(columns["failed"]) for columns in result.runs.values())
            shares[name] = f"{100.0 * result.failures['collision'] / episodes:.0f} % on `{name}`"
    if not shares:
        return []
    limit = report.scenarios[next(iter(shares))].config.limits.collision
    return [
        f"Of its episodes {', '.join(shares.values())} end by the rule that centres stay {limit:g} m apart: "
        "[why](docs/experiment.md)."
    ]


def _variant(report: Report) -> list[str]:
    rates = any(s.config.level.actuation == RATES for s in report.scenarios.values())
    return ["At `rates` its tracker is a variant of this package's."] if rates else []


def _tuning(report: Report, spent: Budgets) -> str:
    """What searched gains bring each law, in the mean over the scenarios, which laws have none, and how much
    was flown to find them."""
    gains = {}
    for name in filter(searched, report.policies):
        plain = name.removesuffix(TUNED)
        both = [
            s.results[name].score.value - s.results[plain].score.value
            for s in report.scenarios.values()
            if name in s.results and plain in s.results
        ]
        if both:
            gains[plain] = float(np.mean(both))
    if not gains:
        return ""
    each = ", ".join(f"`{name}` {gain:+.3f}" for name, gain in gains.items())
    bare = [name for name in report.policies if name + TUNED in POLICIES and name not in gains]
    without = f" {listed(bare)}: none searched yet." if bare else ""
    budget = budgets.sentence(report, spent)
    return (
        f"**Searched gains.** In the mean over scenarios they change the score of {each}, each by one search."
        f"{without}{' ' if budget else ''}{budget}"
    )


# -- what was learned -----------------------------------------------------------------------------


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
    cells, each = ("1 cell", "") if len(own) == 1 else (f"{len(own)} cells", " each")
    number = "one training run" if max(runs) == 1 else f"{_range(runs)} training runs"
    return (
        f"**Learned, for the task flown.** Of {cells}, of {number}{each}, by paired intervals "
        f"{'; '.join(counts) or 'none is compared'}.{_teachers(own)}"
    )


def _teachers(own: Sequence[tuple[Scenario, str, str]]) -> str:
    """The teachers of each method that imitates: the most frequent one, then others with their tasks."""
    cloned: dict[str, dict[str, list[str]]] = {}
    for s, name, policy in own:
        teacher = s.sources[policy].teacher
        if teacher:
            cloned.setdefault(policy, {}).setdefault(teacher, []).append(name)
    told = []
    for policy, teachers in cloned.items():
        usual, *others = sorted(teachers, key=lambda teacher: -len(teachers[teacher]))
        rest = "".join(f", on {listed(teachers[other])} `{other}`" for other in others)
        told.append(f" `{policy}` clones `{usual}`{rest}.")
    return "".join(told)


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
        failed = np.mean([r.failed for r in results])
        parts.append(f"{words} {score:.3f} and {100.0 * failed:.0f} %")
    return f"**Transfer.** Median score and mean failures of learned cells: {', '.join(parts)}."


# -- what is left ---------------------------------------------------------------------------------


def _left(report: Report, ceiling: Ceiling | None) -> str:
    """The scenario whose highest score is the lowest, what limits it, and where a best policy is agreed.

    Whose score that is says something only where it is separated from the next: else all are named that are
    not."""
    name = hardest(report)
    if name is None:
        return ""
    scenario = report.scenarios[name]
    best = scenario.results[scenario.best]
    late, near = best.summary["slot_error_late"].value, unseparated(scenario)
    whose = f"`{scenario.best}`"
    if near:
        whose += f", not separated (95 %, paired) from {listed(near)}"
    agreed = Counter(
        found for s in report.scenarios.values() if s.results and (found := agreed_best(s))
    )
    shares = ", ".join(f"`{policy}` on {count}" for policy, count in agreed.items())
    return (
        f"**What is left.** The highest score is lowest on `{name}`: {scored(best.score)} by {whose}, "
        f"{late:.3f} m off in the second half.{_limits(ceiling, name)} Agreed to be the best: "
        f"{shares or 'none'}, of {_counted(report.scenarios)}."
    )


def _limits(ceiling: Ceiling | None, name: str) -> str:
    """The highest score of a programmed law without noise and gusts beside that as it is."""
    if ceiling is None or ceiling.scenario != name:
        return ""
    without = [f"{x:.3f} with {words}" for words, x in ceiling.best.items() if words != PLAIN]
    if not without:
        return " Its measurements are exact and nothing pushes the vehicles."
    return (
        f" On {ceiling.episodes} episodes the highest score of a law is {ceiling.best[PLAIN]:.3f}, and "
        f"{', '.join(without)}."
    )
