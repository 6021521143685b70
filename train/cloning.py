"""What behaviour cloning and DAgger are made of.

Flights that a teacher comments on, a bounded memory of them, and a network fitted to what it said.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, cast, final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from baselines.files import Card, Network
from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from formation_env import FormationConfig
from formation_env.simulation import Simulation, seeded_key
from formation_env.task import Layout
from train.evaluation import TRAINING_SEEDS
from train.scales import CLIP, fixed_scales

Rows = NDArray[np.float32]

# Entries that a teacher who keeps to its slot does not go by: where in the world it flies, and in which
# direction, would let a clone learn the leader's trajectory by heart.
UNSEEN = ("position", "heading")
# An action's entry whose labels are nearly constant counts as this part of the largest, so that the
# clone does not spend itself on rounding errors.
_QUIET = 1e-3


@final
class Memory:
    """The last `ticks` ticks of `rows` followers, labelled; the oldest are overwritten.

    Inputs of a network are put together when asked for, so that a history costs no memory.
    """

    def __init__(self, ticks: int, rows: int, entries: int, size: int, history: int) -> None:
        self.history, self.ticks = history, ticks
        self.seen = np.zeros((ticks, rows, entries), dtype=np.float32)
        self.labels = np.zeros((ticks, rows, size), dtype=np.float32)
        self._age = np.zeros((ticks, rows), dtype=np.int64)  # ticks since the episode began
        self.count = 0  # ticks ever taken in

    def add(self, seen: Rows, age: NDArray[np.int64]) -> None:
        """Take in a tick's observations `(rows, entries)`."""
        at = self.count % self.ticks
        self.seen[at], self._age[at] = seen, age
        self.count += 1

    def label(self, actions: Rows) -> None:
        """Note what the teacher does at the tick taken in last, `(rows, size)`."""
        self.labels[(self.count - 1) % self.ticks] = actions

    def inputs(self, ticks: NDArray[np.int64], rows: NDArray[np.int64]) -> Rows:
        """The last observations before and at these ticks (counted from the first ever), newest last,
        `(N, history * entries)`; before an episode's first observation that one again."""
        age = self._age[ticks % self.ticks, rows]
        back = np.minimum(np.arange(self.history - 1, -1, -1), age[:, None])
        chosen = self.seen[(ticks[:, None] - back) % self.ticks, rows[:, None]]
        return np.asarray(chosen.reshape(len(ticks), -1))

    def everything(self) -> tuple[Rows, Rows]:
        """All observations and labels, `(N, ...)` each."""
        kept = min(self.count, self.ticks)
        seen, labels = self.seen[:kept], self.labels[:kept]
        return seen.reshape(-1, seen.shape[-1]), labels.reshape(-1, labels.shape[-1])

    def draw(
        self, rng: np.random.Generator, count: int, first: int, last: int
    ) -> tuple[Rows, Rows]:
        """Random inputs and labels of the rows from `first` to before `last`."""
        oldest = max(0, self.count - self.ticks)
        begin = oldest + self.history - 1 if oldest else 0
        ticks = rng.integers(begin, self.count, count)
        rows = rng.integers(first, last, count)
        return self.inputs(ticks, rows), self.labels[ticks % self.ticks, rows]


@final
class Clone(nn.Module):
    """A perceptron on the last observations, fitted to labels in units of their size.

    Observations are normalised as PPO's are, by fixed scales, and then standardised by what was
    measured, which only eases the fit: in a policy file it is part of the first layer, and the labels'
    size part of the last.
    """

    mean: Tensor
    scale: Tensor
    centre: Tensor
    gain: Tensor
    size: Tensor

    def __init__(
        self,
        config: FormationConfig,
        history: int,
        hidden: tuple[int, ...],
        activation: str,
        magnify: float = 50.0,
    ) -> None:
        super().__init__()
        self._magnify = magnify
        mean, scale = fixed_scales(config.layout)
        self.register_buffer("mean", torch.from_numpy(np.tile(mean, history)))
        self.register_buffer("scale", torch.from_numpy(np.tile(scale, history)))
        self.register_buffer("centre", torch.zeros(len(mean) * history))
        self.register_buffer("gain", torch.ones(len(mean) * history))
        self.register_buffer("size", torch.ones(config.action_size))
        widths = [len(mean) * history, *hidden, config.action_size]
        self.linear = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self._activation = torch.tanh if activation == "tanh" else torch.relu
        self._entries, self._history = len(mean), history

    def fit_to(self, seen: Rows, labels: Rows, layout: Layout) -> None:
        """Take the standardisation from observations `(N, entries)` and their labels."""
        entries = self._entries
        x = (seen - self.mean[:entries].numpy()) / self.scale[:entries].numpy()
        gain = 1.0 / np.maximum(x.std(axis=0), 1.0 / self._magnify)
        for name in UNSEEN:
            gain[layout.slices[name]] = 0.0
        gain[layout.first_neighbour :] = 0.0
        size = np.sqrt((labels.astype(np.float64) ** 2).mean(axis=0))
        size = np.maximum(size, max(_QUIET * size.max(), 1e-6))
        for buffer, value in ((self.centre, x.mean(axis=0)), (self.gain, gain)):
            buffer.copy_(torch.from_numpy(np.tile(value, self._history)))
        self.size.copy_(torch.from_numpy(size))

    def forward(self, inputs: Tensor) -> Tensor:
        """Actions in units of the labels' size, unclipped."""
        x = ((inputs - self.mean) / self.scale).clamp(-CLIP, CLIP)
        x = (x - self.centre) * self.gain
        for layer in self.linear[:-1]:
            x = self._activation(layer(x))
        result: Tensor = self.linear[-1](x)
        return result

    def act(self, inputs: Rows) -> Rows:
        """Actions for inputs `(N, history * entries)`."""
        with torch.no_grad():
            actions = self(torch.from_numpy(inputs)) * self.size
        return np.asarray(actions.clamp(-1.0, 1.0).numpy())

    def network(self) -> Network:
        """The numbers for a policy file."""
        layers = [cast(nn.Linear, layer) for layer in self.linear]
        with torch.no_grad():
            weights = [layer.weight.double() for layer in layers]
            biases = [layer.bias.double() for layer in layers]
            weights[0] = weights[0] * self.gain
            biases[0] = biases[0] - weights[0] @ self.centre.double()
            weights[-1] = weights[-1] * self.size[:, None]
            biases[-1] = biases[-1] * self.size
        return Network(
            tuple(w.float().numpy() for w in weights),
            tuple(b.float().numpy() for b in biases),
            self.mean[: self._entries].numpy().copy(),
            self.scale[: self._entries].numpy().copy(),
        )

    def card(self, config: FormationConfig, method: str, **rest: Any) -> Card:
        """What the file says about it."""
        return Card(
            action=config.action,
            entries=self._entries,
            action_size=config.action_size,
            scenario=config.scenario,
            method=method,
            activation="tanh" if self._activation is torch.tanh else "relu",
            history=self._history,
            clip=CLIP,
            **rest,
        )


