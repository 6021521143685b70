"""Paragraphs and tables of text for a terminal, as narrow as it is."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Sequence

from baselines.system.console import width

GAP = " "  # between two columns; a cell ends in a place for its mark

Cells = dict[tuple[str, str], str]  # by the names of row and column


def wrapped(text: str, columns: int | None = None) -> str:
    """A paragraph in lines of at most `columns` (by default: the terminal's), the later ones indented."""
    columns = width() if columns is None else columns
    return textwrap.fill(
        text, columns, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


def table(
    corner: str,
    rows: Sequence[str],
    names: Sequence[str],
    cell: Callable[[str, str], str],
    columns: int,
    skip_empty: bool = False,
) -> str:
    """A line for each of `rows` and a column for each of `names`, in several blocks below one another
    where they do not fit into `columns`.

    `cell(row, name)` is the text of a cell, `corner` the heading of the row names; `skip_empty` leaves out
    rows and columns whose cells are all empty.
    """
    cells = {(row, name): cell(row, name) for name in names for row in rows}
    if skip_empty:
        filled = [key for key, text in cells.items() if text]
        rows = [row for row in rows if any(row == of_row for of_row, _ in filled)]
        names = [name for name in names if any(name == of_name for _, of_name in filled)]
    first = min(max(map(len, [corner, *rows])), max(12, columns // 3))
    widths = {
        name: max(map(len, [*_heading(name), *(cells[row, name] for row in rows)]))
        for name in names
    }
    blocks = [
        _block(corner, rows, part, cells, first, widths)
        for part in _parts(names, first, widths, columns)
    ]
    return "\n\n".join(blocks)


def _parts(
    names: Sequence[str], first: int, widths: dict[str, int], columns: int
) -> list[list[str]]:
    """The columns of each block, where the first column, of the row names, is `first` wide."""
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
    corner: str,
    rows: Sequence[str],
    names: Sequence[str],
    cells: Cells,
    first: int,
    widths: dict[str, int],
) -> str:
    headings = {name: _heading(name) for name in names}
    depth = max(map(len, headings.values()))
    lines = []
    for k in range(depth):
        words = [[""] * (depth - len(heading)) + heading for heading in headings.values()]
        lines.append((corner if k == depth - 1 else "", [w[k] for w in words]))
    lines += [(shortened(row, first), [cells[row, name] for name in names]) for row in rows]
    return "\n".join(
        (
            label.ljust(first)
            + "".join(GAP + x.rjust(widths[n]) for x, n in zip(line, names, strict=True))
        ).rstrip()
        for label, line in lines
    )


def _heading(name: str) -> list[str]:
    """A column's name in lines: `nominal`, `:rates`; `nominal`, `gust=0.5`."""
    return [part for part in re.split(r" |(?=:)", name) if part]


def shortened(name: str, most: int) -> str:
    """The end of a name that is too long: the end of a path says most."""
    return name if len(name) <= most else f"...{name[3 - most :]}"
