"""Many scenarios together: the raw figures of every episode as one file, and statistics over them.

A `Matrix` has four axes: method, training seed, scenario, episode. `write` makes one compressed file of it
without pickled objects, `read` reads it. The statistics are those that R. Agarwal et al., *Deep Reinforcement
Learning at the Edge of the Statistical Precipice* (NeurIPS 2021), propose for few training runs: the
interquartile mean over runs and scenarios, the probability of improvement and performance profiles, with
bootstrap intervals whose strata are the scenarios. Within a scenario runs and episodes are drawn as
`intervals` does; the scenarios are held fixed, so an interval says nothing of other ones. All scenarios count
alike, and so do all runs of a method on one scenario.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.scoring.intervals import (
    RESAMPLES,
    TAILS,
    Estimate,
    Floats,
    episode_counts,
    interval_of,
    run_figures,
)
from baselines.scoring.results import Report
from baselines.system.reading import read_bytes
from baselines.system.writing import write_bytes

AXES = ("method", "training_seed", "scenario", "episode")
FIGURES = ("score", "slot_error", "slot_error_late", "failed", "trigger_time")
ALONE = -1  # training seed of a method that is one policy and not one of several runs
_SEED = re.compile(r".+#(\d+)")
_SUFFIX = ".npz"


class Matrix(NamedTuple):
    """Figures of every episode, with the labels of the axes. NaN where a method has not flown."""

    method: tuple[str, ...]
    training_seed: NDArray[np.int64]  # the number of a run, or ALONE
    scenario: tuple[str, ...]
    episode: NDArray[np.int64]  # seed
    figures: dict[str, Floats]  # of `FIGURES`: (method, training seed, scenario, episode)

    def runs(self, method: str, scenario: str, figure: str = "score") -> Floats:
        """The runs of a method that have flown a scenario, `(runs, episodes)`; none where it has not."""
        x = self.figures[figure][self.method.index(method), :, self.scenario.index(scenario)]
        return x[np.isfinite(x).all(axis=1)]

    def flown(self, *methods: str) -> tuple[str, ...]:
        """The scenarios that all of the methods have flown."""
        return tuple(
            name for name in self.scenario if all(len(self.runs(m, name)) > 0 for m in methods)
        )


def over(m: Matrix, scenarios: Sequence[str]) -> Matrix:
    """The matrix of some of its scenarios, in their order, and of the methods that have flown one of them."""
    places = [m.scenario.index(name) for name in scenarios]
    kept = [i for i, name in enumerate(m.method) if set(m.flown(name)) & set(scenarios)]
    figures = {name: x[kept][:, :, places] for name, x in m.figures.items()}
    method = tuple(m.method[i] for i in kept)
    return m._replace(method=method, scenario=tuple(scenarios), figures=figures)


# -- the raw figures ------------------------------------------------------------------------------


def matrix(report: Report) -> Matrix:
    """Every episode of an evaluation."""
    methods, scenarios = report.policies, tuple(report.scenarios)
    each = {
        (method, _training_seed(run), name): columns
        for name, scenario in report.scenarios.items()
        for method, result in scenario.results.items()
        for run, columns in result.runs.items()
    }
    seeds = sorted({seed for _, seed, _ in each})
    shape = (len(methods), len(seeds), len(scenarios), report.episodes)
    figures = {figure: np.full(shape, np.nan) for figure in FIGURES}
    for (method, seed, name), columns in each.items():
        place = methods.index(method), seeds.index(seed), scenarios.index(name)
        for figure in FIGURES:
            figures[figure][place] = columns[figure]
    episodes = report.seed + np.arange(report.episodes, dtype=np.int64)
    return Matrix(tuple(methods), np.array(seeds, np.int64), scenarios, episodes, figures)


def _training_seed(run: str) -> int:
    found = _SEED.fullmatch(run)
    return int(found[1]) if found else ALONE


def file_of(path: Path) -> Path:
    """The name of the file: NumPy's suffix is added where it is missing."""
    return path if path.name.endswith(_SUFFIX) else path.with_name(path.name + _SUFFIX)


