"""Train a follower with PPO: `python -m train.ppo --output DIR`. Needs the `train` extra.

All followers share one policy (Stable-Baselines3's PPO on `train.vec`). Into the output folder go
`best.safetensors` and `last.safetensors`, policies that `baselines.evaluate --policies` takes; `log.csv`,
the score against steps and minutes; `tensorboard/`; and `checkpoint.safetensors`, from which `--resume`
goes on as if nothing had happened. Interrupt (Ctrl-C) once to save and stop after the update in hand.

The score is the leaderboard's, on seeds that neither training nor leaderboard use.
"""

from __future__ import annotations

import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from train.options import Options

PROGRAM = "train.ppo"


def _fail(message: object, status: int) -> int:
    print(f"{PROGRAM}: error: {message}", file=sys.stderr)
    return status


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # theirs, at import
            import rich  # noqa: F401
            import tensorboard  # type: ignore[import-untyped]  # noqa: F401
            import tyro

            from train.learner import prepare
            from train.options import Options
    except ModuleNotFoundError as problem:
        if (problem.name or "").partition(".")[0] in ("train", "baselines", "formation_env"):
            raise
        return _fail(f'{problem.name} is not installed: pip install "formation-env[train]"', 2)
    try:
        options = tyro.cli(Options, prog=f"python -m {PROGRAM}", args=arguments)
        run = prepare(options)
    except ValueError as problem:
        return _fail(problem, 2)
    except OSError as problem:
        return _fail(f"cannot write into {problem.filename}: {problem.strerror}", 2)
    return _train(run, options)


def _train(run: Any, options: Options) -> int:
    """Train until it is done or somebody interrupts."""
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, _once(asked, options.quiet))
    try:
        run.train(stop=lambda: bool(asked))
    except KeyboardInterrupt:
        return _fail("interrupted twice: the last checkpoint is intact", 130)
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        return _fail(f"{where}{problem.strerror or problem}; earlier files are intact", 1)
    finally:
        signal.signal(signal.SIGINT, before)
    if not options.quiet:
        print(run.summary())
    if options.profile:
        print(run.profile())
    if asked:
        print(
            f"interrupted: saved; continue with --resume --output {options.output}", file=sys.stderr
        )
        return 130
    return 0


def _once(asked: list[int], quiet: bool) -> Callable[[int, Any], None]:
    """Note the first interruption and pass on the second."""

    def handle(number: int, frame: Any) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)
        if not quiet:
            print(
                "\ninterrupted: saving after this update (again to stop at once)", file=sys.stderr
            )

    return handle


if __name__ == "__main__":
    sys.exit(main())
