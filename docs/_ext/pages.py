"""Pages that hold what is written elsewhere: files of the checkout and tables made of the code.

A line `<!-- file: NAME -->` of a page stands for a file of the checkout, `<!-- made: NAME -->` for a text of
`made.TEXTS`. Links to files of the checkout lead to the page that holds the file, so that one text
serves the manual and the files as they are.
"""

from __future__ import annotations

import re
from pathlib import Path
from posixpath import dirname, normpath, relpath
from typing import Any

from sphinx.application import Sphinx

from _ext import made

ROOT = Path(__file__).resolve().parent.parent.parent
DOCS = "docs"
# Files of the checkout that are pages of the manual.
PAGES = {
    "README.md": "docs/index.md",
    "CONTRIBUTING.md": "docs/contributing.md",
    "CHANGELOG.md": "docs/changelog.md",
    "LEADERBOARD.md": "docs/leaderboard.md",
    "train/README.md": "docs/training.md",
}
_PLACE = re.compile(r"^<!-- (file|made): (\S+) -->$", re.MULTILINE)
_FENCE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\]\([^)]*\))*)\]\(([^()\s]+)\)")


def relinked(text: str, folder: str, page: str) -> str:
    """Text whose links are relative to `folder` of the checkout, with links relative to the page `page`.

    A link to a folder, which no page shows, becomes its text.
    """

    def link(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        words = _LINK.sub(link, words)
        path, _, anchor = target.partition("#")
        if not path or re.match(r"\w+:", target):
            return f"{picture}[{words}]({target})"
        whole = normpath(f"{folder}/{path}") if folder else normpath(path)
        if (ROOT / whole).is_dir():
            return words
        target = relpath(PAGES.get(whole, whole), dirname(page))
        return f"{picture}[{words}]({target}{'#' + anchor if anchor else ''})"

    parts = _FENCE.split(text)
    return "".join(x if i % 2 else _LINK.sub(link, x) for i, x in enumerate(parts))


def _read(app: Sphinx, docname: str, source: list[str]) -> None:
    if app.env.doc2path(docname).suffix != ".md":
        return
    page = f"{DOCS}/{docname}.md"

    def text(found: re.Match[str]) -> str:
        kind, name = found.groups()
        if kind == "made":
            app.env.note_reread()
            return made.TEXTS[name]()
        app.env.note_dependency(str(ROOT / name))
        return relinked((ROOT / name).read_text(encoding="utf-8"), dirname(name), page)

    source[0] = _PLACE.sub(text, relinked(source[0], dirname(page), page))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the reading of pages."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
