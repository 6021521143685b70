"""What a command prints: nothing that is written or computed is lost where printing fails.

The standard output may be a pipe whose reader has gone (`| head`) or a device that is full, and so may
the standard error. A command's `main` is decorated with `command`; it writes its files first, then
prints with `say`, and messages with `complain`.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps
from typing import Any, TextIO, final

WIDEST = 100  # columns of what is printed

Main = Callable[[Sequence[str] | None], int]


def width() -> int:
    """Columns to print into: those of the terminal, at most `WIDEST` (80 where there is none)."""
    return max(40, min(WIDEST, shutil.get_terminal_size((80, 24)).columns))


class Unprintable(Exception):
    """The standard output failed; the cause is an `OSError`."""


def say(text: str) -> None:
    """Print to the standard output. Raises `Unprintable`, which `command` deals with."""
    try:
        print(text, flush=True)
    except OSError as problem:
        raise Unprintable from problem


def complain(text: str) -> None:
    """Print to the standard error, if there is one that can be written to."""
    with suppress(OSError, ValueError):
        print(text, file=sys.stderr, flush=True)


def command(main: Main) -> Callable[..., int]:
    """Decorates a command's `main(arguments)`, which returns the exit status.

    Where the reader of a pipe has gone, what is left to print is dropped without a word and the status is
    that of the work: 0. A standard output that fails in another way is one line on the standard error
    and status 1. Neither ends in a traceback, nor in one when the interpreter exits; nor does Ctrl-C while
    libraries are imported, with status 130.
    """

    @wraps(main)
    def guarded(arguments: Sequence[str] | None = None) -> int:
        try:
            try:
                status = main(arguments)
            finally:  # where `--help` exits, too
                _flush()
        except Unprintable as failure:
            problem = failure.__cause__
            _drop(sys.stdout)
            if isinstance(problem, BrokenPipeError):
                return 0
            complain(f"error: cannot print: {getattr(problem, 'strerror', None) or problem}")
            return 1
        except KeyboardInterrupt:  # before or after the work, which prints its own line
            complain("interrupted")
            return 130
        return status

    return guarded


def _flush() -> None:
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as problem:
        raise Unprintable from problem


def _drop(stream: Any) -> None:
    """Let what a stream still holds, and all that follows, go nowhere."""
    with suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, stream.fileno())
        finally:
            os.close(nowhere)


@final
class Lenient:
    """The standard error for progress bars: where it cannot be written to, they are not shown."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream

    def write(self, text: str) -> int:
        """Write if possible."""
        with suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush if possible."""
        with suppress(OSError, ValueError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:  # encoding, isatty, fileno
        return getattr(self._stream, name)
