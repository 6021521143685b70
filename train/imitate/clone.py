"""The network that is fitted to a teacher's actions."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, cast, final

import numpy as np
import torch
from torch import Tensor, nn

from baselines.files import Card, Network
from formation_env import FormationConfig
from formation_env.task import Layout
from train.imitate.buffer import Rows
from train.scales import CLIP, fixed_scales

# Fields of an observation that a clone ignores. A teacher that keeps to its slot does not depend on them,
# and where in the world it flies, and in which direction, would let a clone learn the leader's trajectory
# by heart.
IGNORED_FIELDS = ("position", "heading")
# Least size of an entry of the labels, as part of the largest entry's, so that the fit does not go into the
# rounding errors of entries that are nearly constant.
_LEAST_SIZE = 1e-3


@final
class Clone(nn.Module):
    """A perceptron on the last observations, fitted to labels in units of their size.

    Observations are normalised as PPO's are, by fixed scales, and then standardised by the samples' mean
    and deviation, which only eases the fit: in a policy file it is part of the first layer, and the labels'
    size part of the last. `magnify` is the largest factor of the standardisation.
    """

    mean: Tensor  # of the normalisation, (history * entries,)
    scale: Tensor
    centre: Tensor  # of the standardisation, (history * entries,)
    gain: Tensor
    size: Tensor  # root mean square of the labels, (action_size,)

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

    def standardise(self, observations: Rows, labels: Rows, layout: Layout) -> None:
        """Take the standardisation and the labels' size from samples `(N, entries)` and `(N, size)`."""
        entries = self._entries
        x = (observations - self.mean[:entries].numpy()) / self.scale[:entries].numpy()
        gain = 1.0 / np.maximum(x.std(axis=0), 1.0 / self._magnify)
        for name in IGNORED_FIELDS:
            gain[layout.slices[name]] = 0.0
        gain[layout.first_neighbour :] = 0.0
        size = np.sqrt((labels.astype(np.float64) ** 2).mean(axis=0))
        size = np.maximum(size, max(_LEAST_SIZE * size.max(), 1e-6))
        for buffer, value in ((self.centre, x.mean(axis=0)), (self.gain, gain)):
            buffer.copy_(torch.from_numpy(np.tile(value, self._history)))
        self.size.copy_(torch.from_numpy(size))

    def forward(self, inputs: Tensor) -> Tensor:
        """Actions in units of the labels' size, unclipped, for inputs `(N, history * entries)`."""
        x = ((inputs - self.mean) / self.scale).clamp(-CLIP, CLIP)
        x = (x - self.centre) * self.gain
        for layer in self.linear[:-1]:
            x = self._activation(layer(x))
        result: Tensor = self.linear[-1](x)
        return result

    def act(self, inputs: Rows) -> Rows:
        """Actions `(N, action_size)` for inputs `(N, history * entries)`."""
        with torch.no_grad():
            actions = self(torch.from_numpy(inputs)) * self.size
        return np.asarray(actions.clamp(-1.0, 1.0).numpy())

    def network(self) -> Network:
        """The network as a policy file has it."""
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
        """The policy file's card; `rest` are its fields about the run."""
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
