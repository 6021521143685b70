"""Train a follower with RLlib's PPO: `python -m train.rllib --output DIR`. Needs the `ray` extra.

The task, the network, the options and the files are those of `train.ppo`, which is several times faster
on one machine; this one is for clusters. `--runners N` flies in N processes wherever `--address` leads,
and the learner is here. Every machine of the cluster has to have this package installed, in the same
version.

Interrupt (Ctrl-C) once to save and stop after the update in hand; `--resume` goes on from there with
fresh episodes.
"""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from baselines.scoring import cluster
from baselines.system import console
from train.command_line import fail, interruptions, read, wait_passively

if TYPE_CHECKING:
    from train.rllib_options import Options
    from train.rllib_run import Saved

SCRIPT = "formation-train-rllib"


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    wait_passively()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # theirs, at import
            import tyro  # noqa: F401

            from train.rllib_options import Options

            options = read(Options, SCRIPT, arguments)  # its help needs no Ray
            cluster.load_ray()

            from train.rllib_run import prepare
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    except cluster.Unreachable as problem:
        return fail(SCRIPT, problem, 2)
    except ModuleNotFoundError as problem:
        if (problem.name or "").partition(".")[0] in ("train", "baselines", "formation_env"):
            raise
        return fail(SCRIPT, f'{problem.name} is not installed: pip install "formation-env[ray]"', 2)
    try:
        options, saved, own = prepare(options)
    except ValueError as problem:
        return fail(SCRIPT, problem, 2)
    except OSError as problem:
        return fail(SCRIPT, f"cannot write into {problem.filename}: {problem.strerror}", 2)
    try:
        with own, cluster.joined(options.address, max(1, options.runners)) as ray, _quietly():
            return _train(ray, options, saved)
    except cluster.Unreachable as problem:
        return fail(SCRIPT, problem, 2)
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        return fail(SCRIPT, f"{where}{problem.strerror or problem}; earlier files are intact", 1)


@contextmanager
def _quietly() -> Iterator[None]:
    """Without RLlib's warnings, which are many."""
    logging.getLogger("ray.rllib").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _train(ray: Any, options: Options, saved: Saved | None) -> int:
    """Train until it is done or somebody interrupts."""
    from train.rllib_run import Run, require_cores

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
    if asked():
        print(
            f"interrupted: saved; continue with --resume --output {options.output}", file=sys.stderr
        )
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
