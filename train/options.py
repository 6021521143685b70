"""The options of `python -m train.ppo`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from formation_env import FormationConfig, configure
from train.command_line import check, repeated
from train.saved import defaults

# Of the exploration at the start, by action level: about how far apart the actions are that matter.
STD = {"wrench": 0.05, "rates": 0.05, "reference": 0.3}
FINE = 0.2  # part of it when the actor comes from a file


@dataclass(frozen=True)
class Options:
    """Train one policy, shared by all followers, with PPO."""

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
    here only steps, minutes, profile and quiet count."""
    init: Path | None = None
    """Start from the actor in a policy file."""
    residual: float = 0.0
    """Learn a correction of at most this to the expert's action; 0 learns the action itself."""
    history: int = 1
    """How many observations the policy sees, the present one included."""
    critic: Literal["local", "central"] = "local"
    """What the critic sees: the follower's observation, or the world's true state too."""

    start: Literal["formation", "ground"] | None = None
    """How training episodes begin, instead of the scenario's way."""
    start_offset: float | None = None
    """Radius in m of the ball around the slot in which they begin, instead of the scenario's."""
    scenario_duration: float | None = None
    """Their length in s, instead of the scenario's."""

    worlds: int = 256
    """How many fly at once."""
    rollout: int = 32
    """Ticks flown between two updates."""
    batch: int = 2048
    """Agent steps in a step of the optimiser."""
    epochs: int = 5
    """Passes over a rollout."""
    learning_rate: float = 1e-3
    """At the start; it falls in a straight line to a tenth at the last step."""
    actor_rate: float = 1.0
    """Part of the learning rate that the actor takes: a critic that begins from nothing must learn fast
    to tell an actor from a file, which is good already, what is better."""
    kl: float | None = None
    """Steer the actor's part of the learning rate, from actor_rate on, so that an update changes what it
    does by about so much (mean Kullback-Leibler divergence); it falls as the learning rate does. An actor
    from a file needs a rate of its own, which depends on the exploration."""
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
    """Widths of the hidden layers; those of the file with --init."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Of the hidden layers; that of the file with --init."""
    normalise: Literal["fixed", "running"] = "fixed"
    """Inputs by fixed scales, or by the running mean and variance."""
    critic_steps: int = 0
    """Agent steps during which the critic alone learns, worth it with --init."""

    evaluate_every: int = 1_000_000
    """Agent steps between two evaluations."""
    episodes: int = 32
    """In an evaluation."""
    save_every: float = 1.0
    """Minutes between two checkpoints, which also follow every evaluation."""
    threads: int = 1
    """Threads of PyTorch and of the simulation. Two gain about a sixth on a machine that does nothing
    else, and lose where it does; give each of several runs side by side one. Another number of them
    rounds otherwise."""
    profile: bool = False
    """Say at the end where the time went."""
    quiet: bool = False
    """No progress bar, no lines but the errors."""

    def __post_init__(self) -> None:
        check(self, _WHOLE, _REAL)
        self.training_config()

    def config(self) -> FormationConfig:
        """The task as the leaderboard has it."""
        given: dict[str, Any] = {} if self.action is None else {"action": self.action}
        return configure(self.scenario, **given)

    def training_config(self) -> FormationConfig:
        """The task as it is trained. Raises `ValueError` naming the field if it is impossible."""
        given: dict[str, Any] = {
            "start": self.start,
            "start_offset": self.start_offset,
            "duration": self.scenario_duration,
        }
        return configure(self.config(), **{k: v for k, v in given.items() if v is not None})


# Least and largest.
_WHOLE = {
    "steps": (1, 2**50),
    "seed": (0, 2**32 - 1),
    "history": (1, 100),
    "worlds": (1, 2**20),
    "rollout": (2, 2**16),
    "batch": (2, 2**24),
    "epochs": (1, 1000),
    "critic_steps": (0, 2**50),
    "evaluate_every": (1, 2**50),
    "episodes": (1, 100_000),
    "threads": (1, 1024),
}
_REAL = {
    "minutes": (1e-9, 1e9),
    "residual": (0.0, 1.0),
    "learning_rate": (1e-12, 1.0),
    "actor_rate": (0.0, 1.0),
    "kl": (1e-9, 1.0),
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
FREE = ("steps", "minutes", "resume", "profile", "quiet", "output")


def to_json(options: Options) -> dict[str, Any]:
    """The options as JSON takes them."""
    return {k: str(v) if isinstance(v, Path) else v for k, v in asdict(options).items()}


def command(options: Options) -> str:
    """The command that repeats a run, without what does not change its result."""
    idle = ("output", "resume", "profile", "quiet", "threads")
    return repeated("train.ppo", to_json(options), defaults(Options), idle)
