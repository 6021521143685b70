"""Policies to compare with, their evaluation, flights to look at, and the paper's figures redone."""

from typing import TYPE_CHECKING, Any

from baselines.own import PolicyError
from baselines.policies.base import EpisodeWarning, Policy
from baselines.policies.transfer import TransferWarning
from baselines.policies.tuned import UntunedWarning
from baselines.registry import METHODS, POLICIES, make_policy

if TYPE_CHECKING:
    from baselines.evaluate import evaluate as evaluate
    from baselines.replay import replay as replay
    from baselines.reporting.plots import plot as plot

__all__ = [
    "METHODS",
    "POLICIES",
    "EpisodeWarning",
    "Policy",
    "PolicyError",
    "TransferWarning",
    "UntunedWarning",
    "evaluate",
    "make_policy",
    "plot",
    "replay",
]


def __getattr__(name: str) -> Any:
    # Not at the top: `python -m baselines.evaluate` runs the module anew. Importing it sets the attribute.
    if name in ("evaluate", "replay"):
        import importlib

        return importlib.import_module(f"baselines.{name}")
    if name == "plot":
        from baselines.reporting.plots import plot

        return plot
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
