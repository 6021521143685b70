"""What a controller is made of: a planner part, a tracker part, and what they are given.

    observation --> Measured --> planner part --> Points --> tracker part --> Wrench --> action

A planner part says where each follower should be and how that moves, a tracker part how a vehicle flies
there. All arrays have the shape `(worlds, followers, ...)`, float64, inertial frame north-east-down. To write
a part, subclass `Planner` or `Tracker`; `baselines.policies.composed.Composed` makes a policy of two.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.policies.base import Rows
from baselines.policies.vectors import Complexes, Floats, cross, out_of_frame
from formation_env import FormationConfig
from formation_env.physics.quadrotor import Wrench
from formation_env.validation.checks import require


class Motion(NamedTuple):
    """The followers' vehicles, as measured."""

    p: Floats  # m, (worlds, followers, 3)
    v: Floats  # m/s, (worlds, followers, 3)
    R: Floats  # attitude, (worlds, followers, 3, 3): its columns are the body axes
    w: Floats  # rad/s, body, (worlds, followers, 3)


class Points(NamedTuple):
    """A point of a trajectory for every follower, with its derivatives; each `(worlds, followers, 3)`."""

    p: Floats  # m
    v: Floats  # m/s
    a: Floats  # m/s^2
    j: Floats  # m/s^3
    s: Floats  # m/s^4


class Measured(NamedTuple):
    """What observations say, in the inertial frame."""

    motion: Motion
    leader: Points  # as each follower measures it; jerk and snap, which nothing measures, are zero
    heading: Complexes  # exp(j theta) of the estimated theta (23), (worlds, followers)
    offset: Floats  # d, m, {F}, (worlds, followers, 3)
    started: NDArray[np.bool_]  # whether the trigger (40) has fired, (worlds, followers)
    entries: dict[str, Floats]  # the observation itself, by the names of `config.layout`


def measured(rows: Rows, config: FormationConfig) -> Measured:
    """What observations `(worlds, followers, entries)` were made of: their change of frame undone.

    Entries beyond the bounds of the layout, which no environment gives, count as the bounds.
    """
    most = config.layout.bound
    e = config.layout.unpack(np.clip(rows, -most, most).astype(np.float64))
    heading: Complexes = e["heading"][..., 0] + 1j * e["heading"][..., 1]
    v_L = out_of_frame(heading, e["leader_velocity"])
    v = v_L - out_of_frame(heading, e["relative_velocity"])
    p_L = e["position"] + out_of_frame(heading, e["slot_error"] + e["offset"])
    r1, r3 = out_of_frame(heading, e["body_x"]), out_of_frame(heading, e["body_z"])
    zero = np.zeros_like(v)
    leader = Points(p_L, v_L, out_of_frame(heading, e["leader_acceleration"]), zero, zero)
    R = np.stack((r1, cross(r3, r1), r3), axis=-1)
    motion = Motion(e["position"], v, R, e["angular_velocity"])
    return Measured(motion, leader, heading, e["offset"], e["started"][..., 0] > 0.5, e)


class Part(ABC):  # noqa: B024
    """A planner or tracker part for a configuration.

    One that remembers its worlds implements `begin` and `begin_again`; where a world's episode begins, the
    next call is for its first observation. A part is used by one policy.
    """

    def __init__(self, config: FormationConfig) -> None:
        given = isinstance(config, FormationConfig)
        require(given, "config", config, "a FormationConfig, as `configure` makes one")
        self.config = config

    @property
    def remembers(self) -> bool:
        """Whether what it computes depends on more than its arguments."""
        return type(self).begin_again is not Part.begin_again

    def begin(self, worlds: int) -> None:  # noqa: B027
        """Episodes begin in `worlds` worlds; nothing of other worlds is remembered."""

    def begin_again(self, mask: NDArray[np.bool_]) -> None:  # noqa: B027
        """Episodes begin in the worlds of `mask` `(worlds,)`; the others go on."""


class Planner(Part):
    """Says where each follower should be."""

    @abstractmethod
    def plan(self, m: Measured) -> Points:
        """The trajectories' points for this tick. Called once a tick."""

    def velocity_after(self, point: Points) -> Floats:
        """The trajectories' velocities one tick later, m/s, after `plan` has returned `point`."""
        return point.v + self.config.control_period * point.a


class Tracker(Part):
    """Says how each vehicle flies to its point."""

    @abstractmethod
    def command(self, motion: Motion, point: Points) -> Wrench:
        """Thrust `(worlds, followers)` (N) and turn `(worlds, followers, 3)`, body: a moment (N m) at action
        level `wrench`, an angular velocity (rad/s) at `rates`."""

    def acceleration(self, p: Floats, v: Floats, point: Points, velocity_after: Floats) -> Floats:
        """At action level `reference`, the acceleration (m/s^2, inertial) of virtual followers at `p`, `v`.

        Here one that makes their velocity a tick later that of the trajectory and twice the difference in
        position (1/s), which so vanishes with a time constant of half a second. The environment's own
        tracker flies the vehicles.
        """
        wanted: Floats = velocity_after - v + 2.0 * (point.p - p)
        return wanted / self.config.control_period


class Estimator(Part):
    """Replaces what is measured by estimates."""

    @abstractmethod
    def estimate(self, m: Measured) -> Measured:
        """The same with positions, velocities or accelerations replaced. Called once a tick."""


def part_of(name: str, value: Any, kind: type[Part], config: FormationConfig) -> None:
    """Refuse what is no part of a kind for the configuration; raises `ValueError` naming it."""
    if not isinstance(value, kind):
        raise ValueError(
            f"{name} is {type(value).__name__}: expected a part of kind {kind.__name__}"
        )
    if value.config != config:
        raise ValueError(f"{name} was made for another configuration than the policy")
