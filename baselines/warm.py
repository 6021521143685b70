"""What `python -m formation_env.warm` compiles besides the simulation: policies and scoring.

Declared as an entry point in pyproject.toml.
"""

from __future__ import annotations

from baselines.registry import available
from baselines.scoring import evaluation
from baselines.scoring.tasks import tasks
from formation_env import SCENARIOS


def use_kernels() -> None:
    """Fly every policy that ships for two ticks on every scenario, and score it."""
    configs = tasks(list(SCENARIOS))
    flyable = evaluation.find_flyable(configs, available(configs.values()))
    evaluation.warm(configs, flyable)
