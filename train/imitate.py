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

from baselines import console
from formation_env import FormationConfig, configure
from train.command_line import check, fail, refuse, repeated, wait_passively

PROGRAM, SCRIPT = "train.imitate", "formation-train-imitate"


@final
@dataclass(frozen=True)
class Options:
    """Clone a policy into one network, shared by all followers."""

    output: Path
    """Folder for the policy and the log."""
    scenario: str = "nominal"
    """Which task, as in the leaderboard."""
    action: Literal["wrench", "rates", "reference"] | None = None
    """Action level instead of the scenario's own."""
    method: Literal["bc", "dagger"] = "dagger"
    """Who flies: the teacher, or the clone more and more."""
    teacher: str = "expert"
    """Who is cloned: a policy's name, or a policy file."""
    seed: int = 0
    """Of everything that is drawn."""
    history: int = 1
    """How many observations the clone sees, the present one included."""
    residual: float = 0.0
    """Learn a correction of at most this to the expert's action, who flies underneath, so that together
    they do what the teacher does; 0 learns the action itself."""

    rounds: int = 40
    """Of flying and then learning."""
    ticks: int = 250
    """Flown in a round, in every world; before the first, the teacher flies an episode's length more."""
    updates: int = 300
    """Steps of the optimiser in a round."""
    worlds: int = 64
    """How many fly at once; what an eighth of them shows is held out."""
    buffer: int = 4000
    """Ticks of every world that are remembered, the latest."""
    share: float = 0.5
    """Part of the worlds that the teacher flies in the second round of dagger; its square in the third,
    and so on down to a fifth, so that what a clone that fails early never reaches is not forgotten."""
    stray: float = 30.0
    """A world in which the teacher wants more than so many times its usual action begins again: far from
    home there is nothing to learn for those who keep close."""
    noise: float = 0.0
    """Of executed actions, in units of the size of what is learned: shows recoveries (DART)."""
    explore: float = 0.0
    """Of white noise on executed actions, all the time, in the unit of PPO's `--std`: a clone that has
    always flown smoothly takes the last action's least change for a sign, and PPO's exploration throws
    it off; one that PPO is to go on from should know it."""
    magnify: float = 50.0
    """At most so many times is an input magnified that hardly varies. A clone that PPO is to go on from
    is better without (1): what is large by itself is thrown about by small steps of the weights."""
    batch: int = 2048
    """Samples in a step of the optimiser."""
    learning_rate: float = 3e-3
    """At the start; it falls to nearly nothing along a cosine."""
    huber: float = 1.0
    """Where the loss turns from squared to absolute, in units of the size of the teacher's actions."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Of the hidden layers."""

    evaluate_every: int = 5
    """Rounds between two evaluations; the last round is always evaluated."""
    episodes: int = 32
    """In an evaluation."""
    tensorboard: bool = False
    """Write losses and scores for TensorBoard too."""
    threads: int = 1
    """At most so many, worth it for large networks; another number of them rounds otherwise."""
    quiet: bool = False
    """No progress bar, no lines but the errors."""

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
            import tyro

            from train.course import Course
    except ModuleNotFoundError as problem:
        return fail(
            PROGRAM, f'{problem.name} is not installed: pip install "formation-env[train]"', 2
        )
    options = tyro.cli(Options, prog=SCRIPT, args=arguments)
    try:
        course = Course(options)
    except ValueError as problem:
        return fail(PROGRAM, problem, 2)
    except OSError as problem:
        return fail(PROGRAM, f"cannot write into {problem.filename}: {problem.strerror}", 2)
    except KeyboardInterrupt:
        return fail(PROGRAM, "interrupted: nothing was written", 130)
    try:
        course.take()
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        return fail(PROGRAM, f"{where}{problem.strerror or problem}; earlier files are intact", 1)
    except KeyboardInterrupt:
        return fail(PROGRAM, f"interrupted: {course.summary()}", 130)
    if not options.quiet:
        console.say(course.summary())
    return 0


if __name__ == "__main__":
    sys.exit(main())
