"""PPO whose actor may learn more slowly than its critic, or later, or by a given divergence an update."""

from __future__ import annotations

from time import perf_counter
from typing import Any, final

from stable_baselines3 import PPO

from train.ppo.networks import FollowerPolicy

_RATE_FACTOR = 1.5  # by which the actor's rate is changed after an update


@final
class FollowerPPO(PPO):
    """Stable-Baselines3's PPO with a learning rate of the actor's own, which also measures its time.

    Its loss, its updates and its results are those of PPO while the fields below have their defaults.
    """

    update_seconds = 0.0  # wall time spent in updates
    critic_steps = 0  # agent steps at the start in which only the critic learns
    actor_rate = 1.0  # factor, 0 to 1, on the actor's learning rate
    # Divergence that an update should change the actor by, at the start; it falls with the learning rate.
    kl: float | None = None

    policy: FollowerPolicy

    def _adapt_actor_rate(self, kl: float) -> None:
        """Lower the actor's rate after an update of twice the target's divergence, raise it after half."""
        assert self.kl is not None
        left = self.lr_schedule(self._current_progress_remaining) / self.lr_schedule(1.0)
        target = self.kl * left
        if kl > 2.0 * target:
            self.actor_rate /= _RATE_FACTOR
        elif kl < 0.5 * target:
            self.actor_rate = min(self.actor_rate * _RATE_FACTOR, 1.0)

    def separate_actor(self, actor_rate: float) -> None:
        """Give actor and critic a learning rate each. To be called before anything is learned."""
        self.actor_rate = actor_rate
        actor = self.policy.actor_parameters()
        of_actor = {id(p) for p in actor}
        critic = [p for p in self.policy.parameters() if id(p) not in of_actor]
        groups = [{"params": actor}, {"params": critic}]
        kind, settings = self.policy.optimizer_class, self.policy.optimizer_kwargs
        self.policy.optimizer = kind(groups, lr=self.lr_schedule(1.0), **settings)  # type: ignore[call-arg]

    def _update_learning_rate(self, optimizers: Any) -> None:
        super()._update_learning_rate(optimizers)
        actor, *critic = self.policy.optimizer.param_groups
        if critic:
            actor["lr"] *= self.actor_rate

    def train(self) -> None:
        """One update, timed."""
        begun = perf_counter()
        critic_only = self.num_timesteps <= self.critic_steps
        for parameter in self.policy.actor_parameters():
            parameter.requires_grad_(not critic_only)
        super().train()
        if self.kl is not None and not critic_only:
            self._adapt_actor_rate(self.logger.name_to_value["train/approx_kl"])
        self.update_seconds += perf_counter() - begun
