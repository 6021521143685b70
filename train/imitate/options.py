"""The options of `python -m train.imitate`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, final

from formation_env import FormationConfig
from train.command_line import SCRIPTS, refuse
from train.margin import flown_on
from train.options import Ranges, RunOptions


@final
@dataclass(frozen=True)
class Options(RunOptions):
    """Clone a policy into one network, shared by all followers.

    The network is fitted to the actions of a teacher, the policy to be cloned.
    """

    threads: int = 1
    """Number of threads of PyTorch and of the simulation.
    More are of use for large networks only, on a machine that does nothing else.
    Results with another number of threads differ by rounding."""

    method: Literal["bc", "dagger"] = "dagger"
    """Way of learning: bc flies the teacher all the time, dagger the clone more and more."""
    teacher: str = "expert"
    """Policy that is cloned: a name, such as expert or expert-tuned, or a policy file."""
    margin: bool = True
    """Fly the samples with measurements one sample later and slight noise where the task's own are exact.
    A clone of flights on exact sensors alone is lost on any others. Evaluations fly the task as it is."""
    history: int = 1
    """Number of observations that the clone sees, the present one included."""
    residual: float = 0.0
    """Largest correction to the expert's action that is learned, from 0 to 1 (the largest action).
    The expert's action and the correction together are fitted to the teacher's action.
    0 learns the action itself."""

    rounds: int = 40
    """Number of rounds; in each, worlds are flown and then the network is fitted."""
    ticks: int = 250
    """Number of control ticks that every world is flown in a round.
    Before the first round the teacher flies the length of an episode more."""
    updates: int = 300
    """Number of steps of the optimiser in a round."""
    worlds: int = 64
    """Number of worlds that are flown at once; an eighth of them is held out to measure the error."""
    buffer: int = 4000
    """Number of control ticks of every world whose samples are kept; the oldest are dropped."""
    share: float = 0.5
    """Part of the worlds, 0 to 1, that the teacher flies in the second round of dagger.
    It is squared in the third, and so on down to a fifth, since a clone that fails early never reaches
    the rest of an episode."""
    stray: float = 30.0
    """Number of times its usual action that the teacher may ask for; beyond it the world begins again."""
    noise: float = 0.0
    """Standard deviation of slow noise on executed actions, in units of the teacher's usual action.
    With it the samples show how the teacher recovers (DART)."""
    explore: float = 0.0
    """Standard deviation of white noise on executed actions, in units of the largest action.
    A clone that PPO goes on from needs samples with it, since PPO explores in this way."""
    magnify: float = 50.0
    """Largest factor by which an input that hardly varies is magnified.
    With 1 a clone suits better for PPO to go on from."""
    batch: int = 2048
    """Number of samples in one step of the optimiser."""
    learning_rate: float = 3e-3
    """Step size of Adam at the start; it falls along a cosine to a two-hundredth of it."""
    huber: float = 1.0
    """Error at which the loss turns from squared to absolute, in units of the teacher's usual action."""

    evaluate_every: int = 5
    """Number of rounds between two evaluations; the last round is always evaluated."""
    tensorboard: bool = False
    """Write losses and scores for TensorBoard too, into the folder tensorboard of the output."""

    script: ClassVar[str] = SCRIPTS["train.imitate"]
    without_effect: ClassVar[tuple[str, ...]] = ("output", "tensorboard", "threads", "quiet")
    integers: ClassVar[Ranges] = {
        **RunOptions.integers,
        "history": (1, 100),
        "rounds": (1, 10**6),
        "ticks": (1, 10**6),
        "updates": (1, 10**6),
        "worlds": (8, 2**16),
        "buffer": (2, 10**7),
        "batch": (1, 2**24),
        "evaluate_every": (1, 10**6),
    }
    numbers: ClassVar[Ranges] = {
        "residual": (0.0, 1.0),
        "share": (0.0, 1.0),
        "stray": (1.0, 1e9),
        "noise": (0.0, 1e3),
        "explore": (0.0, 1.0),
        "magnify": (1.0, 1e6),
        "learning_rate": (1e-12, 1.0),
        "huber": (1e-6, 1e6),
    }

    def training_config(self) -> FormationConfig:
        """The task as samples are flown on it."""
        return flown_on(self.config(), self.margin)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.residual > 0.0 and self.teacher == "expert":
            refuse("teacher", self.teacher, "another with --residual, which corrects the expert")
        if self.buffer < self.ticks + self.history:
            refuse("buffer", self.buffer, "at least ticks and history together")
