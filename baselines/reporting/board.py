"""The leaderboard: LEADERBOARD.md, and the extract of it in the README, between two markers."""

from __future__ import annotations

from pathlib import Path

import formation_env
from baselines.reporting import report
from baselines.scoring.results import Report
from baselines.system.reading import read_text
from baselines.system.writing import write_text

NAME, README = "LEADERBOARD.md", "README.md"
BEGIN, END = "<!-- leaderboard:begin -->", "<!-- leaderboard:end -->"

# What is known to be wrong with the scores, in three sentences; to be dropped with the flaws.
FLAWS = (
    "These scores have known flaws. The return pays for reaching the formation sooner, so on scenarios that "
    "start on the floor a faster climb can outweigh better formation keeping, and every scenario but "
    "`agile` flies one path in one direction, which a policy can learn by heart. `pd` is a weak baseline "
    "with untuned gains, and a cell in italics is of a policy that was trained on another scenario."
)
LEGEND = (
    "*Italics*: the policy was trained on another scenario; `-`: it does not fly this one; NAME:LEVEL: "
    "the scenario at another action level."
)


def leaderboard(result: Report, command: str) -> str:
    """The text of LEADERBOARD.md."""
    layout = next(iter(result.scenarios.values())).config.layout.version
    last = result.seed + result.episodes - 1
    return (
        "# Leaderboard\n\n"
        "Written by the command below; do not edit.\n\n"
        f"```bash\n{command}\n```\n\n"
        f"`Formation-v0`, observation layout {layout}, package {formation_env.__version__}. "
        f"{result.episodes} episodes for each scenario and policy, seeds {result.seed} to {last}, the same "
        f"for every policy.\n\n{FLAWS}\n\n{report.markdown(result, LEGEND)}"
    )


def extract(result: Report) -> str:
    """The scores without intervals, for the README."""
    grid = report.grid(result, lambda score: f"{score.value:.2f}")
    return f"{FLAWS}\n\n{grid}\n\n{LEGEND}"


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
    """Make sure that the README can take the extract. Raises `ValueError` naming it."""
    path = checkout / README
    text = read_text(path)
    try:
        with_extract(text, "")
    except ValueError as problem:
        raise ValueError(f"{path}: {problem}") from None


def write(result: Report, checkout: Path, command: str) -> list[Path]:
    """Write both files; returns their paths. Raises `OSError`, `ValueError`."""
    board, readme = checkout / NAME, checkout / README
    write_text(board, leaderboard(result, command))
    write_text(readme, with_extract(read_text(readme), extract(result)))
    return [board, readme]
