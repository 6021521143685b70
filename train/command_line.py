"""What the commands of this package share: options checked and repeated, errors, interruptions."""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from math import isfinite
from typing import Any

from formation_env import SCENARIOS


def flag(name: str) -> str:
    """The option that sets a field."""
    return f"--{name.replace('_', '-')}"


def refuse(name: str, value: object, expected: str) -> None:
    """Raise the `ValueError` that names an option, its value and what was expected."""
    raise ValueError(f"{flag(name)} {value}: expected {expected}")


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
        if not least <= value <= most:
            refuse(name, value, f"a whole number from {least} to {most}")
    for name, (low, high) in real.items():
        value = getattr(options, name)
        if value is not None and not (isfinite(value) and low <= value <= high):
            refuse(name, value, f"a number from {low:g} to {high:g}")
    if not 0 < len(options.hidden) <= 8 or not all(1 <= n <= 4096 for n in options.hidden):
        refuse("hidden", options.hidden, "1 to 8 widths from 1 to 4096")


def repeated(
    program: str, values: Mapping[str, Any], usual: Mapping[str, Any], idle: Collection[str]
) -> str:
    """The command with those values that are not the usual ones, and not of `idle` options."""
    words = ["python", "-m", program]
    for name, value in values.items():
        if name not in idle and value != usual[name]:
            words += [flag(name), *map(str, value if isinstance(value, tuple) else (value,))]
    return shlex.join(words)


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
