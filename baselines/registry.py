"""The policies by name: those that are programmed, those that ship as files, other files and code."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from baselines import own
from baselines.files import SUFFIX, Card, load
from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned, Misfit, require_fit
from baselines.policies.simple import Hover, Random
from baselines.policies.textbook import Ff, FfFilter, LeeSlot, LqrSlot
from baselines.policies.textbook_tuned import (
    FfFilterTuned,
    FfTuned,
    LeeTuned,
    LqrTuned,
    Tuned,
    found,
)
from baselines.policies.tuned import ExpertTuned
from formation_env import FormationConfig
from formation_env.validation.checks import require

_PROGRAMMED: tuple[type[Policy], ...] = (
    *(Expert, ExpertTuned),
    *(Ff, FfTuned, FfFilter, FfFilterTuned, LeeSlot, LeeTuned, LqrSlot, LqrTuned),
    *(Hover, Random),
)
POLICIES: dict[str, type[Policy]] = {policy.name: policy for policy in _PROGRAMMED}
# Ways of learning, whose policies are shipped as files, one for a scenario and action level.
METHODS = (
    "ppo",
    "bc",
    "dagger",
    "bc-ppo",
    "dagger-ppo",
    "residual",
    "residual-dagger",
    "residual-dagger-ppo",
)
SHIPPED = Path(__file__).parent / "policies"  # the folder of their files
# A scenario without a file of its own is flown by the file of this one, untrained for the other.
USUAL = "nominal"


class Recipe(NamedTuple):
    """How to make a policy for a configuration, and for a policy file what it holds."""

    make: Callable[[FormationConfig], Policy]
    file: str = ""  # its name without the folder
    card: Card | None = None
    own: str = ""  # name of a user's own policy
    hidden: tuple[int, ...] = ()  # of a policy file: widths of the network's hidden layers


class Unshipped(Misfit):
    """A method of which no file is shipped for the configuration."""


def is_policy(name: object) -> bool:
    """Whether `recipe` may know the name: a policy, a method, a path of a policy file, or code."""
    if not isinstance(name, str):
        return False
    known = name in POLICIES or name in METHODS
    return known or name.endswith(SUFFIX) or own.is_source(name)


def known_names() -> str:
    """What a policy may be, for a message."""
    names = ", ".join(map(repr, (*POLICIES, *METHODS)))
    return f"one of {names}, a path of a *{SUFFIX} file, module:Name or file.py:Name"


def available(configs: Collection[FormationConfig]) -> list[str]:
    """The names of all that can fly at least one of the configurations.

    Without controllers with gains of their own where none were found for any: they would be the plain ones.
    """
    programmed = [
        name
        for name, policy in POLICIES.items()
        if not issubclass(policy, Tuned) or any(found(policy.law, config) for config in configs)
    ]
    methods = [m for m in METHODS if any(_shipped(m, config) for config in configs)]
    return [*programmed, *methods]


def recipe(policy: Any, config: FormationConfig) -> Recipe:
    """How to make a policy for a configuration: by a name, or a user's own as `own` describes.

    Raises `ValueError` listing the names if it is unknown, or saying what is wrong with its file or code;
    and `Misfit`, which is one too, if it exists but not for this configuration.
    """
    if isinstance(policy, str):
        require(is_policy(policy), "policy", policy, known_names())
        if policy in POLICIES:
            return Recipe(POLICIES[policy])
        if policy in METHODS or policy.endswith(SUFFIX):
            return _from_file(policy, config)
    own.make(config, policy)  # raises for what is amiss before anything flies
    return Recipe(partial(own.make, source=policy), own=own.label(policy))


def _from_file(name: str, config: FormationConfig) -> Recipe:
    path = Path(name) if name.endswith(SUFFIX) else _shipped(name, config)
    if path is None:
        tried = " or ".join(map(repr, dict.fromkeys((config.scenario, USUAL))))
        raise Unshipped(
            f"policy = {name!r}: no file for action level {config.action!r} is shipped for scenario "
            f"{tried}"
        )
    source = load(path)
    hidden = tuple(len(b) for b in source[1].biases[:-1])
    made = Recipe(partial(Learned, source=source), path.name, source[0], hidden=hidden)
    try:
        require_fit(source[0], config)
    except Misfit as problem:
        raise Misfit(f"{path}: {problem}") from None
    return made


def _shipped(method: str, config: FormationConfig) -> Path | None:
    """The file of a method for a configuration, if there is one."""
    for scenario in dict.fromkeys((config.scenario, USUAL)):
        path = shipped_file(method, scenario, config.action)
        if path.is_file():
            return path
    return None


def shipped_file(method: str, scenario: str, action: str) -> Path:
    """Where the policy of a method that was trained for a scenario at an action level lies, if it ships."""
    return SHIPPED / f"{method}-{scenario}-{action}{SUFFIX}"


def make_policy(policy: Any, config: FormationConfig) -> Policy:
    """The policy of that name for a configuration.

    A name of `POLICIES`, a method of `METHODS`, whose file for the configuration's scenario and action
    level is taken (for a scenario without one that of `nominal`), a path that ends in
    `.safetensors`, or your own: `module:Name`, `file.py:Name`, a class or an object (see
    `baselines.own`). Raises `ValueError` as `recipe` does; warns with `TransferWarning` where a file
    was trained for another task.
    """
    return recipe(policy, config).make(config)
