"""Train a follower with PPO: `python -m train.ppo --output DIR`. Needs the `train` extra.

All followers share one policy (Stable-Baselines3's PPO on `train.vec`). Into the output folder go
`best.safetensors` and `last.safetensors`, policies that `baselines.evaluate --policies` takes; `log.csv`,
the score against steps and minutes; `tensorboard/`; and `checkpoint.safetensors`, from which `--resume`
continues with the same numbers as a run that was not interrupted. Interrupt (Ctrl-C) once to save and stop
after the present update.

The score is the leaderboard's, on seeds that neither training nor leaderboard use.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from baselines.system import console
from train.command_line import (
    DIVERGED,
    SCRIPTS,
    diverged,
    fail,
    fail_before,
    fail_missing,
    fail_writing,
    interrupted_and_saved,
    interruptions,
    read_options,
    wait_passively,
)

if TYPE_CHECKING:
    from train.ppo.options import Options

SCRIPT = SCRIPTS[__name__]


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    wait_passively()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the libraries, at import
            import tensorboard  # type: ignore[import-untyped]  # noqa: F401
            import tyro  # noqa: F401

            from train.ppo.options import Options
            from train.ppo.start import prepare
    except ModuleNotFoundError as problem:
        return fail_missing(SCRIPT, problem, "train")
    try:
        options = read_options(Options, SCRIPT, arguments)
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    try:
        run = prepare(options)
        run.compile()
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    except OSError as problem:
        return fail_before(SCRIPT, problem)
    except KeyboardInterrupt:
        return fail(SCRIPT, "interrupted: nothing was written", 130)
    return _train(run, options)


def _train(run: Any, options: Options) -> int:
    """Train to the limit or to an interruption, and print the result; the exit status."""
    try:
        with interruptions(options.quiet) as asked:
            run.train(stop=asked)
    except KeyboardInterrupt:
        return fail(SCRIPT, "interrupted twice: the last checkpoint is intact", 130)
    except OSError as problem:
        return fail_writing(SCRIPT, problem)
    except ValueError as problem:
        if not diverged(problem):
            raise
        return fail(SCRIPT, f"{DIVERGED}; earlier files are intact", 1)
    if not options.quiet:
        console.say(run.summary())
    if options.profile:
        console.say(run.profile())
    return interrupted_and_saved(options.output) if asked() else 0
