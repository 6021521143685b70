"""How large the numbers of an observation and of the state typically are: what networks divide by."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formation_env.task import Layout

Array = NDArray[np.float32]

CLIP = 10.0  # of normalised inputs
# By how much an entry typically differs from what is usual while a formation is kept; units as in the
# layout. Fixed, because measured spreads hide centimetres behind the metres of the first minutes, and
# are zero for offsets, which other formations then fall outside of. The position is all but hidden:
# where in the world a formation flies is none of a follower's business.
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
UPRIGHT = (0.0, 0.0, 1.0)  # mean of body_z
# Inertial positions, velocities, attitudes and angular velocities, as `state()` has them.
_VEHICLE = [5.0] * 3 + [1.0] * 3 + [0.5] * 4 + [1.0] * 3


def fixed_scales(layout: Layout) -> tuple[Array, Array]:
    """Mean and scale of one observation's entries."""
    mean = np.zeros(layout.size, dtype=np.float32)
    scale = np.full(layout.size, NEIGHBOUR_SCALE, dtype=np.float32)
    for name, where in layout.slices.items():
        scale[where] = SCALES[name]
    mean[layout.slices["body_z"]] = UPRIGHT
    return mean, scale


def state_scales(followers: int) -> Array:
    """Scales of the numbers of `state()`."""
    numbers = _VEHICLE * (followers + 1) + [5.0] * (3 * followers) + [1.0]
    return np.array(numbers, dtype=np.float32)
