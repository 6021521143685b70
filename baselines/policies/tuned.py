"""The paper's laws with gains found by a search: what the expert could do with less caution.

The gains are those of `baselines/tuned_gains.json`, one set for each scenario and action level,
found by `python -m train.tune_expert`. They fly the follower alone: its planner, and its tracker where
the follower commands what the tracker puts out. The leader, and at action level `reference` the
tracker that flies the follower, belong to the world and keep the configuration's own gains.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from baselines.files import located
from baselines.policies.base import Policy, Rows
from baselines.policies.expert import Expert
from baselines.system.reading import file_name, read_bytes
from formation_env import FormationConfig, configure
from formation_env.laws.gains import PlannerGains, TrackerGains
from formation_env.laws.levels import NAMES as LEVEL_NAMES
from formation_env.physics.quadrotor import MOMENT, RATES
from formation_env.validation.checks import choice, refuse, require, shown
from formation_env.validation.warning import warn_user

GAINS = Path(__file__).parent.parent / "tuned_gains.json"
VERSION = 1  # of the file's format

FEEDFORWARDS = ("zero", "derived")
_PLANNER = tuple(f.name for f in fields(PlannerGains))
# `p12` and `p22` follow from the others (59).
_TRACKER = tuple(f.name for f in fields(TrackerGains) if f.name not in ("p12", "p22"))

Table = dict[tuple[str, str], "Gains"]


class UntunedWarning(UserWarning):
    """No gains were found for this scenario and action level: the configuration's own fly."""


@final
@dataclass(frozen=True)
class Gains:
    """What a search may choose of the expert. `tracker` is None where the environment's own flies."""

    planner: PlannerGains
    tracker: TrackerGains | None
    feedforward: str = "zero"  # or "derived"

    def __post_init__(self) -> None:
        planned = isinstance(self.planner, PlannerGains)
        require(planned, "planner", self.planner, "PlannerGains")
        tracked = self.tracker is None or isinstance(self.tracker, TrackerGains)
        require(tracked, "tracker", self.tracker, "TrackerGains or None")
        choice("feedforward", self.feedforward, FEEDFORWARDS)

    def document(self) -> dict[str, Any]:
        """The gains as in the file."""
        tracker = self.tracker
        return {
            "planner": {name: getattr(self.planner, name) for name in _PLANNER},
            "tracker": tracker and {name: getattr(tracker, name) for name in _TRACKER},
            "feedforward": self.feedforward,
        }


def tracker_field(config: FormationConfig) -> str | None:
    """The field of the configuration with the gains of the expert's own tracker, if it has one."""
    own_tracker = {MOMENT: "tracker", RATES: "rates_tracker"}
    actuation = config.level.actuation
    return None if actuation is None else own_tracker[actuation]


def own(config: FormationConfig, feedforward: str = "zero") -> Gains:
    """The configuration's own gains: with them the tuned expert is the expert."""
    name = tracker_field(config)
    return Gains(config.planner, getattr(config, name) if name else None, feedforward)


def lawful(config: FormationConfig, gains: Gains) -> FormationConfig:
    """The configuration whose laws have these gains.

    It checks them together, as (53) joins planner and tracker. Raises `ValueError` naming the gain.
    """
    name = tracker_field(config)
    if (name is None) != (gains.tracker is None):
        expected = "none: the environment's own flies" if name is None else "the tracker's gains"
        refuse("tracker", gains.tracker, expected)
    given: dict[str, Any] = {} if name is None else {name: gains.tracker}
    return configure(config, planner=gains.planner, **given)


# -- the file -------------------------------------------------------------------------------------


def read(path: str | os.PathLike[str] = GAINS) -> Table:
    """The gains in a file by scenario and action level.

    Raises `ValueError` naming the file and what in it is not as expected: no regular file, not JSON,
    another version, a gain too many, missing, not finite or against a condition of the paper.
    """
    path = file_name(path)
    try:
        text = read_bytes(path).decode("utf-8")
        document = json.loads(text, object_pairs_hook=_named_once)
        return {
            (scenario, action): _gains(entry, f"{scenario}.{action}", action)
            for scenario, actions in _entries(document).items()
            for action, entry in _object(actions, scenario).items()
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


def _object(value: Any, where: str, names: tuple[str, ...] | None = None) -> dict[str, Any]:
    """`value` as a JSON object, with exactly these names where given."""
    require(isinstance(value, dict), where, value, "an object")
    if names is not None:
        unknown, missing = sorted(set(value) - set(names)), sorted(set(names) - set(value))
        require(not unknown, where, unknown, f"only {', '.join(names)}")
        require(not missing, where, sorted(value), f"also {', '.join(missing)}")
    return dict(value)


def _entries(document: Any) -> dict[str, Any]:
    whole = _object(document, "the file", ("version", "gains"))
    require(whole["version"] == VERSION, "version", whole["version"], f"{VERSION}")
    return _object(whole["gains"], "gains")


def _gains(entry: Any, where: str, action: str) -> Gains:
    try:
        e = _object(entry, "entry", ("planner", "tracker", "feedforward", "made"))
        require(action in LEVEL_NAMES, "action level", action, f"one of {', '.join(LEVEL_NAMES)}")
        planner = PlannerGains(**_object(e["planner"], "planner", _PLANNER))
        tracker = None
        if action == "reference":
            require(e["tracker"] is None, "tracker", e["tracker"], "null: the environment's flies")
        else:
            tracker = TrackerGains(**_object(e["tracker"], "tracker", _TRACKER))
        _object(e["made"], "made")
        return Gains(planner, tracker, e["feedforward"])
    except ValueError as problem:
        raise ValueError(f"{where}: {problem}") from None


@lru_cache(maxsize=1)
def _shipped() -> Table:
    return read()


# -- the policy -----------------------------------------------------------------------------------


@final
class ExpertTuned(Policy):
    """The expert with gains of its own.

    By default those found for the configuration's scenario and action level, whatever else of the
    scenario was changed: they stay within the conditions of the paper's theorems. Where none were found
    it warns with `UntunedWarning` and flies with the configuration's, as the expert does; `tuned` says
    which. Raises `ValueError` for what are no gains, and for gains that do not fit the configuration.
    """

    name = "expert-tuned"

    def __init__(self, config: FormationConfig, gains: Gains | None = None) -> None:
        super().__init__(config)
        require(gains is None or isinstance(gains, Gains), "gains", gains, "Gains or None")
        found = gains or _shipped().get((config.scenario, config.action))
        self.tuned = found is not None
        if found is None:
            warn_user(
                f"expert-tuned: no gains were found for scenario {shown(config.scenario)} at action level "
                f"{config.action!r}; the configuration's own fly",
                UntunedWarning,
            )
        self.gains = found or own(config)
        try:
            law = lawful(config, self.gains)
        except ValueError as problem:
            raise ValueError(f"expert-tuned: {problem}") from None
        self._expert = Expert(law, self.gains.feedforward)

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        self._expert.begin(seeds)

    def begin_again(self, mask: NDArray[np.bool_]) -> None:
        self._expert.begin_again(mask)

    def decide(self, rows: Rows) -> Rows:
        return self._expert.decide(rows)