def write(m: Matrix, path: Path) -> Path:
    """Write a matrix; the figures are stored in single precision. Returns the file's name.

    The arrays: `axes`, the names of the axes; under each of these names its labels; under each name of
    `FIGURES` an array with these axes. Raises `OSError`.
    """
    path, data = file_of(path), io.BytesIO()
    arrays: dict[str, Any] = {"axes": np.array(AXES)}
    arrays |= {name: np.array(getattr(m, name)) for name in AXES}
    arrays |= {name: x.astype(np.float32) for name, x in m.figures.items()}
    np.savez_compressed(data, **arrays)
    write_bytes(path, data.getvalue())
    return path


def read(path: Path) -> Matrix:
    """The matrix in a file that `write` has written; nothing in it is executed.

    Raises `ValueError` naming the file if it is another, `OSError` if it cannot be read.
    """
    try:
        with np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as file:
            arrays = {name: file[name] for name in ("axes", *AXES, *FIGURES)}
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile, TypeError, AttributeError):
        raise ValueError(
            f"{path}: expected a file of baselines.evaluate --matrix, without pickled objects"
        ) from None
    shape = tuple(arrays[name].size for name in AXES)
    if tuple(arrays["axes"]) != AXES or any(arrays[name].shape != shape for name in FIGURES):
        raise ValueError(f"{path}: expected arrays with the axes {', '.join(AXES)}")
    return Matrix(
        tuple(map(str, arrays["method"])),
        arrays["training_seed"].astype(np.int64),
        tuple(map(str, arrays["scenario"])),
        arrays["episode"].astype(np.int64),
        {name: arrays[name].astype(np.float64) for name in FIGURES},
    )


# -- over the scenarios ---------------------------------------------------------------------------


def interquartile_mean(x: Floats, weights: Floats) -> Floats:
    """The mean of the middle half, over the last axis of `x`, `(..., n)`, with weights `(n,)` that need not
    be equal: the lowest and the highest quarter of the weight are left out, to the fraction of a value."""
    order = np.argsort(x, axis=-1)
    share = weights[order] / weights.sum()
    upper = np.cumsum(share, axis=-1)
    inside = np.clip(np.minimum(upper, 0.75) - np.maximum(upper - share, 0.25), 0.0, None)
    middle: Floats = (np.take_along_axis(x, order, -1) * inside).sum(axis=-1) / 0.5
    return middle


class SuiteScore(NamedTuple):
    """The score of a method over scenarios."""

    interquartile_mean: Estimate
    mean: Estimate
    scenarios: tuple[str, ...]


def suite_score(m: Matrix, method: str, scenarios: Sequence[str] = ()) -> SuiteScore:
    """Interquartile mean and mean over training runs and scenarios of the mean score of a run.

    Of the given scenarios, or else of all that the method has flown. Raises `ValueError` where it has
    flown none, or not one that is given.
    """
    names = _require_flown(m, scenarios, method)
    each = [m.runs(method, name) for name in names]
    weights = np.concatenate([np.full(len(x), 1.0 / len(x)) for x in each])
    rng = np.random.default_rng(0)
    values = np.concatenate([x.mean(axis=1) for x in each])
    drawn = np.concatenate([_resampled_runs(x, rng) for x in each], axis=1)
    count = sum(x.size for x in each)

    def estimated(value: float, resampled: Floats) -> Estimate:
        return Estimate(value, *interval_of(resampled), count)

    middle = float(interquartile_mean(values, weights))
    mean = float(values @ weights / weights.sum())
    return SuiteScore(
        estimated(middle, interquartile_mean(drawn, weights)),
        estimated(mean, drawn @ weights / weights.sum()),
        names,
    )


def _require_flown(m: Matrix, scenarios: Sequence[str], *methods: str) -> tuple[str, ...]:
    for method in methods:
        if method not in m.method:
            raise ValueError(f"method = {method!r}: expected one of {', '.join(m.method)}")
    flown = m.flown(*methods)
    missing = [name for name in scenarios if name not in flown]
    if missing or not flown:
        raise ValueError(
            f"{' and '.join(methods)}: not flown on {', '.join(missing) or 'any scenario'}: expected "
            "scenarios that have been flown"
        )
    return tuple(scenarios) or flown


def _resampled_runs(x: Floats, rng: np.random.Generator) -> Floats:
    """Mean scores of drawn runs over drawn episodes, `(RESAMPLES, runs)`."""
    parts = []
    for counts in episode_counts(x.shape[1], rng):
        figures = run_figures(x, counts)
        drawn = rng.integers(len(x), size=figures.shape)
        parts.append(np.take_along_axis(figures, drawn, axis=1))
    return np.concatenate(parts)


