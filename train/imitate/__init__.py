"""Clone a policy: `python -m train.imitate --output DIR`. Needs the `train` extra.

A teacher, by default the expert, gives its action for each observation of many worlds, and a network is
fitted to these actions. With `--method bc` (behaviour cloning) the teacher flies all the time; with
`dagger` the clone flies more and more of the worlds, so that the teacher labels observations that the
clone's own mistakes lead to. With `--residual` the network learns a correction to the expert's action, with
which it does what another teacher does.

Into the output folder go `best.safetensors`, the best policy so far by the leaderboard's score on seeds
that neither training nor leaderboard use, which `baselines.evaluate --policies` and `train.ppo --init`
take; and `log.csv`, the score against samples and minutes. An interruption (Ctrl-C) leaves both.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from baselines.system import console
from train.command_line import (
    SCRIPTS,
    fail,
    fail_before,
    fail_missing,
    fail_writing,
    read_options,
    wait_passively,
)

SCRIPT = SCRIPTS[__name__]


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    wait_passively()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the libraries, at import
            import tyro  # noqa: F401

            from train.imitate.options import Options
            from train.imitate.run import Run
    except ModuleNotFoundError as problem:
        return fail_missing(SCRIPT, problem, "train")
    try:
        options = read_options(Options, SCRIPT, arguments)
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    try:
        run = Run(options)
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    except OSError as problem:
        return fail_before(SCRIPT, problem)
    except KeyboardInterrupt:
        return fail(SCRIPT, "interrupted: nothing was written", 130)
    try:
        run.train()
    except OSError as problem:
        return fail_writing(SCRIPT, problem)
    except KeyboardInterrupt:
        return fail(SCRIPT, f"interrupted: {run.summary()}", 130)
    if not options.quiet:
        console.say(run.summary())
    return 0
