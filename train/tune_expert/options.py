"""The options of `python -m train.tune_expert`."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import final

from baselines.policies.tuned import FEEDFORWARDS
from formation_env import FormationConfig, configure
from formation_env.validation.checks import integer, number, require
from train.command_line import SCRIPTS
from train.options import defaults, repeating_command
from train.seeds import MOST_TUNING_EPISODES
from train.tune_expert.tunables import TUNABLES, Tunable

SCRIPT = SCRIPTS["train.tune_expert"]
# Options that may differ where a search is continued.
FREE_ON_RESUME = ("resume", "threads", "quiet", "output", "gains", "evaluations")


@final
@dataclass(frozen=True)
class Options:
    """Search gains for a law with CMA-ES, on seeds of its own.

    Results do not depend on the number of threads.
    """

    policy: str = "expert"
    """Policy whose gains are searched: expert, ff, ff-filter, lee or lqr."""
    scenario: str = "nominal"
    """Name of the scenario that gains are searched for: nominal, paper, experiment, agile or swarm."""
    action: str | None = None
    """Name of an action level; by default the scenario's own."""
    feedforward: str = "both"
    """How the third and fourth derivatives of the reference are taken: zero, derived, or both tried.
    For the expert alone."""
    margin: bool = True
    """Fly the task with measurements one sample later and slight noise where its own are exact.
    Gains that are searched on exact sensors have no stability to spare."""
    episodes: int = 64
    """Number of training episodes that every candidate flies, all on the same seeds."""
    evaluations: int = 2000
    """Number of candidates in all, half for each feedforward where both are tried."""
    validation: int = 256
    """Number of validation episodes, on which the best candidates are compared."""
    finalists: int = 8
    """Number of candidates of each feedforward that fly the validation episodes."""
    spread: float = 0.5
    """Standard deviation of the first candidates about the scenario's own gains, in the logarithm of a gain.
    1 is a factor of e."""
    seed: int = 1
    """Seed of the random numbers that CMA-ES draws; episodes have seeds of their own."""
    output: Path = field(default_factory=lambda: Path("runs/tune"))
    """Folder for the journal, SCENARIO-ACTION.json, of others than the expert POLICY-SCENARIO-ACTION.json;
    made if it is not there."""
    gains: Path | None = None
    """File of gains that the result is written into, such as baselines/tuned_gains.json for the expert or
    baselines/tuned_gains_lee.json for lee; by default none."""
    resume: bool = False
    """Continue the search whose journal is in the output folder.
    Only evaluations, gains, threads and quiet may differ from the options that it was begun with."""
    threads: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Number of threads; by default one for each core. The expert's candidates are flown in one each, those
    of other laws together."""
    quiet: bool = False
    """Print no progress bar while the search runs."""

    def check(self) -> FormationConfig:
        """The configuration searched. Raises `ValueError` naming the option that is wrong."""
        known = self.policy in TUNABLES
        require(known, "policy", self.policy, f"one of {', '.join(TUNABLES)}")
        config = configure(self.scenario)
        if self.action is not None:
            config = configure(self.scenario, action=self.action)
        allowed = ("both", *FEEDFORWARDS)
        known = self.feedforward in allowed
        require(known, "feedforward", self.feedforward, f"one of {', '.join(allowed)}")
        integer("episodes", self.episodes, 1, MOST_TUNING_EPISODES)
        integer("evaluations", self.evaluations, 1, 10_000_000)
        integer("validation", self.validation, 1, MOST_TUNING_EPISODES)
        integer("finalists", self.finalists, 1, 1000)
        number("spread", self.spread, 0.0)
        integer("seed", self.seed, 0, 2**63)
        integer("threads", self.threads, 1, 1024)
        return config

    def choices(self, config: FormationConfig) -> tuple[str, ...]:
        """What is searched one after the other, sharing the candidates: for the expert the feedforwards."""
        return self.tunable.choices(config, self.feedforward)

    @property
    def tunable(self) -> Tunable:
        """What is searched."""
        return TUNABLES[self.policy]

    def command(self) -> str:
        """The command that repeats the result, without the options that do not change it."""
        return repeating_command(
            SCRIPT, asdict(self), defaults(Options), ("resume", "threads", "quiet", "output")
        )
