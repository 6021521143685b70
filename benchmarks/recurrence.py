"""Which memory serves best against measurement noise: `python -m benchmarks.recurrence`.

On `paper` at action level `reference`, where every follower measures positions to 0.2 m, policies are
trained from scratch for the same number of processor minutes on one core and scored on the evaluation's
seeds: `train.ppo`'s perceptron with its last 1, 4 and 8 observations, and sb3-contrib's RecurrentPPO,
whose actor and critic each have an LSTM and see one observation. All have hidden layers of 64, the same
environment, exploration, discounts and inputs. Processor time and not wall time is counted, so that what
else the machine does hardly matters, and PyTorch has one thread. Needs the `train` extra and
`pip install sb3-contrib`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections.abc import Sequence
from math import log
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Any, NamedTuple

from baselines.system import console
from baselines.system.arguments import Parser, above_zero, whole
from train.command_line import wait_passively

if TYPE_CHECKING:
    from train.ppo.options import Options

HISTORIES = (1, 4, 8)


class Figure(NamedTuple):
    """One policy, trained and scored."""

    name: str
    seed: int
    steps: int  # agent steps
    minutes: float  # of processor time, the score's not counted
    score: tuple[float, float, float]  # and its 95 % interval
    failed: float  # part of the episodes


def options(folder: Path, seed: int, history: int, episodes: int) -> Options:
    """What all runs share."""
    from train.ppo.options import Options

    return Options(
        output=folder,
        scenario="paper",
        action="reference",
        seed=seed,
        history=history,
        steps=10**9,
        rollout=64,
        gamma=0.995,
        gae_lambda=0.97,
        learning_rate=5e-4,
        evaluate_every=10**9,
        episodes=episodes,
        save_every=1e9,
        threads=1,
        quiet=True,
    )


class _Clock:
    """Says when so many minutes of processor time have been used."""

    def __init__(self, minutes: float) -> None:
        self._begun, self._limit = process_time(), minutes

    @property
    def minutes(self) -> float:
        return (process_time() - self._begun) / 60.0

    def late(self) -> bool:
        return self.minutes >= self._limit


def stacked(history: int, seed: int, minutes: float, episodes: int) -> Figure:
    """PPO with a history of observations, as `python -m train.ppo` trains it."""
    from train.ppo.start import prepare

    with tempfile.TemporaryDirectory() as folder:
        run = prepare(options(Path(folder), seed, history, episodes))
        clock = _Clock(minutes)
        run.train(stop=clock.late)
        used = clock.minutes
        score, columns = run.evaluator.score_network(*run.policy_file())
    three = (float(score.value), float(score.low), float(score.high))
    name = f"history of {history}"
    return Figure(name, seed, run.model.num_timesteps, used, three, float(columns["failed"].mean()))


def recurrent(seed: int, minutes: float, episodes: int) -> Figure:
    """RecurrentPPO on the same environment."""
    import torch
    from sb3_contrib import RecurrentPPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

    from train.evaluation import Evaluator
    from train.options import STD
    from train.scales import CLIP, fixed_scales
    from train.seeds import first_training_seed
    from train.vec import FollowerVecEnv

    with tempfile.TemporaryDirectory() as folder:
        o = options(Path(folder), seed, 1, episodes)
    torch.set_num_threads(1)
    env = FollowerVecEnv(
        o.training_config(),
        o.worlds,
        seed_offset=first_training_seed(seed, o.worlds),
        stagger=True,
        reward_scale=1.0 - o.gamma,
        threads=1,
    )
    evaluator, clock = Evaluator(o.config(), episodes), _Clock(minutes)
    mean, scale = (torch.from_numpy(x) for x in fixed_scales(env.config.layout))

    class Scaled(BaseFeaturesExtractor):
        """Inputs as the perceptrons have them."""

        def __init__(self, space: Any) -> None:
            super().__init__(space, features_dim=space.shape[0])

        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return ((x - mean) / scale).clamp(-CLIP, CLIP)

    class Stop(BaseCallback):
        """Between two updates, as the others stop."""

        going = True

        def _on_rollout_start(self) -> None:
            self.going = not clock.late()

        def _on_step(self) -> bool:
            return self.going

    model = RecurrentPPO(
        "MlpLstmPolicy",
        env,
        learning_rate=o.learning_rate,
        n_steps=o.rollout,
        batch_size=o.batch,
        n_epochs=o.epochs,
        gamma=o.gamma,
        gae_lambda=o.gae_lambda,
        clip_range=o.clip_range,
        ent_coef=o.entropy,
        vf_coef=o.value,
        max_grad_norm=o.gradient,
        seed=seed,
        device="cpu",
        policy_kwargs={
            "lstm_hidden_size": o.hidden[0],
            "net_arch": {"pi": list(o.hidden[1:]), "vf": list(o.hidden[1:])},
            "log_std_init": log(STD["reference"]),
            "features_extractor_class": Scaled,
        },
    )
    model.learn(o.steps, callback=Stop())
    used = clock.minutes
    score, columns = evaluator.score_policy(_policy(env.config, model.policy))
    three = (float(score.value), float(score.low), float(score.high))
    return Figure("LSTM", seed, model.num_timesteps, used, three, float(columns["failed"].mean()))


def _policy(config: Any, lstm: Any) -> Any:
    """The recurrent policy as one that the metrics take."""
    import numpy as np

    from baselines.policies.base import Policy

    class Recurrent(Policy):
        name = "lstm"

        def begin(self, seeds: Any) -> None:
            self._state: Any = None
            self._fresh = np.ones(len(seeds) * self.config.followers, dtype=np.bool_)

        def begin_again(self, mask: Any) -> None:
            self._fresh |= np.repeat(mask, self.config.followers)

        def decide(self, rows: Any) -> Any:
            flat = rows.reshape(len(self._fresh), -1)
            actions, self._state = lstm.predict(flat, self._state, self._fresh, deterministic=True)
            self._fresh[:] = False
            return np.asarray(actions, dtype=np.float32).reshape(*rows.shape[:2], -1)

    return Recurrent(config)


def table(figures: Sequence[Figure]) -> str:
    """In Markdown."""
    lines = [
        "| memory | seed | score | failed | agent steps | processor minutes |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for f in figures:
        value, low, high = f.score
        lines.append(
            f"| {f.name} | {f.seed} | {value:.3f} ({low:.3f} .. {high:.3f}) | {100 * f.failed:.0f} % "
            f"| {f.steps:,} | {f.minutes:.1f} |"
        )
    return "\n".join(lines)


def _minutes(text: str) -> float:
    value = above_zero("minutes above 0")(text)
    if value > 10_000.0:
        raise argparse.ArgumentTypeError(f"{text!r}: expected at most 10000 minutes")
    return value


def parser() -> Parser:
    """The options of the command, none of them read yet."""
    own = Parser(
        "benchmarks.recurrence",
        "Compare memories against measurement noise: the last 1, 4 and 8 observations with PPO, and an "
        "LSTM with RecurrentPPO, trained for the same processor time on one thread and scored on the same "
        "episodes.",
    )
    add = own.add_argument
    add("--minutes", type=_minutes, default=4.0, metavar="MIN",
        help="Processor time of each training in minutes. (default: %(default)s)")  # fmt: skip
    add("--seeds", type=whole(1, 1000), default=1, metavar="N",
        help="Number of trainings of each policy, with seeds from 0 on. "
        "(default: %(default)s)")  # fmt: skip
    add("--episodes", type=whole(1, 1000), default=32, metavar="N",
        help="Number of episodes that score each policy. (default: %(default)s)")  # fmt: skip
    return own


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    own = parser()
    given = own.parse_args(arguments)
    wait_passively()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # theirs, at import
        try:
            import sb3_contrib  # noqa: F401

            import train.ppo.start  # noqa: F401
        except ModuleNotFoundError as problem:
            own.exit(
                2,
                f"{own.prog}: error: {problem.name} is not installed: "
                'pip install "formation-env[train]" sb3-contrib\n',
            )
    figures = []
    for seed in range(given.seeds):
        for history in HISTORIES:
            figures.append(stacked(history, seed, given.minutes, given.episodes))
            print(table(figures[-1:]).splitlines()[-1], file=sys.stderr)
        figures.append(recurrent(seed, given.minutes, given.episodes))
        print(table(figures[-1:]).splitlines()[-1], file=sys.stderr)
    print(table(sorted(figures, key=lambda f: (f.name, f.seed))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
