"""How good a policy is while it learns, by the leaderboard's own score on seeds of its own."""

from __future__ import annotations

from typing import final

from baselines.files import Card, Network
from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned
from baselines.scoring.intervals import Estimate, estimate
from baselines.scoring.rollout import Episodes, fly, fly_all
from formation_env import FormationConfig
from train.seeds import EVALUATION_SEEDS


@final
class Evaluator:
    """Scores policies on `episodes` episodes of a configuration.

    Making it compiles what that needs, also of a policy that corrects the expert.
    """

    def __init__(self, config: FormationConfig, episodes: int) -> None:
        self.config, self.episodes = config, episodes
        fly(Expert(config), range(EVALUATION_SEEDS, EVALUATION_SEEDS + 1), most=2)

    def score_network(self, card: Card, network: Network) -> tuple[Estimate, Episodes]:
        """The score of a policy file's contents with its interval, and every episode's metrics."""
        return self.score_policy(Learned(self.config, (card, network)))

    def score_policy(self, policy: Policy) -> tuple[Estimate, Episodes]:
        """The same of any policy."""
        seeds = range(EVALUATION_SEEDS, EVALUATION_SEEDS + self.episodes)
        columns = fly_all(policy, seeds)
        return estimate(columns["score"]), columns
