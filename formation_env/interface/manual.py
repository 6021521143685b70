"""The tables of the manual (`env.FormationEnv`), made of the fields that they tell of."""

from __future__ import annotations

from collections.abc import Iterable

from formation_env.laws.levels import LEVELS
from formation_env.memory.records import notes, size
from formation_env.task import ENTRIES, NEIGHBOUR_ENTRIES, Neighbour, Rewards, Terms, entries


def filled(text: str | None) -> str | None:
    """A docstring with its tables in place of `{actions}`, `{observations}` and `{rewards}`.

    Each stands alone on its line. None, which docstrings are under `python -OO`, stays None.
    """
    if text is None:
        return None
    tables = {"actions": _actions(), "observations": _observations(), "rewards": _rewards()}
    for name, rows in tables.items():
        line = f"    {{{name}}}\n"
        text = text.replace(line, "".join(f"    | {' | '.join(row)} |\n" for row in rows))
    return text


def _headed(*names: str) -> list[list[str]]:
    return [list(names), ["---"] * len(names)]


def _actions() -> Iterable[list[str]]:
    rows = _headed("`action=`", "k", "entries", "-1 ... 0 ... +1")
    return rows + [[f'`"{x.name}"`', str(x.size), x.entries, x.range] for x in LEVELS]


def _observations() -> Iterable[list[str]]:
    rows = _headed("index", "entry", "unit", "frame", "meaning", "bound")
    start = 0
    for e in ENTRIES:
        where = str(start) if e.size == 1 else f"{start}-{start + e.size - 1}"
        rows.append([where, f"`{e.name}`", e.unit, e.frame, e.meaning, f"{e.bound:g}"])
        start += e.size
    for level in LEVELS:
        for e in entries(level.view):
            meaning = f'only with `action="{level.name}"`: {e.meaning}'
            rows.append([f"+{e.size}", f"`{e.name}`", e.unit, e.frame, meaning, f"{e.bound:g}"])
    names, units, bounds = (
        ", ".join(x)
        for x in zip(
            *((f"`{e.name}`", e.unit, f"{e.bound:g}") for e in NEIGHBOUR_ENTRIES), strict=True
        )
    )
    meaning = "the nearest other followers (`neighbours=2`), nearest first, minus own; zeros where none is"
    return [*rows, [f"+{size(Neighbour)} each", names, units, "{F}", meaning, bounds]]


def _rewards() -> Iterable[list[str]]:
    rows = _headed("entry of `info`", "value per tick", "default weight")
    for name, term in notes(Terms).items():
        defaults = (
            f"{weight} {Rewards._field_defaults[weight]:g} {term.unit}".strip()
            for weight in term.weights.split()
        )
        rows.append([f"`reward_{name}`", term.meaning, ", ".join(defaults)])
    return rows
