"""The page of statistics over the scenarios of a board."""

from __future__ import annotations

from collections.abc import Mapping

from baselines.reporting.cells import listed, markdown_table, scored
from baselines.scoring.results import REFERENCES, Report
from baselines.scoring.suite import (
    Matrix,
    SuiteScore,
    over,
    probability_of_improvement,
    suite_score,
)

ABOUT = (
    "After R. Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical Precipice* "
    "(NeurIPS 2021). A run's score on a scenario is its mean over the episodes; the interquartile mean "
    "leaves out the lowest and the highest quarter of a method's runs and scenarios, each scenario counted "
    "alike. Intervals (95 %, bootstrap) are stratified by scenario: within each, training runs and "
    "episodes are drawn. The scenarios are held fixed: an interval says nothing of other scenarios."
)
IMPROVEMENT = (
    "How likely an episode of the method scores above one of the other, drawn at random on one of the "
    "scenarios that both fly (Mann and Whitney's U over the number of pairs, averaged over scenarios)."
)


def parts(report: Report, matrix: Matrix, picture: str) -> list[str]:
    """The page's paragraphs; `picture` is the file name of the performance profile, of `primary`."""
    first, everything = primary(report, matrix), matrix.scenario
    of_first = over(matrix, first)
    others = [name for name in REFERENCES if name in of_first.method]
    scores = _suite_scores(of_first)
    told = [ABOUT, *_means(report, of_first, scores, FIRST)]
    if first != everything:
        told += ["## All scenarios", *_means(report, matrix, _suite_scores(matrix), ALL)]
    return [
        *told,
        "## Probability of improvement",
        f"{IMPROVEMENT} Over {listed(first)}.",
        markdown_table(
            ["method", *(f"over `{name}`" for name in others)],
            [[f"`{m}`", *(_probability(of_first, m, name) for name in others)] for m in scores],
        ),
        "## Performance profile",
        f"The share of episodes with a score above a threshold, over {listed(first)}, each counted alike, of "
        "the methods that fly all of them; shaded the pointwise 95 % interval. The axis is stretched above "
        "0.8.",
        f"![Share of episodes above each score, programmed laws and learned policies]({picture})",
    ]


FIRST = "The scenarios"
ALL = "All that were flown, a scenario at two levels twice, though these are not independent"


def primary(report: Report, matrix: Matrix) -> tuple[str, ...]:
    """The scenarios that methods are ordered by: those at their own action level."""
    return tuple(name for name in report.native if name in matrix.scenario)


def _means(report: Report, m: Matrix, scores: Mapping[str, SuiteScore], what: str) -> list[str]:
    """The scenarios, what the interquartile mean leaves out of them, and a row for each method."""
    cut = len(m.scenario) / 4.0
    return [
        f"{what}: {listed(m.scenario)}. Of a method of one run the interquartile mean leaves out its {cut:g} "
        f"best and its {cut:g} worst scores of {len(m.scenario)}. Methods that do not fly all come last: "
        "theirs is another average. Those of a learned method include the scenarios that it was not trained "
        "for.",
        markdown_table(
            ["method", "scenarios", "trained for", "mean", "interquartile mean"],
            [_scores(report, name, score) for name, score in scores.items()],
        ),
    ]


def _suite_scores(m: Matrix) -> dict[str, SuiteScore]:
    """Those of all methods, ordered by the mean; methods that do not fly all scenarios last."""
    found = {name: suite_score(m, name) for name in m.method}
    every = len(m.scenario)
    return dict(
        sorted(found.items(), key=lambda x: (len(x[1].scenarios) < every, -x[1].mean.value))
    )


def _scores(report: Report, method: str, score: SuiteScore) -> list[str]:
    each = (report.scenarios[name] for name in score.scenarios)
    learned = [s.sources[method] for s in each if method in s.sources]
    own = sum(not source.differs for source in learned)
    count, trained = str(len(score.scenarios)), str(own) if learned else "-"
    return [f"`{method}`", count, trained, scored(score.mean), scored(score.interquartile_mean)]


def _probability(matrix: Matrix, method: str, other: str) -> str:
    if method == other or not matrix.flown(method, other):
        return "-"
    p = probability_of_improvement(matrix, method, other)
    return f"{p.value:.2f} ({p.low:.2f} .. {p.high:.2f})"
