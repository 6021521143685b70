"""Formulas as MathML, which browsers draw themselves: no script and no font is loaded.

LaTeX is converted by docutils.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator


def mathml(text: str, block: bool) -> str:
    """LaTeX as a `<math>` element. Raises `ValueError` naming a formula that docutils cannot read."""
    try:
        return str(latex2mathml.tex2mathml(text, as_block=block))
    except Exception as error:
        raise ValueError(f"formula {text!r}: {error}") from error


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
