"""`ff`, `ff-filter`, `lee` and `lqr` with gains found by the search that finds the expert's.

The gains are those of `baselines/tuned_gains_ff.json` and so on, one set for each scenario and action level,
found by `python -m train.tune_expert --policy ff`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.cascade import LoopGains
from baselines.policies.composed import Composed
from baselines.policies.gain_files import FOLDER, Table, as_object, read_table, warn_untuned
from baselines.policies.lqr import LqrWeights
from baselines.policies.textbook import Ff, FfFilter, FilteredGains, LeeSlot, LqrSlot
from formation_env import FormationConfig
from formation_env.configuration.parts import part
from formation_env.validation.checks import require


class Law(NamedTuple):
    """A law whose gains can be searched."""

    policy: Any  # a kind of `Composed`, made with the configuration and gains
    gains: Any  # the record of its gains
    file: Path  # of the gains that were found


LAWS = {
    "ff": Law(Ff, LoopGains, FOLDER / "tuned_gains_ff.json"),
    "ff-filter": Law(FfFilter, FilteredGains, FOLDER / "tuned_gains_ff-filter.json"),
    "lee": Law(LeeSlot, LoopGains, FOLDER / "tuned_gains_lee.json"),
    "lqr": Law(LqrSlot, LqrWeights, FOLDER / "tuned_gains_lqr.json"),
}


def read(law: str, path: str | os.PathLike[str]) -> Table[Any]:
    """The gains of a law in a file, by scenario and action level.

    Raises `ValueError` naming the file and what in it is not as expected, a gain among it.
    """
    kind = LAWS[law].gains

    def parse(entry: dict[str, Any], action: str) -> Any:
        e = as_object(entry, "entry", ("gains",))
        return part("gains", as_object(e["gains"], "gains", kind._fields), kind())

    return read_table(path, parse)


@cache
def _shipped(law: str) -> Table[Any]:
    return read(law, LAWS[law].file)


def found(law: str, config: FormationConfig) -> Any:
    """The gains found for the configuration's scenario and action level, or None."""
    return _shipped(law).get((config.scenario, config.action))


class Tuned(Composed):
    """A law of `LAWS` on the slot, with gains of its own.

    By default those found for the configuration's scenario and action level. Where none were found it warns
    with `UntunedWarning` and flies with the plain ones; `tuned` says which. Raises `ValueError` for what are
    no gains.
    """

    law: str

    def __init__(self, config: FormationConfig, gains: Any = None) -> None:
        require(isinstance(config, FormationConfig), "config", config, "a FormationConfig")
        gains = found(self.law, config) if gains is None else gains
        self.tuned = gains is not None
        if gains is None:
            warn_untuned(self.name, config, "the plain ones")
        law = LAWS[self.law].policy(config, gains)
        super().__init__(config, law.planner, law.tracker, law.estimator)


@final
class Stacked(Composed):
    """A law of `LAWS` with several gains, each of which flies so many of the worlds in a row.

    A world's actions are those of the law with its gains alone, bit for bit. Raises `ValueError` for what are
    no gains, and where another number of worlds is flown.
    """

    name = "stacked"

    def __init__(
        self, law: str, config: FormationConfig, gains: Sequence[Any], worlds: int
    ) -> None:
        one, *_ = alone = [LAWS[law].policy(config, each) for each in gains]
        tracker = one.tracker.stacked([each.tracker for each in alone], worlds)
        estimator = one.estimator and one.estimator.stacked([e.estimator for e in alone], worlds)
        super().__init__(config, one.planner, tracker, estimator)
        self._of_all = len(gains) * worlds

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        require(len(seeds) == self._of_all, "worlds", len(seeds), f"{self._of_all}")
        super().begin(seeds)


@final
class FfTuned(Tuned):
    """`ff` with gains that were searched."""

    name, law = "ff-tuned", "ff"


@final
class FfFilterTuned(Tuned):
    """`ff-filter` with gains and factors that were searched."""

    name, law = "ff-filter-tuned", "ff-filter"


@final
class LeeTuned(Tuned):
    """`lee` with gains that were searched."""

    name, law = "lee-tuned", "lee"


@final
class LqrTuned(Tuned):
    """`lqr` with weights that were searched."""

    name, law = "lqr-tuned", "lqr"


TUNED: dict[str, type[Tuned]] = {
    kind.law: kind for kind in (FfTuned, FfFilterTuned, LeeTuned, LqrTuned)
}
