"""A claim of the paper's text beside what was measured, and the table of all of them."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import NamedTuple

# What the reading notes on the paper say of a claim.
SOUND = "sound"  # checked and confirmed
SILENT = "silent"  # not mentioned


class Claim(NamedTuple):
    """One statement of the text. `values` are the numbers behind `measured`, SI units."""

    id: str
    figures: tuple[int, ...]
    section: str
    text: str  # the statement, quoted or shortened
    paper: str  # the paper's value
    measured: str
    holds: bool
    criterion: str  # what `holds` was decided by
    errata: str  # SOUND or SILENT
    values: dict[str, float]
    note: str = ""


class Cost(NamedTuple):
    """Tracking error with the reference's third and fourth derivatives made in one way."""

    setting: str
    feedforward: str  # what is done about them
    tracking_rms: float  # m, of |p - p_d| of the vehicles behind their virtual followers


_HEAD = ("fig.", "claim", "paper", "measured", "holds")
_GAP = 2


def _widths(width: int) -> tuple[int, ...]:
    """Columns of each cell where a line has `width`."""
    left = width - 2 * 5 - _GAP * (len(_HEAD) - 1)
    paper = left // 4
    claim = (left - paper) // 2
    return (5, claim, paper, left - paper - claim, 5)


def _line(cells: Sequence[str], widths: Sequence[int]) -> list[str]:
    wrapped = [textwrap.wrap(c, w) or [""] for c, w in zip(cells, widths, strict=True)]
    height = max(map(len, wrapped))
    rows = ([part[i] if i < len(part) else "" for part in wrapped] for i in range(height))
    return [
        (" " * _GAP).join(x.ljust(w) for x, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _figures(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers)) or "-"


def claim_table(claims: Sequence[Claim], width: int = 100) -> str:
    """The claims as text in lines of `width` columns, with the notes on those that do not hold below."""
    rule, widths = "-" * width, _widths(width)
    lines = [*_line(_HEAD, widths), rule]
    for c in claims:
        verdict = "yes" if c.holds else "NO"
        lines += _line(
            (_figures(c.figures), f"{c.section}: {c.text}", c.paper, c.measured, verdict), widths
        )
        lines.append("")
    lines[-1] = rule
    held = sum(c.holds for c in claims)
    lines.append(f"{held} of {len(claims)} claims hold.")
    for c in claims:
        if not c.holds:
            lines += textwrap.wrap(f"{c.id}: {c.note}", width, subsequent_indent="  ")
    return "\n".join(lines)


def cost_table(costs: Sequence[Cost]) -> str:
    """What the reference's third and fourth derivatives are worth, as text."""
    lines = ["Third and fourth derivatives of the planner's reference (default: zero)"]
    for c in costs:
        error = f"{1e3 * c.tracking_rms:9.4f} mm"
        lines.append(f"  {c.setting:32} {c.feedforward:24} {error}")
    return "\n".join([*lines, "  RMS of |p - p_d| in the steady state."])
