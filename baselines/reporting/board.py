"""The leaderboard: LEADERBOARD.md, its pages in docs/board, and the README's extract, between two markers.

The first is a few tables and sentences, `LARGEST` bytes at most. Everything else that was measured stands
in the pages: one for each scenario, what the scenarios ask of the vehicles, robustness, the files that flew,
statistics over scenarios with a picture, and `results.json`.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from math import inf
from pathlib import Path

import formation_env
from baselines.reporting import demands, profile, report, robustness, statistics
from baselines.reporting.cells import rounded
from baselines.reporting.findings import findings
from baselines.reporting.further import Further
from baselines.reporting.rows import PAPER, SEEDS, agreed_best
from baselines.scoring.results import Report, Scenario
from baselines.scoring.suite import Matrix, matrix, over
from baselines.system.reading import read_text
from baselines.system.writing import write_text

NAME, README = "LEADERBOARD.md", "README.md"
PAGES = Path("docs/board")
PICTURE, JSON = "profile.png", "results.json"
FILES, STATISTICS, FIGURES = "files.md", "statistics.md", "figures.md"
DEMANDS, ROBUSTNESS = "scenarios.md", "robustness.md"
BEGIN, END = "<!-- leaderboard:begin -->", "<!-- leaderboard:end -->"
LARGEST = 8000  # bytes of LEADERBOARD.md
TOP = 3  # policies that the README shows, beside the best learned one and the paper's

ANY, CLEAR = 0.0005, 0.005  # half the width of the intervals that are shown, at least
WORST = 0.02  # by which the worst run's score is below the median's where it is shown
LEGEND = (
    "N %: of the episodes, of all runs, have failed. "
    f"Behind a learned score: the worst run's where lower by {WORST:g} or more; what it was trained for, "
    "`own` this one. *Italics*: transfer. `-`: does not fly it. NAME:LEVEL: at another action "
    "level. "
    f"**Bold**: every run, of what was trained or searched {SEEDS} at least, scores above all others' runs "
    "(95 %, paired); `-tuned` is one search, so not bold."
)
ADD = (
    "1. A controller: `formation-evaluate --policies expert,ff,mine.py:MyPolicy` scores it beside others.\n"
    f"2. A learned one: train {SEEDS} seeds; `formation-evaluate --runs runs` scores them, "
    "`python -m train.cards --ship RUN ...` checks the median in.\n"
    "3. `python -m baselines.evaluate --leaderboard --runs runs` writes this page and docs/board: "
    "propose both."
)

Cell = Callable[[Scenario, str], str]


# -- the short page -------------------------------------------------------------------------------


def leaderboard(
    result: Report, command: str, figures: Matrix, further: Further | None = None
) -> str:
    """The text of LEADERBOARD.md: where it would be too long without the small intervals in the table, then
    without any, and if need be without robustness, which the pages have too."""
    further = further or Further()
    best = {id(s): agreed_best(s) for s in result.scenarios.values() if s.results}

    def cell(least: float) -> Cell:
        def text(scenario: Scenario, policy: str) -> str:
            found = rounded(scenario.results[policy].score, least)
            found = f"**{found}**" if best[id(scenario)] == policy else found
            failed = _failed(scenario.results[policy].failed)
            source = scenario.sources.get(policy)
            if source is None:
                return f"{found}{failed}"
            trained = source.scenario if source.differs else "own"
            return f"{found}{_worst(scenario, policy)}{failed} {trained}"

        return text

    said, robust = findings(result, figures, further), _robustness(further)
    text = ""
    for least, tried in ((ANY, robust), (CLEAR, robust), (inf, robust), (inf, [])):
        text = _page(result, command, said, cell(least), _spread(least), tried)
        if len(text.encode()) <= LARGEST:
            break
    return text


def _spread(least: float) -> str:
    """What the intervals in the table are."""
    if least == inf:
        return "intervals are on the pages"
    return f"± 95 % over runs and episodes{f', where {least:g} or more' if least > ANY else ''}"


def _worst(scenario: Scenario, policy: str) -> str:
    """The worst run's score, where it is clearly below the median's."""
    result = scenario.results[policy]
    worst = min(result.scores.values())
    return f", worst {f'{worst:.3f}'.lstrip('0')}" if result.score.value - worst >= WORST else ""


def _failed(share: float) -> str:
    """Failed episodes in %, where there are any."""
    return f", {100.0 * share:.{0 if share >= 0.01 else 1}f} %" if share else ""


def _robustness(further: Further) -> list[str]:
    found = further.robustness
    if found is None or not found.plain:
        return []
    return ["## Robustness", robustness.caption(found), robustness.table(found)]


def _page(
    result: Report, command: str, said: list[str], cell: Cell, spread: str, robust: list[str]
) -> str:
    layout = next(iter(result.scenarios.values())).config.layout.version
    last = result.seed + result.episodes - 1
    return "\n\n".join(
        [
            "# Leaderboard",
            f"Written by `{command}`; do not edit. `Formation-v0`, observation layout {layout}, package "
            f"{formation_env.__version__}; seeds {result.seed} to {last} of each scenario, the same for "
            f"every policy. {report.score(result)} Of several training runs the median is shown; {spread}.",
            report.grid(result, cell, lambda name: f"[{name}]({_page_of(name)})"),
            LEGEND,
            *robust,
            "## What it says",
            *said,
            "## How to add a row",
            ADD,
            f"More: {_links()}.",
        ]
    ) + "\n"  # fmt: skip


def _links() -> str:
    pages = {"what makes each hard": DEMANDS, "robustness": ROBUSTNESS}
    pages |= {"statistics": STATISTICS, "policy files": FILES, "meanings": FIGURES, "all": JSON}
    return ", ".join(f"[{name}]({PAGES.as_posix()}/{file})" for name, file in pages.items())


# -- the other pages ------------------------------------------------------------------------------


def _page_of(scenario: str) -> str:
    return f"{PAGES.as_posix()}/{page_name(scenario)}"


def page_name(scenario: str) -> str:
    """The file name of a scenario's page."""
    return f"{''.join(c if c.isalnum() else '-' for c in scenario)}.md"


