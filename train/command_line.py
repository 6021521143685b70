"""What the commands of this package share: reading options, one-line errors, exit statuses, interruptions."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from baselines.system import console

T = TypeVar("T")

# The console scripts of the commands, by package: here, since both a command and its options name it.
SCRIPTS = {
    "train.imitate": "formation-train-imitate",
    "train.ppo": "formation-train-ppo",
    "train.rllib": "formation-train-rllib",
    "train.tune_expert": "formation-tune-expert",
}


def flag(name: str) -> str:
    """The option that sets a field."""
    return f"--{name.replace('_', '-')}"


def refuse(name: str, value: object, expected: str) -> None:
    """Raise the `ValueError` that names an option, its value and what was expected."""
    raise ValueError(f"{flag(name)} {value}: expected {expected}")


def read_options(kind: type[T], script: str, arguments: Sequence[str] | None) -> T:
    """The options of a command line. Raises `ValueError` for an impossible one, `SystemExit` after help."""
    import tyro

    try:
        given: T = tyro.cli(kind, prog=script, args=arguments)
    except BrokenPipeError as problem:  # the reader of the help has closed the pipe
        raise console.Unprintable from problem
    return given


def wait_passively() -> None:
    """Have PyTorch's threads sleep where they wait for one another. To be called before PyTorch is loaded.

    They spin otherwise, each against the one it waits for where another process has the core: on two
    busy cores `train.ppo` at action level `reference` made 114,688 agent steps in a quarter of a minute
    with two threads that spin, 671,744 with two that sleep, and 475,136 to 688,128 with one.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


DIVERGED = "the policy's numbers are no longer finite: try a smaller learning rate"


def diverged(problem: ValueError) -> bool:
    """Whether it is the error that PyTorch or the simulation raise for actions that are not finite."""
    return any(
        words in str(problem) for words in ("found invalid values", "expected finite numbers")
    )


def fail(program: str, message: object, status: int) -> int:
    """Print what went wrong, in one line; the exit status."""
    print(f"{program}: error: {message}", file=sys.stderr)
    return status


def fail_missing(script: str, problem: ModuleNotFoundError, extra: str) -> int:
    """Print which package of an extra is not installed; the exit status. Re-raises for modules of ours."""
    name = problem.name or ""
    if name.partition(".")[0] in ("train", "baselines", "formation_env"):
        raise problem
    return fail(script, f'{name} is not installed: pip install "formation-env[{extra}]"', 2)


def fail_before(script: str, problem: OSError) -> int:
    """Print that the output folder cannot be used; the exit status."""
    return fail(script, f"cannot write into {problem.filename}: {problem.strerror}", 2)


def fail_writing(script: str, problem: OSError) -> int:
    """Print which file could not be written; the exit status. Files are replaced whole, so others stay."""
    where = f"{problem.filename}: " if problem.filename else ""
    return fail(script, f"{where}{problem.strerror or problem}; earlier files are intact", 1)


def interrupted_and_saved(folder: object) -> int:
    """Print how to continue after an interruption; the exit status."""
    print(f"interrupted: saved; continue with --resume --output {folder}", file=sys.stderr)
    return 130


@contextmanager
def interruptions(quiet: bool = False) -> Iterator[Callable[[], bool]]:
    """Within, the first Ctrl-C only makes the function given return True; the second interrupts."""
    asked: list[int] = []

    def handle(number: int, frame: Any) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)
        if not quiet:
            print(
                "\ninterrupted: saving after this update (again to stop at once)", file=sys.stderr
            )

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield lambda: bool(asked)
    finally:
        signal.signal(signal.SIGINT, before)
