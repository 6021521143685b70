"""The contents of a checkpoint, checked before any of it is used: facts, options, arrays.

A file that was damaged or made up is refused in one line that names the field. Numbers that index
something are checked for their range, numbers that are calculated with for being finite. All functions
raise `ValueError`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from math import isnan
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from formation_env.validation.checks import (
    boolean,
    choice,
    integer,
    number,
    refuse_where,
    require,
    shown,
)
from train.command_line import flag
from train.log import LogRow, RunRecord
from train.options import PPOOptions, defaults

Arrays = dict[str, NDArray[Any]]
Options = TypeVar("Options", bound=PPOOptions)

_LARGEST_COUNT = 2**62
# Size of a number that training multiplies or squares: far beyond any that it makes, and its square is
# far below the largest float32.
_LARGEST = 1e15


# -- facts ----------------------------------------------------------------------------------------


def run_record(facts: Mapping[str, Any]) -> RunRecord:
    """Steps, time and log of a run."""
    rows = fact(facts, "rows")
    require(isinstance(rows, list), "rows", rows, "a list of evaluations")
    return RunRecord(
        integer("steps", fact(facts, "steps"), 0, _LARGEST_COUNT),
        number("minutes", fact(facts, "minutes"), 0.0, 1e9, strict=False),
        integer("next_evaluation", fact(facts, "next_evaluation"), 0, _LARGEST_COUNT),
        tuple(_log_row(f"rows[{i}]", row) for i, row in enumerate(rows)),
    )


def fact(facts: Mapping[str, Any], name: str) -> Any:
    """A fact by name. Raises `ValueError` where it is missing."""
    if name not in facts:
        raise ValueError(f"{name} is missing")
    return facts[name]


def _log_row(name: str, values: Any) -> LogRow:
    """A row of the log. Figures may be NaN: a score is, where hover does as well as the expert."""
    whole = isinstance(values, list) and len(values) == len(LogRow._fields)
    require(whole, name, values, f"{len(LogRow._fields)} numbers")
    steps, *figures, seed = values
    known = [
        x if isinstance(x, float) and isnan(x) else number(f"{name}.{field}", x)
        for field, x in zip(LogRow._fields[1:-1], figures, strict=True)
    ]
    counts = [
        integer(f"{name}.{field}", x, 0, _LARGEST_COUNT)
        for field, x in (("steps", steps), ("seed", seed))
    ]
    return LogRow._make([counts[0], *known, counts[1]])


# -- options --------------------------------------------------------------------------------------


def resumed_options(saved: object, given: Options) -> Options:
    """The options of a run that is resumed: those saved with it, but for `free_on_resume`, as given.

    Raises `ValueError` naming an option that is given otherwise than it was saved, or saved options
    that are not of this command and version.
    """
    kind: Any = type(given)
    require(isinstance(saved, dict), "options", saved, "an object")
    assert isinstance(saved, dict)
    if set(saved) != {f.name for f in fields(kind)}:
        raise ValueError("options: saved by another command, or by another version of this one")
    hints = get_type_hints(kind)
    values = {name: _typed(f"options.{name}", hints[name], x) for name, x in saved.items()}
    usual = defaults(kind)
    for name, old in values.items():
        now = getattr(given, name)
        if name not in given.free_on_resume and now not in (usual[name], old):
            raise ValueError(
                f"{flag(name)} {now}: the run was started with {old}, and goes on with that"
            )
    chosen = {name: getattr(given, name) for name in given.free_on_resume}
    if chosen["steps"] == usual["steps"]:
        chosen["steps"] = values["steps"]
    return replace(given, **{**values, **chosen})


def _typed(name: str, kind: Any, value: Any) -> Any:
    """A value from JSON as the kind that a field is annotated with."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        if value is None and NoneType in parts:
            return None
        return _typed(name, next(part for part in parts if part is not NoneType), value)
    if origin is Literal:
        return choice(name, value, parts)
    if origin is tuple:
        require(isinstance(value, list), name, value, "a list")
        return tuple(_typed(f"{name}[{i}]", parts[0], x) for i, x in enumerate(value))
    if kind is bool:
        return boolean(name, value)
    if kind is int:
        return integer(name, value, -_LARGEST_COUNT, _LARGEST_COUNT)
    if kind is float:
        return number(name, value)
    require(isinstance(value, str), name, value, "a text")
    return kind(value)


