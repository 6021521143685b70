"""The manual as it is built (`docs/_build/html`; `bash .ci/run docs`), and its notebooks."""

from __future__ import annotations

import json
import re
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from pages import DOCS

HTML = DOCS / "_build/html"
BUILT = pytest.mark.skipif(
    not (HTML / "index.html").exists(), reason="needs the manual: bash .ci/run docs"
)
# Of each notebook what makes it short: what stands there, and what takes its place.
SHORT = {
    "fly_and_look": ("SECONDS = 30.0", "SECONDS = 2.0"),
    "train_and_compare": ("MINUTES, EPISODES = 0.5, 20", "MINUTES, EPISODES = 0.05, 2"),
}
LOADED = {("script", "src"), ("img", "src"), ("link", "href"), ("iframe", "src"), ("source", "src")}


class Page(HTMLParser):
    """Its anchors, links and what a browser loads for it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "link" and dict(attrs).get("rel") in ("index", "search", "next", "prev"):
            return  # for navigation, of which the page has links
        for name, value in attrs:
            if name == "id" or (tag == "a" and name == "name"):
                self.ids.add(value or "")
            elif (tag, name) in LOADED:
                self.loaded.append(value or "")
            elif (tag, name) == ("a", "href"):
                self.links.append(value or "")


@cache
def page(path: Path) -> Page:
    return Page(path)


def built() -> list[Path]:
    return sorted(HTML.rglob("*.html"))


@BUILT
def test_nothing_is_loaded_from_elsewhere() -> None:
    for path in built():
        for target in page(path).loaded:
            assert not re.match(r"(\w+:)?//", target), f"{path.name} loads {target}"
            assert (path.parent / unquote(target).partition("?")[0]).exists(), (path, target)
    for path in HTML.rglob("*.css"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", text), path.name
    for path in HTML.rglob("*.js"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"(fetch|import|src\s*=)\s*\(?\s*[\"'](https?:)?//", text), path.name


@BUILT
def test_no_link_is_dead() -> None:
    """Every link within the manual leads to a file, and to an anchor that is there."""
    dead = []
    for path in built():
        for target in page(path).links:
            if re.match(r"(\w+:)?//|mailto:", target):
                continue
            file, _, anchor = unquote(target).partition("#")
            to = (path.parent / file.partition("?")[0]).resolve() if file else path
            to_anchor = anchor and to.suffix == ".html" and to.exists()
            if not to.exists() or (to_anchor and anchor not in page(to).ids):
                dead.append((path.name, target))
    assert not dead


@BUILT
def test_links_outwards_are_few() -> None:
    own = {x for path in built() for x in page(path).links if re.match(r"https?://", x)}
    assert len(own) <= 12, sorted(own)


@BUILT
@pytest.mark.parametrize("word", ["gust", "quaternion", "autoreset", "saturation"])
def test_the_index_of_the_search_knows_the_words(word: str) -> None:
    text = (HTML / "searchindex.js").read_text(encoding="utf-8")
    index = json.loads(text[text.index("(") + 1 : text.rindex(")")])
    known = {**index["terms"], **index["titleterms"]}
    assert any(term.startswith(word[:6]) for term in known), f"{word} is not found"


@BUILT
def test_every_formula_is_mathematics() -> None:
    """MathML, with an index beside and not below a letter that has a dot."""
    text = (HTML / "equations.html").read_text(encoding="utf-8")
    assert text.count('<div class="equation"><math') == 70
    assert not re.search(r"<munderover><mi>\w</mi>", text)


@BUILT
def test_equations_lead_to_their_functions() -> None:
    links = page(HTML / "equations.html").links
    assert "api/laws.html#formation_env.laws.planner.mu" in links
    assert "api/laws.html#formation_env.laws.tracker.torque" in links


@BUILT
def test_tables_are_those_of_the_code() -> None:
    """Every field of the configuration stands in one table, every entry of the observation in another."""
    from dataclasses import fields

    from formation_env import FormationConfig
    from formation_env.task import ENTRIES

    text = (HTML / "configuration.html").read_text(encoding="utf-8")
    rows = re.findall(r"<tr[^>]*>\s*<td>.*?<span class=\"pre\">(\w+)</span>", text, re.DOTALL)
    assert {f.name for f in fields(FormationConfig)} <= set(rows)
    text = (HTML / "environment.html").read_text(encoding="utf-8")
    assert all(f'<span class="pre">{entry.name}</span>' in text for entry in ENTRIES)


def test_every_notebook_has_a_short_form_and_no_output() -> None:
    found = {path.stem: path for path in (DOCS / "notebooks").glob("*.ipynb")}
    assert set(found) == set(SHORT)
    for name, path in found.items():
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        assert not any(cell.get("outputs") for cell in cells), f"{name}: clear its outputs"
        assert sum(SHORT[name][0] in "".join(cell["source"]) for cell in cells) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", SHORT)
def test_notebooks_run(
    name: str, tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("ipykernel", "matplotlib", "pygame", "torch", "stable_baselines3"):
        pytest.importorskip(module)
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    monkeypatch.setenv("PYTHONPATH", str(root))
    monkeypatch.delenv("MPLBACKEND")  # IPython has one of its own
    book = nbformat.read(DOCS / f"notebooks/{name}.ipynb", as_version=4)
    for cell in book.cells:
        cell.source = cell.source.replace(*SHORT[name])
    client = nbclient.NotebookClient(
        book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    pictures = [
        out
        for cell in book.cells
        for out in cell.get("outputs", ())
        if "image/png" in out.get("data", {})
    ]
    assert pictures
    assert not list(tmp_path.iterdir())
