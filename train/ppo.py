"""Train a follower with PPO: `python -m train.ppo --output DIR`. Needs the `train` extra.

All followers share one policy (Stable-Baselines3's PPO on `train.vec`). Into the output folder go
`best.safetensors` and `last.safetensors`, policies that `baselines.evaluate --policies` takes; `log.csv`,
the score against steps and minutes; `tensorboard/`; and `checkpoint.safetensors`, from which `--resume`
goes on as if nothing had happened. Interrupt (Ctrl-C) once to save and stop after the update in hand.

The score is the leaderboard's, on seeds that neither training nor leaderboard use.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from baselines.system import console
from train.command_line import DIVERGED, diverged, fail, interruptions, read, wait_passively

if TYPE_CHECKING:
    from train.options import Options

SCRIPT = "formation-train-ppo"


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    wait_passively()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # theirs, at import
            import tensorboard  # type: ignore[import-untyped]  # noqa: F401
            import tyro  # noqa: F401

            from train.learner import prepare
            from train.options import Options
    except ModuleNotFoundError as problem:
        if (problem.name or "").partition(".")[0] in ("train", "baselines", "formation_env"):
            raise
        return fail(
            SCRIPT, f'{problem.name} is not installed: pip install "formation-env[train]"', 2
        )
    try:
        options = read(Options, SCRIPT, arguments)
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    try:
        run = prepare(options)
        run.compile()
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    except OSError as problem:
        return fail(SCRIPT, f"cannot write into {problem.filename}: {problem.strerror}", 2)
    except KeyboardInterrupt:
        return fail(SCRIPT, "interrupted: nothing was written", 130)
    return _train(run, options)


def _train(run: Any, options: Options) -> int:
    """Train until it is done or somebody interrupts."""
    try:
        with interruptions(options.quiet) as asked:
            run.train(stop=asked)
    except KeyboardInterrupt:
        return fail(SCRIPT, "interrupted twice: the last checkpoint is intact", 130)
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        return fail(SCRIPT, f"{where}{problem.strerror or problem}; earlier files are intact", 1)
    except ValueError as problem:
        if not diverged(problem):
            raise
        return fail(SCRIPT, f"{DIVERGED}; earlier files are intact", 1)
    if not options.quiet:
        console.say(run.summary())
    if options.profile:
        console.say(run.profile())
    if asked():
        print(
            f"interrupted: saved; continue with --resume --output {options.output}", file=sys.stderr
        )
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
