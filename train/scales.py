"""Typical sizes of the entries of an observation and of the central state, by which networks divide them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formation_env.task import Layout

Array = NDArray[np.float32]

CLIP = 10.0  # bound of normalised inputs, either way
UPRIGHT = (0.0, 0.0, 1.0)  # mean of body_z
# The fields of `state()` in its order: of each vehicle, of each follower's slot, of the world.
_POSITION, _VELOCITY, _ATTITUDE, _ANGULAR_VELOCITY = [5.0] * 3, [1.0] * 3, [0.5] * 4, [1.0] * 3
_VEHICLE = [*_POSITION, *_VELOCITY, *_ATTITUDE, *_ANGULAR_VELOCITY]
_SLOT, _STARTED = [5.0] * 3, [1.0]


def fixed_scales(layout: Layout) -> tuple[Array, Array]:
    """Mean and scale of one observation's entries, float32 `(entries,)` each.

    The scale is what the layout calls typical of each quantity. Fixed, because measured deviations hide
    centimetres behind the metres of the first minutes, and are zero for offsets, so that other formations
    would be clipped.
    """
    mean = np.zeros(layout.size, dtype=np.float32)
    mean[layout.slices["body_z"]] = UPRIGHT
    return mean, layout.typical.copy()


def state_scales(followers: int) -> Array:
    """Scales of the numbers of `state()`, float32 `(numbers,)`."""
    numbers = _VEHICLE * (followers + 1) + _SLOT * followers + _STARTED
    return np.array(numbers, dtype=np.float32)
