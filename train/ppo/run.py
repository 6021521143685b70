"""One run of PPO: trained, evaluated, saved and restored. `train.ppo.start` makes it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from time import perf_counter
from typing import Any, final

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

import formation_env
from baselines import files
from baselines.files import Card, Network
from baselines.system.progress import compiling
from baselines.system.writing import Claim
from formation_env.validation.checks import integer, number
from train import checkpoint
from train.checkpoint_contents import Arrays, array_like, arrays_like, fact, run_record
from train.evaluation import Evaluator
from train.log import RunRecord, summary
from train.margin import changes
from train.ppo.callbacks import BEST, EvaluateAndSave, Hooks, Limits, time_table
from train.ppo.model import critic_state_scales, make_environment, make_model
from train.ppo.networks import ObservationMoments
from train.ppo.options import Options
from train.ppo.policy_files import actor_network
from train.progress import Progress
from train.scales import CLIP

# Names in the checkpoint of the running moments of observations.
_MOMENTS = ("count", "mean", "square")


@final
class Run:
    """A run of PPO that is ready to train; `train.ppo.start.prepare` makes it.

    `method` is the name of the way of training for the policy's card, `source` the policy file's contents
    that the actor starts from.
    """

    def __init__(
        self, options: Options, method: str, source: tuple[Card, Network] | None = None
    ) -> None:
        self.options, self._method = options, method
        torch.set_num_threads(options.threads)
        self.env = make_environment(options)
        self.model = make_model(options, self.env, source)
        self.policy = self.model.policy
        self.entries = self.env.entries
        self.moments = ObservationMoments(self.env.config.layout)
        self.record = RunRecord()  # of earlier sittings
        self._callback: EvaluateAndSave | None = None
        self._train_seconds = 0.0
        self.claim: Claim | None = None  # of the output folder

    @cached_property
    def evaluator(self) -> Evaluator:
        """Scores the policy. Making it flies episodes, and so compiles what is not compiled yet."""
        return Evaluator(self.options.config(), self.options.episodes)

    # -- files ------------------------------------------------------------------------------------

    def policy_file(self) -> tuple[Card, Network]:
        """Card and network of the policy as it is now."""
        o, config = self.options, self.env.config
        minutes = self._callback.minutes if self._callback else 0.0
        rows = self._callback.rows if self._callback else []
        score = {}
        if rows and rows[-1].steps == self.model.num_timesteps:
            score = {o.scenario: [rows[-1].score, rows[-1].low, rows[-1].high]}
        card = Card(
            action=config.action,
            entries=self.entries,
            action_size=config.action_size,
            scenario=o.scenario,
            method=self._method,
            activation=o.activation,
            history=o.history,
            residual=o.residual,
            clip=CLIP,
            margin=bool(changes(o.config(), config)),
            command=o.command(),
            seed=o.seed,
            steps=int(self.model.num_timesteps),
            minutes=minutes,
            package=formation_env.__version__,
            score=score,
        )
        return card, actor_network(self.policy, self.entries)

    def save(self, record: RunRecord) -> None:
        """Write the checkpoint."""
        random_facts, random_arrays = checkpoint.random_state()
        groups = {
            "random": random_arrays,
            "environment": self.env.get_state(),
            "policy": {k: v.numpy() for k, v in self.policy.state_dict().items()},
            "optimiser": checkpoint.optimiser_state(self.policy.optimizer),
            "spread": {name: getattr(self.moments, name) for name in _MOMENTS},
            "last": {"obs": self.model._last_obs, "starts": self.model._last_episode_starts},
        }
        flat = {f"{g}/{name}": x for g, part in groups.items() for name, x in part.items()}
        checkpoint.save(
            self.options.output / checkpoint.NAME,
            {
                "options": self.options.to_json(),
                "method": self._method,
                "steps": int(self.model.num_timesteps),
                "updates": int(self.model._n_updates),
                "actor_rate": self.model.actor_rate,
                "random": random_facts,
                "rows": [list(row) for row in record.rows],
                "minutes": record.minutes,
                "next_evaluation": record.next_evaluation,
            },
            flat,
        )

    def restore(self, facts: dict[str, Any], arrays: Arrays) -> None:
        """Take back what `save` wrote.

        Raises `ValueError` naming what does not fit; the run cannot be used then.
        """
        state = {name: x.numpy() for name, x in self.policy.state_dict().items()}
        weights = arrays_like(arrays, "policy", state)
        shape = (self.env.num_envs, *(self.env.observation_space.shape or ()))
        observations = array_like(arrays, "last/obs", shape, np.float32)
        starts = array_like(arrays, "last/starts", shape[:1], np.bool_)
        self.env.reset()  # so that its state has the arrays that are compared
        self.env.set_state(arrays_like(arrays, "environment", self.env.get_state()))
        self.policy.load_state_dict({k: torch.from_numpy(v.copy()) for k, v in weights.items()})
        checkpoint.restore_optimiser(self.policy.optimizer, arrays)
        files.check(*self.policy_file())
        moments = {name: getattr(self.moments, name) for name in _MOMENTS}
        for name, x in arrays_like(arrays, "spread", moments).items():
            setattr(self.moments, name, x)
        self.model._last_obs, self.model._last_episode_starts = observations, starts
        self.record = run_record(facts)
        self.model.num_timesteps = self.record.steps
        self.model._n_updates = integer("updates", fact(facts, "updates"), 0)
        rate = number("actor_rate", fact(facts, "actor_rate"), 0.0, 1.0, strict=False)
        self.model.actor_rate = rate
        checkpoint.restore_random(fact(facts, "random"), arrays)

    # -- training ---------------------------------------------------------------------------------

    def compile(self) -> None:
        """Compile what is not compiled yet; `train` does it too, but before it Ctrl-C ends at once."""
        with compiling(self.options.quiet):
            _ = self.evaluator

    def train(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Train to the limit, or until `stop` returns True between two updates; then release the folder."""
        o = self.options
        self.compile()
        bar = Progress(o.steps, o.minutes, o.quiet)
        self._callback = EvaluateAndSave(
            o.output,
            self.record,
            self.evaluator,
            Hooks(self.policy_file, _save_policy, self.save, stop, bar.show),
            Limits(
                float("inf") if o.minutes is None else o.minutes, o.save_every, o.evaluate_every
            ),
        )
        begun = perf_counter()
        try:
            self.model.learn(
                max(0, o.steps - self.model.num_timesteps),
                [_UpdateNormalisation(self)] * (o.normalise == "running") + [self._callback],
                reset_num_timesteps=False,
            )
        finally:
            bar.close()
            self.release()
        self._train_seconds = perf_counter() - begun

    def release(self) -> None:
        """Let other runs write into the folder."""
        if self.claim is not None:
            self.claim.release()

    def profile(self) -> str:
        """A table of how long each part took."""
        assert self._callback is not None
        named = {
            "gradient steps": self.model.update_seconds,
            "environment": self.env.simulation_seconds,
            "bridge": self.env.step_seconds - self.env.simulation_seconds,
            "policy in the rollout": self.policy.rollout_seconds,
            **self._callback.seconds,
        }
        return time_table(named, self._train_seconds)

    def summary(self) -> str:
        """The last and the best evaluation in words."""
        assert self._callback is not None
        return summary(self._callback.rows, self.options.output / BEST)


def _save_policy(path: Any, policy_file: tuple[Card, Network]) -> None:
    files.save(path, *policy_file)


@final
class _UpdateNormalisation(BaseCallback):
    """Adds a rollout's observations to the moments, and normalises by them from the next rollout on."""

    def __init__(self, run: Run) -> None:
        super().__init__()
        self._run = run

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        run, local = self._run, self._run.env.local_size
        observations = run.model.rollout_buffer.observations[..., :local].reshape(-1, local)
        run.moments.add(observations[:, -run.entries :])  # the newest of a history

    def _on_rollout_start(self) -> None:
        run = self._run
        if run.moments.count > 0:
            scales = run.moments.scales()
            run.policy.set_normalisation(*scales, critic_state_scales(run.options, run.env))
