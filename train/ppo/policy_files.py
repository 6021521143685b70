"""From PPO's policy to a policy file's network, and back."""

from __future__ import annotations

import torch

from baselines.files import Card, Network
from train.ppo.networks import FollowerPolicy
from train.scales import CLIP, state_scales


def actor_network(policy: FollowerPolicy, entries: int) -> Network:
    """The actor with its normalisation, for observations of so many entries, as a policy file has it."""
    layers, normalisation = policy.actor_layers(), policy.mlp_extractor
    weights = [layer.weight.detach().clone() for layer in layers]
    biases = [layer.bias.detach().clone() for layer in layers]
    weights[-1] *= policy.gain
    biases[-1] *= policy.gain
    return Network(
        tuple(w.numpy() for w in weights),
        tuple(b.numpy() for b in biases),
        normalisation.mean[:entries].numpy().copy(),
        normalisation.scale[:entries].numpy().copy(),
    )


def hidden_sizes(network: Network) -> list[int]:
    """Widths of a network's hidden layers."""
    return [len(bias) for bias in network.biases[:-1]]


def load_actor(policy: FollowerPolicy, card: Card, network: Network, followers: int) -> None:
    """Make the actor that of a policy file whose hidden layers are as wide; the exploration stays.

    Raises `ValueError` if the file's inputs are clipped to another bound than here.
    """
    if card.clip != CLIP:
        raise ValueError(f"clip = {card.clip:g} in the policy: expected {CLIP:g}")
    last = len(network.weights) - 1
    with torch.no_grad():
        for i, layer in enumerate(policy.actor_layers()):
            factor = 1.0 / policy.gain if i == last else 1.0
            layer.weight.copy_(factor * torch.from_numpy(network.weights[i]))
            layer.bias.copy_(factor * torch.from_numpy(network.biases[i]))
    layers = policy.mlp_extractor
    central = len(layers.mean) > layers.actor_inputs
    policy.set_normalisation(
        network.mean, network.scale, state_scales(followers) if central else None
    )
