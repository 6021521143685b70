"""The options of `python -m train.rllib`, named as those of `train.ppo` where they are the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from train.command_line import SCRIPTS
from train.options import STD, PPOOptions, Ranges


@dataclass(frozen=True)
class Options(PPOOptions):
    """Train one policy, shared by all followers, with PPO on a Ray cluster."""

    resume: bool = False
    """Continue the run in the output folder with the options that it was started with.
    Of those given here only steps, minutes, runners, address, threads and quiet count."""
    worlds: int = 64
    """Number of worlds that each process flies at once."""
    rollout: int = 64
    batch: int = 1024
    threads: int = 1
    """Number of threads of PyTorch in the learner; every runner has one.
    More are of use for large networks on a machine that does nothing else."""

    runners: int = 0
    """Number of processes that fly, one core each, anywhere in the cluster; 0 flies in this process."""
    address: str | None = None
    """HOST:PORT of a Ray cluster that runs already; by default one is started for this run alone."""

    script: ClassVar[str] = SCRIPTS["train.rllib"]
    without_effect: ClassVar[tuple[str, ...]] = ("output", "resume", "address", "threads", "quiet")
    free_on_resume: ClassVar[tuple[str, ...]] = (
        "steps", "minutes", "resume", "runners", "address", "threads", "quiet", "output",
    )  # fmt: skip
    integers: ClassVar[Ranges] = {
        **PPOOptions.integers,
        "worlds": (1, 2**16),
        "runners": (0, 10_000),
    }

    def exploration(self) -> float:
        """Standard deviation of the actions at the start."""
        return STD[self.config().action] if self.std is None else self.std
