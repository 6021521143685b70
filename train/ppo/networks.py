"""The policy that PPO trains: an actor that sees what a follower sees, and a critic that may see more.

Both are plain perceptrons on normalised inputs. The normalisation is part of the policy and goes with
the actor into a policy file.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any, final

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor, nn

from formation_env.task import Layout
from train.scales import CLIP, fixed_scales

Array = NDArray[np.float32]

_LEAST_SCALE = 0.1  # a measured scale is at least this part of the fixed one


@final
class ActorCriticLayers(nn.Module):
    """Hidden layers of actor and critic, on normalised inputs `(N, inputs)`.

    The actor sees the first `actor_inputs` of them, the critic all. As Stable-Baselines3's `MlpExtractor`
    otherwise, whose names its layers have.
    """

    mean: Tensor  # (inputs,)
    scale: Tensor  # (inputs,)

    def __init__(
        self, inputs: int, actor_inputs: int, hidden: dict[str, list[int]], relu: bool
    ) -> None:
        super().__init__()
        self.actor_inputs = actor_inputs
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("scale", torch.ones(inputs))
        self.policy_net, self.latent_dim_pi = _perceptron(actor_inputs, hidden["pi"], relu)
        self.value_net, self.latent_dim_vf = _perceptron(inputs, hidden["vf"], relu)

    def _normalised(self, x: Tensor) -> Tensor:
        return ((x - self.mean) / self.scale).clamp(-CLIP, CLIP)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """The last hidden layers of actor and critic."""
        x = self._normalised(features)
        return self.policy_net(x[:, : self.actor_inputs]), self.value_net(x)

    def forward_actor(self, features: Tensor) -> Tensor:
        """The actor's last hidden layer."""
        latent: Tensor = self.policy_net(self._normalised(features)[:, : self.actor_inputs])
        return latent

    def forward_critic(self, features: Tensor) -> Tensor:
        """The critic's last hidden layer."""
        latent: Tensor = self.value_net(self._normalised(features))
        return latent


def _perceptron(inputs: int, hidden: list[int], relu: bool) -> tuple[nn.Sequential, int]:
    parts: list[nn.Module] = []
    for before, after in zip([inputs, *hidden], hidden, strict=False):
        parts += [nn.Linear(before, after), nn.ReLU() if relu else nn.Tanh()]
    return nn.Sequential(*parts), hidden[-1] if hidden else inputs


@final
class FollowerPolicy(ActorCriticPolicy):
    """SB3's actor-critic policy with `ActorCriticLayers`.

    Of an observation the actor sees the first `actor_inputs` numbers. Actions are the actor's output times
    `gain`. With a gain of about the exploration's standard deviation, a step of the optimiser moves actions
    by so many deviations at every action level; at level `wrench`, where the expert's actions are a few
    thousandths, steps would be far too large otherwise.
    """

    mlp_extractor: ActorCriticLayers  # type: ignore[assignment]

    def __init__(self, *args: Any, actor_inputs: int, gain: float = 1.0, **kwargs: Any) -> None:
        self._actor_inputs, self.gain = actor_inputs, gain
        self.rollout_seconds = 0.0  # in forward passes of rollouts, since construction
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        relu = self.activation_fn is nn.ReLU
        assert isinstance(self.net_arch, dict)
        self.mlp_extractor = ActorCriticLayers(
            self.features_dim, self._actor_inputs, self.net_arch, relu
        )

    def _get_action_dist_from_latent(self, latent_pi: Tensor) -> Any:
        return self.action_dist.proba_distribution(
            self.gain * self.action_net(latent_pi), self.log_std
        )

    def forward(self, obs: Any, deterministic: bool = False) -> Any:
        """Actions, values and log-probabilities; timed."""
        start = perf_counter()
        result = super().forward(obs, deterministic)
        self.rollout_seconds += perf_counter() - start
        return result

    def _get_constructor_parameters(self) -> dict[str, Any]:
        parameters = super()._get_constructor_parameters()
        return {**parameters, "actor_inputs": self._actor_inputs, "gain": self.gain}

    def actor_layers(self) -> list[nn.Linear]:
        """The actor's layers from input to output."""
        modules = (*self.mlp_extractor.policy_net, self.action_net)
        return [x for x in modules if isinstance(x, nn.Linear)]

    def actor_parameters(self) -> list[nn.Parameter]:
        """The parameters that actions depend on: the actor's layers and the exploration."""
        return [*(p for layer in self.actor_layers() for p in layer.parameters()), self.log_std]

    def set_normalisation(self, mean: Array, scale: Array, state: Array | None = None) -> None:
        """Set mean and scale of one observation's entries, `(entries,)`, and the scales of the central
        state's numbers, if the critic sees it."""
        layers = self.mlp_extractor
        rest = np.zeros(0, dtype=np.float32) if state is None else state
        history = layers.actor_inputs // len(mean)
        layers.mean.copy_(torch.from_numpy(np.concatenate((np.tile(mean, history), 0.0 * rest))))
        layers.scale.copy_(torch.from_numpy(np.concatenate((np.tile(scale, history), rest))))


@final
class ObservationMoments:
    """Running mean and variance of an observation's entries, as Stable-Baselines3's VecNormalize has them."""

    def __init__(self, layout: Layout) -> None:
        self.count = np.zeros(1)  # observations so far
        self.mean = np.zeros(layout.size)
        self.square = np.zeros(layout.size)  # sum of squared deviations from the mean
        self._least = _LEAST_SCALE * fixed_scales(layout)[1]

    def add(self, rows: NDArray[Any]) -> None:
        """Take in observations `(N, entries)`; Chan's update, exact for any split."""
        rows = rows.astype(np.float64)
        n, mean = len(rows), rows.mean(axis=0)
        total = self.count + n
        gap = mean - self.mean
        self.square += ((rows - mean) ** 2).sum(axis=0) + gap**2 * self.count * n / total
        self.mean += gap * n / total
        self.count = total

    def scales(self) -> tuple[Array, Array]:
        """Mean and standard deviation so far, the latter at least a tenth of the fixed scale."""
        deviation = np.sqrt(self.square / np.maximum(self.count, 1.0))
        return self.mean.astype(np.float32), np.maximum(deviation, self._least).astype(np.float32)
