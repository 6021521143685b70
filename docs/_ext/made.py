"""The texts of the manual that are made of the code, by name."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from make_pictures import EFFECTS as EFFECT_PICTURES

from _ext import record_fields
from _ext.record_fields import field_table, shown, table
from formation_env import SCENARIOS, FormationConfig
from formation_env.config import PARTS, quietly
from formation_env.env import FormationEnv

PICTURES = Path(__file__).resolve().parent.parent / "pictures"

# Which fields of the configuration stand in which table. All others are effects: what a field that is
# added does to a flight is there without a word more.
TASK = ("scenario", "offsets", "trajectory", "path", "action", "neighbours", "reward", "limits")
EPISODE = ("start", "start_offset", "leader_start", "follower_starts", "trigger", "duration",
           "control_period", "substeps")  # fmt: skip
FLIGHT = ("vehicle", "leader_actuation", "reference_actuation", "reference_max", "planner", "tracker",
          "rates_tracker")  # fmt: skip
NAMES = tuple(f.name for f in dataclasses.fields(FormationConfig))
EFFECTS = tuple(n for n in NAMES if n not in (*TASK, *EPISODE, *FLIGHT))


def _manual() -> str:
    """Of the environment: its class docstring, whose tables are made of the code."""
    return inspect.cleandoc(FormationEnv.__doc__ or "")


def _of(names: tuple[str, ...]) -> str:
    return field_table(FormationConfig, names)


def _parts() -> str:
    """The fields of the fields that are objects."""
    kinds: list[type] = []
    for part in PARTS.values():
        if type(part) not in kinds:
            kinds.append(type(part))
    words = []
    for kind in kinds:
        of = ", ".join(f"`{name}`" for name, part in PARTS.items() if type(part) is kind)
        words.append(f"### {kind.__name__}\n\nOf {of}.\n\n{field_table(kind)}")
    return "\n\n".join(words)


def _set_by(name: str) -> dict[str, Any]:
    """Scenario: its value of the field, where it is another than the default."""
    default = {f.name: f for f in record_fields.fields(FormationConfig)}[name].default
    values = {scenario: getattr(quietly(make), name) for scenario, make in SCENARIOS.items()}
    return {scenario: value for scenario, value in values.items() if value != default}


def _value(name: str, value: Any, default: Any) -> str:
    """A value in a cell; of an object the fields that differ from the default."""
    if name == "offsets":
        return f"{len(value)}"
    if name == "trajectory":
        return f"`{value.name}`"
    if name in PARTS:
        new, old = (x._asdict() if hasattr(x, "_asdict") else vars(x) for x in (value, default))
        return ", ".join(f"`{k}` {x:.3g}" for k, x in new.items() if x != old[k])
    return shown(value)


def _scenarios() -> str:
    """What each scenario sets."""
    defaults = {f.name: f.default for f in record_fields.fields(FormationConfig)}
    rows = []
    for name in NAMES:
        if name == "scenario" or not (other := _set_by(name)):
            continue
        cells = [_value(name, other[s], defaults[name]) if s in other else "" for s in SCENARIOS]
        first = (
            _value(name, defaults[name], defaults[name])
            or "`" + type(defaults[name]).__name__ + "`"
        )
        rows.append([f"`{name}`" + (" (followers)" if name == "offsets" else ""), first, *cells])
    return table(["field", "default", *(f"`{s}`" for s in SCENARIOS)], rows)


def _descriptions() -> str:
    """The docstrings of the scenarios, each with its picture."""
    words = []
    for name, make in SCENARIOS.items():
        text = inspect.cleandoc(make.__doc__ or "")
        picture = PICTURES / f"{name}.png"
        shown_here = f"\n\n![The scenario {name}](pictures/{name}.png)" if picture.exists() else ""
        words.append(f"### {name}\n\n{text}{shown_here}")
    return "\n\n".join(words)


def _effects() -> str:
    """The fields that disturb a flight or what is measured of it; numbers and choices first, then parts."""
    known = {f.name: f for f in record_fields.fields(FormationConfig)}
    rows = []
    for name in EFFECTS:
        sets = ", ".join(f"`{s}`" for s in _set_by(name))
        rows.append([f"`{name}`", shown(known[name].default), known[name].comment or "-", sets])
    return table(["field", "default", "unit and meaning", "another in"], rows)


def _effect_pictures() -> str:
    """The pictures of effects that were made, with what is set in each."""
    shown_here = [
        f"![{each.caption}](pictures/{each.name}.png)\n\n`{each.keywords()}`: {each.caption}."
        for each in EFFECT_PICTURES
        if (PICTURES / f"{each.name}.png").exists()
    ]
    cells = "\n".join(f":::{{container}}\n{x}\n:::" for x in shown_here)
    return f"::::{{container}} pictures\n{cells}\n::::"


TEXTS: dict[str, Callable[[], str]] = {
    "manual": _manual,
    "task-fields": lambda: _of(TASK),
    "episode-fields": lambda: _of(EPISODE),
    "flight-fields": lambda: _of(FLIGHT),
    "effect-fields": lambda: _of(EFFECTS),
    "parts": _parts,
    "scenarios": _scenarios,
    "descriptions": _descriptions,
    "effects": _effects,
    "effect-pictures": _effect_pictures,
}
