"""How good a policy is while it learns, by the leaderboard's own metrics on seeds of its own."""

from __future__ import annotations

from typing import final

from baselines.files import Card, Network
from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned
from baselines.policies.simple import Hover
from baselines.scoring.intervals import Estimate, estimate, normalised
from baselines.scoring.rollout import Episodes, fly_all
from formation_env import FormationConfig
from train.seeds import EVALUATION_SEEDS


@final
class Evaluator:
    """Scores policies on `episodes` episodes of a configuration.

    Hover and the expert, which define the scores 0 and 1, fly the same episodes when it is made.
    """

    def __init__(self, config: FormationConfig, episodes: int) -> None:
        self.config, self.episodes = config, episodes
        self._hover = self._fly(Hover(config))["return"]
        self._expert = self._fly(Expert(config))["return"]

    def _fly(self, policy: Policy) -> Episodes:
        return fly_all(policy, range(EVALUATION_SEEDS, EVALUATION_SEEDS + self.episodes))

    def score_network(self, card: Card, network: Network) -> tuple[Estimate, Episodes]:
        """The normalised score of a policy file's contents with its interval, and every episode's metrics."""
        return self.score_policy(Learned(self.config, (card, network)))

    def score_policy(self, policy: Policy) -> tuple[Estimate, Episodes]:
        """The same of any policy."""
        columns = self._fly(policy)
        return estimate(normalised, columns["return"], self._hover, self._expert), columns