@final
class Flight:
    """Worlds that fly on and on while a teacher says what it would do; ended ones begin again.

    The teacher sees what the worlds show, whoever flies them, so that what it remembers fits. First
    episodes end early, at random ages, so that the worlds are not all in the same phase ever after.

    With `residual` > 0 the expert flies underneath, and what is learned is the correction that makes its
    action the teacher's, in units of `residual` and clipped to [-1, 1]. The teacher too then flies with
    the clipped correction: better a policy of this kind cannot be.
    """

    explore = 0.0  # standard deviation of white noise on everything that is executed, labels' unit

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
        self._residual = np.float32(residual)
        self._expert = Expert(config) if residual > 0.0 else None
        self.rng = np.random.default_rng(seed)
        self.simulation = Simulation(config, worlds, threads)
        for world in range(worlds):
            self.simulation.seed(world, seeded_key(TRAINING_SEEDS + worlds * seed + world))
        teacher.reset(seed=seed, worlds=worlds)
        if self._expert is not None:
            self._expert.reset(worlds=worlds)
        self._seen = self.simulation.reset().observations
        self._age = np.zeros(worlds, dtype=np.int64)
        self._left = self.rng.integers(1, config.max_steps + 1, worlds)  # ticks to an early end
        self._noise = np.zeros((worlds, config.followers, config.action_size))

    def fly(
        self,
        ticks: int,
        memory: Memory,
        clone: Clone | None = None,
        share: float = 1.0,
        stray: float = np.inf,
        noise: NDArray[Any] | None = None,
    ) -> None:
        """Fly on for so many ticks and note everything in `memory`.

        The teacher flies about `share` of the worlds, the clone, if there is one, the others, drawn
        anew each time. Where the teacher wants more than `stray` times the labels' size, the clone has
        lost it, and the world begins again. `noise` `(action_size,)` is the standard deviation of what
        is added to what they do, in the labels' unit.
        """
        taught = self.rng.random(self.worlds) < share
        n = self.config.followers
        everyone = np.arange(self.worlds * n)
        for _ in range(ticks):
            memory.add(self._seen.reshape(self.worlds * n, -1), np.repeat(self._age, n))
            labels, below = self._ask()
            memory.label(labels.reshape(self.worlds * n, -1))
            actions: NDArray[Any] = labels
            if clone is not None and not taught.all():
                now = np.full(len(everyone), memory.count - 1)
                own = clone.act(memory.inputs(now, everyone)).reshape(labels.shape)
                actions = np.where(taught[:, None, None], labels, own)
                far = np.abs(labels) > stray * clone.size.numpy()
                self._left[far.any(axis=(1, 2))] = 1
            if noise is not None:
                actions = actions + self._disturbance(noise)
            if self.explore > 0.0:
                actions = actions + self.explore * self.rng.standard_normal(actions.shape)
            self._step(self._executed(actions.astype(np.float32), below))

    def _ask(self) -> tuple[Rows, Rows | None]:
        """What is to be learned at these observations, and the action underneath if there is one."""
        wanted = self.teacher.act(self._seen)
        if self._expert is None:
            return wanted, None
        below = self._expert.act(self._seen)
        return np.clip((wanted - below) / self._residual, -1.0, 1.0), below

    def _executed(self, actions: Rows, below: Rows | None) -> Rows:
        """The action itself, or with the one underneath that it corrects; as `Learned` flies it."""
        actions = np.clip(actions, -1.0, 1.0)
        if below is None:
            return actions
        return np.asarray(np.clip(below + self._residual * actions, -1.0, 1.0))

    def _disturbance(self, deviation: NDArray[Any]) -> NDArray[np.float64]:
        """Coloured noise, with a memory of about ten ticks: white noise hardly moves a vehicle."""
        keep = 0.9
        draw = self.rng.standard_normal(self._noise.shape)
        self._noise = keep * self._noise + np.sqrt(1.0 - keep * keep) * draw
        return np.asarray(self._noise * deviation)

    def _step(self, actions: Rows) -> None:
        results = self.simulation.step(actions)
        self._seen = results.observations
        self._age += 1
        self._left -= 1
        done = results.terminated | results.truncated | (self._left == 0)
        if done.any():
            self._seen = self.simulation.reset(done).observations
            self._age[done], self._left[done] = 0, -1
            self.teacher.restart(done)
            if self._expert is not None:
                self._expert.restart(done)
