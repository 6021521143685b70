"""CMA-ES (pycma) over the gain space, with restarts.

Its next points depend on its seed and the values of the points before, and on nothing else. So a search that
was interrupted is repeated from recorded values, without flying again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from train.tune_expert.gain_space import REACH
from train.tune_expert.tunables import Space

Point = NDArray[np.float64]


class Candidate(NamedTuple):
    """A point of the gain space that has been flown."""

    x: tuple[float, ...]
    choice: str  # of the tunable: for the expert a feedforward
    value: float  # mean score on the training seeds


class Search(NamedTuple):
    """What a search is made of."""

    space: Space
    mean_scores: Callable[[Sequence[Any]], list[float]]  # flies candidates
    on_generation: Callable[[str, Sequence[Candidate]], None]  # called after every generation
    spread: float  # standard deviation of the first generation, in units of the space
    seed: int
    choices: tuple[str, ...]  # all that there are: each has random numbers of its own


def search(s: Search, choice: str, budget: int, recorded: Sequence[float]) -> None:
    """CMA-ES from the plain gains with `budget` candidates, the first of them those gains.

    Where it has converged before, it starts again with twice as many candidates a generation (IPOP).
    `recorded` are the values of the first candidates, from a journal: they are not flown again.
    """
    rng = np.random.default_rng((s.seed, s.choices.index(choice)))
    remaining, left = list(recorded), budget
    own_point = np.zeros(len(s.space.names))
    left -= _generation(s, choice, [own_point], remaining)
    size_factor = 1
    while left > 0:
        strategy = _strategy(s, rng, size_factor)
        while left > 0 and not strategy.stop():
            points = strategy.ask()[: max(left, 0)]
            full = len(points) == strategy.popsize
            values: list[float] = []
            left -= _generation(s, choice, points, remaining, values)
            if full:  # the budget may cut off the last generation
                strategy.tell(points, [-v for v in values])
        size_factor *= 2


def _strategy(s: Search, rng: np.random.Generator, size_factor: int) -> Any:
    """pycma's CMA-ES with `size_factor` times the usual number of candidates in a generation."""
    import cma

    dimension = len(s.space.names)
    options = {
        "bounds": [-REACH, REACH],
        "popsize": size_factor * (4 + int(3 * np.log(dimension))),
        # Its own stream: nothing is drawn from NumPy's global state.
        "seed": np.nan,
        "randn": lambda *shape: rng.standard_normal(shape),
        "tolfun": 1e-7,  # smaller differences of scores do not count
        "tolx": 1e-4,
        "verbose": -10,  # also keeps pycma from reading a file of signals
        "verb_log": 0,
        "verb_disp": 0,
    }
    return cma.CMAEvolutionStrategy(np.zeros(dimension), s.spread, options)


def _generation(
    s: Search,
    choice: str,
    points: Sequence[Point],
    recorded: list[float],
    values: list[float] | None = None,
) -> int:
    """Fly the points, or take their values from `recorded`; returns how many there were."""
    old = recorded[: len(points)]
    del recorded[: len(points)]
    new = s.mean_scores([s.space.gains(x, choice) for x in points[len(old) :]])
    both = [*old, *new]
    s.on_generation(
        choice,
        [
            Candidate(tuple(map(float, x)), choice, value)
            for x, value in zip(points, both, strict=True)
        ],
    )
    if values is not None:
        values += both
    return len(points)
