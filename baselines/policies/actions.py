"""From what a vehicle should do to an action, clipping, and a correction added to the expert's action."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device
from formation_env.elementary import pick
from formation_env.quadrotor import Wrench
from formation_env.so3 import Vector
from formation_env.world import Action, Reach

Rows = NDArray[np.float32]


@device
def wrench_action(wanted: Wrench, reach: Reach) -> Action:
    """The action of level WRENCH or RATE that asks for a thrust (N) and a turn (N m or rad/s, body).

    The inverse of `world.driven`; beyond [-1, 1] where the vehicle cannot do it.
    """
    turn, most = wanted.turn, reach.turn
    return (
        2.0 * wanted.thrust / reach.thrust - 1.0,
        turn[0] / most[0],
        turn[1] / most[1],
        turn[2] / most[2],
    )


@device
def acceleration_action(wanted: Vector, reach: Reach) -> Vector:
    """The action of level REFERENCE that asks for an acceleration, m/s^2 in the formation frame.

    The inverse of what `world.guided` does; beyond [-1, 1] where it is more than can be asked for.
    """
    most = reach.acceleration
    return (wanted[0] / most[0], wanted[1] / most[1], wanted[2] / most[2])


@device
def clipped_or_zero(a: float) -> float:
    """An entry of an action within [-1, 1]; 0, which hovers, for what is not a number."""
    return pick(a == a, min(max(a, -1.0), 1.0), 0.0)


def clipped(actions: NDArray[Any]) -> Rows:
    """Actions of any shape within [-1, 1], in single precision."""
    return np.asarray(np.clip(actions, -1.0, 1.0), dtype=np.float32)


def corrected(actions: Rows, correction: NDArray[Any], residual: float) -> Rows:
    """`actions` with `residual` times a correction added, both the correction and the sum clipped."""
    return clipped(actions + np.float32(residual) * clipped(correction))
