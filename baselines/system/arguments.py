"""Options of the commands: read from text, and refused in one line where they are wrong."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Callable
from math import isfinite
from typing import NoReturn, TypeVar, final

from baselines.system.console import say, width
from formation_env.validation.checks import shown

T = TypeVar("T")


@final
class Formatter(argparse.RawDescriptionHelpFormatter):
    """Help as wide as the terminal, at most 100 columns; descriptions and examples keep their lines.

    Nothing is broken at a hyphen: half of an option's or policy's name is none.
    """

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=26, width=width())

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)


@final
class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong, and helps within the terminal's width, also piped into `head`."""

    def __init__(self, prog: str, description: str, epilog: str | None = None) -> None:
        super().__init__(
            prog=prog,
            description=textwrap.fill(description, width()),
            epilog=epilog,
            formatter_class=Formatter,
            allow_abbrev=False,
        )

    def error(self, message: str) -> NoReturn:
        """End with status 2."""
        self.exit(2, f"{self.prog}: error: {message}\n")

    def print_help(self, file: object = None) -> None:
        """To the standard output, whatever becomes of it."""
        say(self.format_help().rstrip("\n"))


def whole(low: int, high: int) -> Callable[[str], int]:
    """Reads a whole number within bounds."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(
                f"{shown(text)}: expected a whole number from {low} to {high}"
            )
        return value

    return read


def above_zero(expected: str) -> Callable[[str], float]:
    """Reads a finite number above 0; `expected` says in a message what it is."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not (isfinite(value) and value > 0.0):
            raise argparse.ArgumentTypeError(f"{shown(text)}: expected {expected}")
        return value

    return read


seconds = above_zero("a time in seconds above 0")


def reader(read_value: Callable[[str], T]) -> Callable[[str], T]:
    """A reader that raises `ValueError`, for argparse, which would hide the message."""

    def read(text: str) -> T:
        try:
            return read_value(text)
        except ValueError as problem:
            raise argparse.ArgumentTypeError(str(problem)) from None

    return read
