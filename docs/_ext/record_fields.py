"""The fields of a dataclass or NamedTuple as their source declares them, with unit and comment of each."""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any, NamedTuple

from baselines.system.field_comments import comments
from formation_env.configuration.parts import unit_of


class Field(NamedTuple):
    """A field of a class."""

    name: str
    default: Any  # `inspect.Parameter.empty` where there is none
    comment: str  # unit and meaning


def fields(kind: type) -> list[Field]:
    """The fields of `kind`, in order, none without source text; a comment is behind the field or above it."""
    defaults = _defaults(kind)
    return [
        Field(name, defaults.get(name, _EMPTY), _told(kind, name, comment))
        for name, comment in comments(kind).items()
    ]


_EMPTY = inspect.Parameter.empty


def _told(kind: type, name: str, comment: str) -> str:
    """Unit and meaning. A pure number has no unit, nor a field of what is imported for types alone."""
    try:
        unit = unit_of(kind, name)
    except NameError:
        unit = "1"
    return ": ".join(filter(None, ("" if unit == "1" else unit, comment)))


def _defaults(kind: type) -> dict[str, Any]:
    if not dataclasses.is_dataclass(kind):
        return dict(getattr(kind, "_field_defaults", {}))
    found: dict[str, Any] = {}
    for f in dataclasses.fields(kind):
        if f.default is not dataclasses.MISSING:
            found[f.name] = f.default
        elif f.default_factory is not dataclasses.MISSING:
            found[f.name] = f.default_factory()
    return found


def shown(value: Any) -> str:
    """A value in a cell."""
    if value is _EMPTY:
        return ""
    if isinstance(value, float):
        return f"`{value:.4g}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return f"`{type(value).__name__}`"
    if isinstance(value, tuple) and all(isinstance(x, tuple) for x in value):
        return f"{len(value)} rows"
    if isinstance(value, tuple):
        return f"`({', '.join(f'{x:.4g}' for x in value)})`"
    if value is None or isinstance(value, int):
        return f"`{value}`"
    return f"`{type(value).__name__}`"


def table(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        f"| {' | '.join(x.replace('|', chr(92) + '|') for x in row)} |" for row in lines
    )


def field_table(kind: type, names: Any = None) -> str:
    """The fields of `kind` as a table, or those of `names`."""
    rows = [
        [f"`{f.name}`", shown(f.default), f.comment or "-"]
        for f in fields(kind)
        if names is None or f.name in names
    ]
    if all(row[1] == "" for row in rows):
        return table(["field", "unit and meaning"], [[a, c] for a, _, c in rows])
    return table(["field", "default", "unit and meaning"], rows)
