"""The expert's action with a learned correction, and the correction that makes it another action."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Actions = NDArray[Any]  # of any shape; entries in [-1, 1] are within the vehicle's limits


def corrected(expert: Actions, correction: Actions, bound: float) -> Actions:
    """The action that is executed: `clip(expert + bound clip(correction))`, both clipped to [-1, 1].

    float32 in, float32 out, as `baselines.policies.learned.Learned` flies it.
    """
    change = np.float32(bound) * np.clip(correction, -1.0, 1.0)
    return np.asarray(np.clip(expert + change, -1.0, 1.0))


def correction_towards(wanted: Actions, expert: Actions, bound: float) -> Actions:
    """The correction by which `corrected` comes nearest to an action that is wanted, in [-1, 1]."""
    return np.asarray(np.clip((wanted - expert) / np.float32(bound), -1.0, 1.0))
