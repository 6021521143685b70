"""Pictures of learning curves. Needs the `plot` extra."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.system.writing import write_bytes
from train.cards.curves import Curve, Key, to_text

Floats = NDArray[np.float64]

# Colours that stay apart for colour-blind readers (Okabe and Ito), each with marks of its own.
_STYLES = {
    "ppo": ("#0072B2", "o"),
    "bc": ("#E69F00", "s"),
    "dagger": ("#009E73", "^"),
    "bc-ppo": ("#CC79A7", "D"),
    "residual": ("#D55E00", "v"),
    "dagger-ppo": ("#56B4E9", "P"),
    "residual-dagger": ("#8C6D1F", "X"),
    "residual-dagger-ppo": ("#222222", "*"),
}
_OTHER_STYLES = (("#888888", "p"), ("#7A3E9D", "h"))
_RC: Any = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}
_FLOOR = -0.25  # lowest score on the axis
# Above this score the axis is stretched by this factor, so that scores near the expert's can be told apart.
_STRETCHED_FROM, _STRETCH = 0.9, 4.0
_TICKS = (-0.25, 0.0, 0.25, 0.5, 0.75, 0.9)
_FINE_TICKS, _COARSE_TICKS = (
    (0.95, 1.0, 1.05, 1.1, 1.15, 1.2),
    (1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0),
)
_VERSION = 2  # of the drawing, part of the digest


def digest(curves: Sequence[Curve]) -> str:
    """SHA-256 of what a picture shows. It is in the picture's file, so that a stale picture is noticed."""
    shown = "\n".join(f"{c.name}\n{to_text(c)}" for c in curves)
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


def draw(curves: Sequence[Curve], path: Path) -> None:
    """The curves of one scenario and action level, in the order of their methods.

    Written whole or not at all; the same curves give the same bytes with the same Matplotlib. Raises
    `OSError`, `ModuleNotFoundError`.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    methods = dict.fromkeys(c.key for c in curves)
    styles = _styles([key.method for key in methods])
    with matplotlib.rc_context({**matplotlib.rcParamsDefault, **_RC, "backend": "agg"}):
        figure = Figure(figsize=(9.0, 3.9), dpi=100, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        axes = figure.subplots(1, 2, sharey=True)
        for key in methods:
            _line(axes, [c for c in curves if c.key == key], styles[key.method])
        _finish(axes, curves)
        lines, labels = axes[0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside lower center", ncols=min(len(lines), 5))
        canvas.draw()  # type: ignore[no-untyped-call]
    write_bytes(path, _png(canvas, digest(curves)))


def _png(canvas: Any, source: str) -> bytes:
    """The picture in 256 colours, which makes it small; the lines' colours are kept to within one step."""
    from PIL import Image, PngImagePlugin

    size = canvas.get_width_height()
    image = Image.frombuffer("RGBA", size, bytes(canvas.buffer_rgba()), "raw", "RGBA", 0, 1)
    few = image.convert("RGB").quantize(
        256, method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE
    )
    text, data = PngImagePlugin.PngInfo(), io.BytesIO()
    text.add_text("Source", source)
    few.save(data, "PNG", optimize=True, pnginfo=text)
    return data.getvalue()


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


def stretch(y: Floats) -> Floats:
    """The position of scores on the axis, which is stretched above 0.9."""
    return np.where(y > _STRETCHED_FROM, _STRETCHED_FROM + _STRETCH * (y - _STRETCHED_FROM), y)


def _unstretch(y: Floats) -> Floats:
    return np.where(y > _STRETCHED_FROM, _STRETCHED_FROM + (y - _STRETCHED_FROM) / _STRETCH, y)


def _finish(axes: Any, curves: Sequence[Curve]) -> None:
    """Axes, labels and the expert's line, which do not depend on the method."""
    scores = np.array([row.score for c in curves for row in c.rows])
    top = max(1.05, float(scores.max()) + 0.02)
    bottom = max(_FLOOR, min(-0.05, float(scores.min()) - 0.05))
    axes[0].set_yscale("function", functions=(stretch, _unstretch))
    ticks = (*_TICKS, *(_FINE_TICKS if top < 1.25 else _COARSE_TICKS))
    axes[0].set_yticks([y for y in ticks if bottom <= y <= top], minor=False)
    axes[0].set_ylim(bottom, top)
    for ax, label in zip(axes, ("agent steps, millions", "minutes of training"), strict=True):
        ax.axhline(1.0, color="#222222", linewidth=1.0, linestyle="--", label="expert")
        ax.set_xlabel(label)
        ax.set_xlim(left=0.0)
    axes[0].set_ylabel("score")
    key = curves[0].key
    axes[0].set_title(f"{key.scenario}, {key.action}", loc="left", fontsize=9.5)


def picture_name(key: Key) -> str:
    """File name of the picture that shows all methods of a scenario and action level."""
    return f"{key.scenario}-{key.action}.png"
