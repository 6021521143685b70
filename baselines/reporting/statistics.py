"""The page of statistics over all scenarios of a board."""

from __future__ import annotations

from baselines.reporting.cells import listed, markdown_table, scored
from baselines.scoring.results import REFERENCES, Report
from baselines.scoring.suite import Matrix, SuiteScore, probability_of_improvement, suite_score

ABOUT = (
    "After R. Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical Precipice* "
    "(NeurIPS 2021). A run's score on a scenario is its mean over the episodes; the interquartile mean "
    "leaves out the lowest and the highest quarter of a method's runs and scenarios, each scenario counted "
    "alike. Intervals (95 %, bootstrap) are stratified by scenario: within each, training runs and "
    "episodes are drawn."
)
IMPROVEMENT = (
    "How likely an episode of the method scores above one of the other, drawn at random on one of the "
    "scenarios that both fly (Mann and Whitney's U over the number of pairs, averaged over scenarios)."
)


def parts(report: Report, matrix: Matrix, picture: str) -> list[str]:
    """The page's paragraphs; `picture` is the file name of the performance profile."""
    whole = [m for m in matrix.method if len(matrix.flown(m)) == len(matrix.scenario)]
    others = [name for name in REFERENCES if name in matrix.method]
    scores = {m: suite_score(matrix, m) for m in matrix.method}
    order = sorted(matrix.method, key=lambda m: (m not in whole, -_middle(scores[m])))
    return [
        ABOUT,
        f"The scenarios: {listed(matrix.scenario)}. Methods that do not fly all of them come last: theirs is "
        "another average. Those of a learned method include the scenarios that it was not trained for.",
        markdown_table(
            ["method", "scenarios", "trained for", "interquartile mean", "mean"],
            [_scores(report, m, scores[m]) for m in order],
        ),
        "## Probability of improvement",
        IMPROVEMENT,
        markdown_table(
            ["method", *(f"over `{name}`" for name in others)],
            [[f"`{m}`", *(_probability(matrix, m, name) for name in others)] for m in order],
        ),
        "## Performance profile",
        "The share of episodes with a score above a threshold, each scenario counted alike, of the methods "
        "that fly all scenarios; shaded the pointwise 95 % interval. The axis is stretched above 0.8.",
        f"![Share of episodes above each score, programmed laws and learned policies]({picture})",
    ]


def _middle(score: SuiteScore) -> float:
    return score.interquartile_mean.value


def _scores(report: Report, method: str, score: SuiteScore) -> list[str]:
    learned = [s.sources[method] for s in report.scenarios.values() if method in s.sources]
    own = sum(not source.differs for source in learned)
    middle, mean = scored(score.interquartile_mean), scored(score.mean)
    return [
        f"`{method}`", str(len(score.scenarios)), str(own) if learned else "-", middle, mean
    ]  # fmt: skip


def _probability(matrix: Matrix, method: str, other: str) -> str:
    if method == other or not matrix.flown(method, other):
        return "-"
    p = probability_of_improvement(matrix, method, other)
    return f"{p.value:.2f} ({p.low:.2f} .. {p.high:.2f})"