def probability_of_improvement(
    m: Matrix, method: str, other: str, scenarios: Sequence[str] = ()
) -> Estimate:
    """How likely an episode of `method` scores more than one of `other`: Mann and Whitney's U over the number
    of pairs, equal scores counted one half, averaged over the scenarios.

    An episode is one of a run drawn at random, and the two of a pair need not have the same seed; a resample
    draws the same seeds for both. Raises `ValueError` as `suite_score` does.
    """
    names = _require_flown(m, scenarios, method, other)
    rng = np.random.default_rng(0)
    value, resampled, count = 0.0, np.zeros(RESAMPLES), 0
    for name in names:
        x, y = m.runs(method, name), m.runs(other, name)
        whole = np.ones((1, x.shape[1])), np.ones((1, len(x))), np.ones((1, len(y)))
        value += float(_exceedance(x, y, *whole)[0]) / len(names)
        resampled += np.concatenate(list(_resampled_exceedance(x, y, rng))) / len(names)
        count += x.size
    return Estimate(value, *interval_of(resampled), count)


def _resampled_exceedance(x: Floats, y: Floats, rng: np.random.Generator) -> Iterator[Floats]:
    for counts in episode_counts(x.shape[1], rng):
        yield _exceedance(x, y, counts, *(_run_counts(len(z), len(counts), rng) for z in (x, y)))


def _exceedance(x: Floats, y: Floats, counts: Floats, runs_x: Floats, runs_y: Floats) -> Floats:
    """The share of pairs in which `x` exceeds `y`, ties one half, `(resamples,)`.

    `counts` `(resamples, episodes)` and `runs_x`, `runs_y` `(resamples, runs)` say how often each episode
    and each run is drawn.
    """
    weights_x, weights_y = (
        (runs[:, :, None] * counts[:, None, :]).reshape(len(counts), -1)
        for runs in (runs_x, runs_y)
    )
    order = np.argsort(y.ravel())
    ordered = y.ravel()[order]
    below = np.concatenate(
        [np.zeros((len(counts), 1)), np.cumsum(weights_y[:, order], axis=1)], axis=1
    )
    left, right = (np.searchsorted(ordered, x.ravel(), side) for side in ("left", "right"))
    wins = (weights_x * 0.5 * (below[:, left] + below[:, right])).sum(axis=1)
    share: Floats = wins / (weights_x.sum(axis=1) * weights_y.sum(axis=1))
    return share


def _run_counts(runs: int, rows: int, rng: np.random.Generator) -> Floats:
    """How often each run is drawn, `(rows, runs)`."""
    return rng.multinomial(runs, np.full(runs, 1.0 / runs), size=rows).astype(np.float64)


class Profile(NamedTuple):
    """Share of episodes with a score above each threshold, `(thresholds,)` each."""

    share: Floats
    low: Floats  # of the pointwise interval
    high: Floats


def performance_profile(
    m: Matrix, method: str, thresholds: Floats, scenarios: Sequence[str] = ()
) -> Profile:
    """The share of a method's episodes, of all its runs, whose score is above a threshold.

    Raises `ValueError` as `suite_score` does.
    """
    names = _require_flown(m, scenarios, method)
    rng = np.random.default_rng(0)
    share, resampled = np.zeros(len(thresholds)), np.zeros((RESAMPLES, len(thresholds)))
    for name in names:
        x = m.runs(method, name)
        above = (x[:, None, :] > thresholds[:, None]).astype(
            np.float64
        )  # (runs, thresholds, episodes)
        share += above.mean(axis=(0, 2)) / len(names)
        first = 0
        for counts in episode_counts(x.shape[1], rng):
            runs = _run_counts(len(x), len(counts), rng)
            of_runs = np.einsum("be,rte->brt", counts, above, optimize=True) / x.shape[1]
            part = np.einsum("br,brt->bt", runs, of_runs) / len(x)
            resampled[first : first + len(counts)] += part / len(names)
            first += len(counts)
    low, high = np.percentile(resampled, TAILS, axis=0)
    return Profile(share, low, high)
