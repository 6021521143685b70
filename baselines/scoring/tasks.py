"""What is flown: scenarios by name, configurations from files, single fields set, sweeps of a field.

nominal:rates                    a scenario at an action level
--config mine.json               fields of a configuration as JSON; "scenario" names what they change
--set noise.position=0.1         a field, or a part of one after a dot, in every task
--sweep gust=0:2:9               nine values from 0 to 2, a task for each
--sweep noise.position=0,0.1,0.2
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from baselines.scoring.results import Sweep
from baselines.system.reading import read_json
from formation_env import SCENARIOS, FormationConfig, configure
from formation_env.configuration.parts import unit_of
from formation_env.laws.levels import NAMES as LEVEL_NAMES
from formation_env.trajectories import Trajectory
from formation_env.validation.checks import shown

MOST = 1000  # tasks


class Setting(NamedTuple):
    """A field, perhaps with the name of a part of it after a dot, and its values: one, or a sweep's."""

    field: str
    values: tuple[Any, ...]
    texts: tuple[str, ...]  # of each
    text: str  # of all, as given


# -- from text ------------------------------------------------------------------------------------


def read_setting(text: str) -> Setting:
    """`field=value`; the value is JSON, or else a name. Raises `ValueError`."""
    name, value = _halves(text, "FIELD=VALUE, such as noise.position=0.1")
    return Setting(name, (_value(value),), (value,), value)


def read_sweep(text: str) -> Setting:
    """`field=low:high:count` or `field=value,value,...`. Raises `ValueError`."""
    usage = "FIELD=LOW:HIGH:COUNT or FIELD=VALUE,VALUE,..."
    name, value = _halves(text, usage)
    parts = value.split(":")
    if len(parts) == 2:
        raise ValueError(f"{text!r}: expected {usage}")
    if len(parts) == 3:
        values = _evenly(text, *parts)
        return Setting(name, values, tuple(f"{x:.12g}" for x in values), value)
    try:
        items = json.loads(f"[{value}]")
        texts = [json.dumps(item) for item in items]
    except ValueError:
        texts = [part.strip() for part in value.split(",")]
        items = [_value(part) for part in texts]
    if len(set(texts)) < len(texts) or not texts:
        raise ValueError(f"{text!r}: expected values that differ, {usage}")
    return Setting(name, tuple(items), tuple(texts), value)


def _evenly(text: str, first: str, last: str, number: str) -> tuple[float, ...]:
    """The values of a sweep `text`; whole ones are integers, as those of counts have to be."""
    try:
        low, high, count = float(first), float(last), int(number)
    except ValueError:
        raise ValueError(f"{text!r}: expected numbers LOW:HIGH and a whole number COUNT") from None
    if not np.isfinite((low, high)).all() or low == high:
        raise ValueError(f"{text!r}: expected finite LOW and HIGH that differ")
    if not 2 <= count <= MOST:
        raise ValueError(f"{text!r}: expected COUNT from 2 to {MOST}")
    values = [float(f"{x:.12g}") for x in np.linspace(low, high, count)]
    return tuple(int(x) if x.is_integer() else x for x in values)


