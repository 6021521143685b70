"""Colours (red, green, blue) of the pictures, and how they blend."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formation_env.paths.references import Floats

Colour = tuple[int, int, int]

FAR: Colour = (243, 246, 250)  # the floor at the upper edge of the picture
NEAR: Colour = (221, 228, 236)  # and at the lower edge
GRID: Colour = (168, 182, 198)
NORTH: Colour = (196, 92, 84)
EAST: Colour = (82, 140, 96)
INK: Colour = (38, 50, 64)
FAINT: Colour = (108, 122, 138)
SHADOW: Colour = (52, 66, 84)
PANEL: Colour = (255, 255, 255)
BAD: Colour = (206, 44, 58)
LEADER: Colour = (232, 89, 12)
FOLLOWERS: tuple[Colour, ...] = (
    (25, 113, 194),
    (12, 133, 118),
    (132, 66, 196),
    (66, 83, 208),
    (176, 54, 132),
    (84, 118, 32),
)


def vehicle(i: int) -> Colour:
    """The colour of vehicle `i`: 0 is the leader, followers take turns."""
    return LEADER if i == 0 else FOLLOWERS[(i - 1) % len(FOLLOWERS)]


def mix(a: Colour, b: Colour, share: float) -> Colour:
    """`a` with a `share` (0 to 1) of `b`."""
    red, green, blue = (round(x + share * (y - x)) for x, y in zip(a, b, strict=True))
    return (red, green, blue)


def ground(rows: Floats, height: int) -> Floats:
    """The floor's colour `(..., 3)` in the given pixel rows of a picture of that height."""
    share = np.clip(rows / height, 0.0, 1.0)[..., None]
    return np.asarray(FAR + share * (np.array(NEAR, dtype=np.float64) - FAR))


def over_ground(colour: Floats, strength: Floats, rows: Floats, height: int) -> NDArray[np.int64]:
    """`colour` `(..., 3)` laid over the floor with a `strength` (...) between 0 and 1.

    Lines are drawn opaque in the colour they would have if they were translucent: pygame has no
    fast translucent lines.
    """
    floor = ground(rows, height)
    return np.rint(floor + strength[..., None] * (colour - floor)).astype(np.int64)
