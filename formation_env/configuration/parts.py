"""The parts of a configuration that are objects, from what a user may write for them.

`noise`, `reward`, `limits` are NamedTuples, `vehicle`, `planner`, `tracker`, `rates_tracker` dataclasses.
For each a dictionary of some of its fields may be given, as JSON has it; the fields that are left out
keep the value that they have where the change is made. For a NamedTuple a list of all its numbers
does as well. What annotates the fields of these (`checks.Within`) are their bounds. Units are in the
annotations of all fields (`checks.Unit`, `checks.Within`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from math import inf
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np

from formation_env.maths.so3 import Vector
from formation_env.memory.records import notes
from formation_env.validation.checks import array, number, refuse

Part = TypeVar("Part")


def rows(name: str, value: Any, bound: float = inf) -> tuple[Vector, ...]:
    """`value` as rows of three finite numbers, none larger than `bound` in size."""
    table = array(name, value, (None, 3), -bound, bound, strict=False)
    return tuple((float(a), float(b), float(c)) for a, b, c in table)


def part(name: str, value: Any, base: Part) -> Part:
    """`value` as a part of the kind of `base`, which gives the fields that a dictionary leaves out.

    Raises `ValueError` for another kind of value, an unknown field, or a number out of its bounds.
    """
    kind, own = type(base), cast(Any, base)
    if is_dataclass(kind) and isinstance(value, kind):
        return value  # it checked itself
    entries = _entries(name, value, kind)
    if is_dataclass(kind):
        try:
            return cast(Part, replace(own, **entries))
        except ValueError as error:  # the gains of both trackers call themselves `tracker`
            raise ValueError(str(error).replace("tracker.", f"{name}.", 1)) from None
    whole = {**own._asdict(), **entries}
    checked = {
        field: number(f"{name}.{field}", whole[field], to.low, to.high, strict=to.strict)
        for field, to in notes(cast(Any, kind)).items()
    }
    return kind(**checked)


def _entries(name: str, value: Any, kind: type) -> dict[str, Any]:
    """What `value` says of the fields of `kind`."""
    named = is_dataclass(kind)
    known: tuple[str, ...] = (
        tuple(f.name for f in fields(kind)) if named else kind._fields  # type: ignore[attr-defined]
    )
    if isinstance(value, Mapping) and all(key in known for key in value):
        return dict(value)
    value = value.tolist() if isinstance(value, np.ndarray) else value
    # Another NamedTuple with as many fields is a mistake.
    listed = isinstance(value, kind) or type(value) in (list, tuple)
    if not named and listed and len(value) == len(known):
        return dict(zip(known, value, strict=True))
    refuse(name, value, f"a {kind.__name__}, or a dictionary with some of {', '.join(known)}")


def unit_of(kind: Any, field: str) -> str:
    """The unit of a field of a configuration's class, or of a part of it after a dot: "m" for
    `noise.position`, "1" for a pure number and for a name that is none of its fields."""
    note: Any = None
    for name in field.split("."):
        hint = get_type_hints(kind, include_extras=True).get(name)
        kind, note = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, None)
    return str(getattr(note, "unit", "1"))
