"""What the paper's figures have beside the style of all pictures: colours of the vehicles, marks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from baselines.system.pictures import COLOURS, DARK, PALE, style
from formation_env.paths.references import Floats

LEADER, REFERENCE = DARK, PALE
FOLLOWERS = (COLOURS[0], COLOURS[4])
AXES = (COLOURS[2], COLOURS[1], COLOURS[3])  # x, y, z components


@contextmanager
def picture(path: Path, width: float, height: float) -> Iterator[Any]:
    """A figure (inches) that is written to `path` at the end, without any window or global state."""
    with style():
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        figure.savefig(path, dpi=160)


def ends(ax: Any, x: Floats, y: Floats, colour: str) -> None:
    """The paper's marks: a triangle where a path starts, a square where it ends."""
    ax.plot(x[:1], y[:1], ">", color=colour, markersize=7, markeredgecolor="white", zorder=5)
    ax.plot(x[-1:], y[-1:], "s", color=colour, markersize=6, markeredgecolor="white", zorder=5)


def components(ax: Any, t: Floats, x: Floats, names: str = "xyz", **line: Any) -> None:
    """Each column of `x` in the colour of its axis."""
    for k, name in enumerate(names):
        ax.plot(t, x[:, k], color=AXES[k], label=name, **line)


def label(ax: Any, y: str, title: str = "", time: bool = True) -> None:
    """Title, and labels of the axes."""
    ax.set_title(title, loc="left")
    ax.set_ylabel(y)
    if time:
        ax.set_xlabel("time (s)")
