"""Numbers over several runs that differ in their noise.

Noise makes every run another one. Unless said otherwise a claim is judged by the median over the
runs, and the worst run is reported beside it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from baselines.reproduction.sampled import Run
from formation_env.paths.references import Floats


def rms(x: Floats) -> float:
    """RMS of the length of the vectors `(..., k)`."""
    return float(np.sqrt((x**2).sum(axis=-1).mean()))


def per_world(run: Run, measure: Callable[[int, NDArray[np.bool_]], float]) -> Floats:
    """`measure(world, steady instants)` for every world."""
    return np.array([measure(w, run.steady(w)) for w in range(run.p.shape[1])])


def spread(x: Floats) -> dict[str, float]:
    return {"drawn": x[0], "median": float(np.median(x)), "worst": float(x.max())}
