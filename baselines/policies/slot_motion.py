"""How a follower's slot moves, from what is measured of the leader.

The slot is `p* = p_L - R(theta) d` (6), and its heading follows the zero dynamics (23). With the leader's
velocity and acceleration in {F}, `V = R^T v_L` and `A = R^T a_L`, for which `V_dot = A - S(theta_dot) V`,

    theta_dot  = V_y / d_x                                                    (23)
    theta_ddot = (A_y - theta_dot V_x) / d_x
    R^T v*     = V - theta_dot S d
    R^T a*     = A - theta_ddot S d + theta_dot^2 d

where `S d = (-d_y, d_x, 0)` and the last term takes the planar part of `d`. Before the trigger (40) the slot
stands still.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from baselines.policies.parts import Measured, Planner, Points
from baselines.policies.vectors import Floats, each, in_frame, out_of_frame

# Far above what flies, m/s^2 and rad/s: sums and squares of what is limited to it can be computed with.
MOST = 1e6


class SlotMotion(NamedTuple):
    """The motion of every follower's slot in {F}, `(worlds, followers, 3)` and `(worlds, followers)`."""

    error: Floats  # m, slot minus vehicle
    velocity: Floats  # m/s, of the slot
    acceleration: Floats  # m/s^2, of the slot
    turn_rate: Floats  # theta_dot, rad/s


def _over(a: Floats, d_x: Floats) -> Floats:
    """`a / d_x` within `MOST`; 0 for `d_x = 0`, where turning does not move the leader sideways in {F}."""
    sound = d_x != 0.0
    return np.clip(np.where(sound, a, 0.0) / np.where(sound, d_x, 1.0), -MOST, MOST)


def slot_motion(m: Measured) -> SlotMotion:
    """The motion of the slots. Finite for whatever is finite; numbers are limited to `MOST`."""
    d = m.offset
    V, A = in_frame(m.heading, m.leader.v), in_frame(m.heading, m.leader.a)
    d_x = d[..., 0]
    to_slot = in_frame(m.heading, m.leader.p - m.motion.p) - d
    rate = _over(V[..., 1], d_x)
    rate_dot = _over(np.clip(A[..., 1], -MOST, MOST) - rate * np.clip(V[..., 0], -MOST, MOST), d_x)
    across = np.stack((-d[..., 1], d_x, np.zeros_like(d_x)), axis=-1)  # S d
    along = d * np.array((1.0, 1.0, 0.0))
    moving = each(m.started)
    velocity = np.where(moving, V - each(rate) * across, 0.0)
    a = A - each(rate_dot) * across + each(rate * rate) * along
    acceleration = np.where(moving, np.clip(a, -MOST, MOST), 0.0)
    return SlotMotion(to_slot, velocity, acceleration, np.where(m.started, rate, 0.0))


@final
class SlotPlanner(Planner):
    """The slot itself as the trajectory. Jerk and snap, for which the leader's are not measured, are zero.

    Unlike the paper's planner it keeps no virtual follower: the noise of the measurements is in the points.
    """

    def plan(self, m: Measured) -> Points:
        s = slot_motion(m)
        zero = np.zeros_like(s.error)
        return Points(
            m.motion.p + out_of_frame(m.heading, s.error),
            out_of_frame(m.heading, s.velocity),
            out_of_frame(m.heading, s.acceleration),
            zero,
            zero,
        )
