"""Train a follower with RLlib's PPO: `python -m train.rllib --output DIR`. Needs the `ray` extra.

The task, the network, the options and the files are those of `train.ppo`, which is several times faster
on one machine; this one is for clusters. `--runners N` flies in N processes of the cluster that `--address`
names, and the learner is in this process. Every machine of the cluster has to have this package installed,
in the same version.

Interrupt (Ctrl-C) once to save and stop after the present update; `--resume` goes on from there with
new episodes.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from baselines.scoring import cluster
from baselines.system import console
from train.command_line import (
    SCRIPTS,
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
    from train.rllib.options import Options
    from train.rllib.run import Saved

SCRIPT = SCRIPTS[__name__]


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    wait_passively()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the libraries, at import
            import tyro  # noqa: F401

            from train.rllib.options import Options

            options = read_options(Options, SCRIPT, arguments)  # its help needs no Ray
            cluster.load_ray()

            from train.rllib.run import prepare
    except (ValueError, cluster.Unreachable) as problem:
        return fail(SCRIPT, problem, 2)
    except ModuleNotFoundError as problem:
        return fail_missing(SCRIPT, problem, "ray")
    try:
        options, saved, folder = prepare(options)
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    except OSError as problem:
        return fail_before(SCRIPT, problem)
    try:
        with folder, cluster.joined(options.address, max(1, options.runners)) as ray, _quietly():
            return _train(ray, options, saved)
    except cluster.Unreachable as problem:
        return fail(SCRIPT, problem, 2)
    except OSError as problem:
        return fail_writing(SCRIPT, problem)


@contextmanager
def _quietly() -> Iterator[None]:
    """Without RLlib's warnings, which are many."""
    logging.getLogger("ray.rllib").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _train(ray: Any, options: Options, saved: Saved | None) -> int:
    """Train to the limit or to an interruption, and print the result; the exit status."""
    from train.rllib.run import Run, require_cores

    try:
        require_cores(ray, options)
        run = Run(options, saved)
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    try:
        with interruptions() as asked:
            run.train(stop=asked)
    except KeyboardInterrupt:
        return fail(SCRIPT, "interrupted twice: the last checkpoint is intact", 130)
    except ray.exceptions.RayError as problem:
        return fail(SCRIPT, f"the cluster gave up ({problem}); the last checkpoint is intact", 1)
    finally:
        run.close()
    if not options.quiet:
        console.say(run.summary())
    return interrupted_and_saved(options.output) if asked() else 0
