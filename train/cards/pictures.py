"""Pictures of learning curves. Needs the `plot` extra."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.system.pictures import (
    COLOURS,
    DARK,
    MARKS,
    TICKS,
    png,
    stretch,
    style,
    unstretch,
)
from baselines.system.writing import write_bytes
from train.cards.curves import Curve, Key, to_text

Floats = NDArray[np.float64]

# By the method, so that it looks alike in all pictures.
_STYLES = dict(
    zip(
        ("ppo", "bc", "dagger", "bc-ppo", "residual", "dagger-ppo", "residual-dagger",
         "residual-dagger-ppo"),
        zip(COLOURS, MARKS, strict=True),
        strict=True,
    )
)  # fmt: skip
_OTHER_STYLES = (("#888888", "p"), ("#7A3E9D", "h"))
_VERSION = 3  # of the drawing, part of the digest


def digest(curves: Sequence[Curve], compared: Mapping[str, float]) -> str:
    """SHA-256 of what a picture shows. It is in the picture's file, so that a stale picture is noticed."""
    shown = "\n".join(f"{c.name}\n{to_text(c)}" for c in curves) + f"\n{dict(compared)}"
    return hashlib.sha256(f"{_VERSION}\n{shown}".encode()).hexdigest()


class Band(NamedTuple):
    """Several runs of one method together, at steps that all of them reached."""

    steps: Floats
    minutes: Floats  # mean over the runs
    low: Floats  # least score of the runs
    mean: Floats
    high: Floats


def band(runs: Sequence[Curve]) -> Band:
    """The runs, in straight lines between their points. Raises `ValueError` if they do not overlap."""
    steps = [_column(run, "steps") for run in runs]
    first, last = max(x[0] for x in steps), min(x[-1] for x in steps)
    if first > last:
        raise ValueError(
            f"{', '.join(run.name for run in runs)}: no steps that all of them reached"
        )
    every = np.unique(np.concatenate(steps))
    x = every[(first <= every) & (every <= last)]

    def at(name: str) -> Floats:
        columns = [_column(run, name) for run in runs]
        return np.array([np.interp(x, a, b) for a, b in zip(steps, columns, strict=True)])

    scores = at("score")
    return Band(
        x, at("minutes").mean(axis=0), scores.min(axis=0), scores.mean(axis=0), scores.max(axis=0)
    )


def draw(curves: Sequence[Curve], compared: Mapping[str, float], path: Path) -> None:
    """The curves of one scenario and action level, in the order of their methods.

    As lines the scores of the policies that they are `compared` with.

    Written whole or not at all; the same curves give the same bytes with the same Matplotlib. Raises
    `OSError`, `ModuleNotFoundError`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    methods = dict.fromkeys(c.key for c in curves)
    styles = _styles([key.method for key in methods])
    with style():
        figure = Figure(figsize=(9.0, 3.9), dpi=100, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        axes = figure.subplots(1, 2, sharey=True)
        for key in methods:
            _line(axes, [c for c in curves if c.key == key], styles[key.method])
        _finish(axes, curves, compared)
        lines, labels = axes[0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside lower center", ncols=min(len(lines), 5))
        canvas.draw()  # type: ignore[no-untyped-call]
    write_bytes(path, png(canvas, digest(curves, compared)))


def _styles(methods: Sequence[str]) -> dict[str, tuple[str, str]]:
    odd = [m for m in methods if m not in _STYLES]
    return {**_STYLES, **{m: _OTHER_STYLES[i % len(_OTHER_STYLES)] for i, m in enumerate(odd)}}


def _column(curve: Curve, name: str) -> Floats:
    return np.array([getattr(row, name) for row in curve.rows], dtype=np.float64)


def _line(axes: Any, runs: Sequence[Curve], style: tuple[str, str]) -> None:
    """One method: mean over its runs, and from the worst to the best shaded."""
    (colour, mark), b = style, band(runs)
    number = "1 seed" if len(runs) == 1 else f"{len(runs)} seeds"
    for ax, x in zip(axes, (b.steps / 1e6, b.minutes), strict=True):
        ax.fill_between(x, b.low, b.high, color=colour, alpha=0.2, linewidth=0.0)
        ax.plot(x, b.mean, color=colour, linewidth=1.5, marker=mark, markersize=5.0,
                markevery=max(1, len(x) // 6), label=f"{runs[0].key.method} ({number})")  # fmt: skip


_LINES = ("--", ":", "-.")


def _finish(axes: Any, curves: Sequence[Curve], compared: Mapping[str, float]) -> None:
    """Axes, labels and lines, which do not depend on the method."""
    axes[0].set_yscale("function", functions=(stretch, unstretch))
    axes[0].set_yticks(TICKS, minor=False)
    axes[0].set_ylim(0.0, 1.0)
    for ax, label in zip(axes, ("agent steps, millions", "minutes of training"), strict=True):
        for (name, score), dashes in zip(compared.items(), _LINES, strict=False):
            ax.axhline(score, color=DARK, linewidth=1.0, linestyle=dashes, label=name)
        ax.set_xlabel(label)
        ax.set_xlim(left=0.0)
    axes[0].set_ylabel("score")
    key = curves[0].key
    axes[0].set_title(f"{key.scenario}, {key.action}", loc="left", fontsize=9.5)


def picture_name(key: Key) -> str:
    """File name of the picture that shows all methods of a scenario and action level."""
    return f"{key.scenario}-{key.action}.png"
