"""The page's controls, made from the configuration's fields: a new field is a new control.

A field's name, type, default, unit and the comment beside it make a control; `Within`, which annotates the
fields of records, and the tables of `formation_env.config` give bounds and choices. A field that is a
part (`noise`, `planner`, ...) gives a control for each of its own.

Bounds say what is possible, which is far more than what is of interest: a slider ends at five times the
largest value that the field has in a scenario, while the box beside it takes any number.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from math import floor, inf, isfinite, log10
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from baselines.system.field_comments import comments
from formation_env import SCENARIOS, FormationConfig, formations
from formation_env.config import CHOICES, COUNTS, NUMBERS, quietly
from formation_env.configuration.parts import unit_of
from formation_env.memory.records import is_record
from formation_env.trajectories import FACTORIES, Trajectory
from formation_env.validation.checks import Within

FOLLOWERS, FORMATION = "followers", "formation"  # controls of what is no field: see `settings`
OFFSETS, TRAJECTORY = "offsets", "trajectory"
# Which kinds come first in a group.
_RANK = {
    **dict.fromkeys(("maker", "number", "integer"), 0),
    **dict.fromkeys(("boolean", "choice"), 1),
    **dict.fromkeys(("text", "vector", "json"), 2),
}
_REACH = 5.0  # of a slider, in the largest value of a scenario
_STEPS = 100  # of a slider, about


class Control(NamedTuple):
    """One control of the page."""

    name: str  # of the field; of one of a part `part.field`
    group: str  # the part, or ""
    kind: str  # number, integer, boolean, choice, text, vector, json, maker
    unit: str = ""
    text: str = ""  # what it is
    optional: bool = False  # whether None is a value, which means that it follows from others
    low: float | None = None  # of the slider
    high: float | None = None
    step: float | None = None
    choices: tuple[str, ...] = ()
    makers: tuple[dict[str, Any], ...] = ()  # of a kind `maker`: functions by name, with controls


# -- controls of a configuration ------------------------------------------------------------------


def controls(
    kind: type = FormationConfig, examples: Iterable[Any] | None = None
) -> tuple[Control, ...]:
    """A control for every field of a configuration's class, and of its parts: first its own, sliders first.

    `examples` are configurations whose values say how far the sliders go, by default the scenarios.
    """
    if examples is None:
        examples = [quietly(make) for make in SCENARIOS.values()]
    examples = list(examples)
    count = max((getattr(one, FOLLOWERS, 1) for one in examples), default=1)
    more = (
        Control(FOLLOWERS, "", "integer", text="how many", low=1.0, high=2.0 * count, step=1.0),
        Control(FORMATION, "", "maker", text="its shape", makers=_makers(SHAPES, skip=("n",))),
    )
    found = [*more, *_of(kind, "", examples)]
    parts = list(dict.fromkeys(one.group for one in found))
    return tuple(sorted(found, key=lambda one: (parts.index(one.group), _RANK[one.kind])))


def groups(kind: type = FormationConfig) -> dict[str, str]:
    """What the parts are, by their names."""
    found = {}
    for name, hint in get_type_hints(kind).items():
        if is_record(hint) or (is_dataclass(hint) and hint is not Trajectory):
            found[name] = _first(hint)
    return found


def _of(kind: Any, group: str, examples: Sequence[Any]) -> list[Control]:
    hints, said = get_type_hints(kind, include_extras=True), comments(kind)
    found: list[Control] = []
    for name in _names(kind):
        if not group and name == "scenario":  # chosen as a whole
            continue
        known = [getattr(one, name) for one in examples]
        hint, note, optional = _plain(hints[name])
        if is_record(hint) or (is_dataclass(hint) and hint is not Trajectory):
            found += _of(hint, f"{group}{name}.", known)
        else:
            full = f"{group}{name}"
            found.append(
                _control(
                    full,
                    group[:-1],
                    hint,
                    note,
                    optional,
                    unit_of(kind, name),
                    said.get(name, ""),
                    known,
                )
            )
    return found


def _names(kind: Any) -> tuple[str, ...]:
    return tuple(kind._fields) if is_record(kind) else tuple(f.name for f in fields(kind) if f.init)


def _plain(hint: Any) -> tuple[Any, Within | None, bool]:
    """A type without what it is wrapped in: its note, if that is bounds, and whether None is a value too."""
    note, optional = None, False
    if get_origin(hint) is Annotated:
        hint, *notes = get_args(hint)
        note = next((one for one in notes if isinstance(one, Within)), None)
    if get_origin(hint) in (Union, UnionType):
        left = [one for one in get_args(hint) if one is not type(None)]
        optional = len(left) < len(get_args(hint))
        hint = left[0] if len(left) == 1 else Any
    return hint, note, optional


def _control(
    name: str,
    group: str,
    hint: Any,
    note: Within | None,
    optional: bool,
    unit: str,
    text: str,
    known: Sequence[Any],
) -> Control:
    own = Control(name, group, _kind(hint), "" if unit == "1" else unit, text, optional)
    if hint is Trajectory:
        return own._replace(kind="maker", makers=_makers(FACTORIES))
    if name in CHOICES:
        return own._replace(kind="choice", choices=tuple(CHOICES[name]))
    if own.kind not in ("number", "integer"):
        return own
    if note is not None:
        bounds = (note.low, note.high, note.strict)
    elif name in NUMBERS:
        bounds = NUMBERS[name]
    else:
        least, most = COUNTS.get(name, (0, inf))
        bounds = (float(least), float(most), False)
    return _with_range(own, *bounds, [x for x in known if x is not None])


def _kind(hint: Any) -> str:
    if hint in (bool, int, float, str):
        return {bool: "boolean", int: "integer", float: "number", str: "text"}[hint]
    if get_origin(hint) is Literal:
        return "choice"
    parts = get_args(hint)
    if get_origin(hint) is tuple and parts and all(one is float for one in parts):
        return "vector"
    return "json"


def _with_range(
    own: Control, low: float, high: float, strict: bool, known: Sequence[float]
) -> Control:
    """With the range and the step of a slider, inside the bounds."""
    whole = own.kind == "integer"
    largest = max((abs(float(x)) for x in known), default=0.0)
    top = _round(_REACH * largest) if largest else (10.0 if whole else 1.0)
    top = min(top, high)
    bottom = low if isfinite(low) and low > -1e6 else -top
    step = max(1.0, _below((top - bottom) / _STEPS)) if whole else _below((top - bottom) / _STEPS)
    return own._replace(low=bottom + step if strict else bottom, high=top, step=step)


def _round(x: float) -> float:
    """The next number above of 1, 2, 5, 10, ..."""
    power = 10.0 ** floor(log10(x))
    return float(f"{next(k for k in (1, 2, 5, 10) if k * power >= x * (1 - 1e-9)) * power:.6g}")


def _below(x: float) -> float:
    power = 10.0 ** floor(log10(x))
    return float(f"{next(k for k in (5, 2, 1) if k * power <= x * (1 + 1e-9)) * power:.6g}")


def _first(what: Any) -> str:
    """The first paragraph of what a class or function says of itself."""
    text = (inspect.getdoc(what) or "").partition("\n\n")[0]
    return " ".join(text.replace("`", "").split())


# -- functions that make a path or a formation ------------------------------------------------------


# The functions of `formations` that make one of so many followers, by name.
SHAPES = {
    name: maker
    for name, maker in vars(formations).items()
    if inspect.isfunction(maker)
    and not name.startswith("_")
    and next(iter(inspect.signature(maker).parameters), "") == "n"
}


def _makers(
    functions: Mapping[str, Callable[..., Any]], skip: Sequence[str] = ()
) -> tuple[dict[str, Any], ...]:
    """Name, meaning and controls of the functions whose arguments all have one."""
    found = []
    for name, function in functions.items():
        hints = get_type_hints(function)
        parameters = inspect.signature(function).parameters.values()
        own = [_argument(p, hints[p.name]) for p in parameters if p.name not in skip]
        if all(one is not None for one in own):
            found.append({"name": name, "text": _first(function), "arguments": own})
    return tuple(found)


def _argument(parameter: inspect.Parameter, hint: Any) -> dict[str, Any] | None:
    """The control of an argument and its default; None where there is no control for its type."""
    kind = _kind(hint)
    missing = parameter.default is inspect.Parameter.empty
    if kind == "json" or (missing and kind != "integer"):
        return None
    default = 2 if missing else parameter.default
    own = Control(parameter.name, "", kind)
    if kind == "choice":
        own = own._replace(choices=get_args(hint))
    if kind == "integer":
        own = _with_range(own, 1.0, inf, False, [default])
    if kind == "number":
        low = 0.0 if default > 0.0 else -inf
        own = _with_range(own, low, inf, low == 0.0, [default if default else 1.0])
    value = list(default) if isinstance(default, tuple) else default
    return {**own._asdict(), "default": value, "required": missing}