# -- arrays ---------------------------------------------------------------------------------------


def group(arrays: Arrays, name: str) -> Arrays:
    """The arrays whose names begin with `name/`, by the rest of the name."""
    start = f"{name}/"
    return {key[len(start) :]: x for key, x in arrays.items() if key.startswith(start)}


def array_like(arrays: Arrays, name: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """An array by name, of this shape and kind, its numbers finite and at most 1e15 in size."""
    found = arrays.get(name)
    if found is None:
        raise ValueError(f"{name} is missing")
    if found.shape != shape or found.dtype != np.dtype(dtype):
        raise ValueError(
            f"{name} is {found.dtype} {found.shape}: expected {np.dtype(dtype)} {shape}"
        )
    require_finite(name, found)
    return found


def arrays_like(arrays: Arrays, part: str, own: Mapping[str, NDArray[Any]]) -> Arrays:
    """The arrays of a group, which has to have the names, shapes and kinds of `own`."""
    for name in group(arrays, part):
        require(name in own, "name of an array", f"{part}/{name}", "a name of this run's")
    return {name: array_like(arrays, f"{part}/{name}", x.shape, x.dtype) for name, x in own.items()}


def require_finite(name: str, numbers: NDArray[Any]) -> None:
    """Refuse NaN, infinity and numbers above 1e15 in size."""
    if numbers.dtype.kind != "f":
        return
    bad = ~(np.abs(numbers) <= _LARGEST)
    refuse_where(bad, name, numbers, f"a finite number of at most {_LARGEST:g}")


def adam_moments(
    arrays: Arrays, shapes: Sequence[tuple[int, ...]] | None = None
) -> dict[int, Arrays]:
    """Adam's moments from the group `optimiser`, by the parameter's number.

    A parameter has none or all three; with the parameters' `shapes`, they are as large.
    """
    found: dict[int, Arrays] = {}
    for key, x in group(arrays, "optimiser").items():
        index, _, name = key.partition(".")
        whole = index.isascii() and index.isdigit() and len(index) < 6
        known = whole and name in ("step", "exp_avg", "exp_avg_sq")
        require(known, "name of an array", f"optimiser/{key}", "a moment of Adam's")
        found.setdefault(int(index), {})[name] = x
    for parameter, each in found.items():
        if shapes is not None:
            integer("parameter of a moment", parameter, 0, len(shapes) - 1)
        shape = None if shapes is None else shapes[parameter]
        _require_moments(f"optimiser/{parameter}", each, shape)
    return found


def _require_moments(name: str, each: Arrays, shape: tuple[int, ...] | None) -> None:
    """Refuse moments of another shape, of no step, and squares below zero."""
    named = {f"{name}.{key}": x for key, x in each.items()}
    if shape is None:
        shape = each["exp_avg"].shape if "exp_avg" in each else ()
    for key in ("exp_avg", "exp_avg_sq"):
        array_like(named, f"{name}.{key}", shape, np.float32)
    steps = each.get("step")
    # Of float32 in a state of PyTorch's own, of float64 in one that went through RLlib.
    fits = steps is not None and steps.size == 1 and steps.dtype.kind == "f"
    require(fits, f"{name}.step", None if steps is None else shown(steps), "one number, a float")
    assert steps is not None
    number(f"{name}.step", float(steps.ravel()[0]), 1.0, _LARGEST, strict=False)
    least = float(each["exp_avg_sq"].min(initial=0.0))
    number(f"least of {name}.exp_avg_sq", least, 0.0, strict=False)
