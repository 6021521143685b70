"""The options of `python -m train.rllib`, named as those of `train.ppo` where they are the same."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from formation_env import FormationConfig, configure
from train.command_line import check, repeated
from train.options import STD
from train.saved import defaults


@dataclass(frozen=True)
class Options:
    """Train one policy, shared by all followers, with PPO on a Ray cluster."""

    output: Path
    """Folder for the policies, the log and the checkpoint."""
    scenario: str = "nominal"
    """Which task, as in the leaderboard."""
    action: Literal["wrench", "rates", "reference"] | None = None
    """Action level instead of the scenario's own."""
    steps: int = 20_000_000
    """Stop after so many agent steps: ticks times followers times worlds."""
    minutes: float | None = None
    """Stop after so many minutes, evaluations included, if that is earlier."""
    seed: int = 0
    """Of everything that is drawn."""
    resume: bool = False
    """Continue the run in the output folder with the options that it was started with; of those given
    here only steps, minutes, runners, address, threads and quiet count."""
    critic: Literal["local", "central"] = "local"
    """What the critic sees: the follower's observation, or the world's true state too."""

    runners: int = 0
    """Processes that fly, one core each, anywhere in the cluster; 0 flies in this one."""
    address: str | None = None
    """HOST:PORT of a Ray cluster that runs already, instead of a local one for this run alone."""

    worlds: int = 64
    """How many fly at once in each process."""
    rollout: int = 64
    """Ticks flown between two updates."""
    batch: int = 1024
    """Agent steps in a step of the optimiser."""
    epochs: int = 5
    """Passes over a rollout."""
    learning_rate: float = 1e-3
    """At the start; it falls in a straight line to a tenth at the last step."""
    gamma: float = 0.98
    """Discount per tick. Rewards are scaled by 1 - gamma, so that values are of order one."""
    gae_lambda: float = 0.95
    """Of the generalised advantage estimate."""
    clip_range: float = 0.2
    """Of the probability ratio."""
    entropy: float = 0.0
    """Weight of the entropy bonus."""
    value: float = 0.5
    """Weight of the value loss."""
    gradient: float = 0.5
    """Largest norm of a gradient."""
    std: float | None = None
    """Of the exploration at the start; by default fit for the action level."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Of the hidden layers."""

    evaluate_every: int = 1_000_000
    """Agent steps between two evaluations."""
    episodes: int = 32
    """In an evaluation."""
    save_every: float = 1.0
    """Minutes between two checkpoints, which also follow every evaluation."""
    threads: int = 1
    """Threads of PyTorch in the learner; each runner has one. More help with large networks only, on a
    machine that does nothing else."""
    quiet: bool = False
    """No progress bar, no lines but the errors."""

    def __post_init__(self) -> None:
        check(self, _WHOLE, _REAL)
        self.config()

    def config(self) -> FormationConfig:
        """The task as the leaderboard has it. Raises `ValueError` naming a field."""
        given: dict[str, Any] = {} if self.action is None else {"action": self.action}
        return configure(self.scenario, **given)

    def exploration(self) -> float:
        """Standard deviation of the actions at the start."""
        return STD[self.config().action] if self.std is None else self.std


# Least and largest.
_WHOLE = {
    "steps": (1, 2**50),
    "seed": (0, 2**32 - 1),
    "runners": (0, 10_000),
    "worlds": (1, 2**16),
    "rollout": (2, 2**16),
    "batch": (2, 2**24),
    "epochs": (1, 1000),
    "evaluate_every": (1, 2**50),
    "episodes": (1, 100_000),
    "threads": (1, 1024),
}
_REAL = {
    "minutes": (1e-9, 1e9),
    "learning_rate": (1e-12, 1.0),
    "gamma": (0.0, 0.999999),
    "gae_lambda": (0.0, 1.0),
    "clip_range": (1e-6, 1e6),
    "entropy": (0.0, 1e6),
    "value": (0.0, 1e6),
    "gradient": (1e-9, 1e9),
    "std": (1e-6, 10.0),
    "save_every": (0.0, 1e9),
}
# What a resumed run may change.
FREE = ("steps", "minutes", "resume", "runners", "address", "threads", "quiet", "output")
# What changes no result, or only where it lies.
_ASIDE = ("output", "resume", "address", "threads", "quiet")


def to_json(options: Options) -> dict[str, Any]:
    """The options as JSON takes them."""
    return {k: str(v) if isinstance(v, Path) else v for k, v in asdict(options).items()}


def command(options: Options) -> str:
    """The command that repeats a run."""
    return repeated("train.rllib", asdict(options), defaults(Options), _ASIDE)
