"""The samples that a clone is fitted to: observations with the teacher's actions, the oldest overwritten."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.float32]
Indices = NDArray[np.int64]


@final
class SampleBuffer:
    """Observations `(ticks, rows, entries)` and labels `(ticks, rows, size)` of the last `ticks` ticks.

    A row is a follower, a label the teacher's action or correction. The network's inputs, with a history of
    observations, are put together when asked for, so that a history costs no memory.
    """

    def __init__(self, ticks: int, rows: int, entries: int, size: int, history: int) -> None:
        self.history, self.ticks = history, ticks
        self.observations = np.zeros((ticks, rows, entries), dtype=np.float32)
        self.labels = np.zeros((ticks, rows, size), dtype=np.float32)
        self.ages = np.zeros((ticks, rows), dtype=np.int64)  # ticks since the episode began
        self.count = 0  # ticks ever added

    def add(self, observations: Rows, ages: Indices) -> None:
        """Add a tick's observations `(rows, entries)` and how old the episodes are, `(rows,)` ticks."""
        at = self.count % self.ticks
        self.observations[at], self.ages[at] = observations, ages
        self.count += 1

    def label(self, actions: Rows) -> None:
        """Set the labels `(rows, size)` of the tick that was added last."""
        self.labels[(self.count - 1) % self.ticks] = actions

    def inputs(self, ticks: Indices, rows: Indices) -> Rows:
        """The network's inputs `(N, history * entries)` at N ticks, counted from the first ever, and rows.

        The observations before and at the tick, newest last; before an episode's first observation that
        one again.
        """
        age = self.ages[ticks % self.ticks, rows]
        back = np.minimum(np.arange(self.history - 1, -1, -1), age[:, None])
        chosen = self.observations[(ticks[:, None] - back) % self.ticks, rows[:, None]]
        return np.asarray(chosen.reshape(len(ticks), -1))

    def all_samples(self) -> tuple[Rows, Rows]:
        """All observations `(N, entries)` and labels `(N, size)`."""
        kept = min(self.count, self.ticks)
        observations, labels = self.observations[:kept], self.labels[:kept]
        flat = observations.reshape(-1, observations.shape[-1])
        return flat, labels.reshape(-1, labels.shape[-1])

    def draw(
        self, rng: np.random.Generator, count: int, first: int, last: int
    ) -> tuple[Rows, Rows]:
        """Random inputs and labels, `count` of each, of the rows from `first` to before `last`."""
        oldest = max(0, self.count - self.ticks)
        begin = oldest + self.history - 1 if oldest else 0
        ticks = rng.integers(begin, self.count, count)
        rows = rng.integers(first, last, count)
        return self.inputs(ticks, rows), self.labels[ticks % self.ticks, rows]
