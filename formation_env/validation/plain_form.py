"""The JSON form of a value: dictionaries, lists, numbers, names, True, False and None, nothing else.

`plain(value)` gives it for whatever a field of the configuration or a keyword of an environment may
hold, and each of them accepts it back:

| value | its form |
|---|---|
| `FormationConfig`, `Trajectory`: what has `to_dict` | that dictionary |
| `Vehicle`, `PlannerGains`, ...: a dataclass; `Noise`, `Limits`, ...: a NamedTuple | `{field: value}` |
| an array, a tuple, a list | a list |
| a number, also of NumPy | `int` or `float` with the same value; None where it is infinite |
| a member of an enumeration such as `AutoresetMode` | its name |

JSON has no infinity. Where a value may be infinite, as the duration of a trajectory, None stands for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from math import isinf, isnan
from typing import Any

import numpy as np

from formation_env.validation.checks import refuse


def plain(value: Any, name: str = "value") -> Any:
    """The JSON form of `value`; raises `ValueError` naming what has none (a function, NaN)."""
    if hasattr(value, "to_dict") and not isinstance(value, type):
        value = value.to_dict()
    if value is None or isinstance(value, (bool, np.bool_)):
        return None if value is None else bool(value)
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, str):
        return str(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return _number(name, float(value))
    entries = _named(value)
    if entries is not None:
        return {key: plain(entry, f"{name}.{key}") for key, entry in entries.items()}
    return _sequence(name, value)


def _number(name: str, value: float) -> float | None:
    """A number; None if it is infinite."""
    if isnan(value):
        refuse(name, value, "a value that JSON can hold")
    return None if isinf(value) else value


def _named(value: Any) -> dict[str, Any] | None:
    """What has named entries as a dictionary, else None."""
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {str(key): value[key] for key in value}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return dict(zip(value._fields, value, strict=True))
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in fields(value) if f.init}
    return None


def _sequence(name: str, value: Any) -> Any:
    """A list of the entries of a sequence or an array; the entry itself of an array without axes."""
    if isinstance(value, np.ndarray) and not isinstance(value, np.ma.MaskedArray):
        if value.dtype.kind not in "biufOU":
            refuse(name, value, "a value that JSON can hold")
        value = value.tolist() if value.dtype.char != "g" else value.astype(np.float64).tolist()
        if not isinstance(value, list):
            return plain(value, name)
    if not isinstance(value, (list, tuple)):
        refuse(name, value, "a value that JSON can hold")
    return [plain(entry, f"{name}[{i}]") for i, entry in enumerate(value)]
