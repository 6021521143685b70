"""The task with a margin: what is searched or learned on exact sensors also flies on slightly worse ones.

On exact sensors without delay a higher gain is always better, so that a search ends at the edge of stability:
gains found so scored 0.98 on `nominal` and 0.02 with its measurements one sample later. With the margin
such gains fail while they are searched.
"""

from __future__ import annotations

from typing import Any

from baselines.scoring import changes as tested
from formation_env import FormationConfig, configure
from formation_env.config import NO_NOISE
from formation_env.validation.plain_form import plain

# What the board's robustness is tested with, and accelerations of 0.01 m/s^2.
NOISE = tested.NOISE._replace(acceleration=0.01)
DELAY = tested.LATER  # samples
_FIELDS = ("measurement_delay", "noise")


def with_margin(config: FormationConfig) -> FormationConfig:
    """The task with measurements `DELAY` samples later and of `NOISE`, where its own are exact and
    undelayed; the task itself where they are not."""
    if config.noise != NO_NOISE or config.measurement_delay > 0:
        return config
    return configure(config, measurement_delay=DELAY, noise=NOISE)


def flown_on(config: FormationConfig, margin: bool) -> FormationConfig:
    """`with_margin` if `margin`, else the task itself."""
    return with_margin(config) if margin else config


def changes(config: FormationConfig, flown: FormationConfig) -> dict[str, Any]:
    """What of a margin `flown` has that the task has not, by the names of the fields, as JSON takes it."""
    pairs = ((name, getattr(config, name), getattr(flown, name)) for name in _FIELDS)
    return {name: plain(now, name) for name, own, now in pairs if own != now}
