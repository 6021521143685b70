"""What environments with a row per follower share: seeds, early ends, rewards, the central state.

Row = world * followers + follower.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from formation_env.core.results import Results
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.interface import faces
from formation_env.task import COLUMNS, REWARD

Mask = NDArray[np.bool_]


def seed_worlds(simulation: Simulation, first: int) -> None:
    """Let world w draw from the stream of seed `first + w` from its next episode on."""
    for world in range(simulation.num_worlds):
        simulation.seed(world, seeded_key(first + world))


def follower_rewards(results: Results) -> NDArray[np.float64]:
    """Each follower's own reward of this tick, `(worlds, followers)`."""
    return results.outputs[..., REWARD]


def central_state(simulation: Simulation, results: Results) -> NDArray[np.float32]:
    """Each row's world as PettingZoo's `state()` has it, `(worlds * followers, numbers)`."""
    slots = results.outputs[..., COLUMNS["slot"]]
    return np.repeat(faces.states(simulation, slots), simulation.config.followers, axis=0)


@final
class EarlyEnds:
    """Ends episodes early, as if at the time limit: `left` ticks from now, int64 `(worlds,)`; -1 never.

    Worlds whose first episodes end at random ages ("staggered") do not begin and end together ever
    after, so that a batch holds all phases of an episode.
    """

    def __init__(self, worlds: int) -> None:
        self.left = np.full(worlds, -1, dtype=np.int64)

    def stagger(self, rng: np.random.Generator, max_steps: int) -> None:
        """End each world's present episode at a random age from 1 to `max_steps`, if it has just begun."""
        self.left[:] = rng.integers(1, max_steps + 1, len(self.left))

    def tick(self, flown: Any = slice(None)) -> Mask:
        """Count one control tick in the worlds `flown`; the worlds whose episode ends by it, `(worlds,)`."""
        self.left[flown] -= 1
        return np.equal(self.left, 0)

    def end_next(self, worlds: Any) -> None:
        """End the present episodes of these worlds with the next tick."""
        self.left[worlds] = 1

    def cancel(self, worlds: Any = slice(None)) -> None:
        """Let the present episodes of these worlds last."""
        self.left[worlds] = -1
