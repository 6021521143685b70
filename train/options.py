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
    Of those given here only steps, minutes, profile and quiet count."""
    init: Path | None = None
    """Policy file whose actor training starts from; by default an untrained one."""
    residual: float = 0.0
    """Largest correction to the expert's action that is learned, from 0 to 1 (the largest action).
    0 learns the action itself."""
    history: int = 1
    """Number of observations that the policy sees, the present one included."""
    critic: Literal["local", "central"] = "local"
    """What the critic sees: local is the follower's observation, central the world's true state too."""

    start: Literal["formation", "ground"] | None = None
    """How training episodes begin, near the formation or on the ground; by default as the scenario's do."""
    start_offset: float | None = None
    """Radius, in m, of the ball around its slot in which a follower begins; by default the scenario's."""
    scenario_duration: float | None = None
    """Length of a training episode, in s; by default the scenario's."""

    worlds: int = 256
    """Number of worlds that are flown at once."""
    rollout: int = 32
    """Number of control ticks that every world is flown between two updates."""
    batch: int = 2048
    """Number of agent steps in one step of the optimiser."""
    epochs: int = 5
    """Number of passes over the rollout in one update."""
    learning_rate: float = 1e-3
    """Step size of Adam at the start; it falls in a straight line to a tenth of it at the last step."""
    actor_rate: float = 1.0
    """Factor, from 0 to 1, on the learning rate of the actor.
    A critic that begins from nothing has to learn faster than an actor that comes from a file."""
    kl: float | None = None
    """Mean Kullback-Leibler divergence that an update should change the actor by, at the start.
    The actor's rate is steered to it, from --actor-rate on; it falls as the learning rate does.
    By default the rate is not steered."""
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
    By default it is chosen for the action level, and a fifth of that with --init."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers; with --init those of the file."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Activation function of the hidden layers; with --init that of the file."""
    normalise: Literal["fixed", "running"] = "fixed"
    """How inputs are normalised: by fixed scales, or by their running mean and variance."""
    critic_steps: int = 0
    """Number of agent steps at the start during which only the critic learns; of use with --init."""

    evaluate_every: int = 1_000_000
    """Number of agent steps between two evaluations."""
    episodes: int = 32
    """Number of episodes in an evaluation."""
    save_every: float = 1.0
    """Time between two checkpoints, in minutes; every evaluation is followed by one too."""
    threads: int = 1
    """Number of threads of PyTorch and of the simulation.
    A second one gains about a sixth on a machine that does nothing else, and nothing on a busy one.
    Results with another number of threads differ by rounding."""
    profile: bool = False
    """Print at the end which part of the time went where."""
    quiet: bool = False
    """Print errors only: no progress bar and no summary."""

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
