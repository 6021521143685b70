"""The programs of the manual that need other libraries."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pages
import pytest

PROGRAMS = [
    pages.programs(pages.DOCS / page)[0]
    for page, folder in pages.APART.items()
    if folder == Path(__file__).parent.name
]


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.page)
def test_program_runs(
    program: pages.Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    pages.run(program)
