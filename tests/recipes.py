"""The recipes of CONTRIBUTING.md: edits of the sources as the page has them, carried out on a copy."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "CONTRIBUTING.md"
PACKAGE = "formation_env"


class Edit(NamedTuple):
    """A hunk of a recipe: `old`, found exactly once in the file, becomes `new`."""

    file: str
    old: str
    new: str


def section(title: str = "Recipes") -> str:
    """The text of a section of the page, up to the next heading of its level."""
    (found,) = re.findall(
        rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE.read_text(encoding="utf-8"), re.S | re.M
    )
    return str(found)


def recipes() -> dict[str, list[Edit]]:
    """The edits of each recipe by its heading, in the order of the page."""
    chapters = re.split(r"^### (.+)\n", section(), flags=re.M)[1:]
    pairs = zip(chapters[::2], chapters[1::2], strict=True)
    return {title.strip(): edits(text) for title, text in pairs}


def prose() -> dict[str, str]:
    """What each recipe says beside its edits."""
    chapters = re.split(r"^### (.+)\n", section(), flags=re.M)[1:]
    fenced = r"^```diff\n.*?^```\n"
    return {
        title.strip(): re.sub(fenced, "", text, flags=re.S | re.M)
        for title, text in zip(chapters[::2], chapters[1::2], strict=True)
    }


def edits(text: str) -> list[Edit]:
    """The hunks of all fenced blocks of a text: `--- file`, then lines of ` `, `-` and `+` apart by `@@`."""
    found = []
    for block in re.findall(r"^```diff\n(.*?)^```$", text, re.S | re.M):
        head, _, body = block.partition("\n")
        if not head.startswith("--- "):
            raise ValueError(f"a block begins with {head!r}: expected '--- file'")
        for hunk in re.split(r"^@@\n", body, flags=re.M):
            lines = hunk.splitlines()
            odd = [line for line in lines if line and line[0] not in " -+"]
            if odd or not any(line[:1] in "-+" for line in lines if line):
                raise ValueError(f"{head}: no hunk of ' ', '-' and '+': {odd or lines}")
            old = [line[1:] for line in lines if line[:1] != "+"]
            new = [line[1:] for line in lines if line[:1] != "-"]
            found.append(Edit(head.removeprefix("--- "), _joined(old), _joined(new)))
    return found


def _joined(lines: list[str]) -> str:
    return "".join(f"{line}\n" for line in lines)


def files(hunks: list[Edit]) -> list[str]:
    """The files that a recipe touches."""
    return list(dict.fromkeys(one.file for one in hunks))


def copy_to(folder: Path) -> Path:
    """A copy of the package in an empty folder, without what was compiled."""
    shutil.copytree(ROOT / PACKAGE, folder / PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def carry_out(hunks: list[Edit], folder: Path) -> None:
    """Apply edits to a copy; raises `ValueError` for one whose text is not there exactly once."""
    for one in hunks:
        path = folder / one.file
        text = path.read_text(encoding="utf-8")
        # From the begin of a line: `failure: float` is not a part of another line.
        times = f"\n{text}".count(f"\n{one.old}")
        if times != 1:
            raise ValueError(f"{one.file} holds {times} times, expected once:\n{one.old}")
        path.write_text(f"\n{text}".replace(f"\n{one.old}", f"\n{one.new}")[1:], encoding="utf-8")
