"""What the faces share of their arguments: keywords, the limit of an episode, seeds, options of `reset`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from formation_env.config import FormationConfig
from formation_env.laws.world import MAX_TICKS
from formation_env.scenarios import FIELDS, configure
from formation_env.validation.checks import integer, refuse, unexpected_keyword

_CONFIGURED = frozenset(("scenario", *FIELDS))

# Keywords of one face that are given to another, and what to write there.
_NATIVE = (
    "only the native vector environment has it, which make_vec makes without a vectorization_mode"
)
_ELSEWHERE = {
    "autoreset_mode": f"{_NATIVE}; with 'sync' or 'async' give make_vec "
    "vector_kwargs={'autoreset_mode': ...}",
    "threads": _NATIVE,
    "max_cycles": "PettingZoo has it; Gymnasium's make and make_vec have max_episode_steps, and every "
    "face `duration` (s)",
    "max_episode_steps": "Gymnasium's make and make_vec have it; PettingZoo has max_cycles, and every "
    "face `duration` (s)",
}


def configured(
    face: str,
    own: Iterable[str],
    scenario: str | FormationConfig | Mapping[str, Any],
    followers: int | None,
    options: dict[str, Any],
) -> FormationConfig:
    """`configure`, with `TypeError` for a keyword that is neither a field nor one of the face's `own`."""
    for name in options:
        if name in FIELDS:
            continue
        if name in _ELSEWHERE:
            message = f"{face}() got an unexpected keyword argument {name!r}: {_ELSEWHERE[name]}"
            raise TypeError(message)
        raise unexpected_keyword(face, name, ("scenario", "followers", *own, *FIELDS))
    return configure(scenario, followers=followers, **options)


def limit(name: str, steps: Any, config: FormationConfig) -> int:
    """A number of steps after which episodes are truncated; refused above those of the duration."""
    whole = integer(name, steps, 1)
    if whole > config.max_steps:
        expected = f"at most {config.max_steps}, the steps of duration = {config.duration:g} s"
        if whole <= MAX_TICKS:
            longer = whole * config.control_period
            expected += f"; for longer episodes give duration={longer:g} as well"
        refuse(name, whole, expected)
    return whole


def whole_seed(seed: Any, name: str = "seed") -> int | None:
    """A seed as an `int` from 0, or None."""
    return None if seed is None else integer(name, seed, 0)


def check_options(options: Any, *known: str, passed: str | None = None) -> None:
    """Refuse options of `reset` that are not known: they would do nothing.

    `passed` is let pass and not named: another library sends it, and it means nothing to a user.
    """
    if options is None:
        return
    names = ", ".join(map(repr, known)) if known else "none"
    if not isinstance(options, Mapping):
        refuse("options", options, f"a dictionary or None; known keys: {names}")
    for key in options:
        if key not in known and key != passed:
            refuse(f"options[{key!r}]", options[key], f"only known keys: {names}")


class Fixed:
    """Attributes that the constructor alone sets, and fields of the configuration: assigned later, they
    would change nothing."""

    _fixed: frozenset[str] = frozenset()

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _CONFIGURED or (name in self._fixed and name in self.__dict__):
            raise AttributeError(
                f"{name!r} of {type(self).__name__} is fixed: make a new environment with it"
            )
        super().__setattr__(name, value)
