"""The options that several training commands share, with their help texts, ranges and checks.

`RunOptions` are those of all, `PPOOptions` those of PPO, whether with Stable-Baselines3 or with RLlib. A
command's own options are in `options.py` of its folder.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, dataclass, fields
from math import isfinite
from pathlib import Path
from typing import Any, ClassVar, Literal

from formation_env import SCENARIOS, FormationConfig, configure
from formation_env.laws.levels import LEVELS
from train.command_line import flag, refuse

Ranges = Mapping[str, tuple[float, float]]  # least and largest value of an option, by name

# The names of the action levels, of which help lists the choices. Type checkers do not compute a type, so it
# is written out; `tests/test_level_lists.py` holds it to the table.
ActionLevel = Literal["wrench", "rates", "reference"]

# Standard deviation of the exploration at the start, by action level, in units of the largest action:
# about how far apart the actions are that matter.
STD = {level.name: level.exploration for level in LEVELS}


@dataclass(frozen=True)
class RunOptions:
    """Options of every command that trains a network.

    Raises `ValueError` naming an option that is impossible.
    """

    output: Path
    """Folder for the best policy and the log; made if it is not there."""
    scenario: str = "nominal"
    """Name of the scenario that is trained on: nominal, paper, experiment, agile or swarm."""
    action: ActionLevel | None = None
    """Action level; by default the scenario's own."""
    seed: int = 0
    """Seed of all random numbers: initial weights, episodes, exploration, order of the samples."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers, from input to output."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Activation function of the hidden layers."""
    episodes: int = 32
    """Number of episodes in an evaluation."""
    threads: int = 1
    """Number of threads of PyTorch and of the simulation.
    A second one gains about a sixth on a machine that does nothing else, and nothing on a busy one.
    Results with another number of threads differ by rounding."""
    quiet: bool = False
    """Print errors only: no progress bar and no summary."""

    # Of the class, not options themselves.
    script: ClassVar[str]  # the console script
    without_effect: ClassVar[tuple[str, ...]]  # options that change no result
    integers: ClassVar[Ranges] = {
        "seed": (0, 2**32 - 1),
        "episodes": (1, 100_000),
        "threads": (1, 1024),
    }
    numbers: ClassVar[Ranges] = {}  # real ones, which may also be None

    def __post_init__(self) -> None:
        if self.scenario not in SCENARIOS:
            refuse("scenario", self.scenario, f"one of {', '.join(SCENARIOS)}")
        for name, (least, most) in self.integers.items():
            value = getattr(self, name)
            if not (_is_integer(value) and least <= value <= most):
                refuse(name, value, f"a whole number from {least} to {most}")
        for name, (low, high) in self.numbers.items():
            value = getattr(self, name)
            if value is not None and not (_is_number(value) and low <= value <= high):
                refuse(name, value, f"a number from {low:g} to {high:g}")
        hidden = self.hidden
        if not 0 < len(hidden) <= 8 or not all(_is_integer(n) and 1 <= n <= 4096 for n in hidden):
            refuse("hidden", hidden, "1 to 8 widths from 1 to 4096")
        self.config()

    def config(self) -> FormationConfig:
        """The task as the leaderboard has it."""
        given: dict[str, Any] = {} if self.action is None else {"action": self.action}
        return configure(self.scenario, **given)

    def to_json(self) -> dict[str, Any]:
        """The options by name, as JSON takes them."""
        return {k: str(v) if isinstance(v, Path) else v for k, v in asdict(self).items()}

    def command(self) -> str:
        """The command that repeats the run: with every option that is not its default, but for those
        that change no result."""
        return repeating_command(
            self.script, self.to_json(), defaults(type(self)), self.without_effect
        )


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: object) -> bool:
    return _is_integer(value) or (isinstance(value, float) and isfinite(value))


def defaults(kind: type[Any]) -> dict[str, Any]:
    """The defaults of a dataclass by name; None where there is none."""
    return {f.name: _default(f) for f in fields(kind)}


def _default(field: Field[Any]) -> Any:
    if field.default_factory is not MISSING:
        return field.default_factory()
    return None if field.default is MISSING else field.default


def repeating_command(
    script: str, values: Mapping[str, Any], usual: Mapping[str, Any], without: tuple[str, ...]
) -> str:
    """A console script with the `values` that are not the `usual` ones, none of those named `without`."""
    words = [script]
    for name, value in values.items():
        if name in without or value == usual[name]:
            continue
        if isinstance(value, bool):
            words.append(flag(name if value else f"no_{name}"))
        else:
            words += [flag(name), *map(str, value if isinstance(value, tuple) else (value,))]
    return shlex.join(words)


@dataclass(frozen=True)
class PPOOptions(RunOptions):
    """Options of PPO."""

    output: Path
    """Folder for the policies, the log and the checkpoint; made if it is not there."""
    steps: int = 20_000_000
    """Stop after this many agent steps; one is one control tick of one follower."""
    minutes: float | None = None
    """Stop after this many minutes of wall time, if that is earlier; by default no limit of time."""
    resume: bool = False
    """Continue the run in the output folder with the options that it was started with."""
    critic: Literal["local", "central"] = "local"
    """What the critic sees: local is the follower's observation, central the world's true state too."""

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
    """Largest norm of a gradient; a larger one is scaled down to it."""
    std: float | None = None
    """Standard deviation of the actions at the start, in units of the largest action.
    By default that of the action level, `exploration` in formation_env/laws/levels.py."""

    evaluate_every: int = 1_000_000
    """Number of agent steps between two evaluations."""
    save_every: float = 1.0
    """Time between two checkpoints, in minutes; every evaluation is followed by one too."""

    free_on_resume: ClassVar[tuple[str, ...]]  # options that a resumed run takes as they are given
    integers: ClassVar[Ranges] = {
        **RunOptions.integers,
        "steps": (1, 2**50),
        "worlds": (1, 2**20),
        "rollout": (2, 2**16),
        "batch": (2, 2**24),
        "epochs": (1, 1000),
        "evaluate_every": (1, 2**50),
    }
    numbers: ClassVar[Ranges] = {
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
