"""The results for a terminal: scores and failures, policies by scenarios, as narrow as it is."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from baselines.console import width

if TYPE_CHECKING:  # `scoring` imports this module to print its reports
    from baselines.scoring import Report, Scenario

GAP = " "  # a cell ends in a place for its mark
ELSEWHERE = "*"  # marks what a policy from a file scores where it was not trained


def summary(report: Report, columns: int | None = None) -> str:
    """Scores, failures and what the marks mean, at most `columns` wide (by default: the terminal)."""
    columns = width() if columns is None else columns
    count = f"{report.episodes} episode{'s' if report.episodes > 1 else ''}"
    head = f"score of {count}: hover is 0, the expert 1, higher is better"
    parts = [f"{wrapped(head, columns)}\n{_table(report, _score, columns)}"]
    if any(
        r.summary["failed"].value > 0.0
        for s in report.scenarios.values()
        for r in s.results.values()
    ):
        failed = _table(report, _failed, columns, needed=True)
        parts.append(f"failed episodes, of {report.episodes} (none where empty)\n{failed}")
    notes = list(_notes(report))
    if notes:
        parts.append("\n".join(wrapped(note, columns) for note in notes))
    return "\n\n".join(parts)


def wrapped(text: str, columns: int | None = None) -> str:
    """A paragraph in lines, the later ones indented."""
    columns = width() if columns is None else columns
    return textwrap.fill(
        text, columns, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


def _notes(report: Report) -> Iterable[str]:
    scenarios = report.scenarios
    if any(s.untrained(policy) for s in scenarios.values() for policy in s.results):
        yield f"{ELSEWHERE} trained for another task"
    if any(policy in s.absent for s in scenarios.values() for policy in _policies(report)):
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


def _policies(report: Report) -> list[str]:
    return list(dict.fromkeys(p for s in report.scenarios.values() for p in s.results))


def _table(
    report: Report, cell: Callable[[Scenario, str], str], columns: int, needed: bool = False
) -> str:
    """A line for each policy and a column for each scenario, in several blocks if there are too many.

    `needed` leaves out the lines and columns that are empty.
    """
    cells = {
        (p, name): cell(s, p) for name, s in report.scenarios.items() for p in _policies(report)
    }
    policies = [p for p in _policies(report) if not needed or _any(cells, p, 0)]
    names = [name for name in report.scenarios if not needed or _any(cells, name, 1)]
    first = min(max(map(len, ["policy", *policies])), max(12, columns // 3))
    widths = {
        name: max(map(len, [*_head(name), *(cells[p, name] for p in policies)])) for name in names
    }
    blocks = [
        _block(part, policies, cells, first, widths)
        for part in _parts(names, first, widths, columns)
    ]
    return "\n\n".join(blocks)


def _any(cells: dict[tuple[str, str], str], name: str, which: int) -> bool:
    return any(text for key, text in cells.items() if key[which] == name)


def _parts(names: list[str], first: int, widths: dict[str, int], columns: int) -> list[list[str]]:
    """The columns of each block."""
    parts: list[list[str]] = [[]]
    used = first
    for name in names:
        more = len(GAP) + widths[name]
        if parts[-1] and used + more > columns:
            parts.append([])
            used = first
        parts[-1].append(name)
        used += more
    return parts


def _block(
    names: list[str],
    policies: list[str],
    cells: dict[tuple[str, str], str],
    first: int,
    widths: dict[str, int],
) -> str:
    heads = {name: _head(name) for name in names}
    depth = max(map(len, heads.values()))
    rows = []
    for k in range(depth):
        words = [[""] * (depth - len(h)) + h for h in heads.values()]
        rows.append(("policy" if k == depth - 1 else "", [w[k] for w in words]))
    rows += [(_short(p, first), [cells[p, name] for name in names]) for p in policies]
    return "\n".join(
        (
            label.ljust(first)
            + "".join(GAP + x.rjust(widths[n]) for x, n in zip(row, names, strict=True))
        ).rstrip()
        for label, row in rows
    )


def _head(name: str) -> list[str]:
    """A scenario's name in lines: `nominal`, `:rates`; `nominal`, `gust=0.5`."""
    return [part for part in re.split(r" |(?=:)", name) if part]


def _short(name: str, most: int) -> str:
    """The end of a name that is too long, where a path says most."""
    return name if len(name) <= most else f"...{name[3 - most :]}"
