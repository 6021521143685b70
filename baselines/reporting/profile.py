"""The performance profile as a picture: how many episodes score more than what."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from baselines.registry import POLICIES
from baselines.reporting.rows import PAPER, TUNED, laws
from baselines.scoring.suite import Matrix, performance_profile
from baselines.system.pictures import COLOURS, MARKS, TICKS, png, stretch, style, unstretch
from baselines.system.writing import write_bytes

_THRESHOLDS = unstretch(np.linspace(0.0, float(stretch(np.ones(()))), 161))
_VERSION = 1  # of the drawing, part of the digest


def panels(matrix: Matrix) -> dict[str, list[str]]:
    """The methods of each panel: those that fly every scenario, programmed and learned."""
    whole = [m for m in matrix.method if len(matrix.flown(m)) == len(matrix.scenario)]
    programmed = laws(whole)
    learned = [m for m in whole if m not in POLICIES]
    compared = [m for m in programmed if m == PAPER]  # shown among the learned policies too
    found = {
        "programmed laws": programmed,
        "learned policies": [*compared, *learned] if learned else [],
    }
    return {title: methods for title, methods in found.items() if methods}


def draw(matrix: Matrix, path: Path) -> None:
    """Write the picture of all scenarios of a matrix: a panel each for programmed and learned policies.

    The same matrix gives the same bytes with the same Matplotlib. Raises `OSError`, `ModuleNotFoundError`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    shown = panels(matrix)
    with style():
        figure = Figure(figsize=(9.0, 3.9), dpi=100, layout=ConstrainedLayoutEngine(wspace=0.04))
        canvas = FigureCanvasAgg(figure)
        axes = figure.subplots(1, max(1, len(shown)), sharey=True, squeeze=False)[0]
        for ax, (title, methods) in zip(axes, shown.items(), strict=False):
            _panel(ax, matrix, methods)
            ax.set_title(f"{title}, {len(matrix.scenario)} scenarios", loc="left", fontsize=9.5)
        axes[0].set_ylabel("share of episodes with a score above it")
        canvas.draw()  # type: ignore[no-untyped-call]
    write_bytes(path, png(canvas, digest(matrix)))


def digest(matrix: Matrix) -> str:
    """SHA-256 of what the picture shows, which its file holds."""
    found = hashlib.sha256(f"{_VERSION} {matrix.method} {matrix.scenario}".encode())
    found.update(matrix.figures["score"].astype(np.float32).tobytes())
    return found.hexdigest()


def _panel(ax: Any, matrix: Matrix, methods: Sequence[str]) -> None:
    families = list(dict.fromkeys(m.removesuffix(TUNED) for m in methods))
    for method in methods:
        family = families.index(method.removesuffix(TUNED))
        colour, mark = COLOURS[family % len(COLOURS)], MARKS[family % len(MARKS)]
        tuned = method.endswith(TUNED)
        profile = performance_profile(matrix, method, _THRESHOLDS)
        ax.fill_between(
            _THRESHOLDS, profile.low, profile.high, color=colour, alpha=0.15, linewidth=0
        )
        ax.plot(_THRESHOLDS, profile.share, color=colour, linewidth=1.4, label=method,
                linestyle="--" if tuned else "-", marker=mark, markersize=4.5,
                markerfacecolor="white" if tuned else colour,
                markevery=(3 * (family % 7), 24))  # fmt: skip
    ax.set_xlabel("score")
    ax.set_xscale("function", functions=(stretch, unstretch))
    ax.set_xlim(0.0, 1.0)
    ax.set_xticks(TICKS, [f"{x:g}" for x in TICKS], minor=False)
    ax.set_ylim(0.0, 1.02)
    ax.legend(loc="lower left")
