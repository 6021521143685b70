"""What a baseline is: a function from observations to actions, batched over worlds and followers.

One implementation serves one world and ten thousand: observations come as rows of any leading shape
whose last axis is one follower's row, or one world's rows side by side, and actions go back in the
same form.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation_env import FormationConfig

Rows = NDArray[np.float32]


class Policy(ABC):
    """A policy for one configuration.

    Subclasses implement `begin` and `decide` on rows `(worlds, followers, entries)`, and those that
    remember also `begin_again`. They are final.
    """

    name: str

    def __init__(self, config: FormationConfig) -> None:
        self.config = config
        self.layout = config.layout
        self._worlds = -1

    def reset(self, seed: int | None = None, worlds: int = 1) -> None:
        """Forget everything: episodes begin in `worlds` worlds. World i draws from `seed + i`.

        `act` calls it by itself when it first sees a number of worlds; with a policy that remembers,
        call it whenever the environments are reset.
        """
        self._worlds = worlds
        first = 0 if seed is None else seed
        self.begin(np.arange(first, first + worlds, dtype=np.uint64))

    def restart(self, mask: NDArray[np.bool_]) -> None:
        """Episodes begin in the worlds of `mask`, shape `(worlds,)`; in the others they go on.

        For worlds that are reset one by one: call it with the next observations still to come. Raises
        `ValueError` for any other shape or type.
        """
        mask = np.asarray(mask)
        if mask.shape != (self._worlds,) or mask.dtype != np.bool_:
            raise ValueError(
                f"mask is {mask.dtype} {mask.shape}: expected bool ({max(self._worlds, 0)},), an entry "
                "for each world of the last reset"
            )
        if mask.any():
            self.begin_again(mask)

    def act(self, observation: NDArray[Any]) -> Rows:
        """Actions for observations of shape `(entries,)`, `(followers, entries)`, `(worlds,
        followers, entries)` or with the followers' entries side by side, as the Gymnasium faces
        give them. Raises `ValueError` for any other shape.
        """
        n, size, k = self.config.followers, self.layout.size, self.config.action_size
        observation = np.asarray(observation, dtype=np.float32)
        shape = observation.shape
        if shape in ((n * size,), (n, size)):
            worlds = 1
            result: tuple[int, ...] = (n * k,) if len(shape) == 1 else (n, k)
        elif len(shape) == 2 and shape[1] == n * size:
            worlds, result = shape[0], (shape[0], n * k)
        elif len(shape) == 3 and shape[1:] == (n, size):
            worlds, result = shape[0], (shape[0], n, k)
        else:
            raise ValueError(
                f"observation has shape {shape}: expected ({n}, {size}), ({n * size},), or either "
                "with the number of worlds in front"
            )
        if worlds != self._worlds:
            self.reset(worlds=worlds)
        return self.decide(observation.reshape(worlds, n, size)).reshape(result)

    @abstractmethod
    def begin(self, seeds: NDArray[np.uint64]) -> None:
        """Start episodes, one world per seed."""

    def begin_again(self, mask: NDArray[np.bool_]) -> None:  # noqa: B027
        """Start new episodes in the worlds of `mask`. Nothing to do for who remembers nothing."""

    @abstractmethod
    def decide(self, rows: Rows) -> Rows:
        """Actions `(worlds, followers, action_size)` for rows `(worlds, followers, entries)`."""
