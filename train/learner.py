"""One run of PPO: made from options or from a checkpoint, trained, saved."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from math import log
from pathlib import Path
from time import perf_counter
from typing import Any, final

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure as configure_logger

import formation_env
from baselines import files
from baselines.files import Card, Network
from baselines.system.progress import compiling
from baselines.system.writing import Claim, claim
from formation_env._jit import untold
from formation_env.checks import integer, number, require
from train import checkpoint
from train.actor_rate import Learner
from train.callbacks import Diary, Keeper, shares
from train.evaluation import TRAINING_SEEDS, Judge
from train.export import adopt, hidden_sizes, network
from train.networks import FollowerPolicy, Spread
from train.options import FINE, FREE, STD, Options, command, to_json
from train.progress import Progress
from train.saved import Arrays, continued, fact, past, take, take_like
from train.scales import CLIP, fixed_scales, state_scales
from train.vec import FollowerVecEnv

RESIDUAL_STD = 0.3  # of the exploration, as part of the bound


@final
class Run:
    """A run that is ready to train; see `prepare`."""

    def __init__(
        self, options: Options, method: str, source: tuple[Card, Network] | None = None
    ) -> None:
        self.options, self._method = options, method
        torch.set_num_threads(options.threads)
        self.env = _environment(options)
        self.model = _model(options, self.env, source)
        self.policy = self.model.policy
        self.entries = self.env.entries
        self.spread = Spread(self.env.config.layout)
        self.diary = Diary([], 0.0, 0)
        self._keeper: Keeper | None = None
        self._total = 0.0
        self.claim: Claim | None = None  # of the output folder

    @cached_property
    def judge(self) -> Judge:
        """Scores the policy. Making it flies episodes, and so compiles what is not compiled yet."""
        return Judge(self.options.config(), self.options.episodes)

    # -- files ------------------------------------------------------------------------------------

    def made(self) -> tuple[Card, Network]:
        """The policy as it is, with its card."""
        o, config = self.options, self.env.config
        minutes = self._keeper.minutes if self._keeper else 0.0
        rows = self._keeper.rows if self._keeper else []
        now = {}
        if rows and rows[-1].steps == self.model.num_timesteps:
            now = {o.scenario: [rows[-1].score, rows[-1].low, rows[-1].high]}
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
            command=command(o),
            seed=o.seed,
            steps=int(self.model.num_timesteps),
            minutes=minutes,
            package=formation_env.__version__,
            score=now,
        )
        return card, network(self.policy, self.entries)

    def save(self, diary: Diary) -> None:
        """Write the checkpoint."""
        facts, arrays = checkpoint.random_state()
        groups = {
            "random": arrays,
            "environment": self.env.get_state(),
            "policy": {k: v.numpy() for k, v in self.policy.state_dict().items()},
            "optimiser": checkpoint.optimiser_state(self.policy.optimizer),
            "spread": {name: getattr(self.spread, name) for name in ("count", "mean", "square")},
            "last": {"obs": self.model._last_obs, "starts": self.model._last_episode_starts},
        }
        flat = {f"{g}/{name}": x for g, part in groups.items() for name, x in part.items()}
        checkpoint.save(
            self.options.output / checkpoint.NAME,
            {
                "options": to_json(self.options),
                "method": self._method,
                "steps": int(self.model.num_timesteps),
                "updates": int(self.model._n_updates),
                "actor_rate": self.model.actor_rate,
                "random": facts,
                "rows": [list(row) for row in diary.rows],
                "minutes": diary.minutes,
                "next_evaluation": diary.next_evaluation,
            },
            flat,
        )

    def restore(self, facts: dict[str, Any], arrays: Arrays) -> None:
        """Take back what `save` wrote. Raises `ValueError` naming what is amiss; then nothing is usable."""
        state = {name: x.numpy() for name, x in self.policy.state_dict().items()}
        weights = take_like(arrays, "policy", state)
        spread = {name: getattr(self.spread, name) for name in ("count", "mean", "square")}
        seen = (self.env.num_envs, *(self.env.observation_space.shape or ()))
        last = take(arrays, "last/obs", seen, np.float32)
        starts = take(arrays, "last/starts", seen[:1], np.bool_)
        self.env.reset()  # for what a state of it is made of
        self.env.set_state(take_like(arrays, "environment", self.env.get_state()))
        self.policy.load_state_dict({k: torch.from_numpy(v.copy()) for k, v in weights.items()})
        checkpoint.restore_optimiser(self.policy.optimizer, arrays)
        files.check(*self.made())
        for name, x in take_like(arrays, "spread", spread).items():
            setattr(self.spread, name, x)
        self.model._last_obs, self.model._last_episode_starts = last, starts
        before = past(facts)
        self.model.num_timesteps = before.steps
        self.model._n_updates = integer("updates", fact(facts, "updates"), 0)
        rate = number("actor_rate", fact(facts, "actor_rate"), 0.0, 1.0, strict=False)
        self.model.actor_rate = rate
        self.diary = Diary(before.rows, before.minutes, before.next_evaluation)
        checkpoint.restore_random(fact(facts, "random"), arrays)

    # -- training ---------------------------------------------------------------------------------

    def compile(self) -> None:
        """Compile what is not compiled yet; `train` does it too, but before it Ctrl-C ends all at once."""
        with compiling(self.options.quiet):
            _ = self.judge

    def train(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Train to the limit, or until `stop` says so between two updates; then the folder is released."""
        o = self.options
        self.compile()
        bar = Progress(o.steps, o.minutes, o.quiet)
        self._keeper = Keeper(
            o.output,
            self.diary,
            self.judge,
            self.made,
            lambda path, made: files.save(path, *made),
            self.save,
            (float("inf") if o.minutes is None else o.minutes, o.save_every, o.evaluate_every),
            stop,
            bar.show,
        )
        begun = perf_counter()
        try:
            self.model.learn(
                max(0, o.steps - self.model.num_timesteps),
                [_Measure(self)] * (o.normalise == "running") + [self._keeper],
                reset_num_timesteps=False,
            )
        finally:
            bar.close()
            self.release()
        self._total = perf_counter() - begun

    def release(self) -> None:
        """Let other runs write into the folder."""
        if self.claim is not None:
            self.claim.release()

    def profile(self) -> str:
        """Where the time went."""
        assert self._keeper is not None
        named = {
            "gradient steps": self.model.seconds,
            "environment": self.env.seconds,
            "bridge": self.env.seconds_here - self.env.seconds,
            "policy in the rollout": self.policy.seconds,
            **self._keeper.seconds,
        }
        return shares(named, self._total)

    def summary(self) -> str:
        """The last line of the log in words."""
        assert self._keeper is not None
        if not self._keeper.rows:
            return "nothing was evaluated"
        row, best = self._keeper.rows[-1], max(self._keeper.rows, key=lambda r: r.score)
        return (
            f"score {row.score:.3f} ({row.low:.3f} .. {row.high:.3f}) after {row.steps:,} agent steps "
            f"and {row.minutes:.1f} minutes; best {best.score:.3f} at {best.steps:,}: "
            f"{self.options.output / 'best.safetensors'}"
        )


