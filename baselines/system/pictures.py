"""How all pictures of this package look, and their files: small, and the same bytes for the same figures.

Those of evaluations, of the leaderboard, of training and of the paper's figures. Matplotlib is imported
where something is drawn: it comes with the `plot` extra.
"""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Colours that stay apart for colour-blind readers (Okabe and Ito), without the yellow, which is too light
# for lines, and black; each has a mark of its own.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#8C6D1F", "#222222")
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
DARK, GREY, PALE, SHADE = "#222222", "#666666", "#9a9a9a", "#f1f1f1"  # text and lines, an area
_RC: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.3,
    "svg.hashsalt": "formation",
}
MISSING = 'the pictures need Matplotlib: pip install "formation-env[plot]"'


def installed() -> bool:
    """Whether pictures can be drawn; `MISSING` says what is needed."""
    return importlib.util.find_spec("matplotlib") is not None


@contextmanager
def style() -> Iterator[None]:
    """Within, figures are made and drawn in the style of all pictures, whatever the user's own is."""
    import matplotlib

    with matplotlib.rc_context({**matplotlib.rcParamsDefault, **_RC, "backend": "agg"}):
        yield


def labelled(name: str, unit: str) -> str:
    """The label of an axis: `slot error (m)`, `gust (m/s²)`; a pure number's has no unit."""
    return name if unit == "1" else f"{name} ({unit.replace('^2', '²')})"


# Above this score an axis is stretched by this factor, so that good scores can be told apart.
_STRETCHED_FROM, _STRETCH = 0.8, 4.0
TICKS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.85, 0.9, 0.95, 1.0)


def stretch(score: Floats) -> Floats:
    """The position of scores on an axis, which is stretched above `_STRETCHED_FROM`."""
    high = _STRETCHED_FROM + _STRETCH * (score - _STRETCHED_FROM)
    return np.where(score > _STRETCHED_FROM, high, score)


def unstretch(position: Floats) -> Floats:
    """The inverse of `stretch`."""
    high = _STRETCHED_FROM + (position - _STRETCHED_FROM) / _STRETCH
    return np.where(position > _STRETCHED_FROM, high, position)


def png(canvas: Any, source: str) -> bytes:
    """A drawn canvas in 256 colours, which makes it small; lines keep their colours to within one step.

    `source` is stored in the file as text, so that a stale picture can be noticed.
    """
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