def pages(result: Report, figures: Matrix, further: Further | None = None) -> dict[str, str]:
    """The texts of the pages by file name."""
    further = further or Further()
    robust = further.robustness
    back = f"[Leaderboard](../../{NAME})"
    meanings = f"[what the figures mean]({FIGURES})"
    files = report.files_table(result) or "No policy file has flown."
    absent = report.absences(result)
    return {
        **{
            page_name(name): _joined([f"# {name}", f"{back}, {meanings}", *report.details(each)])
            for name, each in result.scenarios.items()
        },
        DEMANDS: _joined(
            ["# What makes each scenario hard", back, *demands.parts(result, further.demands)]
        ),
        ROBUSTNESS: _joined(
            ["# Robustness", back, *(robustness.parts(robust) if robust else ["Not flown."])]
        ),
        FILES: _joined(["# Policy files", back, files, *absent]),
        FIGURES: _joined(["# Figures", back, report.score(result), report.meanings()]),
        STATISTICS: _joined(
            ["# Statistics over scenarios", back, *statistics.parts(result, figures, PICTURE)]
        ),
    }


def _joined(parts: list[str]) -> str:
    return "\n\n".join(parts) + "\n"


# -- the README -----------------------------------------------------------------------------------


def extract(result: Report) -> str:
    """For the README: the scores of the best `TOP` policies, the best learned one and the expert, on the
    scenarios as they are named.

    By the mean over these, in which what a policy does not fly counts zero; without scenarios at other action
    levels, where there are any at their own.
    """
    named = {n: s for n, s in result.scenarios.items() if ":" not in n} or result.scenarios

    def total(policy: str) -> float:
        return sum(s.results[policy].score.value for s in named.values() if policy in s.results)

    ranked = sorted(result.policies, key=total, reverse=True)
    learned = [p for p in ranked if any(p in s.sources for s in named.values())]
    kept = [p for k, p in enumerate(ranked) if k < TOP or p in (PAPER, *learned[:1])]
    shown = {
        name: s._replace(results={p: s.results[p] for p in kept if p in s.results})
        for name, s in named.items()
    }
    grid = report.grid(
        result._replace(scenarios=shown), lambda s, policy: f"{s.results[policy].score.value:.2f}"
    )
    cells = "\n".join(grid.splitlines()[2:])
    marks = {"*": "*Italics*: trained for another scenario", "| - ": "`-`: does not fly this one"}
    told = "; ".join(text for mark, text in marks.items() if mark in cells)
    return f"{grid}\n\n{told}." if told else grid


def with_extract(readme: str, text: str) -> str:
    """README text with the part between the leaderboard's markers replaced.

    Raises `ValueError` unless each marker stands there once, in order.
    """
    once = readme.count(BEGIN) == readme.count(END) == 1
    if not once or readme.index(END) < readme.index(BEGIN):
        raise ValueError(f"expected the lines {BEGIN} and {END} once each, in this order")
    before, rest = readme.split(BEGIN)
    return f"{before}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}"


def check(checkout: Path) -> None:
    """Make sure that all can be written. Raises `ValueError` naming what is missing."""
    if importlib.util.find_spec("matplotlib") is None:
        raise ValueError('matplotlib is not installed: pip install "formation-env[plot]"')
    path = checkout / README
    text = read_text(path)
    try:
        with_extract(text, "")
    except ValueError as problem:
        raise ValueError(f"{path}: {problem}") from None


def write(result: Report, checkout: Path, command: str, further: Further) -> list[Path]:
    """Write all of it; returns the paths. Pages of scenarios that are no longer flown are removed.

    Raises `OSError`, `ValueError`.
    """
    figures, folder = matrix(result), checkout / PAGES
    texts = {
        checkout / NAME: leaderboard(result, command, figures, further),
        checkout / README: with_extract(read_text(checkout / README), extract(result)),
        folder / JSON: report.to_json(result, command),
        **{folder / name: text for name, text in pages(result, figures, further).items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    profile.draw(over(figures, statistics.primary(result, figures)), folder / PICTURE)
    for path, text in texts.items():
        write_text(path, text)
    for path in set(folder.glob("*.md")) - set(texts):
        path.unlink()
    return [*texts, folder / PICTURE]
