"""Files of gains that a search has found, by scenario and action level."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from baselines.files import located
from baselines.system.reading import file_name, read_bytes
from formation_env import FormationConfig
from formation_env.laws.levels import NAMES as LEVEL_NAMES
from formation_env.validation.checks import require, shown
from formation_env.validation.warning import warn_user

VERSION = 1  # of the files' format
FOLDER = Path(__file__).parent.parent

Found = TypeVar("Found")
Parse = Callable[[dict[str, Any], str], Found]  # of an entry without `made`, and its action level
Table = dict[tuple[str, str], Found]


class UntunedWarning(UserWarning):
    """No gains were found for this scenario and action level: the plain ones fly."""


def warn_untuned(policy: str, config: FormationConfig, flown: str) -> None:
    """Say that no gains were found for a configuration, and which fly instead."""
    warn_user(
        f"{policy}: no gains were found for scenario {shown(config.scenario)} at action level "
        f"{config.action!r}; {flown} fly",
        UntunedWarning,
    )


def read_table(path: str | os.PathLike[str], parse: Parse[Found]) -> Table[Found]:
    """The gains in a file by scenario and action level, each as `parse` makes them of its entry.

    Raises `ValueError` naming the file and what in it is not as expected: no regular file, not JSON,
    another version, or what `parse` raises.
    """
    path = file_name(path)
    try:
        text = read_bytes(path).decode("utf-8")
        document = json.loads(text, object_pairs_hook=_named_once)
        return {
            (scenario, action): _parsed(entry, f"{scenario}.{action}", action, parse)
            for scenario, actions in _entries(document).items()
            for action, entry in as_object(actions, scenario).items()
        }
    except OSError as problem:
        raise ValueError(located(path, f"{problem.strerror}; expected a file of gains")) from None
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as problem:
        reason = "nested too deep" if isinstance(problem, RecursionError) else problem
        raise ValueError(located(path, f"{reason}; expected JSON")) from None
    except ValueError as problem:
        raise ValueError(located(path, problem)) from None


def _named_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object no name of which stands twice, where JSON would silently keep the last."""
    named = dict(pairs)
    twice = sorted({name for name, _ in pairs if sum(name == other for other, _ in pairs) > 1})
    require(len(named) == len(pairs), "object", twice, "every name once")
    return named


def as_object(value: Any, where: str, names: tuple[str, ...] | None = None) -> dict[str, Any]:
    """`value` as a JSON object, with exactly these names where given."""
    require(isinstance(value, dict), where, value, "an object")
    if names is not None:
        unknown, missing = sorted(set(value) - set(names)), sorted(set(names) - set(value))
        require(not unknown, where, unknown, f"only {', '.join(names)}")
        require(not missing, where, sorted(value), f"also {', '.join(missing)}")
    return dict(value)


def _entries(document: Any) -> dict[str, Any]:
    whole = as_object(document, "the file", ("version", "gains"))
    require(whole["version"] == VERSION, "version", whole["version"], f"{VERSION}")
    return as_object(whole["gains"], "gains")


def _parsed(entry: Any, where: str, action: str, parse: Parse[Found]) -> Found:
    try:
        given = as_object(entry, "entry")
        require(action in LEVEL_NAMES, "action level", action, f"one of {', '.join(LEVEL_NAMES)}")
        as_object(given.pop("made", None), "made")
        return parse(given, action)
    except ValueError as problem:
        raise ValueError(f"{where}: {problem}") from None
