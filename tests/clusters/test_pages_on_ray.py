"""The program of the manual that needs Ray, in a process of its own: it starts a cluster itself."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pages
import pytest

pytest.importorskip("ray")

PROGRAMS = [
    pages.programs(pages.DOCS / page)[0]
    for page, folder in pages.APART.items()
    if folder == Path(__file__).parent.name
]


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.page)
def test_program_runs(program: pages.Program, tmp_path: Path) -> None:
    path = tmp_path / "program.py"
    path.write_text(program.text, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, str(path)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(pages.ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr[-3000:]
    assert "steps" in run.stdout
