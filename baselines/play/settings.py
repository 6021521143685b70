"""What is set on the page: a scenario, and what differs from it, as a configuration and as Python.

Changes are values in JSON form by the names of the controls (`controls`): `gust`, `planner.k1`, and two that
are no fields of the configuration: `followers`, how many, and `formation`, a function of
`formation_env.formations` with its arguments, `{"maker": "wedge", "spacing": 0.9}`.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from typing import Any

from baselines.play.controls import FOLLOWERS, FORMATION, OFFSETS, SHAPES, TRAJECTORY
from baselines.scoring.tasks import changed
from formation_env import SCENARIOS, FormationConfig, formations
from formation_env.config import quietly
from formation_env.validation.checks import choice, integer, require
from formation_env.validation.plain_form import plain

Changes = Mapping[str, Any]

# Each of these says what the others say, too: one takes their place.
_RIVALS = {
    OFFSETS: (FOLLOWERS, FORMATION),
    FOLLOWERS: (OFFSETS,),
    FORMATION: (OFFSETS,),
}
MAKER = "maker"


def from_fields(fields: Changes) -> dict[str, Any]:
    """Changes of fields of `configure`, in which a path is described as `as_trajectory` takes it."""
    changes = dict(fields)
    path = changes.get(TRAJECTORY)
    if isinstance(path, str):
        changes[TRAJECTORY] = {MAKER: path}
    elif isinstance(path, Mapping) and "path" in path:
        changes[TRAJECTORY] = {
            MAKER: path["path"],
            **{k: x for k, x in path.items() if k != "path"},
        }
    return changes


def with_change(changes: Changes, name: str, value: Any) -> dict[str, Any]:
    """The changes with another."""
    rivals = _RIVALS.get(name, ())
    return {k: x for k, x in changes.items() if k not in (name, *rivals)} | {name: value}


def configuration(scenario: str, changes: Changes) -> FormationConfig:
    """The configuration. Raises `ValueError`, `TypeError` naming the field whose value is impossible."""
    given = dict(changes)
    fields: dict[str, Any] = {"scenario": scenario}
    count = given.pop(FOLLOWERS, None)
    shape = given.pop(FORMATION, None)
    if shape is not None:
        fields[OFFSETS] = _offsets(shape, _count(scenario, count))
    elif count is not None:
        fields[FOLLOWERS] = count
    path = given.get(TRAJECTORY)
    if isinstance(path, Mapping) and MAKER in path:
        given[TRAJECTORY] = _path(path)
    return changed(fields, list(given.items()))


def _count(scenario: str, count: Any) -> int:
    if count is None:
        return quietly(SCENARIOS[scenario]).followers
    return integer(FOLLOWERS, count, 1, formations.MAX_FOLLOWERS)


def _path(path: Mapping[str, Any]) -> dict[str, Any]:
    """As `as_trajectory` takes it."""
    return {"path": path[MAKER], **{k: x for k, x in path.items() if k != MAKER}}


def _shape(shape: Any) -> tuple[str, dict[str, Any]]:
    """Name and arguments of the function of a formation. Raises `ValueError`."""
    require(isinstance(shape, Mapping) and MAKER in shape, FORMATION, shape, "a shape by its name")
    name = choice(FORMATION, shape[MAKER], SHAPES)
    given = {str(k): x for k, x in shape.items() if k != MAKER}
    arguments = inspect.signature(SHAPES[name]).parameters
    for key in given:
        require(key in arguments and key != "n", f"{FORMATION}.{key}", given[key], "an argument")
    return name, given


def _offsets(shape: Any, count: int) -> list[list[float]]:
    name, given = _shape(shape)
    try:
        offsets: list[list[float]] = SHAPES[name](count, **given).tolist()
    except TypeError as problem:
        raise ValueError(f"{FORMATION}: {problem}") from None
    except ValueError as problem:
        raise ValueError(f"{FORMATION}.{problem}") from None
    return offsets


def values(config: FormationConfig) -> dict[str, Any]:
    """What each field now is, by the names of the controls, in JSON form."""
    whole = config.to_dict()
    whole.pop(TRAJECTORY)
    found: dict[str, Any] = {FOLLOWERS: config.followers}
    for name, value in whole.items():
        if isinstance(value, dict):
            found |= {f"{name}.{key}": x for key, x in value.items()}
        else:
            found[name] = value
    return found


# -- as Python ---------------------------------------------------------------------------------------


def python(scenario: str, changes: Changes) -> str:
    """Python that makes the configuration: imports, and the call of `configure`."""
    arguments, imports = [json.dumps(scenario)], "configure"
    given = dict(changes)
    count, shape = given.pop(FOLLOWERS, None), given.pop(FORMATION, None)
    if shape is not None:
        name, own = _shape(shape)
        inner = [str(_count(scenario, count)), *(f"{k}={_literal(x)}" for k, x in own.items())]
        arguments.append(f"offsets=formations.{name}({', '.join(inner)})")
        imports = "configure, formations"
    elif count is not None:
        arguments.append(f"followers={_literal(count)}")
    whole: dict[str, Any] = {}
    for name, value in given.items():
        part, dot, field = name.partition(".")
        if dot:
            whole.setdefault(part, {})[field] = value
        elif name == TRAJECTORY and isinstance(value, Mapping) and MAKER in value:
            whole[name] = _path(value)
        else:
            whole[name] = value
    arguments += [f"{name}={_literal(value)}" for name, value in whole.items()]
    call = f"config = configure({', '.join(arguments)})"
    if len(call) > 88:
        call = "config = configure(\n" + "".join(f"    {one},\n" for one in arguments) + ")"
    return f"from formation_env import {imports}\n\n{call}\n"


def _literal(value: Any) -> str:
    text = repr(plain(value))
    return text.replace("'", '"') if '"' not in text and "\\" not in text else text
