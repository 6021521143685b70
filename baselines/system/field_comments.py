"""The comments beside the fields of a class, which the manual and the live page show."""

from __future__ import annotations

import ast
import inspect
import io
import tokenize
from collections.abc import Mapping


def comments(kind: type) -> dict[str, str]:
    """What stands beside each field of a class, or above it where nothing does; empty without source text."""
    try:
        source = inspect.cleandoc("\n" + inspect.getsource(kind))
    except (OSError, TypeError):
        return {}
    lines: dict[int, tuple[bool, str]] = {}  # by line: whether it stands alone, and the text
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            alone = not token.line[: token.start[1]].strip()
            lines[token.start[0]] = (alone, token.string.lstrip("# ").strip())
    found = {}
    (tree,) = ast.parse(source).body
    for node in getattr(tree, "body", []):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found[node.target.id] = _beside(lines, node.lineno, node.end_lineno or node.lineno)
    return found


def _beside(lines: Mapping[int, tuple[bool, str]], first: int, last: int) -> str:
    own = [lines[k][1] for k in range(first, last + 1) if k in lines]
    above: list[str] = []
    line = first - 1
    while not own and line in lines and lines[line][0]:
        above.insert(0, lines[line][1])
        line -= 1
    return " ".join(own or above)
