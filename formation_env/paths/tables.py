"""What a trajectory's kind and table may hold, and that its path stays finite: by `references.FAMILIES`.

`references` evaluates the tables and never looks whether they are long enough, so every table passes
through `checked` first. A path counts as finite while its position and derivatives up to the fourth
stay within `LARGEST`, for all times up to that many seconds.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formation_env.paths.references import FAMILIES, Floats
from formation_env.paths.references import LARGEST as LARGEST
from formation_env.paths.references import MOST_HARMONICS as MOST_HARMONICS
from formation_env.paths.references import MOST_ROWS as MOST_ROWS
from formation_env.validation.checks import array, choice, integer, require

KINDS = {family.name: kind for kind, family in enumerate(FAMILIES)}
ABOVE_FLOOR = "a point above the floor: z points down, so that 1.5 m above it is p_z = -1.5"

_ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")
_UNITS = ("m", "m/s", "m/s^2", "m/s^3", "m/s^4")


def checked_kind(name: str, value: Any) -> int:
    """A kind of trajectory, by its number or its name."""
    if isinstance(value, str):
        return KINDS[choice(name, value, KINDS)]
    return integer(name, value, min(KINDS.values()), max(KINDS.values()))


def checked(name: str, kind: int, value: Any) -> Floats:
    """`value` as a table of that kind, a new array; raises `ValueError` naming the entry at fault."""
    table = array(name, value, (None,))
    FAMILIES[kind].check(name, table)
    return table


def reach(kind: int, table: Floats, duration: float = 0.0) -> Floats:
    """Bounds of the norms of position (from the origin) to snap in the first `duration` seconds.

    From the sizes of all terms, without looking at the path: it may stay far below them.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return FAMILIES[kind].reach(table, duration)


def require_finite(path: str, kind: int, table: Floats) -> None:
    """Refuse a checked table whose path has a derivative beyond `LARGEST`; `path` is its name."""
    for order, unit, most in zip(_ORDERS, _UNITS, reach(kind, table), strict=True):
        expected = f"at most {LARGEST:g} {unit}: a slower, wider or nearer path"
        require(bool(most <= LARGEST), f"{order} of path {path}", float(most), expected)
