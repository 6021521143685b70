"""A policy that was trained for one task and flies another: what differs, in a warning."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from functools import lru_cache

from baselines.files import Card
from formation_env import SCENARIOS, FormationConfig, configure
from formation_env.validation.checks import shown
from formation_env.validation.warning import warn_user

# How an episode begins, how long it lasts and what it is worth: training may choose those freely.
_FREE = (
    "scenario",
    "duration",
    "reward",
    "limits",
    "start",
    "start_offset",
    "leader_start",
    "follower_starts",
)


class TransferWarning(UserWarning):
    """A policy flies another task than it was trained for, which few policies survive."""


@lru_cache(maxsize=64)
def _trained_on(scenario: str, action: str) -> FormationConfig:
    return configure(scenario, action=action)


def differences(card: Card, config: FormationConfig) -> list[str]:
    """How a configuration differs from what the card says the policy was trained for, each in words."""
    if card.scenario != config.scenario:
        return [f"scenario {shown(config.scenario)} with {_follower_count(config.followers)}"]
    if card.scenario not in SCENARIOS:  # one of the user's own, which the card does not describe
        return []
    own = _trained_on(card.scenario, card.action)
    names = [f.name for f in fields(config) if f.name not in _FREE]
    changed = [name for name in names if getattr(own, name) != getattr(config, name)]
    if own.followers != config.followers:
        changed = [
            _follower_count(config.followers),
            *(name for name in changed if name != "offsets"),
        ]
    return changed


@contextmanager
def transfer_unwarned() -> Iterator[None]:
    """Within, `TransferWarning` is not given: for results that mark such a policy themselves."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TransferWarning)
        yield


def warn_of_transfer(card: Card, config: FormationConfig) -> None:
    """Warn with `TransferWarning` where a policy flies another task than its card names."""
    changed = differences(card, config)
    if not changed:
        return
    trained = f"scenario {card.scenario!r} at action level {card.action!r}"
    if card.scenario in SCENARIOS:
        trained += f" with {_follower_count(_trained_on(card.scenario, card.action).followers)}"
    message = (
        f"policy ({card.method}) trained on {trained} flies another task: {', '.join(changed)}"
    )
    warn_user(f"{message}. Expect less of it, or a crash", TransferWarning)


def _follower_count(followers: int) -> str:
    return f"{followers} follower{'' if followers == 1 else 's'}"
