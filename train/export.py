"""From what was trained to a policy file, and back."""

from __future__ import annotations

import torch

from baselines.files import Card, Network
from train.networks import FollowerPolicy
from train.scales import CLIP, state_scales


def network(policy: FollowerPolicy, entries: int) -> Network:
    """The actor's numbers, for observations of so many entries; the critic stays behind."""
    layers, towers = policy.actor_layers(), policy.mlp_extractor
    weights = [layer.weight.detach().clone() for layer in layers]
    biases = [layer.bias.detach().clone() for layer in layers]
    weights[-1] *= policy.gain
    biases[-1] *= policy.gain
    return Network(
        tuple(w.numpy() for w in weights),
        tuple(b.numpy() for b in biases),
        towers.mean[:entries].numpy().copy(),
        towers.scale[:entries].numpy().copy(),
    )


def hidden_sizes(network: Network) -> list[int]:
    """Widths of a network's hidden layers."""
    return [len(bias) for bias in network.biases[:-1]]


def adopt(policy: FollowerPolicy, card: Card, network: Network, followers: int) -> None:
    """Make the actor that of a policy file, whose hidden layers are as wide.

    The exploration stays as it is. Raises `ValueError` if the file's inputs are clipped elsewhere than
    here.
    """
    if card.clip != CLIP:
        raise ValueError(f"clip = {card.clip:g} in the policy: expected {CLIP:g}")
    last = len(network.weights) - 1
    with torch.no_grad():
        for i, layer in enumerate(policy.actor_layers()):
            factor = 1.0 / policy.gain if i == last else 1.0
            layer.weight.copy_(factor * torch.from_numpy(network.weights[i]))
            layer.bias.copy_(factor * torch.from_numpy(network.biases[i]))
    towers = policy.mlp_extractor
    central = len(towers.mean) > towers.own
    policy.normalise(network.mean, network.scale, state_scales(followers) if central else None)
