"""The options of `python -m train.ppo`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from formation_env import FormationConfig, configure
from train.command_line import SCRIPTS
from train.margin import flown_on
from train.options import STD, PPOOptions, Ranges

# Of the exploration at the start: its standard deviation with `residual`, as part of that bound, and the
# factor on it where the actor comes from a file.
RESIDUAL_STD = 0.3
INIT_STD_FACTOR = 0.2


@dataclass(frozen=True)
class Options(PPOOptions):
    """Train one policy, shared by all followers, with PPO."""

    resume: bool = False
    """Continue the run in the output folder with the options that it was started with.
    Of those given here only steps, minutes, profile and quiet count."""
    std: float | None = None
    """Standard deviation of the actions at the start, in units of the largest action.
    By default that of the action level, `exploration` in formation_env/laws/levels.py, or 0.3 of a
    residual's bound.
    With --init a fifth of that."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers, from input to output; with --init those of the file."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Activation function of the hidden layers; with --init that of the file."""

    init: Path | None = None
    """Policy file whose actor training starts from; by default an untrained one."""
    residual: float = 0.0
    """Largest correction to the expert's action that is learned, from 0 to 1 (the largest action).
    0 learns the action itself."""
    history: int = 1
    """Number of observations that the policy sees, the present one included."""
    margin: bool = True
    """Train with measurements one sample later and slight noise where the task's own are exact.
    Evaluations fly the task as it is."""
    start: Literal["formation", "ground"] | None = None
    """How training episodes begin, near the formation or on the ground; by default as the scenario's do."""
    start_offset: float | None = None
    """Radius, in m, of the ball around its slot in which a follower begins; by default the scenario's."""
    scenario_duration: float | None = None
    """Length of a training episode, in s; by default the scenario's."""
    actor_rate: float = 1.0
    """Factor, from 0 to 1, on the learning rate of the actor.
    A critic that begins from nothing has to learn faster than an actor that comes from a file."""
    kl: float | None = None
    """Mean Kullback-Leibler divergence that an update should change the actor by, at the start.
    The actor's rate is steered to it, from --actor-rate on; it falls as the learning rate does.
    By default the rate is not steered."""
    critic_steps: int = 0
    """Number of agent steps at the start during which only the critic learns; of use with --init."""
    normalise: Literal["fixed", "running"] = "fixed"
    """How inputs are normalised: by fixed scales, or by their running mean and variance."""
    profile: bool = False
    """Print at the end how much of the time each part of the program took."""

    script: ClassVar[str] = SCRIPTS["train.ppo"]
    without_effect: ClassVar[tuple[str, ...]] = ("output", "resume", "profile", "quiet", "threads")
    free_on_resume: ClassVar[tuple[str, ...]] = (
        "steps", "minutes", "resume", "profile", "quiet", "output",
    )  # fmt: skip
    integers: ClassVar[Ranges] = {
        **PPOOptions.integers,
        "history": (1, 100),
        "critic_steps": (0, 2**50),
    }
    numbers: ClassVar[Ranges] = {
        **PPOOptions.numbers,
        "residual": (0.0, 1.0),
        "actor_rate": (0.0, 1.0),
        "kl": (1e-9, 1.0),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        self.training_config()

    def training_config(self) -> FormationConfig:
        """The task as it is trained. Raises `ValueError` naming the field if it is impossible."""
        given: dict[str, Any] = {
            "start": self.start,
            "start_offset": self.start_offset,
            "duration": self.scenario_duration,
        }
        task = flown_on(self.config(), self.margin)
        return configure(task, **{k: v for k, v in given.items() if v is not None})

    def exploration(self) -> float:
        """Standard deviation of the actor's output at the start."""
        if self.std is not None:
            return self.std
        usual = STD[self.config().action] if self.residual == 0.0 else RESIDUAL_STD
        return usual * (INIT_STD_FACTOR if self.init is not None else 1.0)
