"""The tables of the Markdown pages in `docs`, for the tests that hold them against the code."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

Row = tuple[str, ...]


def rows(page: str, columns: int) -> list[Row]:
    """The rows of all tables of `docs/<page>` with that many columns, headers left out, in order.

    A header is the row above a ruler (`|---|`). Cells are stripped; a bar cannot stand in a cell.
    """
    found: list[Row] = []
    for line in (ROOT / "docs" / page).read_text(encoding="utf-8").splitlines():
        if not line.startswith("|"):
            continue
        cells = tuple(cell.strip() for cell in line.strip().strip("|").split("|"))
        if all(re.fullmatch(":?-+:?", cell) for cell in cells):
            found.pop()
        elif len(cells) == columns:
            found.append(cells)
        else:
            found.append(())
    return [row for row in found if row]


def names(cell: str) -> list[str]:
    """What stands in backquotes in a cell, in order."""
    return re.findall("`([^`]+)`", cell)


def own_tests() -> dict[str, list[str]]:
    """Module to the test files of its own, from the map `docs/tests.md`."""
    return {names(module)[0]: names(own) for module, own, _ in rows("tests.md", 3)}
