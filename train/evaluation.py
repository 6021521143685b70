"""How good a policy is while it learns, by the leaderboard's own metrics on seeds of its own."""

from __future__ import annotations

from typing import NamedTuple, final

from baselines.files import Card, Network
from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned
from baselines.policies.simple import Hover
from baselines.scoring.intervals import Estimate, estimate, normalised
from baselines.scoring.rollout import Episodes, fly_all
from formation_env import FormationConfig

# First seeds: the leaderboard's begin at 0; nobody has a million of any.
EVALUATION_SEEDS = 1_000_000
TRAINING_SEEDS = 10_000_000


class Row(NamedTuple):
    """One line of the log."""

    steps: int  # agent steps
    minutes: float  # of wall time, evaluations included
    score: float  # 0 as hover, 1 as the expert
    low: float  # and its 95 % interval
    high: float
    mean_return: float
    slot_error_rms: float  # m
    failed: float  # part of the episodes
    seed: int  # of the run


def line(steps: int, minutes: float, score: Estimate, columns: Episodes, seed: int) -> Row:
    """The line of a policy that has been judged."""
    value, low, high = (float(x) for x in score[:3])
    names = ("return", "slot_error_rms", "failed")
    earned, error, failed = (float(columns[name].mean()) for name in names)
    return Row(steps, minutes, value, low, high, earned, error, failed, seed)


HEADER = "steps,minutes,score,low,high,return,slot_error_rms,failed,seed\n"


def to_csv(rows: list[Row]) -> str:
    """The log as a file."""
    return HEADER + "".join(
        f"{r.steps},{r.minutes:.3f},{r.score:.5f},{r.low:.5f},{r.high:.5f},"
        f"{r.mean_return:.5f},{r.slot_error_rms:.5f},{r.failed:.4f},{r.seed}\n"
        for r in rows
    )


@final
class Judge:
    """Flies `episodes` episodes of a configuration; hover and the expert fly them once."""

    def __init__(self, config: FormationConfig, episodes: int) -> None:
        self.config, self.episodes = config, episodes
        self._hover = self._fly(Hover(config))["return"]
        self._expert = self._fly(Expert(config))["return"]

    def _fly(self, policy: Policy) -> Episodes:
        return fly_all(policy, range(EVALUATION_SEEDS, EVALUATION_SEEDS + self.episodes))

    def judge(self, card: Card, network: Network) -> tuple[Estimate, Episodes]:
        """The normalised score with its interval, and the metrics of every episode."""
        return self.score(Learned(self.config, (card, network)))

    def score(self, policy: Policy) -> tuple[Estimate, Episodes]:
        """The same of any policy."""
        columns = self._fly(policy)
        return estimate(normalised, columns["return"], self._hover, self._expert), columns
