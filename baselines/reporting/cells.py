"""One figure of the results as text, and tables of such."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite

from baselines.scoring.intervals import Estimate
from baselines.scoring.metrics import EPISODE


def figure(name: str, x: float) -> str:
    """A value of the metric `name`."""
    if not isfinite(x):
        return "-"
    if name in ("failed", "settled"):
        return f"{100.0 * x:.0f} %"
    if EPISODE[name].unit == "s":
        return f"{x:.2f}"
    if abs(x) >= 100.0:
        return f"{x:.1f}"
    return f"{x:.3f}" if x == 0.0 or abs(x) >= 0.001 else f"{x:.1e}"


def scored(s: Estimate) -> str:
    """A score with its interval."""
    exact = s.low == s.high
    return f"{s.value:.3f}" if exact else f"{s.value:.3f} ({s.low:.3f} .. {s.high:.3f})"


def rounded(s: Estimate, least: float = 0.0005) -> str:
    """A score with the longer half of its interval, if that is at least `least`; with both ends where the
    halves differ by more than a third of it and 0.001, or where the interval so written would go beyond 0 or
    1."""
    low, high = s.value - s.low, s.high - s.value
    half = max(low, high)
    if half < least:
        return f"{s.value:.3f}"
    if abs(high - low) > max(half / 3.0, 0.001) or half > min(s.value, 1.0 - s.value):
        return f"{s.value:.3f} ({_short(s.low)} .. {_short(s.high)})"
    return f"{s.value:.3f} ±{_short(half)}"


def _short(x: float) -> str:
    """Three digits, without the zero before the point."""
    text = f"{x:.3f}"
    return text[1:] if text.startswith("0.") else text


def interval(name: str, e: Estimate) -> str:
    """A figure of the metric `name` with its interval."""
    value = figure(name, e.value)
    if e.low == e.high or e.episodes == 0:
        return value
    return f"{value} ({figure(name, e.low)} .. {figure(name, e.high)})"


def signed(e: Estimate) -> str:
    """A difference with its interval."""
    if e.value == e.low == e.high == 0.0:
        return "0"
    return f"{e.value:+.3f} ({e.low:+.3f} .. {e.high:+.3f})"


def listed(names: Iterable[str]) -> str:
    """Names as code, separated by commas."""
    return ", ".join(f"`{name}`" for name in names)


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """A table in Markdown; its first `left` columns are aligned left, the others right."""
    rules = ["-" if i < left else "-:" for i in range(len(head))]
    # A `|` would end the cell.
    lines = [[cell.replace("|", "\\|") for cell in row] for row in (head, rules, *rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
