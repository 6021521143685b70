"""PPO whose actor may learn more slowly than its critic, or later, or by as much as is asked for."""

from __future__ import annotations

from time import perf_counter
from typing import Any, final

from stable_baselines3 import PPO

from train.networks import FollowerPolicy

_STEER = 1.5  # by which the actor's rate is changed after an update


@final
class Learner(PPO):
    """PPO that can let the critic learn alone at first or faster, and that keeps time."""

    seconds = 0.0  # in updates
    alone_until = 0  # agent steps
    actor_rate = 1.0  # part of the learning rate
    kl: float | None = None  # to be kept by that part at the start; it falls with the learning rate

    policy: FollowerPolicy

    def _steer(self, kl: float) -> None:
        """Slower if an update went twice as far as it should, faster if not half as far."""
        assert self.kl is not None
        left = self.lr_schedule(self._current_progress_remaining) / self.lr_schedule(1.0)
        wanted = self.kl * left
        if kl > 2.0 * wanted:
            self.actor_rate /= _STEER
        elif kl < 0.5 * wanted:
            self.actor_rate = min(self.actor_rate * _STEER, 1.0)

    def part(self, actor_rate: float) -> None:
        """Let the actor take so much of the learning rate. Before anything is learned."""
        self.actor_rate = actor_rate
        actor = self.policy.actor_parameters()
        own = {id(p) for p in actor}
        critic = [p for p in self.policy.parameters() if id(p) not in own]
        groups = [{"params": actor}, {"params": critic}]
        kind, settings = self.policy.optimizer_class, self.policy.optimizer_kwargs
        self.policy.optimizer = kind(groups, lr=self.lr_schedule(1.0), **settings)  # type: ignore[call-arg]

    def _update_learning_rate(self, optimizers: Any) -> None:
        super()._update_learning_rate(optimizers)
        actor, *critic = self.policy.optimizer.param_groups
        if critic:
            actor["lr"] *= self.actor_rate

    def train(self) -> None:
        """One update."""
        begun = perf_counter()
        alone = self.num_timesteps <= self.alone_until
        for parameter in self.policy.actor_parameters():
            parameter.requires_grad_(not alone)
        super().train()
        if self.kl is not None and not alone:
            self._steer(self.logger.name_to_value["train/approx_kl"])
        self.seconds += perf_counter() - begun
