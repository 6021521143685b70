"""Flights that several tests of `baselines.replay` look at, each flown once."""

from __future__ import annotations

from functools import cache
from typing import Any

from baselines.registry import recipe
from baselines.replay import Episode
from baselines.replay.recording import fly
from formation_env import configure


@cache
def flown(policy: str = "expert", seed: int = 3, **fields: Any) -> Episode:
    """An episode of a policy on the scenario given by `fields`, `nominal` for two seconds by default."""
    config = configure(**{"scenario": "nominal", "duration": 2.0, **fields})
    return fly(recipe(policy, config), config, seed, policy)
