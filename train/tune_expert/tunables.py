"""What can be tuned: for each policy its space of gains, how it is made of gains, and its file of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies import textbook_tuned, tuned
from baselines.policies.base import Policy
from formation_env import FormationConfig
from train.tune_expert.gain_space import GainSpace
from train.tune_expert.loop_space import LoopSpace


class Space(Protocol):
    """Gains as points; the origin is the plain ones."""

    names: tuple[str, ...]

    def gains(self, x: NDArray[np.float64], choice: str) -> Any:
        """The gains at a point `(len(names),)`, for one of the `choices` of the tunable."""


class Tunable(ABC):
    """A policy whose gains can be searched."""

    name: str  # the policy with its plain gains

    @abstractmethod
    def space(self, config: FormationConfig) -> Space:
        """The space that is searched."""

    @abstractmethod
    def policy(self, config: FormationConfig, gains: Any) -> Policy:
        """The policy with gains."""

    def stack(self, config: FormationConfig, gains: Sequence[Any], worlds: int) -> Policy | None:
        """A policy that flies so many worlds in a row with each of the gains; None where there is none."""
        return None

    @abstractmethod
    def own(self, config: FormationConfig) -> Any:
        """The plain gains."""

    @abstractmethod
    def document(self, gains: Any) -> dict[str, Any]:
        """The gains as an entry of a file has them."""

    @abstractmethod
    def read(self, path: Path) -> Any:
        """The gains in a file; raises `ValueError` naming what is wrong in it."""

    def choices(self, config: FormationConfig, feedforward: str) -> tuple[str, ...]:
        """What is searched one after the other, sharing the candidates."""
        return ("plain",)

    def stem(self, config: FormationConfig) -> str:
        """The name of the journal without its ending."""
        return f"{self.name}-{config.scenario}-{config.action}"


@final
class ExpertGains(Tunable):
    """The paper's planner and tracker, for each way to take the reference's higher derivatives."""

    name = "expert"

    def space(self, config: FormationConfig) -> GainSpace:
        return GainSpace(config)

    def policy(self, config: FormationConfig, gains: Any) -> Policy:
        return tuned.ExpertTuned(config, gains)

    def own(self, config: FormationConfig) -> tuned.Gains:
        return tuned.own(config)

    def document(self, gains: Any) -> dict[str, Any]:
        found: dict[str, Any] = gains.document()
        return found

    def read(self, path: Path) -> Any:
        return tuned.read(path)

    def choices(self, config: FormationConfig, feedforward: str) -> tuple[str, ...]:
        """The feedforwards that are tried; at level `reference` the expert has none."""
        if config.action == "reference":
            return ("zero",)
        return tuned.FEEDFORWARDS if feedforward == "both" else (feedforward,)

    def stem(self, config: FormationConfig) -> str:
        return f"{config.scenario}-{config.action}"


@final
class LoopLaw(Tunable):
    """A law of `textbook_tuned.LAWS`."""

    def __init__(self, name: str) -> None:
        self.name = name

    def space(self, config: FormationConfig) -> LoopSpace:
        return LoopSpace(self.name, config)

    def policy(self, config: FormationConfig, gains: Any) -> Policy:
        return textbook_tuned.TUNED[self.name](config, gains)

    def stack(self, config: FormationConfig, gains: Sequence[Any], worlds: int) -> Policy:
        return textbook_tuned.Stacked(self.name, config, gains, worlds)

    def own(self, config: FormationConfig) -> Any:
        return textbook_tuned.LAWS[self.name].gains()

    def document(self, gains: Any) -> dict[str, Any]:
        return {"gains": gains._asdict()}

    def read(self, path: Path) -> Any:
        return textbook_tuned.read(self.name, path)


TUNABLES: dict[str, Tunable] = {
    one.name: one for one in (ExpertGains(), *map(LoopLaw, textbook_tuned.LAWS))
}
