"""What a follower sees, what it is paid for, and when an episode has failed.

`Observation` is the layout: its fields, in order, are the entries of a follower's row, followed by
`neighbours` times a `Neighbour`. `Layout` turns rows into names and back.
"""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device
from formation_env.checks import refuse
from formation_env.sensors import Measured
from formation_env.slots import in_frame
from formation_env.so3 import Rotation, Vector, dot, rotation, sub
from formation_env.world import REFERENCE, Action, Guide

# How a follower's episode ended. LEADER: the leader crashed, for which no follower pays.
NO_FAILURE, COLLISION, IMPACT, LOST, LEADER = 0, 1, 2, 3, 4
FAILURES = ("none", "collision", "impact", "lost", "leader")


class Observation(NamedTuple):
    """One follower's row, without its neighbours. {F} is the formation frame that it estimates."""

    slot_error: Vector  # m, {F}: where the leader is, minus where it should be
    relative_velocity: Vector  # m/s, {F}: leader's minus own
    leader_velocity: Vector  # m/s, {F}
    leader_acceleration: Vector  # m/s^2, {F}
    body_x: Vector  # r1 in {F}
    body_z: Vector  # r3 in {F}
    angular_velocity: Vector  # rad/s, body
    heading: tuple[float, float]  # (cos, sin) of the estimated theta
    offset: Vector  # d, m, {F}
    previous_action: Action
    started: float  # 1 once the trigger (40) has fired, else 0
    position: Vector  # m, inertial


class Neighbour(NamedTuple):
    """Another follower, nearest first; all zero where there is none."""

    present: float  # 1 or 0
    position: Vector  # m, {F}, relative to the observer
    velocity: Vector  # m/s, {F}, relative to the observer


class Entry(NamedTuple):
    """One named part of an observation row."""

    name: str
    size: int
    bound: float
    unit: str
    frame: str
    meaning: str


# Bounds that entries are clipped to: m, m; m/s, m/s^2 or rad/s; 1.
NEAR, ANYWHERE, RATE_BOUND, UNIT = 1e3, 1e4, 100.0, 1.0

ENTRIES = (
    Entry("slot_error", 3, NEAR, "m", "{F}", "R^T(p_L - p) - d: (7) for the vehicle itself"),
    Entry("relative_velocity", 3, RATE_BOUND, "m/s", "{F}", "leader's velocity minus own"),
    Entry("leader_velocity", 3, RATE_BOUND, "m/s", "{F}", "leader's velocity"),
    Entry("leader_acceleration", 3, RATE_BOUND, "m/s^2", "{F}", "leader's acceleration"),
    Entry("body_x", 3, UNIT, "1", "{F}", "first body axis r1"),
    Entry("body_z", 3, UNIT, "1", "{F}", "third body axis r3; thrust acts along -r3"),
    Entry("angular_velocity", 3, RATE_BOUND, "rad/s", "body", "omega"),
    Entry("heading", 2, UNIT, "1", "inertial", "cos and sin of the estimated theta (23)"),
    Entry("offset", 3, NEAR, "m", "{F}", "d, where the leader should be seen"),
    Entry("previous_action", 4, UNIT, "1", "-", "last action as executed, padded with zeros"),
    Entry("started", 1, UNIT, "1", "-", "1 once the trigger (40) has fired"),
    Entry("position", 3, ANYWHERE, "m", "inertial", "own measured position, north-east-down"),
)
REFERENCE_ENTRIES = (
    Entry("guide_position", 3, NEAR, "m", "{F}", "virtual follower's position minus own"),
    Entry("guide_velocity", 3, RATE_BOUND, "m/s", "{F}", "virtual follower's velocity minus own"),
)
NEIGHBOUR_ENTRIES = (
    Entry("neighbour_present", 1, UNIT, "1", "-", "1 if there is such a neighbour"),
    Entry("neighbour_position", 3, NEAR, "m", "{F}", "its position minus own"),
    Entry("neighbour_velocity", 3, RATE_BOUND, "m/s", "{F}", "its velocity minus own"),
)

CORE = sum(entry.size for entry in ENTRIES)
GUIDE = sum(entry.size for entry in REFERENCE_ENTRIES)
NEIGHBOUR = sum(entry.size for entry in NEIGHBOUR_ENTRIES)


class Rewards(NamedTuple):
    """What things are worth, per control tick."""

    scale: float  # m, slot error at which the formation term is one half
    effort: float  # weight of the mean squared action
    smoothness: float  # weight of the mean squared change of action
    failure: float  # paid once by the follower that failed


class Limits(NamedTuple):
    """Where an episode fails."""

    collision: float  # m, least distance between two vehicles
    impact: float  # m/s, fastest touch-down
    tilt: float  # least r3 . k at touch-down
    lost: float  # m, largest slot error


class Terms(NamedTuple):
    """The reward's parts, signed and weighted; their sum is the reward."""

    formation: float
    effort: float
    smoothness: float
    failure: float


@device
def observe(
    own: Measured,
    leader: Measured,
    anchor: Vector,
    R: complex,
    d: Vector,
    previous: Action,
    started: bool,
) -> Observation:
    """What a follower measures, in the frame of its estimated heading `R`.

    `anchor` is where the leader counts as being: its measured position, or the first reference point
    while it waits for the trigger (40).
    """
    attitude: Rotation = rotation(own.q)
    p_L = in_frame(R, sub(anchor, own.p))
    return Observation(
        sub(p_L, d),
        in_frame(R, sub(leader.v, own.v)),
        in_frame(R, leader.v),
        in_frame(R, leader.a),
        in_frame(R, attitude[0]),
        in_frame(R, attitude[2]),
        own.w,
        (R.real, R.imag),
        d,
        previous,
        1.0 if started else 0.0,
        own.p,
    )