@final
class _Measure(BaseCallback):
    """Takes in what was observed after a rollout, and normalises by it before the next."""

    def __init__(self, run: Run) -> None:
        super().__init__()
        self._run = run

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        run = self._run
        seen = run.model.rollout_buffer.observations[..., : run.env.own]
        run.spread.add(seen.reshape(-1, run.env.own)[:, -run.entries :])

    def _on_rollout_start(self) -> None:
        run = self._run
        if run.spread.count > 0:
            run.policy.normalise(*run.spread.scales(), _state_scales(run.options, run.env))


# -- making one -----------------------------------------------------------------------------------


def prepare(options: Options) -> Run:
    """A run that is ready to train, in a folder that is its own until `train` has ended.

    Raises `ValueError` for options that cannot be, `OSError` for the folder.
    """
    path = options.output / checkpoint.NAME
    source = None
    if options.resume:
        checkpoint.require_there(path)
    elif options.init is not None:
        source = files.load(options.init)
        options = _fitted(options, *source)
    own = claim(options.output)
    try:
        if options.resume:
            with untold():  # making the worlds compiles a little; `train` says so, with the rest
                run = _resumed(path, options)
        elif path.exists():
            raise ValueError(f"{path} exists: go on with --resume, or choose another folder")
        else:
            with untold():
                run = Run(options, _method(options, source), source)
    except BaseException:
        own.release()
        raise
    run.claim = own
    return run


# What may come of building a run for options and numbers that do not fit one another.
_UNFIT = (ValueError, TypeError, KeyError, IndexError, RuntimeError, OverflowError, MemoryError)


def _resumed(path: Path, given: Options) -> Run:
    facts, arrays = checkpoint.load(path)
    try:
        options = continued(fact(facts, "options"), given, FREE)
        _require_sizes(options, arrays)
        run = Run(options, _known_method(fact(facts, "method")))
        run.restore(facts, arrays)
    except _UNFIT as problem:
        told = " ".join(str(problem).split())[:400]
        what = "" if isinstance(problem, ValueError) else "does not fit its own options: "
        raise ValueError(f"{path}: {what}{told or type(problem).__name__}") from None
    return run


