"""Figures over many episodes, and how sure they are: means with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.scoring.metrics import EPISODE

Floats = NDArray[np.float64]

RESAMPLES = 2000
LEVEL = 0.95
_BATCH = 2_000_000  # numbers resampled at a time


class Estimate(NamedTuple):
    """A figure over episodes and its bootstrap interval; NaN where no episode has a value."""

    value: float
    low: float
    high: float
    episodes: int  # that have a value


def mean(x: Floats, axis: int = -1) -> Floats:
    """The mean along an axis."""
    return np.asarray(np.mean(x, axis=axis))


def median(x: Floats, axis: int = -1) -> Floats:
    """The median along an axis."""
    return np.asarray(np.median(x, axis=axis))


def normalised(x: Floats, hover: Floats, expert: Floats, axis: int = -1) -> Floats:
    """The score of returns `x`: 0 for as good as hover in the mean, 1 for as good as the expert.

    Not a number where hover and the expert are equally good.
    """
    low, high = mean(hover, axis), mean(expert, axis)
    span = np.where(high == low, np.nan, high - low)
    return np.asarray((mean(x, axis) - low) / span)


def estimate(statistic: Callable[..., Any], *samples: Floats) -> Estimate:
    """`statistic` of the samples with its percentile bootstrap interval.

    Several samples are resampled together: entry i of each belongs to the same seed. Episodes without a
    value (NaN) are left out. The same samples always give the same interval.
    """
    data = np.stack(samples)
    data = data[:, np.isfinite(data).all(axis=0)]
    count = data.shape[1]
    if count == 0:
        return Estimate(np.nan, np.nan, np.nan, 0)
    value = float(statistic(*data)) + 0.0  # no negative zero
    if (data == data[:, :1]).all():  # nothing to resample: every resample is the sample
        return Estimate(value, value, value, count)
    low, high = _interval(statistic, data)
    return Estimate(value, low, high, count)


def _interval(statistic: Callable[..., Any], data: Floats) -> tuple[float, float]:
    from scipy.stats import bootstrap  # late: its import takes a second

    interval = bootstrap(
        tuple(data),
        statistic,
        paired=True,
        vectorized=True,
        n_resamples=RESAMPLES,
        batch=max(1, _BATCH // data.size),
        confidence_level=LEVEL,
        method="percentile",
        random_state=np.random.default_rng(0),
    ).confidence_interval
    return float(interval.low) + 0.0, float(interval.high) + 0.0


def difference(columns: dict[str, Floats], other: dict[str, Floats], name: str) -> Estimate:
    """How much larger a metric is than another policy's on the same seeds."""
    return estimate(mean, columns[name] - other[name])


def summarise(columns: dict[str, Floats]) -> dict[str, Estimate]:
    """Mean over the episodes of every metric of `EPISODE`; of `settling_time` the median."""
    return {
        name: estimate(median if name == "settling_time" else mean, columns[name])
        for name in EPISODE
    }
