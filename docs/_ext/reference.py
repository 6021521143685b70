"""Docstrings as the package writes them: in Markdown. And links from names in pages to the reference.

Autodoc takes docstrings for reStructuredText; here each is handed to the parser of the pages instead. The
fields of a dataclass or NamedTuple are added as a table. A name in backquotes, such as `planner.mu`, that
ends the name of one documented object and of no other links to it.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.utils import new_document
from myst_parser.parsers.sphinx_ import MystParser
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.nodes import make_refnode

from _ext.record_fields import field_table, fields
from formation_env.env import FormationEnv


class Markdown(Directive):
    """Its content, read as Markdown; headings are captions there."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """The nodes of the content."""
        document = new_document(self.state.document["source"], self.state.document.settings)
        MystParser().parse("\n".join(self.content), document)
        for section in reversed(list(document.findall(nodes.section))):
            (title,) = (x for x in section.children if isinstance(x, nodes.title))
            section.replace_self([nodes.rubric("", "", *title.children), *section.children[1:]])
        return document.children


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and (
        dataclasses.is_dataclass(kind) or (issubclass(kind, tuple) and hasattr(kind, "_fields"))
    )


def _docstring(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    if thing is FormationEnv:
        del lines[next(i for i, line in enumerate(lines) if line.startswith("## ")) :]
        lines += ["The docstring's other parts are a page: [the environment](../environment.md)."]
    if what == "class" and _is_record(thing):
        # Of a record without a docstring NamedTuple and `dataclass` make one.
        if lines and lines[0].startswith(f"{thing.__name__}("):
            lines[:] = []
        # One that is made by a call has no fields in the source.
        if fields(thing):
            lines += ["", *field_table(thing).splitlines()]
    if lines:
        lines[:] = [".. markdown::", "", *(f"   {line}" for line in lines), ""]


def _skip(app: Sphinx, what: str, name: str, thing: Any, skip: bool, options: Any) -> bool | None:
    """The fields of records stand in their tables."""
    field_of_tuple = type(thing).__name__ == "_tuplegetter"
    return True if field_of_tuple else None


def _names(app: Sphinx) -> dict[str, tuple[str, str, str]]:
    """Full names and unambiguous ends of at least two parts: page, anchor and full name."""
    found: dict[str, set[tuple[str, str, str]]] = {}
    for full, entry in app.env.domains.python_domain.objects.items():
        if entry.aliased:
            continue
        parts = full.split(".")
        for k in range(len(parts)):
            end = ".".join(parts[k:])
            if "." in end or (k == len(parts) - 1 and entry.objtype in ("class", "exception")):
                found.setdefault(end, set()).add((entry.docname, entry.node_id, full))
    return {end: next(iter(places)) for end, places in found.items() if len(places) == 1}


def _link(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    known = _names(app)
    for literal in list(doctree.findall(nodes.literal)):
        place = known.get(literal.astext().removesuffix("()"))
        if place is None or _inside(
            literal, (nodes.reference, nodes.title, addnodes.desc_signature)
        ):
            continue
        page, anchor, full = place
        here = literal.parent
        while here is not None and not isinstance(here, addnodes.desc):
            here = here.parent
        if page == docname and here is not None and full in here[0].get("ids", ()):
            continue  # an object's own name in its own docstring
        node = make_refnode(app.builder, docname, page, anchor, literal.deepcopy(), full)
        literal.replace_self(node)


def _inside(node: nodes.Node, kinds: tuple[type, ...]) -> bool:
    above = node.parent
    while above is not None:
        if isinstance(above, kinds):
            return True
        above = above.parent
    return False


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive and the links."""
    app.add_directive("markdown", Markdown)
    app.connect("autodoc-process-docstring", _docstring)
    app.connect("autodoc-skip-member", _skip)
    app.connect("doctree-resolved", _link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
