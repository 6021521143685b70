"""Slot errors against time, gathered while episodes are flown, and their spread over episodes.

Errors are as in the metrics: those of the true positions, at most `metrics.CAP`, which also stands for what
an episode lacks since it has failed; there is none after the end of a flight. They are kept at no more than
`INSTANTS` ticks, so that memory does not grow with the length of an episode.
"""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from baselines.scoring.metrics import CAP, ERROR
from formation_env import FormationConfig

Floats = NDArray[np.float64]

COLUMN = "slot_errors"  # name beside those of the metrics, `(worlds, instants, followers)`, m
INSTANTS = 240  # more than the pixels of a panel show
LOW, HIGH = 10.0, 90.0  # percentiles of the spread


def ticks(config: FormationConfig) -> NDArray[np.int64]:
    """The ticks, from 1, at which errors are kept: all, or `INSTANTS` of them evenly, with the last one."""
    last = config.max_steps
    evenly = np.linspace(1, last, min(INSTANTS, last))
    return np.unique(np.round(evenly).astype(np.int64))


@final
class Gatherer:
    """The errors of some worlds."""

    def __init__(self, config: FormationConfig, worlds: int) -> None:
        self._place = {int(tick): k for k, tick in enumerate(ticks(config))}
        shape = (worlds, len(self._place), config.followers)
        self.errors: NDArray[Any] = np.full(shape, CAP, dtype=np.float32)

    def add(self, tick: int, flying: NDArray[np.bool_], outputs: Floats) -> None:
        """Keep the errors of a tick in the worlds that are `flying`, if it is one of those kept.

        `outputs` is `(worlds, followers, numbers)`, as a step returns it.
        """
        k = self._place.get(tick)
        if k is not None:
            off = np.linalg.norm(outputs[flying, :, ERROR : ERROR + 3], axis=-1)
            self.errors[flying, k] = np.where(off < CAP, off, CAP)  # CAP for NaN

    def finish(self, flown: NDArray[np.int64], failed: NDArray[np.bool_]) -> None:
        """Leave out what comes after the `flown` ticks of the worlds that have not `failed`."""
        after = np.array(list(self._place)) > flown[:, None]
        self.errors[after & ~failed[:, None]] = np.nan


class Curve(NamedTuple):
    """Slot error against time, over episodes and followers, `(instants,)` each, to the last flight's end."""

    time: Floats  # s since reset
    low: Floats  # m, percentile `LOW`
    median: Floats  # m
    high: Floats  # m, percentile `HIGH`


def curve(errors: NDArray[Any], config: FormationConfig) -> Curve:
    """The spread of `errors` `(worlds, instants, followers)`, m, NaN where there is none."""
    flown = np.isfinite(errors).any(axis=(0, 2))
    spread: Any = np.nanpercentile(errors[:, flown], (LOW, 50.0, HIGH), axis=(0, 2))
    low, median, high = spread.astype(np.float64)
    time: Any = ticks(config)[flown] * config.control_period
    return Curve(time, low, median, high)
