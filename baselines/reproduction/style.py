"""How the pictures look: colours, markers and small helpers shared by all of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from formation_env.paths.references import Floats

# Colours that stay apart for colour-blind readers (Okabe and Ito).
LEADER, REFERENCE = "#222222", "#9a9a9a"
FOLLOWERS = ("#0072B2", "#D55E00")
AXES = ("#009E73", "#E69F00", "#CC79A7")  # x, y, z components
_STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "legend.handlelength": 1.8,
}


@contextmanager
def picture(path: Path, width: float, height: float) -> Iterator[Any]:
    """A figure (inches) that is written to `path` at the end, without any window or global state."""
    with matplotlib.rc_context(_STYLE):
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