@device
def observe_neighbour(own: Measured, other: Measured, R: complex) -> Neighbour:
    """Another follower as this one measures it."""
    return Neighbour(1.0, in_frame(R, sub(other.p, own.p)), in_frame(R, sub(other.v, own.v)))


@device
def observe_guide(own: Measured, guide: Guide, R: complex) -> Guide:
    """The virtual follower of the `reference` level, relative to the vehicle that flies it."""
    return Guide(in_frame(R, sub(guide.p, own.p)), in_frame(R, sub(guide.v, own.v)))


@device
def failure(
    separation: float, speed: float, uprightness: float, error: float, limits: Limits
) -> int:
    """How a follower failed in this tick, if it did.

    Distances in m, `speed` of the hardest touch-down in m/s (0 in the air), its `uprightness` r3 . k.
    An error that is not a number counts as lost: the state has left what can be computed. An infinite `speed`
    is no crash: it says the same.
    """
    crashed = (speed > limits.impact) | ((speed > 0.0) & (uprightness < limits.tilt))
    crashed = crashed & (speed < inf)
    lost = not error <= limits.lost
    why = LOST if lost else NO_FAILURE
    why = IMPACT if crashed else why
    return COLLISION if separation < limits.collision else why


@device
def reward(
    error: float, action: Action, previous: Action, size: int, failed: bool, weights: Rewards
) -> Terms:
    """The reward's terms for one follower and one tick.

        formation  = 1 / (1 + (|e| / scale)^2)      1 when exact, heavy-tailed, so always informative
        effort     = -effort |a|^2 / size           zero action is hovering flight
        smoothness = -smoothness |a - a_prev|^2 / size
        failure    = -failure, once

    `error` is the true slot error in m, `size` the number of entries an action has. An error that is not a
    number earns nothing.
    """
    x = error / weights.scale
    b = (
        action[0] - previous[0],
        action[1] - previous[1],
        action[2] - previous[2],
        action[3] - previous[3],
    )
    return Terms(
        max(0.0, 1.0 / (1.0 + x * x)),  # in this order 0 for NaN
        -weights.effort * _square(action) / size,
        -weights.smoothness * _square(b) / size,
        -weights.failure if failed else 0.0,
    )


@device
def _square(a: Action) -> float:
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3]


@device
def distance(a: Vector, b: Vector) -> float:
    """Distance between two points, m."""
    e = sub(a, b)
    return float(np.sqrt(dot(e, e)))


@final
class Layout:
    """Names for the entries of an observation row.

    `layout.slices["slot_error"]` is where an entry lies; `unpack` gives a dictionary of views on rows
    of any leading shape, `pack` the reverse. Neighbour entries are grouped: `neighbour_position` has
    shape `(..., neighbours, 3)`.
    """

    version = 1

    def __init__(self, level: int, neighbours: int) -> None:
        guides = REFERENCE_ENTRIES if level == REFERENCE else ()
        self.neighbours = neighbours
        self.entries: tuple[Entry, ...] = (*ENTRIES, *guides)
        self.slices: dict[str, slice] = {}
        start = 0
        for entry in self.entries:
            self.slices[entry.name] = slice(start, start + entry.size)
            start += entry.size
        self.first_neighbour = start
        self.size = start + neighbours * NEIGHBOUR
        bounds = [np.full(entry.size, entry.bound) for entry in self.entries]
        each = [np.full(entry.size, entry.bound) for entry in NEIGHBOUR_ENTRIES]
        self.bound: NDArray[np.float32] = np.concatenate(bounds + each * neighbours).astype(
            np.float32
        )

    def unpack(self, rows: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Views on the named entries of `rows`, shape `(..., size)`; raises `ValueError` on another size."""
        if rows.shape[-1:] != (self.size,):
            raise ValueError(
                f"observation has shape {rows.shape}: expected (..., {self.size}) for this layout"
            )
        named = {name: rows[..., where] for name, where in self.slices.items()}
        tail = rows[..., self.first_neighbour :]
        tail = tail.reshape(*rows.shape[:-1], self.neighbours, NEIGHBOUR)
        start = 0
        for entry in NEIGHBOUR_ENTRIES:
            named[entry.name] = tail[..., start : start + entry.size]
            start += entry.size
        return named

    def pack(self, named: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Rows from named entries, the inverse of `unpack`; raises `ValueError` on wrong names."""
        wanted = {*self.slices, *(entry.name for entry in NEIGHBOUR_ENTRIES)}
        if set(named) != wanted:
            odd = sorted(map(str, set(named) ^ wanted))
            refuse("entries missing or unknown", odd, ", ".join(sorted(wanted)))
        leading = named["slot_error"].shape[:-1]
        parts = [np.asarray(named[entry.name]) for entry in self.entries]
        tail = [np.asarray(named[entry.name]) for entry in NEIGHBOUR_ENTRIES]
        neighbours = np.concatenate(tail, axis=-1).reshape(*leading, self.neighbours * NEIGHBOUR)
        return np.concatenate([*parts, neighbours], axis=-1).astype(np.float32)
