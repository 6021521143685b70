"""Pictures of learning curves. Needs the `plot` extra."""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train.logs import Curve, Key, to_text

Floats = NDArray[np.float64]

# Colours that stay apart for colour-blind readers (Okabe and Ito), each with marks of its own.
_LOOKS = {
    "ppo": ("#0072B2", "o"),
    "bc": ("#E69F00", "s"),
    "dagger": ("#009E73", "^"),
    "bc-ppo": ("#CC79A7", "D"),
    "residual": ("#D55E00", "v"),
}
_OTHERS = (("#56B4E9", "P"), ("#8C6D1F", "X"), ("#222222", "*"))
_STYLE: Any = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}
_FLOOR = -0.25  # of the axis: worse than hover is not told apart
# Above this a step on the axis is so many times as large: who is near the expert is told apart there.
_NEAR, _STRETCH = 0.9, 4.0
_TICKS = (-0.25, 0.0, 0.25, 0.5, 0.75, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2)
_VERSION = 1  # of the drawing


def digest(curves: Sequence[Curve]) -> str:
    """Of what a picture shows; stands in the picture's file, so that a stale one can be told."""
    shown = "\n".join(f"{c.name}\n{to_text(c)}" for c in curves)
    return hashlib.sha256(f"{_VERSION}\n{shown}".encode()).hexdigest()


def band(xs: Sequence[Floats], ys: Sequence[Floats]) -> tuple[Floats, Floats, Floats, Floats]:
    """Where all runs have values: x, and least, mean and largest y, between points in straight lines."""
    first, last = max(x[0] for x in xs), min(x[-1] for x in xs)
    every = np.unique(np.concatenate([*xs, [first, last]]))
    x = every[(first <= every) & (every <= last)]
    y = np.array([np.interp(x, a, b) for a, b in zip(xs, ys, strict=True)])
    return x, y.min(axis=0), y.mean(axis=0), y.max(axis=0)


def draw(curves: Sequence[Curve], path: Path) -> None:
    """The curves of one scenario and action level, in the order of their methods.

    Written whole or not at all; the same curves give the same bytes with the same Matplotlib. Raises
    `OSError`, `ModuleNotFoundError`.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    methods = dict.fromkeys(c.key for c in curves)
    with matplotlib.rc_context({**matplotlib.rcParamsDefault, **_STYLE, "backend": "agg"}):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        FigureCanvasAgg(figure)
        left, right = figure.subplots(1, 2, sharey=True)
        looks = _looks([key.method for key in methods])
        for key in methods:
            runs = [c for c in curves if c.key == key]
            _line(left, runs, [_column(c, "steps") / 1e6 for c in runs], looks[key.method])
            _line(right, runs, [_column(c, "minutes") for c in runs], looks[key.method])
        _finish(left, right, curves)
        png = io.BytesIO()
        figure.savefig(
            png, dpi=100, format="png", metadata={"Software": None, "Source": digest(curves)}
        )
    _write(path, png.getvalue())


def _looks(methods: Sequence[str]) -> dict[str, tuple[str, str]]:
    odd = [m for m in methods if m not in _LOOKS]
    return {**_LOOKS, **{m: _OTHERS[i % len(_OTHERS)] for i, m in enumerate(odd)}}


def _column(curve: Curve, name: str) -> Floats:
    return np.array([getattr(row, name) for row in curve.rows], dtype=np.float64)


def _line(ax: Any, runs: Sequence[Curve], xs: list[Floats], look: tuple[str, str]) -> None:
    """One method: mean over its runs, from the least to the largest shaded, and how far each went."""
    colour, mark = look
    scores = [_column(run, "score") for run in runs]
    x, low, middle, high = band(xs, scores)
    number = "1 seed" if len(runs) == 1 else f"{len(runs)} seeds"
    ax.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0.0)
    ax.plot(x, middle, color=colour, linewidth=1.5, marker=mark, markersize=5.0,
            markevery=max(1, len(x) // 6), label=f"{runs[0].key.method} ({number})")  # fmt: skip


def stretch(y: Floats) -> Floats:
    """Where a score stands on the axis."""
    return np.where(y > _NEAR, _NEAR + _STRETCH * (y - _NEAR), y)


def _unstretch(y: Floats) -> Floats:
    return np.where(y > _NEAR, _NEAR + (y - _NEAR) / _STRETCH, y)


def _finish(left: Any, right: Any, curves: Sequence[Curve]) -> None:
    scores = np.array([row.score for c in curves for row in c.rows])
    top = max(1.05, float(scores.max()) + 0.02)
    bottom = max(_FLOOR, min(-0.05, float(scores.min()) - 0.05))
    left.set_yscale("function", functions=(stretch, _unstretch))
    left.set_yticks([y for y in _TICKS if bottom <= y <= top], minor=False)
    left.set_ylim(bottom, top)
    for ax, label in ((left, "agent steps, millions"), (right, "minutes of training")):
        ax.axhline(1.0, color="#222222", linewidth=1.0, linestyle="--")
        ax.set_xlabel(label)
        ax.set_xlim(left=0.0)
    left.set_ylabel("score")
    left.annotate("expert", (1.0, 1.0), xycoords=("axes fraction", "data"), xytext=(-2, 3),
                  textcoords="offset points", ha="right", fontsize=8.5)  # fmt: skip
    key = curves[0].key
    left.set_title(f"{key.scenario}, {key.action}", loc="left", fontsize=9.5)
    right.legend(loc="lower right")


def _write(path: Path, data: bytes) -> None:
    """Whole or not at all."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def picture_name(key: Key) -> str:
    """Of the picture that shows a method, which it shares with the others."""
    return f"{key.scenario}-{key.action}.png"
