"""The paper's laws with gains found by a search: what the expert could do with less caution.

The gains are those of `baselines/tuned_gains.json`, one set for each scenario and action level,
found by `python -m train.tune_expert`. They fly the follower alone: its planner, and its tracker where
the follower commands what the tracker puts out. The leader, and at action level `reference` the
tracker that flies the follower, belong to the world and keep the configuration's own gains.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.base import Policy, Rows
from baselines.policies.expert import Expert
from baselines.policies.gain_files import FOLDER, Table, as_object, read_table, warn_untuned
from baselines.policies.gain_files import UntunedWarning as UntunedWarning
from formation_env import FormationConfig, configure
from formation_env.laws.gains import PlannerGains, TrackerGains
from formation_env.physics.quadrotor import MOMENT, RATES
from formation_env.validation.checks import choice, refuse, require

GAINS = FOLDER / "tuned_gains.json"

FEEDFORWARDS = ("zero", "derived")
_PLANNER = tuple(f.name for f in fields(PlannerGains))
# `p12` and `p22` follow from the others (59).
_TRACKER = tuple(f.name for f in fields(TrackerGains) if f.name not in ("p12", "p22"))


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


def read(path: str | os.PathLike[str] = GAINS) -> Table[Gains]:
    """The gains in a file by scenario and action level.

    Raises `ValueError` naming the file and what in it is not as expected: no regular file, not JSON,
    another version, a gain too many, missing, not finite or against a condition of the paper.
    """
    return read_table(path, _gains)


def _gains(entry: dict[str, Any], action: str) -> Gains:
    e = as_object(entry, "entry", ("planner", "tracker", "feedforward"))
    planner = PlannerGains(**as_object(e["planner"], "planner", _PLANNER))
    tracker = None
    if action == "reference":
        require(e["tracker"] is None, "tracker", e["tracker"], "null: the environment's flies")
    else:
        tracker = TrackerGains(**as_object(e["tracker"], "tracker", _TRACKER))
    return Gains(planner, tracker, e["feedforward"])


@lru_cache(maxsize=1)
def _shipped() -> Table[Gains]:
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
            warn_untuned(self.name, config, "the configuration's own")
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
