"""One run of PPO on RLlib: made from options or from a checkpoint, trained, saved."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple, final

import numpy as np
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.tune.registry import register_env

import formation_env
from baselines import files
from baselines.files import Card, Network
from baselines.system.progress import compiling
from baselines.system.writing import Claim, claim
from train import checkpoint
from train.checkpoint_contents import (
    Arrays,
    adam_moments,
    arrays_like,
    fact,
    resumed_options,
    run_record,
)
from train.evaluation import Evaluator
from train.log import LogRow, RunRecord, is_best, log_row, summary, to_csv
from train.progress import Progress
from train.rllib.module import FollowerModule, actor_network
from train.rllib.options import Options
from train.rllib.rows import FollowerRows
from train.scales import CLIP, fixed_scales, state_scales

BEST, LAST, LOG = "best.safetensors", "last.safetensors", "log.csv"
_ENVIRONMENT = "formation_rows"


class Saved(NamedTuple):
    """The contents of a checkpoint that a run is resumed from."""

    record: RunRecord
    arrays: Arrays


# -- the algorithm --------------------------------------------------------------------------------


def _make_rows(config: dict[str, Any]) -> FollowerRows:
    """Makes the environment from RLlib's `env_config`, in the process of every runner."""
    return FollowerRows(**config)


def model_config(options: Options) -> dict[str, Any]:
    """What `FollowerModule` is made of."""
    config = options.config()
    mean, scale = fixed_scales(config.layout)
    central = options.critic == "central"
    return {
        "mean": mean.tolist(),
        "scale": scale.tolist(),
        "state_scale": state_scales(config.followers).tolist() if central else [],
        "hidden": list(options.hidden),
        "activation": options.activation,
        "std": options.exploration(),
    }


def _schedule(options: Options, steps: int) -> list[list[float]]:
    """The learning rate as RLlib takes it, from agent step `steps` on, which counts as 0 there."""
    last, rate = max(options.steps, steps + 1), options.learning_rate
    begin = rate * max(0.1, 1.0 - steps / last)
    return [[0, begin], [max(1, last - steps), 0.1 * rate]]


def algorithm(options: Options, steps: int = 0) -> Any:
    """RLlib's PPO for the options, for a run that has made so many agent steps already."""
    config = options.config()
    rows = options.worlds * config.followers
    batch = rows * options.rollout * max(1, options.runners)
    # Another one after every interruption, so that the worlds flown before do not come again. RLlib
    # adds the runner's number to it.
    seed = int(np.random.SeedSequence([options.seed, steps]).generate_state(1)[0]) >> 2
    register_env(_ENVIRONMENT, _make_rows)
    ppo = (
        PPOConfig()
        .api_stack(enable_rl_module_and_learner=True, enable_env_runner_and_connector_v2=True)
        .environment(
            _ENVIRONMENT,
            env_config={
                "config": config,
                "central": options.critic == "central",
                "reward_scale": 1.0 - options.gamma,
            },
            normalize_actions=False,  # they are in [-1, 1]; what lies outside the task clips itself
            clip_actions=False,
            disable_env_checking=True,
        )
        .env_runners(
            num_env_runners=options.runners,
            num_envs_per_env_runner=rows,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=options.rollout,
        )
        .rl_module(
            rl_module_spec=RLModuleSpec(
                module_class=FollowerModule, model_config=model_config(options)
            )
        )
        .training(
            lr=_schedule(options, steps),
            gamma=options.gamma,
            lambda_=options.gae_lambda,
            clip_param=options.clip_range,
            use_kl_loss=False,
            vf_clip_param=float("inf"),
            vf_loss_coeff=options.value,
            entropy_coeff=options.entropy,
            grad_clip=options.gradient,
            grad_clip_by="global_norm",
            train_batch_size_per_learner=batch,
            minibatch_size=min(options.batch, batch),
            num_epochs=options.epochs,
        )
        .debugging(seed=seed, log_level="ERROR")
    )
    return ppo.build_algo()


# -- a run ----------------------------------------------------------------------------------------


