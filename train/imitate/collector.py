"""Flies worlds and labels every observation with the teacher's action."""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.actions import clipped, corrected, correction_towards
from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from formation_env import FormationConfig
from formation_env.core.simulation import Simulation
from train.imitate.buffer import Rows, SampleBuffer
from train.imitate.clone import Clone
from train.rows import EarlyEnds, seed_worlds
from train.seeds import first_training_seed

# Part of the slow noise that stays from tick to tick: a memory of about ten ticks.
_NOISE_KEPT = 0.9


class Mixture(NamedTuple):
    """How worlds are shared between teacher and clone."""

    clone: Clone
    share: float  # part of the worlds that the teacher flies, 0 to 1
    stray: float = np.inf  # the labels' size times this ends an episode


@final
class Collector:
    """Worlds that are flown on from call to call; where an episode ends, the next begins.

    The teacher acts on the observations of all worlds, whether it or the clone flies them, so that what it
    remembers belongs to them. First episodes end early, at random ages, so that the worlds are not all in
    the same phase ever after.

    With `residual` > 0 the label is the correction to the expert's action that makes it the teacher's, in
    units of `residual` and clipped to [-1, 1]; and the teacher is flown with the clipped correction, since
    no policy of this kind can do better.
    """

    explore = 0.0  # standard deviation of white noise on executed actions, in the labels' unit

    def __init__(
        self,
        config: FormationConfig,
        teacher: Policy,
        worlds: int,
        seed: int,
        threads: int = 1,
        residual: float = 0.0,
    ) -> None:
        self.config, self.teacher, self.worlds = config, teacher, worlds
        self._residual = residual
        self._expert = Expert(config) if residual > 0.0 else None
        self.rng = np.random.default_rng(seed)
        self.simulation = Simulation(config, worlds, threads)
        seed_worlds(self.simulation, first_training_seed(seed, worlds))
        teacher.reset(seed=seed, worlds=worlds)
        if self._expert is not None:
            self._expert.reset(worlds=worlds)
        self._observations = self.simulation.reset().observations
        self._ages = np.zeros(worlds, dtype=np.int64)  # ticks since the episode began
        self.early_ends = EarlyEnds(worlds)
        self.early_ends.stagger(self.rng, config.max_steps)
        self._slow_noise = np.zeros((worlds, config.followers, config.action_size))

    def collect(
        self,
        ticks: int,
        buffer: SampleBuffer,
        mixture: Mixture | None = None,
        noise: NDArray[Any] | None = None,
    ) -> None:
        """Fly so many ticks and add every observation with its label to the buffer.

        Without a `mixture` the teacher flies all worlds. With one it flies about `share` of them, drawn anew
        for each call, and the clone the others; where a label is larger than `stray` times the labels'
        size, the clone has lost the formation, and the world begins again. `noise` `(action_size,)` is the
        standard deviation of slow noise that is added to actions, in the labels' unit.
        """
        share = 1.0 if mixture is None else mixture.share
        by_teacher = self.rng.random(self.worlds) < share
        n = self.config.followers
        for _ in range(ticks):
            observations = self._observations.reshape(self.worlds * n, -1)
            buffer.add(observations, np.repeat(self._ages, n))
            labels, expert = self._labels()
            buffer.label(labels.reshape(self.worlds * n, -1))
            actions: NDArray[Any] = labels
            if mixture is not None and not by_teacher.all():
                actions = self._mixed(labels, mixture, buffer, by_teacher)
            if noise is not None:
                actions = actions + self._next_slow_noise(noise)
            if self.explore > 0.0:
                actions = actions + self.explore * self.rng.standard_normal(actions.shape)
            self._step(self._executed(actions.astype(np.float32), expert))

    def _mixed(
        self, labels: Rows, mixture: Mixture, buffer: SampleBuffer, by_teacher: NDArray[np.bool_]
    ) -> NDArray[Any]:
        """The labels in the teacher's worlds, the clone's actions in the others."""
        rows = np.arange(self.worlds * self.config.followers)
        inputs = buffer.inputs(np.full(len(rows), buffer.count - 1), rows)
        clones = mixture.clone.act(inputs).reshape(labels.shape)
        lost = np.abs(labels) > mixture.stray * mixture.clone.size.numpy()
        self.early_ends.end_next(lost.any(axis=(1, 2)))
        return np.where(by_teacher[:, None, None], labels, clones)

    def _labels(self) -> tuple[Rows, Rows | None]:
        """The labels of the present observations, and the expert's action if that is corrected."""
        wanted = self.teacher.act(self._observations)
        if self._expert is None:
            return wanted, None
        expert = self._expert.act(self._observations)
        return correction_towards(wanted, expert, self._residual), expert

    def _executed(self, actions: Rows, expert: Rows | None) -> Rows:
        """The action itself, or the expert's corrected by it."""
        if expert is None:
            return clipped(actions)
        return corrected(expert, actions, self._residual)

    def _next_slow_noise(self, deviation: NDArray[Any]) -> NDArray[np.float64]:
        """Noise that changes over about ten ticks; white noise hardly moves a vehicle."""
        draw = self.rng.standard_normal(self._slow_noise.shape)
        keep = _NOISE_KEPT
        self._slow_noise = keep * self._slow_noise + np.sqrt(1.0 - keep * keep) * draw
        return np.asarray(self._slow_noise * deviation)

    def _step(self, actions: Rows) -> None:
        """One control tick, after which worlds that end begin their next episode."""
        results = self.simulation.step(actions)
        self._observations = results.observations
        self._ages += 1
        done = results.terminated | results.truncated | self.early_ends.tick()
        if done.any():
            self._observations = self.simulation.reset(done).observations
            self._ages[done] = 0
            self.early_ends.cancel(done)
            self.teacher.restart(done)
            if self._expert is not None:
                self._expert.restart(done)
