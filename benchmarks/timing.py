"""Timing that survives a shared machine: short samples of all candidates in turn, and medians.

What else runs on the machine slows all candidates of a round about alike. So ratios are taken within a
round and their median reported, never the ratio of two figures from different minutes.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from statistics import median

# Does a number of steps and says how many seconds they took.
Sampler = Callable[[int], float]

# Beyond this many steps a sample says no more about the cost of one.
_MOST = 1_000_000


def repeating(step: Callable[[], object]) -> Sampler:
    """A sampler that calls `step` so many times."""

    def sample(count: int) -> float:
        begin = time.perf_counter()
        for _ in range(count):
            step()
        return time.perf_counter() - begin

    return sample


def steps_within(sample: Sampler, seconds: float) -> int:
    """How many steps make a sample of about `seconds`; the steps done here warm up."""
    count = 1
    while True:
        taken = sample(count)
        if taken >= 0.25 * seconds or count >= _MOST:
            return max(1, min(_MOST, round(count * seconds / max(taken, 1e-9))))
        count *= 4


def in_turn(samplers: Mapping[str, Sampler], rounds: int, seconds: float) -> dict[str, list[float]]:
    """Seconds a step, one figure per sampler and round, the samplers taking turns."""
    for sample in samplers.values():  # compile and fill caches before anything is counted
        sample(1)
    counts = {name: steps_within(sample, seconds) for name, sample in samplers.items()}
    times: dict[str, list[float]] = {name: [] for name in samplers}
    for _ in range(rounds):
        gc.collect()
        for name, sample in samplers.items():
            times[name].append(sample(counts[name]) / counts[name])
    return times


def ratio(numerator: list[float], denominator: list[float]) -> float:
    """Median over the rounds of one time over another of the same round."""
    return median(a / b for a, b in zip(numerator, denominator, strict=True))