def _require_sizes(options: Options, arrays: Arrays) -> None:
    """That the options ask for no more than the arrays hold, before anything of that size is made."""
    rows = options.worlds * options.training_config().followers
    seen = arrays.get("last/obs", np.zeros(0))
    require(seen.shape[:1] == (rows,), "options.worlds", options.worlds, "as many as were saved")
    entries = options.history * options.config().layout.size
    fits = seen.ndim == 2 and seen.shape[1] >= entries
    require(fits, "options.history", options.history, "as many as were saved")
    for i, width in enumerate(options.hidden):
        layer = arrays.get(f"policy/mlp_extractor.policy_net.{2 * i}.weight", np.zeros(0))
        require(layer.shape[:1] == (width,), "options.hidden", options.hidden, "those saved")


def _known_method(name: Any) -> str:
    """The method's name as a policy's card takes it."""
    good = isinstance(name, str) and re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name) is not None
    require(good and len(name) <= 100, "method", name, "words of letters and digits with hyphens")
    return str(name)


def _fitted(options: Options, card: Card, net: Network) -> Options:
    """The options with what the file decides. Raises `ValueError` where both do and differ."""
    config = options.config()
    found = {
        "action": (card.action, config.action),
        "observation entries": (card.entries, config.layout.size),
    }
    for name, (own, wanted) in found.items():
        if own != wanted:
            raise ValueError(f"--init {options.init}: {name} {own}, the task has {wanted}")
    for name, usual in (("history", 1), ("residual", 0.0)):
        own, given = getattr(card, name), getattr(options, name)
        if given not in (usual, own):
            raise ValueError(f"--{name} {given}: the policy in {options.init} has {own}")
    return replace(
        options,
        history=card.history,
        residual=card.residual,
        hidden=tuple(hidden_sizes(net)),
        activation="relu" if card.activation == "relu" else "tanh",
    )


def _method(options: Options, source: tuple[Card, Network] | None) -> str:
    """What the policy's card calls the way it was trained."""
    if source is None:
        return "ppo" if options.residual == 0.0 else "residual"
    own = source[0].method
    return own if own == "residual" or own.endswith("ppo") else f"{own}-ppo"


def _environment(options: Options) -> FollowerVecEnv:
    return FollowerVecEnv(
        options.training_config(),
        options.worlds,
        seed_offset=TRAINING_SEEDS + options.seed * options.worlds,
        history=options.history,
        residual=options.residual,
        critic=options.critic,
        stagger=True,
        reward_scale=1.0 - options.gamma,
        threads=options.threads,
    )


def _state_scales(options: Options, env: FollowerVecEnv) -> Any:
    return state_scales(env.followers) if options.critic == "central" else None


def _std(options: Options) -> float:
    """Of the exploration at the start."""
    if options.std is not None:
        return options.std
    usual = STD[options.config().action] if options.residual == 0.0 else RESIDUAL_STD
    return usual * (FINE if options.init is not None else 1.0)


def _model(options: Options, env: FollowerVecEnv, source: tuple[Card, Network] | None) -> Learner:
    """The learner at the start."""
    std, samples = _std(options), env.num_envs * options.rollout
    hidden = list(options.hidden)
    with warnings.catch_warnings():  # that a last batch may be smaller
        warnings.simplefilter("ignore")
        model = Learner(
            FollowerPolicy,
            env,
            learning_rate=lambda left: options.learning_rate * max(0.1, left),
            n_steps=options.rollout,
            batch_size=min(options.batch, samples),
            n_epochs=options.epochs,
            gamma=options.gamma,
            gae_lambda=options.gae_lambda,
            clip_range=options.clip_range,
            ent_coef=options.entropy,
            vf_coef=options.value,
            max_grad_norm=options.gradient,
            seed=options.seed,
            device="cpu",
            policy_kwargs={
                "own": env.own,
                "gain": std,
                "log_std_init": log(std),
                "net_arch": {"pi": hidden, "vf": hidden},
                "activation_fn": torch.nn.ReLU if options.activation == "relu" else torch.nn.Tanh,
            },
        )
    model.alone_until = options.critic_steps
    model.kl = options.kl
    if options.actor_rate != 1.0 or options.kl is not None:
        model.part(options.actor_rate)
    model.set_logger(configure_logger(str(Path(options.output) / "tensorboard"), ["tensorboard"]))
    if source is None:
        scales = fixed_scales(env.config.layout)
        model.policy.normalise(*scales, _state_scales(options, env))
    else:
        adopt(model.policy, *source, env.followers)
    return model
