"""Clipping of actions; the expert's action with a learned correction, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device
from formation_env.maths.elementary import pick
from formation_env.memory import shuffles

Rows = NDArray[np.float32]


@device
def clipped_or_zero(a: float) -> float:
    """An entry of an action within [-1, 1]; 0, which hovers, for what is not a number."""
    return pick(a == a, shuffles.clipped(a), 0.0)


def clipped(actions: NDArray[Any]) -> Rows:
    """Actions of any shape within [-1, 1], in single precision."""
    return np.asarray(np.clip(actions, -1.0, 1.0), dtype=np.float32)


def corrected(actions: Rows, correction: NDArray[Any], residual: float) -> Rows:
    """`actions` with `residual` times a correction added, both the correction and the sum clipped."""
    return clipped(actions + np.float32(residual) * clipped(correction))


def correction_towards(wanted: Rows, actions: Rows, residual: float) -> Rows:
    """The correction by which `corrected` comes nearest to an action that is wanted, in [-1, 1]."""
    return clipped((wanted - actions) / np.float32(residual))
