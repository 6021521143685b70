"""Clone a policy: `python -m train.imitate --output DIR`. Needs the `train` extra.

A teacher, by default the expert, says what it would do in many worlds at once, and a network learns to
say the same. With `--method bc` (behaviour cloning) the teacher flies all the time; with `dagger` the
clone flies more and more of the worlds, so that the teacher is asked about the clone's own mistakes.
With `--residual` the expert flies underneath and the network learns what it lacks of another teacher.

Into the output folder go `best.safetensors`, the best policy so far by the leaderboard's score on seeds
that neither training nor leaderboard use, which `baselines.evaluate --policies` and `train.ppo --init`
take; and `log.csv`, the score against samples and minutes. An interruption (Ctrl-C) leaves both.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Literal, final

from baselines.system import console
from formation_env import FormationConfig, configure
from train.command_line import check, fail, read, refuse, repeated, wait_passively

PROGRAM, SCRIPT = "train.imitate", "formation-train-imitate"


@final
@dataclass(frozen=True)
class Options:
    """Clone a policy into one network, shared by all followers.

    A teacher says what it would do, and the network learns to say the same.
    """

    output: Path
    """Folder for the policy and the log; made if it is not there."""
    scenario: str = "nominal"
    """Name of the scenario that is trained on: nominal, paper, experiment, agile or swarm."""
    action: Literal["wrench", "rates", "reference"] | None = None
    """Action level: wrench, rates or reference; by default the scenario's own."""
    method: Literal["bc", "dagger"] = "dagger"
    """Way of learning: bc flies the teacher all the time, dagger the clone more and more."""
    teacher: str = "expert"
    """Policy that is cloned: a name, such as expert or expert-tuned, or a policy file."""
    seed: int = 0
    """Seed of everything that is drawn: initial weights, episodes, exploration."""
    history: int = 1
    """Number of observations that the clone sees, the present one included."""
    residual: float = 0.0
    """Largest correction to the expert's action that is learned, from 0 to 1 (the largest action).
    The expert flies underneath, and together they do what the teacher does. 0 learns the action itself."""

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
    """Number of control ticks of every world that are remembered; the oldest are dropped."""
    share: float = 0.5
    """Part of the worlds that the teacher flies in the second round of dagger.
    It is squared in the third, and so on down to a fifth: what a clone that fails early never
    reaches has to stay in memory."""
    stray: float = 30.0
    """A world begins again where the teacher wants more than this many times its usual action."""
    noise: float = 0.0
    """Standard deviation of slow noise on executed actions, in units of the teacher's usual action.
    It has the teacher show how to recover (DART)."""
    explore: float = 0.0
    """Standard deviation of white noise on executed actions, in units of the largest action.
    A clone that training goes on from with PPO should know it, since PPO explores so."""
    magnify: float = 50.0
    """Largest factor by which an input that hardly varies is magnified.
    A clone that training goes on from with PPO is better with 1."""
    batch: int = 2048
    """Number of samples in one step of the optimiser."""
    learning_rate: float = 3e-3
    """Step size of Adam at the start; it falls to nearly nothing along a cosine."""
    huber: float = 1.0
    """Error at which the loss turns from squared to absolute, in units of the teacher's usual action."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Activation function of the hidden layers."""

    evaluate_every: int = 5
    """Number of rounds between two evaluations; the last round is always evaluated."""
    episodes: int = 32
    """Number of episodes in an evaluation."""
    tensorboard: bool = False
    """Write losses and scores for TensorBoard too, into the folder tensorboard of the output."""
    threads: int = 1
    """Number of threads of PyTorch and of the simulation; more are of use for large networks only,
    on a machine that does nothing else. Results with another number of them differ by rounding."""
    quiet: bool = False
    """Print errors only: no progress bar and no summary."""

    def check(self) -> FormationConfig:
        """The task. Raises `ValueError` naming the option that is impossible."""
        check(self, _WHOLE, _REAL)
        if self.residual > 0.0 and self.teacher == "expert":
            refuse(
                "teacher", self.teacher, "another with --residual, where the expert flies already"
            )
        if self.buffer < self.ticks + self.history:
            refuse("buffer", self.buffer, "at least ticks and history together")
        return (
            configure(self.scenario)
            if self.action is None
            else configure(self.scenario, action=self.action)
        )

    def command(self) -> str:
        """The command that repeats a run, without what does not change its result."""
        usual = {f.name: f.default for f in fields(self)}
        return repeated(PROGRAM, asdict(self), usual, _IDLE)


# Least and largest.
_WHOLE = {
    "seed": (0, 2**32 - 1),
    "history": (1, 100),
    "rounds": (1, 10**6),
    "ticks": (1, 10**6),
    "updates": (1, 10**6),
    "worlds": (8, 2**16),
    "buffer": (2, 10**7),
    "batch": (1, 2**24),
    "evaluate_every": (1, 10**6),
    "episodes": (1, 100_000),
    "threads": (1, 1024),
}
_REAL = {
    "residual": (0.0, 1.0),
    "share": (0.0, 1.0),
    "stray": (1.0, 1e9),
    "noise": (0.0, 1e3),
    "explore": (0.0, 1.0),
    "magnify": (1.0, 1e6),
    "learning_rate": (1e-12, 1.0),
    "huber": (1e-6, 1e6),
}
_IDLE = ("output", "tensorboard", "threads", "quiet")


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    wait_passively()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # theirs, at import
            import tyro  # noqa: F401

            from train.course import Course
    except ModuleNotFoundError as problem:
        return fail(
            SCRIPT, f'{problem.name} is not installed: pip install "formation-env[train]"', 2
        )
    options = read(Options, SCRIPT, arguments)
    try:
        course = Course(options)
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    except OSError as problem:
        return fail(SCRIPT, f"cannot write into {problem.filename}: {problem.strerror}", 2)
    except KeyboardInterrupt:
        return fail(SCRIPT, "interrupted: nothing was written", 130)
    try:
        course.take()
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        return fail(SCRIPT, f"{where}{problem.strerror or problem}; earlier files are intact", 1)
    except KeyboardInterrupt:
        return fail(SCRIPT, f"interrupted: {course.summary()}", 130)
    if not options.quiet:
        console.say(course.summary())
    return 0


if __name__ == "__main__":
    sys.exit(main())
