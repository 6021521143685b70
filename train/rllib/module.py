"""The network that RLlib trains: an actor that sees what a follower sees, a critic that may see more."""

from __future__ import annotations

from itertools import pairwise
from math import log
from typing import Any, final

import numpy as np
import torch
from numpy.typing import NDArray
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.torch import TorchRLModule
from torch import Tensor, nn

from baselines.files import Network
from train.scales import CLIP

Weights = dict[str, NDArray[np.float32]]


def _perceptron(sizes: list[int], activation: type[nn.Module]) -> nn.Sequential:
    parts: list[nn.Module] = []
    for before, after in pairwise(sizes):
        parts += [nn.Linear(before, after), activation()]
    return nn.Sequential(*parts[:-1])  # the last layer is linear


@final
class FollowerModule(TorchRLModule, ValueFunctionAPI):
    """Two perceptrons on inputs normalised by fixed scales, and a free standard deviation.

    `model_config`: `mean` and `scale` of an observation's entries, `state_scale` of the central state's
    numbers or an empty list, `hidden`, `activation`, `std`. The actor's output times `std`, the standard
    deviation of the exploration at the start, is the action: so a step of the optimiser moves actions by
    about as many deviations at every action level.
    """

    mean: Tensor
    scale: Tensor
    state_scale: Tensor

    def setup(self) -> None:
        """Make the layers."""
        c = self.model_config
        for name in ("mean", "scale", "state_scale"):
            self.register_buffer(name, torch.tensor(c[name], dtype=torch.float32))
        activation = nn.ReLU if c["activation"] == "relu" else nn.Tanh
        entries, state, actions = len(c["mean"]), len(c["state_scale"]), self.action_space.shape[0]
        self.gain: float = c["std"]
        self.actor = _perceptron([entries, *c["hidden"], actions], activation)
        self.critic = _perceptron([entries + state, *c["hidden"], 1], activation)
        self.log_std = nn.Parameter(torch.full((actions,), log(c["std"])))
        with torch.no_grad():
            for parameter in self.actor[-1].parameters():
                parameter.mul_(0.01)

    def _normalised(self, observation: Any) -> Tensor:
        """The follower's own observation, normalised."""
        local = observation["obs"] if isinstance(observation, dict) else observation
        x: Tensor = ((local - self.mean) / self.scale).clamp(-CLIP, CLIP)
        return x

    def _forward(self, batch: dict[str, Any], **_: Any) -> dict[str, Any]:
        mean = self.gain * self.actor(self._normalised(batch[Columns.OBS]))
        return {Columns.ACTION_DIST_INPUTS: torch.cat((mean, self.log_std.expand_as(mean)), -1)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> Tensor:
        """The critic's values `(N,)`, from the observation and, if it is given, the central state."""
        observation = batch[Columns.OBS]
        x = self._normalised(observation)
        if len(self.state_scale):
            state = (observation["state"] / self.state_scale).clamp(-CLIP, CLIP)
            x = torch.cat((x, state), dim=-1)
        values: Tensor = self.critic(x).squeeze(-1)
        return values


def actor_network(weights: Weights, std: float) -> Network:
    """The actor as a policy file has it, from the module's weights; `std` as in its `model_config`."""
    indices = sorted({int(name.split(".")[1]) for name in weights if name.startswith("actor.")})
    parts = {
        kind: [np.array(weights[f"actor.{i}.{kind}"], dtype=np.float32) for i in indices]
        for kind in ("weight", "bias")
    }
    for layers in parts.values():
        layers[-1] *= np.float32(std)
    return Network(
        tuple(parts["weight"]),
        tuple(parts["bias"]),
        np.array(weights["mean"], dtype=np.float32),
        np.array(weights["scale"], dtype=np.float32),
    )
