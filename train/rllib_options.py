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
    """Folder for the policies, the log and the checkpoint; made if it is not there."""
    scenario: str = "nominal"
    """Name of the scenario that is trained on: nominal, paper, experiment, agile or swarm."""
    action: Literal["wrench", "rates", "reference"] | None = None
    """Action level: wrench, rates or reference; by default the scenario's own."""
    steps: int = 20_000_000
    """Stop after this many agent steps; one is one control tick of one follower."""
    minutes: float | None = None
    """Stop after this many minutes of wall time, if that is earlier; by default no limit of time."""
    seed: int = 0
    """Seed of everything that is drawn: initial weights, episodes, exploration."""
    resume: bool = False
    """Continue the run in the output folder with the options that it was started with.
    Of those given here only steps, minutes, runners, address, threads and quiet count."""
    critic: Literal["local", "central"] = "local"
    """What the critic sees: local is the follower's observation, central the world's true state too."""

    runners: int = 0
    """Number of processes that fly, one core each, anywhere in the cluster; 0 flies in this process."""
    address: str | None = None
    """HOST:PORT of a Ray cluster that runs already; by default one is started for this run alone."""

    worlds: int = 64
    """Number of worlds that each process flies at once."""
    rollout: int = 64
    """Number of control ticks that every world is flown between two updates."""
    batch: int = 1024
    """Number of agent steps in one step of the optimiser."""
    epochs: int = 5
    """Number of passes over the rollout in one update."""
    learning_rate: float = 1e-3
    """Step size of Adam at the start; it falls in a straight line to a tenth of it at the last step."""
    gamma: float = 0.98
    """Discount factor per control tick. Rewards are scaled by 1 - gamma, so that values are of order one."""
    gae_lambda: float = 0.95
    """Factor lambda, from 0 to 1, of the generalised advantage estimate."""
    clip_range: float = 0.2
    """Largest change of the probability ratio that PPO's objective rewards."""
    entropy: float = 0.0
    """Weight of the entropy bonus in the loss."""
    value: float = 0.5
    """Weight of the value function's error in the loss."""
    gradient: float = 0.5
    """Largest norm of a gradient; a larger one is scaled down."""
    std: float | None = None
    """Standard deviation of the actions at the start, in units of the largest action.
    By default it is chosen for the action level."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Activation function of the hidden layers."""

    evaluate_every: int = 1_000_000
    """Number of agent steps between two evaluations."""
    episodes: int = 32
    """Number of episodes in an evaluation."""
    save_every: float = 1.0
    """Time between two checkpoints, in minutes; every evaluation is followed by one too."""
    threads: int = 1
    """Number of threads of PyTorch in the learner; every runner has one.
    More are of use for large networks on a machine that does nothing else."""
    quiet: bool = False
    """Print errors only: no progress bar and no summary."""

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
