"""Formulas as MathML, which browsers draw themselves: no script is loaded, nor a font from elsewhere.

LaTeX is converted by docutils. `_static/math.woff2` is a part of STIX Two Math, since not every system has a
font for mathematics.
"""

from __future__ import annotations

import xml.etree.ElementTree as Xml
from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

NAMESPACE = "http://www.w3.org/1998/Math/MathML"
Xml.register_namespace("", NAMESPACE)
ACCENTS = "\u02d9\u00a8"  # the dots of \dot and \ddot


def mathml(text: str, block: bool) -> str:
    """LaTeX as a `<math>` element. Raises `ValueError` naming a formula that docutils cannot read."""
    try:
        made = latex2mathml.tex2mathml(text, as_block=block)
    except Exception as error:
        raise ValueError(f"formula {text!r}: {error}") from error
    root = Xml.fromstring(made.replace("&ApplyFunction;", "\u2061"))
    for node in root.iter(f"{{{NAMESPACE}}}munderover"):
        _index_beside(node)
    for node in root.iter():
        node.text, node.tail = (x and x.strip("\n ") for x in (node.text, node.tail))
    return Xml.tostring(root, encoding="unicode")


def _index_beside(node: Xml.Element) -> None:
    r"""`\dot{p}_F`: docutils puts the index under a letter with an accent; it belongs beside both."""
    base, index, over = list(node)
    if over.text not in ACCENTS:
        return
    accented = Xml.Element(f"{{{NAMESPACE}}}mover", {"accent": "true"})
    accented.extend([base, over])
    node.tag = f"{{{NAMESPACE}}}msub"
    node[:] = [accented, index]


def _inline(writer: HTML5Translator, node: nodes.math) -> None:
    writer.body.append(mathml(node.astext(), False))
    raise nodes.SkipNode


def _block(writer: HTML5Translator, node: nodes.math_block) -> None:
    writer.body.append(f'<div class="equation">{mathml(node.astext(), True)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer, and choose it."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
