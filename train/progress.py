"""The progress bar of a training run: towards the limit that ends it, with the latest score."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

from tqdm import tqdm

from baselines.system.console import Lenient
from train.log import LogRow

BAR = "{percentage:3.0f} %|{bar}| {desc} [{elapsed}, {remaining} left]"


def part_done(steps: int, minutes: float, most_steps: int, most_minutes: float | None) -> float:
    """Progress towards the nearer limit, of steps or of minutes: 0 at the start, 1 at the end."""
    parts = [steps / most_steps, 0.0 if most_minutes is None else minutes / most_minutes]
    return min(max(parts), 1.0)


def described(
    steps: int, minutes: float, most_steps: int, most_minutes: float | None, rows: Sequence[LogRow]
) -> str:
    """The text beside the bar: the nearer limit, how much of it is used, and the latest score."""
    count = tqdm.format_sizeof(steps)
    if most_minutes is not None and minutes / most_minutes > steps / most_steps:
        text = f"{minutes:.1f} of {most_minutes:g} min, {count} steps"
    else:
        text = f"{count} of {tqdm.format_sizeof(most_steps)} steps"
    return f"{text}, score {rows[-1].score:.3f}" if rows else text


@final
class Progress:
    """A bar on standard error, none if `quiet`. To be made after compiling, since it counts time."""

    def __init__(self, most_steps: int, most_minutes: float | None, quiet: bool) -> None:
        self._limits = (most_steps, most_minutes)
        self._quiet = quiet
        self._bar: tqdm[None] | None = None

    def show(self, steps: int, minutes: float, rows: Sequence[LogRow]) -> None:
        """Show agent steps and minutes so far, all sittings together; the first call starts the bar."""
        part = part_done(steps, minutes, *self._limits)
        if self._bar is None:
            self._bar = tqdm(
                total=1.0,
                initial=part,
                bar_format=BAR,
                disable=self._quiet,
                miniters=0,
                file=Lenient(),
                dynamic_ncols=True,
            )
        self._bar.set_description_str(described(steps, minutes, *self._limits, rows), refresh=False)
        self._bar.update(part - self._bar.n)

    def close(self) -> None:
        """Leave the bar as it is."""
        if self._bar is not None:
            self._bar.close()
