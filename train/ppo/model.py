"""What a run of PPO is made of: the environment and the model with its policy, from the options."""

from __future__ import annotations

import warnings
from math import log
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.logger import configure as configure_logger

from baselines.files import Card, Network
from train.ppo.algorithm import FollowerPPO
from train.ppo.networks import FollowerPolicy
from train.ppo.options import Options
from train.ppo.policy_files import load_actor
from train.scales import fixed_scales, state_scales
from train.seeds import first_training_seed
from train.vec import FollowerVecEnv


def make_environment(options: Options) -> FollowerVecEnv:
    """The worlds that are trained on."""
    return FollowerVecEnv(
        options.training_config(),
        options.worlds,
        seed_offset=first_training_seed(options.seed, options.worlds),
        history=options.history,
        residual=options.residual,
        critic=options.critic,
        stagger=True,
        reward_scale=1.0 - options.gamma,
        threads=options.threads,
    )


def critic_state_scales(options: Options, env: FollowerVecEnv) -> Any:
    """Scales of the central state's numbers, None for a critic that does not see it."""
    return state_scales(env.followers) if options.critic == "central" else None


def make_model(
    options: Options, env: FollowerVecEnv, source: tuple[Card, Network] | None
) -> FollowerPPO:
    """PPO before its first update, its actor that of the policy file `source` if there is one."""
    std, samples = options.exploration(), env.num_envs * options.rollout
    hidden = list(options.hidden)
    with warnings.catch_warnings():  # that a last batch may be smaller
        warnings.simplefilter("ignore")
        model = FollowerPPO(
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
                "actor_inputs": env.local_size,
                "gain": std,
                "log_std_init": log(std),
                "net_arch": {"pi": hidden, "vf": hidden},
                "activation_fn": torch.nn.ReLU if options.activation == "relu" else torch.nn.Tanh,
            },
        )
    model.critic_steps = options.critic_steps
    model.kl = options.kl
    if options.actor_rate != 1.0 or options.kl is not None:
        model.separate_actor(options.actor_rate)
    model.set_logger(configure_logger(str(Path(options.output) / "tensorboard"), ["tensorboard"]))
    if source is None:
        scales = fixed_scales(env.config.layout)
        model.policy.set_normalisation(*scales, critic_state_scales(options, env))
    else:
        load_actor(model.policy, *source, env.followers)
    return model