def _halves(text: str, usage: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (equals and value and all(part.isidentifier() for part in name.split("."))):
        raise ValueError(f"{text!r}: expected {usage}")
    return name, value


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


# -- configurations -------------------------------------------------------------------------------


def tasks(
    scenarios: Sequence[str],
    files: Sequence[Path] = (),
    settings: Sequence[Setting] = (),
    sweeps: Sequence[Setting] = (),
    action: str | None = None,
    duration: float | None = None,
) -> dict[str, FormationConfig]:
    """The configurations by name: scenarios and files, each once for every combination of the sweeps'
    values, `nominal gust=0.5`. `action` counts where a name has no level. Raises `ValueError` naming the
    task and the field.
    """
    overrides = {"action": action, "duration": duration}
    common = {field: value for field, value in overrides.items() if value is not None}
    origins = {name: {**common, **scenario_fields(name)} for name in scenarios}
    for path in files:
        if path.stem in origins:
            raise ValueError(f"{path}: there are two tasks of the name {path.stem!r}")
        origins[path.stem] = {**_fields(path), **common}
    return at_values(origins, sweeps, [(s.field, s.values[0]) for s in settings])


def at_values(
    origins: Mapping[str, FormationConfig | Mapping[str, Any]],
    sweeps: Sequence[Setting],
    always: Sequence[tuple[str, Any]] = (),
) -> dict[str, FormationConfig]:
    """What `changed` makes of each origin, with some changes always, once for every combination of the
    sweeps' values. Raises `ValueError` naming the task and the field."""
    fields_swept = [s.field for s in sweeps]
    for field in fields_swept:
        if fields_swept.count(field) > 1:
            raise ValueError(f"{field} is swept twice: expected one sweep of each field")
    points = list(_points(sweeps))
    if len(points) * len(origins) > MOST:
        raise ValueError(f"{len(points) * len(origins)} tasks: expected at most {MOST}")
    found = {}
    for (name, fields), (suffix, swept) in product(origins.items(), points):
        try:
            found[name + suffix] = changed(fields, [*always, *swept])
        except (ValueError, TypeError) as problem:
            raise ValueError(f"scenario {name}{suffix}: {problem}") from None
    return found


def _points(sweeps: Sequence[Setting]) -> Iterator[tuple[str, list[tuple[str, Any]]]]:
    """Every combination of the sweeps' values: what it adds to a task's name, and the fields."""
    for point in product(*(zip(s.values, s.texts, strict=True) for s in sweeps)):
        each = list(zip(sweeps, point, strict=True))
        suffix = "".join(_suffix(s.field, text) for s, (_, text) in each)
        yield suffix, [(s.field, value) for s, (value, _) in each]


def _suffix(field: str, text: str) -> str:
    return f" {field}={text}"


def swept(names: Sequence[str], sweeps: Sequence[Setting]) -> tuple[Sweep, ...]:
    """The tasks that `tasks` makes of those of some `names`, by what the first sweep's field alone tells
    apart; none without sweeps."""
    if not sweeps:
        return ()
    (first, *others), unit = sweeps, unit_of(FormationConfig, sweeps[0].field)
    return tuple(
        Sweep(
            name + suffix,
            first.field,
            unit,
            first.values,
            first.texts,
            tuple(name + _suffix(first.field, text) + suffix for text in first.texts),
        )
        for name, (suffix, _) in product(names, list(_points(others)))
    )


def scenario_fields(name: str) -> dict[str, Any]:
    """The fields that the name of a scenario, perhaps with an action level, stands for."""
    scenario, _, level = name.partition(":")
    return {"scenario": scenario, **({"action": level} if level else {})}


def _fields(path: Path) -> dict[str, Any]:
    """Fields from a file. Raises `ValueError` naming it."""
    fields = read_json(path)
    if not isinstance(fields, dict):
        raise ValueError(
            f"{path}: {shown(fields)}: expected an object with a configuration's fields"
        )
    scenario = fields.get("scenario", "nominal")
    if not (isinstance(scenario, str) and scenario in SCENARIOS):
        known = ", ".join(SCENARIOS)
        raise ValueError(f"{path}: scenario = {shown(scenario)}: expected one of {known}")
    return fields


def changed(
    origin: FormationConfig | Mapping[str, Any], changes: Sequence[tuple[str, Any]]
) -> FormationConfig:
    """A configuration, or the fields of one that a scenario completes, with changes of fields or of parts.

    Raises `ValueError` or `TypeError` naming the field.
    """
    if isinstance(origin, FormationConfig):
        scenario, fields = origin, {}
    else:
        fields = {"scenario": "nominal", **origin}
        scenario = fields.pop("scenario")
    fields.update({name: value for name, value in changes if "." not in name})
    scenario = fields.pop("scenario", scenario)
    parts = [(name.split("."), value) for name, value in changes if "." in name]
    if parts:
        base = configure(scenario, **fields)
        for first in dict.fromkeys(path[0] for path, _ in parts):
            inner = [(path[1:], value) for path, value in parts if path[0] == first]
            if first not in base.__dataclass_fields__:
                names = ", ".join(base.__dataclass_fields__)
                raise ValueError(
                    f"{first} = {shown(inner[0][1])}: expected one of the fields {names}"[:500]
                )
            before = fields.get(first) if _is_value(fields.get(first)) else getattr(base, first)
            fields[first] = _with_parts(first, before, inner)
    return configure(scenario, **fields)


def _is_value(value: object) -> bool:
    """Whether parts of it can be replaced: not so those of a dictionary, which has some of them only."""
    return hasattr(value, "_fields") or is_dataclass(value)


def _with_parts(name: str, whole: Any, parts: Sequence[tuple[Sequence[str], Any]]) -> Any:
    """`whole` with parts replaced, at once: a thrust that fits the new mass may not fit the old one.

    Raises `ValueError` naming the known parts.
    """
    known: tuple[str, ...] = getattr(whole, "_fields", ()) or tuple(
        getattr(whole, "__dataclass_fields__", ())
    )
    if isinstance(whole, Trajectory):  # its parts are numbers of a table, without names for a user
        known = ()
    new: dict[str, Any] = {}
    for (first, *rest), value in parts:
        if first not in known:
            expected = f"one of {', '.join(known)}" if known else f"{name} to be set as a whole"
            raise ValueError(f"{name}.{first} = {shown(value)}: expected {expected}")
        before = new[first] if first in new else getattr(whole, first)
        new[first] = _with_parts(f"{name}.{first}", before, [(rest, value)]) if rest else value
    try:
        return whole._replace(**new) if hasattr(whole, "_replace") else replace(whole, **new)
    except (ValueError, TypeError) as problem:
        reason = str(problem)
        raise ValueError(reason if reason.startswith(f"{name}.") else f"{name}: {reason}") from None


def check_scenario(name: str) -> None:
    """Raises `ValueError` unless it is a scenario's name, perhaps with an action level after a colon."""
    scenario, colon, level = name.partition(":")
    if scenario not in SCENARIOS:
        raise ValueError(f"{name!r}: expected some of {', '.join(SCENARIOS)}")
    if colon and level not in LEVEL_NAMES:
        raise ValueError(f"{name!r}: expected after the colon one of {', '.join(LEVEL_NAMES)}")
