"""The policies by name: those that are programmed, those that ship as files, and anybody's files."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import NamedTuple

from baselines.expert import Expert
from baselines.files import SUFFIX, Card, load
from baselines.learned import Learned, Misfit
from baselines.policy import Policy
from baselines.simple import Hover, Pd, Random
from baselines.tuned import ExpertTuned
from formation_env import FormationConfig

POLICIES: dict[str, type[Policy]] = {
    policy.name: policy for policy in (Expert, ExpertTuned, Pd, Hover, Random)
}
# Ways of learning. What they made is shipped in files, one for a scenario and action level.
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
SHIPPED = Path(__file__).parent / "policies"
# A scenario without a file of its own is flown by the one of this scenario, which has not seen it.
USUAL = "nominal"


class Recipe(NamedTuple):
    """How a policy is made, as often as wanted, and for files what is in them."""

    make: Callable[[FormationConfig], Policy]
    file: str = ""  # its name without the folder
    card: Card | None = None


def is_policy(name: object) -> bool:
    """Whether `recipe` may know the name: a policy, a method or a path of a policy file."""
    return isinstance(name, str) and (name in POLICIES or name in METHODS or name.endswith(SUFFIX))


def available(configs: Collection[FormationConfig]) -> list[str]:
    """The names of all that can fly at least one of the configurations."""
    methods = [m for m in METHODS if any(_shipped(m, config) for config in configs)]
    return [*POLICIES, *methods]


def recipe(name: str, config: FormationConfig) -> Recipe:
    """How to make the policy of that name for a configuration.

    Raises `ValueError` listing the names if it is unknown, or saying what is wrong with its file; and
    `Misfit`, which is one too, if it exists but not for this configuration.
    """
    if not is_policy(name):
        known = ", ".join(map(repr, (*POLICIES, *METHODS)))
        raise ValueError(
            f"policy = {name!r}: expected one of {known} or a path of a *{SUFFIX} file"
        )
    if name in POLICIES:
        return Recipe(POLICIES[name])
    path = Path(name) if name.endswith(SUFFIX) else _shipped(name, config)
    if path is None:
        raise Misfit(
            f"policy = {name!r}: no file for action level {config.action!r} is shipped, neither for "
            f"scenario {config.scenario!r} nor for {USUAL!r}"
        )
    source = load(path)
    made = Recipe(partial(Learned, source=source), path.name, source[0])
    try:
        made.make(config)
    except Misfit as problem:
        raise Misfit(f"{path}: {problem}") from None
    return made


def _shipped(method: str, config: FormationConfig) -> Path | None:
    """The file of a method for a configuration, if there is one."""
    for scenario in dict.fromkeys((config.scenario, USUAL)):
        path = SHIPPED / f"{method}-{scenario}-{config.action}{SUFFIX}"
        if path.is_file():
            return path
    return None


def make_policy(name: str, config: FormationConfig) -> Policy:
    """The policy of that name for a configuration.

    A name of `POLICIES`, a method of `METHODS`, whose file for the configuration's scenario and action
    level is taken (for a scenario without one that of `nominal`), or a path that ends in
    `.safetensors`. Raises `ValueError` as `recipe` does.
    """
    return recipe(name, config).make(config)
