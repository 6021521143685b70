"""What the commands of this package share: options checked and repeated, errors, interruptions."""

from __future__ import annotations

import os
import shlex
import signal
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite
from typing import Any, TypeVar

from baselines.system import console
from formation_env import SCENARIOS

T = TypeVar("T")


def flag(name: str) -> str:
    """The option that sets a field."""
    return f"--{name.replace('_', '-')}"


def refuse(name: str, value: object, expected: str) -> None:
    """Raise the `ValueError` that names an option, its value and what was expected."""
    raise ValueError(f"{flag(name)} {value}: expected {expected}")


def read(kinds: type[T], script: str, arguments: Sequence[str] | None) -> T:
    """The options of a command line. Raises `ValueError` for an impossible one, `SystemExit` after help."""
    import tyro

    try:
        given: T = tyro.cli(kinds, prog=script, args=arguments)
    except BrokenPipeError as problem:  # the reader of the help has closed the pipe
        raise console.Unprintable from problem
    return given


def check(
    options: Any,
    whole: Mapping[str, tuple[int, int]],
    real: Mapping[str, tuple[float, float]],
) -> None:
    """The scenario, whole and real numbers between their least and largest (or None), and the widths.

    Raises `ValueError` naming the option.
    """
    if options.scenario not in SCENARIOS:
        refuse("scenario", options.scenario, f"one of {', '.join(SCENARIOS)}")
    for name, (least, most) in whole.items():
        value = getattr(options, name)
        if not (_whole(value) and least <= value <= most):
            refuse(name, value, f"a whole number from {least} to {most}")
    for name, (low, high) in real.items():
        value = getattr(options, name)
        if value is not None and not (_real(value) and low <= value <= high):
            refuse(name, value, f"a number from {low:g} to {high:g}")
    hidden = options.hidden
    if not 0 < len(hidden) <= 8 or not all(_whole(n) and 1 <= n <= 4096 for n in hidden):
        refuse("hidden", hidden, "1 to 8 widths from 1 to 4096")


def _whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _real(value: object) -> bool:
    return _whole(value) or (isinstance(value, float) and isfinite(value))


def wait_passively() -> None:
    """Have PyTorch's threads sleep where they wait for one another; before it is loaded.

    They spin otherwise, each against the one it waits for where another process has the core: on two
    busy cores `train.ppo` at action level `reference` made 114,688 agent steps in a quarter of a minute
    with two threads that spin, 671,744 with two that sleep, and 475,136 to 688,128 with one.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def repeated(
    program: str, values: Mapping[str, Any], usual: Mapping[str, Any], idle: Collection[str]
) -> str:
    """The command with those values that are not the usual ones, and not of `idle` options."""
    words = ["python", "-m", program]
    for name, value in values.items():
        if name not in idle and value != usual[name]:
            words += [flag(name), *map(str, value if isinstance(value, tuple) else (value,))]
    return shlex.join(words)


DIVERGED = "the policy's numbers are no longer finite: try a smaller learning rate"


def diverged(problem: ValueError) -> bool:
    """Whether it is what PyTorch or the simulation say of actions that are not finite."""
    return any(
        words in str(problem) for words in ("found invalid values", "expected finite numbers")
    )


def fail(program: str, message: object, status: int) -> int:
    """Say what went wrong; the exit status."""
    print(f"{program}: error: {message}", file=sys.stderr)
    return status


@contextmanager
def interruptions(quiet: bool = False) -> Iterator[Callable[[], bool]]:
    """Within, the first Ctrl-C is noted, which the function given tells, and the second passed on."""
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
