"""Policies to compare with: doing nothing and doing anything."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.base import Policy, Rows
from formation_env import FormationConfig
from formation_env._jit import kernel
from formation_env.maths.rng import POLICY, uniforms


@final
class Hover(Policy):
    """The zero action: level hovering thrust and no turning, or an unaccelerated virtual follower."""

    name = "hover"

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        pass

    def decide(self, rows: Rows) -> Rows:
        return np.zeros((*rows.shape[:2], self.config.action_size), dtype=np.float32)


@kernel
def _draw(seeds: NDArray[np.uint64], tick: int, actions: Rows) -> None:
    worlds, n, size = actions.shape
    for w in range(worlds):
        for i in range(n):
            u = uniforms(seeds[w], POLICY, i, tick, 0)
            for k in range(size):
                actions[w, i, k] = 2.0 * u[k] - 1.0


@final
class Random(Policy):
    """Uniform in [-1, 1], anew every tick. A draw depends on the world's seed, follower and tick only.

    The tick is counted from `reset`: a world that is restarted goes on drawing.
    """

    name = "random"

    def __init__(self, config: FormationConfig) -> None:
        super().__init__(config)
        self._seeds = np.zeros(0, dtype=np.uint64)
        self._tick = 0

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        self._seeds = seeds.copy()
        self._tick = 0

    def decide(self, rows: Rows) -> Rows:
        actions = np.empty((*rows.shape[:2], self.config.action_size), dtype=np.float32)
        _draw(self._seeds, self._tick, actions)
        self._tick += 1
        return actions
