"""The pages that are written by hand: the README, the manual in `docs`, and their code blocks."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
# Made by a command, or by Sphinx.
_MADE = (DOCS / "board", DOCS / "trained.md", DOCS / "_build")

MANUAL = sorted(
    path
    for path in DOCS.rglob("*.md")
    if not any(path == made or made in path.parents for made in _MADE)
)
PAGES = [ROOT / "README.md", *MANUAL]
# Programs that need a library with an environment of its own, and the folder of the tests that run them.
APART = {
    "libraries/torchrl.md": "ecosystem",
    "libraries/skrl.md": "ecosystem",
    "libraries/tianshou.md": "ecosystem",
    "libraries/rllib.md": "clusters",
}


class Program(NamedTuple):
    """A block of Python of a page."""

    page: str  # relative to the checkout
    number: int  # of those of its page, from 0
    text: str


def blocks(path: Path, language: str) -> list[str]:
    """The fenced blocks of a page in a language."""
    text = path.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


def programs(path: Path) -> list[Program]:
    """The programs of a page."""
    name = path.relative_to(ROOT).as_posix()
    return [Program(name, i, text) for i, text in enumerate(blocks(path, "python"))]


def run(program: Program) -> None:
    """Execute a program as if it were a file."""
    name = f"<{program.page}, program {program.number}>"
    exec(compile(program.text, name, "exec"), {"__name__": "__main__"})
