"""Networks of random numbers with their cards, and policy files made without `save`."""

from __future__ import annotations

import json
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save as serialise

from baselines.files import Card, Network
from formation_env import FormationConfig, configure

NOMINAL = configure("nominal")
ENTRIES = NOMINAL.layout.size


def card(config: FormationConfig = NOMINAL, **changed: Any) -> Card:
    usual: dict[str, Any] = {
        "action": config.action,
        "entries": config.layout.size,
        "action_size": config.action_size,
        "scenario": "nominal",
        "method": "ppo",
        "command": "python -m train.ppo --seed 3",
        "seed": 3,
        "steps": 1_000_000,
        "minutes": 12.5,
        "package": "0.1.0",
        "score": {"nominal": [0.9, 0.88, 0.92]},
    }
    return Card(**{**usual, **changed})


def network(own: Card, hidden: tuple[int, ...] = (37, 51), seed: int = 0) -> Network:
    """Numbers drawn at random, so that outputs lie on both sides of the clipping."""
    rng = np.random.default_rng(seed)
    sizes = [own.history * own.entries, *hidden, own.action_size]

    def draw(*shape: int) -> NDArray[np.float32]:
        return np.asarray(rng.normal(size=shape) / np.sqrt(shape[-1]), dtype=np.float32)

    return Network(
        tuple(draw(b, a) for a, b in pairwise(sizes)),
        tuple(draw(b) for b in sizes[1:]),
        draw(own.entries),
        rng.uniform(0.3, 2.0, own.entries).astype(np.float32),
    )


def looks(*shape: int, seed: int = 1) -> NDArray[np.float32]:
    """Observations `(*shape, followers, entries)`."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(*shape, 2, ENTRIES)).astype(np.float32)


def tensors(own: Network) -> dict[str, NDArray[np.float32]]:
    named = {"mean": own.mean, "scale": own.scale}
    for i, (weight, bias) in enumerate(zip(own.weights, own.biases, strict=True)):
        named |= {f"layers.{i}.weight": weight, f"layers.{i}.bias": bias}
    return named


def written(
    path: Path, named: dict[str, Any] | None = None, text: str | None = None, key: str = "formation"
) -> Path:
    """A file made without `save`, from tensors and the text of a card."""
    named = tensors(network(card())) if named is None else named
    text = json.dumps(asdict(card())) if text is None else text
    path.write_bytes(serialise(named, {key: text}))
    return path
