"""CMA-ES (pycma) over the gain space, with restarts: where it looks next depends on nothing but values.

So a search that was interrupted is repeated from the values it was told, without flying again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.policies.tuned import FEEDFORWARDS, Gains
from train.gain_space import REACH, GainSpace

Point = NDArray[np.float64]


class Candidate(NamedTuple):
    """A point of the gain space that has been flown."""

    x: tuple[float, ...]
    feedforward: str
    value: float  # mean return on the training seeds


class Search(NamedTuple):
    """One search at a time: its space, how it is driven, and where its results go."""

    space: GainSpace
    value: Callable[[Sequence[Gains]], list[float]]  # mean returns
    told: Callable[[str, Sequence[Candidate]], None]  # after every generation
    spread: float
    seed: int


def search(s: Search, feedforward: str, budget: int, known: Sequence[float]) -> None:
    """CMA-ES from the own gains with `budget` candidates, the first of them the own gains.

    Where it has converged before, it starts again with twice as many candidates a generation (IPOP).
    `known` are the values of the first candidates, from a journal: they are not flown again.
    """
    rng = np.random.default_rng((s.seed, FEEDFORWARDS.index(feedforward)))
    known, left = list(known), budget
    own_point = np.zeros(len(s.space.names))
    left -= _generation(s, feedforward, [own_point], known)
    larger = 1
    while left > 0:
        strategy = _strategy(s, rng, larger)
        while left > 0 and not strategy.stop():
            points = strategy.ask()[: max(left, 0)]
            full = len(points) == strategy.popsize
            values: list[float] = []
            left -= _generation(s, feedforward, points, known, values)
            if full:  # what is cut off by the budget is the last generation
                strategy.tell(points, [-v for v in values])
        larger *= 2


def _strategy(s: Search, rng: np.random.Generator, larger: int) -> Any:
    import cma

    dimension = len(s.space.names)
    options = {
        "bounds": [-REACH, REACH],
        "popsize": larger * (4 + int(3 * np.log(dimension))),
        # Its own stream: nothing is drawn from NumPy's global state.
        "seed": np.nan,
        "randn": lambda *shape: rng.standard_normal(shape),
        "tolfun": 1e-7,  # below it two returns are alike
        "tolx": 1e-4,
        "verbose": -10,  # and reads no file of signals
        "verb_log": 0,
        "verb_disp": 0,
    }
    return cma.CMAEvolutionStrategy(np.zeros(dimension), s.spread, options)


def _generation(
    s: Search,
    feedforward: str,
    points: Sequence[Point],
    known: list[float],
    values: list[float] | None = None,
) -> int:
    """Fly the points, or take their values from `known`; returns how many there were."""
    old = known[: len(points)]
    del known[: len(points)]
    new = s.value([s.space.gains(x, feedforward) for x in points[len(old) :]])
    both = [*old, *new]
    s.told(
        feedforward,
        [
            Candidate(tuple(map(float, x)), feedforward, value)
            for x, value in zip(points, both, strict=True)
        ],
    )
    if values is not None:
        values += both
    return len(points)
