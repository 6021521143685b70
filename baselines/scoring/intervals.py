"""Figures over episodes and training runs, and how sure they are: percentile bootstrap intervals.

A figure of several training runs of one method is the median of the runs' figures, so with an odd number of
them one run's. All of them fly the same episodes, so runs and episodes are crossed: a resample draws runs
and, independently, episodes, both with replacement (the two-level bootstrap of crossed factors: A. Owen,
*The pigeonhole bootstrap*, Annals of Applied Statistics 2007). It counts both sources of chance, and is a
little too wide rather than too narrow.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.scoring.metrics import EPISODE

Floats = NDArray[np.float64]

RESAMPLES = 2000
LEVEL = 0.95
_BATCH = 2_000_000  # counts drawn at a time
TAILS = (50.0 * (1.0 - LEVEL), 50.0 * (1.0 + LEVEL))  # percentiles


class Estimate(NamedTuple):
    """A figure over episodes and its bootstrap interval; NaN where no episode has a value."""

    value: float
    low: float
    high: float
    episodes: int  # that have a value, in all runs together


def episode_counts(
    episodes: int, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Iterator[Floats]:
    """How often each episode is drawn: rows of resamples, `(batch, episodes)`, `resamples` in all."""
    batch = max(1, _BATCH // episodes)
    for first in range(0, resamples, batch):
        rows = min(batch, resamples - first)
        drawn = rng.integers(episodes, size=(rows, episodes))
        drawn += episodes * np.arange(rows)[:, None]
        counts = np.bincount(drawn.ravel(), minlength=rows * episodes)
        yield counts.reshape(rows, episodes).astype(np.float64)


def interval_of(values: Floats) -> tuple[float, float]:
    """The middle `LEVEL` of resampled values; those that are NaN, without a single value, are left out."""
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return np.nan, np.nan
    low, high = np.percentile(known, TAILS)
    return float(low) + 0.0, float(high) + 0.0  # no negative zero


def run_figures(x: Floats, counts: Floats, middle: bool = False) -> Floats:
    """Each run's mean over resampled episodes (or its median, if `middle`), `(resamples, runs)`.

    `x` is `(runs, episodes)`, with NaN where an episode has no value, `counts` `(resamples, episodes)`.
    """
    known = np.isfinite(x)
    if middle:
        return np.stack(
            [_medians(row[k], counts[:, k]) for row, k in zip(x, known, strict=True)], 1
        )
    with np.errstate(invalid="ignore"):
        figures: Floats = (counts @ np.where(known, x, 0.0).T) / (counts @ known.T)
    return figures


def _medians(x: Floats, counts: Floats) -> Floats:
    """The median of `x` `(n,)`, each value taken as often as `counts` `(resamples, n)` says; NaN for none."""
    if len(x) == 0:
        return np.full(len(counts), np.nan)
    order = np.argsort(x)
    reached, total = np.cumsum(counts[:, order], axis=1), counts.sum(axis=1)
    low, high = (
        np.minimum((reached < place[:, None]).sum(axis=1), len(x) - 1)
        for place in (np.floor((total + 1) / 2), np.floor(total / 2) + 1)
    )
    return np.where(total > 0, 0.5 * (x[order][low] + x[order][high]), np.nan)


def over_runs(figures: Floats) -> Floats:
    """The median over the last axis, of runs, of those that have a value; NaN where none has."""
    if figures.shape[-1] == 1:
        return figures[..., 0]
    known = np.isfinite(figures)
    if known.all():  # twenty times faster than what takes care of NaN
        return np.asarray(np.median(figures, axis=-1))
    some = known.any(axis=-1)
    filled = np.where(np.expand_dims(some, -1), figures, 0.0)
    return np.where(some, np.nanmedian(filled, axis=-1), np.nan)


def estimate(x: Floats, middle: bool = False) -> Estimate:
    """The mean over episodes (or the median, if `middle`), of several runs the median run's.

    `x` is `(episodes,)` or `(runs, episodes)`. Episodes without a value (NaN) are left out. The same samples
    always give the same interval.
    """
    return estimates({"": x}, ("",) if middle else ())[""]


def estimates(samples: Mapping[str, Floats], medians: Collection[str] = ()) -> dict[str, Estimate]:
    """`estimate` of several samples of the same runs and episodes, resampled together; the names `medians`
    are those whose median over episodes is taken."""
    each = {name: np.atleast_2d(x) for name, x in samples.items()}
    runs, episodes = next(iter(each.values())).shape
    whole = np.ones((1, episodes))
    values = {n: over_runs(run_figures(x, whole, n in medians))[0] for n, x in each.items()}
    varied = {n: x for n, x in each.items() if not _constant(x)}
    resampled: dict[str, list[Floats]] = {n: [] for n in varied}
    rng = np.random.default_rng(0)
    for counts in episode_counts(episodes, rng) if varied else ():
        drawn = rng.integers(runs, size=(len(counts), runs)) if runs > 1 else None
        for name, x in varied.items():
            figures = run_figures(x, counts, name in medians)
            if drawn is not None:
                figures = np.take_along_axis(figures, drawn, axis=1)
            resampled[name].append(over_runs(figures))
    found = {}
    for name, x in each.items():
        count = int(np.isfinite(x).sum())
        value = float(values[name]) + 0.0 if count else np.nan  # no negative zero
        ends = interval_of(np.concatenate(resampled[name])) if name in varied else (value, value)
        found[name] = Estimate(value, *ends, count)
    return found


def _constant(x: Floats) -> bool:
    """Whether there is nothing to resample: no value, or one only."""
    known = x[np.isfinite(x)]
    return len(known) == 0 or bool((known == known[0]).all())


def stacked(runs: Sequence[Mapping[str, Floats]], name: str) -> Floats:
    """One metric of several runs on the same episodes, `(runs, episodes)`."""
    return np.stack([columns[name] for columns in runs])


def median_run(scores: Floats) -> int:
    """The run whose mean score is the median of all, the worse one of two in the middle.

    `scores` is `(runs, episodes)`.
    """
    order = np.argsort(scores.mean(axis=1), kind="stable")
    return int(order[(len(order) - 1) // 2])


def summarise(runs: Sequence[Mapping[str, Floats]]) -> dict[str, Estimate]:
    """Every metric of `EPISODE`: mean over the episodes, of `settling_time` the median."""
    return estimates({name: stacked(runs, name) for name in EPISODE}, ("settling_time",))
