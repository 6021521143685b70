"""Mean scores of candidates. Those of a law that can be stacked fly together, in worlds of one simulation.

A tick of a textbook's law is some hundred calls of NumPy, whose time hardly depends on how many worlds they
are for. The scores do not depend on which candidates fly together: a world's numbers are its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import Any

import numpy as np

from baselines.policies.base import Policy
from baselines.scoring.rollout import VEHICLES, fly, fly_all
from formation_env import FormationConfig
from train.tune_expert.tunables import Tunable

OVERFLOWED = -1.0  # the score of gains with which the law leaves the range of numbers


def mean_score(policy: Policy, seeds: range) -> float:
    """Mean score over the seeds; `OVERFLOWED` where it is no number."""
    try:
        return _mean(fly_all(policy, seeds)["score"])
    except ValueError as problem:
        if not _overflow(problem):
            raise
        return OVERFLOWED


def stacked_scores(policy: Policy, seeds: range, count: int) -> list[float] | None:
    """The mean scores of the `count` candidates of a stacked policy; None where any of them overflows, which
    ends the flight of all."""
    try:
        scores = fly(policy, seeds, times=count)["score"]
    except ValueError as problem:
        if not _overflow(problem):
            raise
        return None
    return [_mean(each) for each in np.split(scores, count)]


def _mean(scores: Any) -> float:
    value = float(scores.mean())
    return value if np.isfinite(value) else OVERFLOWED


def _overflow(problem: ValueError) -> bool:
    """Whether a law or the simulation refused numbers that are not finite."""
    return "expected finite numbers" in str(problem)


def mean_scores(
    tunable: Tunable,
    config: FormationConfig,
    candidates: Sequence[Any],
    seeds: range,
    pool: ThreadPoolExecutor,
) -> list[float]:
    """The mean score of each of the candidates, which are gains of `tunable`, over the seeds."""
    most = max(1, VEHICLES // ((config.followers + 1) * len(seeds)))
    groups = [candidates[i : i + most] for i in range(0, len(candidates), most)]
    # Made here, not in the threads: silencing warnings, as `configure` does, is not thread-safe.
    stacks = [tunable.stack(config, group, len(seeds)) for group in groups]
    together = list(
        pool.map(
            lambda stack, group: stack and stacked_scores(stack, seeds, len(group)), stacks, groups
        )
    )
    left = [g for group, found in zip(groups, together, strict=True) if not found for g in group]
    policies = [tunable.policy(config, gains) for gains in left]
    alone = pool.map(lambda policy: mean_score(policy, seeds), policies)
    return [
        score
        for group, found in zip(groups, together, strict=True)
        for score in found or islice(alone, len(group))
    ]
