"""Typical sizes of the entries of an observation and of the central state, by which networks divide them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formation_env.task import Layout

Array = NDArray[np.float32]

CLIP = 10.0  # bound of normalised inputs, either way
# By how much each field of an observation typically differs from its mean while a formation is kept; units
# as in the layout. Fixed, because measured deviations hide centimetres behind the metres of the first
# minutes, and are zero for offsets, so that other formations would be clipped. The position is divided by
# so much that it hardly counts: what a follower should do does not depend on where in the world it flies.
SCALES = {
    "slot_error": 0.3,
    "relative_velocity": 0.3,
    "leader_velocity": 1.0,
    "leader_acceleration": 1.0,
    "body_x": 1.0,
    "body_z": 0.2,
    "angular_velocity": 1.0,
    "heading": 1.0,
    "offset": 0.5,
    "previous_action": 0.5,
    "started": 1.0,
    "position": 100.0,
    "guide_position": 0.3,
    "guide_velocity": 0.3,
}
NEIGHBOUR_SCALE = 1.0
OTHER_SCALE = 1.0  # of a field that is not listed
UPRIGHT = (0.0, 0.0, 1.0)  # mean of body_z
# The fields of `state()` in its order: of each vehicle, of each follower's slot, of the world.
_POSITION, _VELOCITY, _ATTITUDE, _ANGULAR_VELOCITY = [5.0] * 3, [1.0] * 3, [0.5] * 4, [1.0] * 3
_VEHICLE = [*_POSITION, *_VELOCITY, *_ATTITUDE, *_ANGULAR_VELOCITY]
_SLOT, _STARTED = [5.0] * 3, [1.0]


def fixed_scales(layout: Layout) -> tuple[Array, Array]:
    """Mean and scale of one observation's entries, float32 `(entries,)` each."""
    mean = np.zeros(layout.size, dtype=np.float32)
    scale = np.full(layout.size, NEIGHBOUR_SCALE, dtype=np.float32)
    for name, where in layout.slices.items():
        scale[where] = SCALES.get(name, OTHER_SCALE)
    mean[layout.slices["body_z"]] = UPRIGHT
    return mean, scale


def state_scales(followers: int) -> Array:
    """Scales of the numbers of `state()`, float32 `(numbers,)`."""
    numbers = _VEHICLE * (followers + 1) + _SLOT * followers + _STARTED
    return np.array(numbers, dtype=np.float32)