@final
class Run:
    """A run that is ready to train, on a Ray that is connected; see `prepare`."""

    def __init__(self, options: Options, saved: Saved | None) -> None:
        self.options = options
        torch.set_num_threads(options.threads)
        with compiling(options.quiet):
            self._evaluator = Evaluator(options.config(), options.episodes)
        record = RunRecord() if saved is None else saved.record
        self._earlier, self.steps = record, record.steps  # agent steps
        self._next_evaluation, self.rows = record.next_evaluation, list[LogRow](record.rows)
        self._algorithm = algorithm(options, record.steps)
        if saved is not None:
            self._restore(saved)
        self._begun = self._saved_at = perf_counter()

    @property
    def minutes(self) -> float:
        """Of wall time, all sittings together."""
        return self._earlier.minutes + (perf_counter() - self._begun) / 60.0

    def train(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Train to the limit, or until `stop` returns True between two updates."""
        o = self.options
        most = float("inf") if o.minutes is None else o.minutes
        bar = Progress(o.steps, o.minutes, o.quiet)
        try:
            while self.steps < o.steps and self.minutes < most and not stop():
                self._maybe_evaluate()
                result = self._algorithm.train()
                lifetime = int(result["env_runners"]["num_env_steps_sampled_lifetime"])
                self.steps = self._earlier.steps + lifetime
                bar.show(self.steps, self.minutes, self.rows)
                if perf_counter() - self._saved_at >= 60.0 * o.save_every:
                    self._save()
            if not stop():
                self._maybe_evaluate(last=True)
            self._save()
        finally:
            bar.close()

    def summary(self) -> str:
        """The last and the best evaluation in words."""
        return summary(self.rows, self.options.output / BEST)

    def close(self) -> None:
        """Stop the runners."""
        self._algorithm.stop()
        with suppress(OSError):  # an empty folder that RLlib makes in the user's home
            Path(self._algorithm.logdir).rmdir()

    # -- evaluations ----------------------------------------------------------------------------------

    def weights(self) -> dict[str, Any]:
        """The module's numbers by name."""
        state = self._algorithm.learner_group.get_state(components="learner/rl_module")
        weights: dict[str, Any] = state["learner"]["rl_module"][DEFAULT_MODULE_ID]
        return weights

    def policy_file(self) -> tuple[Card, Network]:
        """Card and network of the policy as it is now."""
        o = self.options
        config = o.config()
        score = {}
        if self.rows and self.rows[-1].steps == self.steps:
            score = {o.scenario: [self.rows[-1].score, self.rows[-1].low, self.rows[-1].high]}
        card = Card(
            action=config.action,
            entries=config.layout.size,
            action_size=config.action_size,
            scenario=o.scenario,
            method="rllib-ppo",
            activation=o.activation,
            clip=CLIP,
            command=o.command(),
            seed=o.seed,
            steps=self.steps,
            minutes=self.minutes,
            package=formation_env.__version__,
            score=score,
        )
        return card, actor_network(self.weights(), o.exploration())

    def _maybe_evaluate(self, last: bool = False) -> None:
        """If it is due, add a row to the log, and write the policy if it is the best one yet."""
        evaluated = bool(self.rows) and self.rows[-1].steps == self.steps
        if evaluated or not (last or self.steps >= self._next_evaluation):
            return
        o = self.options
        score, columns = self._evaluator.score_network(*self.policy_file())
        row = log_row(self.steps, self.minutes, score, columns, o.seed)
        best = is_best(row, self.rows)
        self.rows.append(row)
        self._next_evaluation = (self.steps // o.evaluate_every + 1) * o.evaluate_every
        if best:
            files.save(o.output / BEST, *self.policy_file())  # now with its score
        checkpoint.write(o.output / LOG, to_csv(self.rows).encode())
        self._save()

    # -- files ------------------------------------------------------------------------------------

    def _save(self) -> None:
        """Write the policy and the checkpoint: numbers and JSON, which RLlib's own are not."""
        files.save(self.options.output / LAST, *self.policy_file())
        state = self._algorithm.learner_group.get_state(components="learner/optimizer")
        ((_, optimiser),) = state["learner"]["optimizer"].items()
        arrays = {f"module/{k}": np.asarray(v) for k, v in self.weights().items()}
        arrays |= {
            f"optimiser/{index}.{name}": np.asarray(value)
            for index, each in optimiser["state"]["state"].items()
            for name, value in each.items()
        }
        facts = {
            "options": self.options.to_json(),
            "steps": self.steps,
            "minutes": self.minutes,
            "next_evaluation": self._next_evaluation,
            "rows": [list(row) for row in self.rows],
        }
        checkpoint.save(self.options.output / checkpoint.NAME, facts, arrays)
        self._saved_at = perf_counter()

    def _restore(self, saved: Saved) -> None:
        """Give the learner what `_save` wrote, and the runners its weights.

        Raises `ValueError` where it does not fit the network, as after a change of the observation.
        """
        present = {name: np.asarray(x) for name, x in self.weights().items()}
        try:
            weights = arrays_like(saved.arrays, "module", present)
            adam = adam_moments(saved.arrays)
        except ValueError as problem:
            raise ValueError(f"{self.options.output / checkpoint.NAME}: {problem}") from None
        learners = self._algorithm.learner_group
        state = learners.get_state(components=["learner/rl_module", "learner/optimizer"])["learner"]
        state["rl_module"][DEFAULT_MODULE_ID] = weights
        ((_, optimiser),) = state["optimizer"].items()
        optimiser["state"] = {**optimiser["state"], "state": adam}
        learners.set_state({"learner": {k: state[k] for k in ("rl_module", "optimizer")}})
        self._algorithm.env_runner_group.sync_weights(from_worker_or_learner_group=learners)


# -- making one -----------------------------------------------------------------------------------


def prepare(options: Options) -> tuple[Options, Saved | None, Claim]:
    """The options to run with, the checkpoint to go on from, and the folder, which no other run writes
    into until it is released.

    Raises `ValueError` for options that cannot be, `OSError` for the folder.
    """
    path = options.output / checkpoint.NAME
    if options.resume:
        checkpoint.require_there(path)
    folder = claim(options.output)
    try:
        if options.resume:
            return *_resumed(path, options), folder
        if path.exists():
            raise ValueError(f"{path} exists: go on with --resume, or choose another folder")
    except BaseException:
        folder.release()
        raise
    return options, None, folder


def _resumed(path: Path, given: Options) -> tuple[Options, Saved]:
    """Options and contents of a checkpoint."""
    facts, arrays = checkpoint.load(path)
    try:
        options = resumed_options(fact(facts, "options"), given)
        return options, Saved(run_record(facts), arrays)
    except ValueError as problem:
        raise ValueError(f"{path}: {problem}") from None


def require_cores(ray: Any, options: Options) -> None:
    """Raise `ValueError` where there are fewer cores than runners, which would wait for one forever."""
    cores = int(ray.cluster_resources().get("CPU", 0))
    if options.runners > cores:
        raise ValueError(
            f"--runners {options.runners}: the cluster has {cores} cores, one for each is needed"
        )
