"""Position and attitude in two loops, as textbooks have them: `ff`, and the parts that other trackers share.

The position loop says how the vehicle should accelerate, the thrust and the attitude loop see to it. What
turns a vehicle is the angular acceleration that the attitude loop asks for, whatever its actuators:

    moment (46):  m = J alpha + w x J w                 so that omega_dot = alpha
    rates:        omega_c = omega + rate_lag alpha      likewise, through the lag of the rate loop
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Annotated, Any, NamedTuple, TypeVar, cast, final

import numpy as np

from baselines.policies.parts import Motion, Points, Tracker
from baselines.policies.vectors import Floats, cross, dot, each, to_body, unit
from formation_env import FormationConfig
from formation_env.configuration.parts import part
from formation_env.physics.quadrotor import GRAVITY, MOMENT, Wrench
from formation_env.validation.checks import Within

DOWN = np.array((0.0, 0.0, 1.0))
NORTH = np.array((1.0, 0.0, 0.0))

Record = TypeVar("Record", bound="tuple[Any, ...]")

_GAIN = Within(0.0, 1e6, strict=True)
SIDEWAYS, UPWARDS = Within(0.0, 1e3, strict=True), Within(0.0, 0.99 * GRAVITY, strict=True)


class LoopGains(NamedTuple):
    """Gains of `ff` and `lee`.

    Both poles of the position loop at -2 1/s, of the attitude loop at -10 1/s: critically damped, and
    five times faster. Wanted accelerations are limited so that the thrust stays within its bounds and the
    vehicle below about 30 degrees of tilt.
    """

    position: Annotated[float, _GAIN] = 4.0  # 1/s^2
    velocity: Annotated[float, _GAIN] = 4.0  # 1/s
    attitude: Annotated[float, _GAIN] = 100.0  # 1/s^2
    rate: Annotated[float, _GAIN] = 20.0  # 1/s
    sideways: Annotated[float, SIDEWAYS] = 5.0  # m/s^2, most of the horizontal part
    upwards: Annotated[float, UPWARDS] = 5.0  # m/s^2, most of the vertical part, either way


def loop_gains(gains: Any) -> LoopGains:
    """`gains`, checked; None is the plain ones. Raises `ValueError` naming the gain."""
    return part("gains", LoopGains() if gains is None else gains, LoopGains())


class AxisGains(NamedTuple):
    """Gains of the two loops for each axis of the vehicle: ahead, to its right, down; about x, y, z.

    Each `(3,)`, or `(worlds, 1, 3)` where worlds have gains of their own.
    """

    position: Floats  # 1/s^2
    velocity: Floats  # 1/s
    attitude: Floats  # 1/s^2; about z `ff` and `lqr` leave the angle free and do not use it
    rate: Floats  # 1/s


class Limits(NamedTuple):
    """Most of a wanted acceleration; each a number, or `(worlds, 1)`."""

    sideways: Any  # m/s^2, length of the horizontal part
    upwards: Any  # m/s^2, of the vertical part, either way


def two_loops(gains: Any) -> tuple[AxisGains, Limits]:
    """The same gains, those of a `LoopGains`, along and about every axis. Raises as `loop_gains`."""
    g = loop_gains(gains)
    return AxisGains(*(np.full(3, gain) for gain in g[:4])), Limits(g.sideways, g.upwards)


def by_world(records: Sequence[Record], worlds: int) -> Record:
    """NamedTuples of numbers or arrays `(...)` as one of arrays `(len(records) * worlds, 1, ...)`.

    Each record is that of so many worlds in a row, and of all their followers.
    """
    kind: Any = type(records[0])
    fields = (np.stack(values)[:, None] for values in zip(*records, strict=True))
    return cast(Record, kind(*(np.repeat(field, worlds, axis=0) for field in fields)))


def limited(a: Floats, most: Limits) -> Floats:
    """Accelerations whose horizontal part keeps its direction."""
    sideways = np.sqrt(a[..., 0] * a[..., 0] + a[..., 1] * a[..., 1])
    shrunk = a[..., :2] * each(most.sideways / np.maximum(sideways, most.sideways))
    climb = np.clip(a[..., 2], -most.upwards, most.upwards)
    return np.concatenate((shrunk, each(climb)), axis=-1)


def turning(alpha: Floats, w: Floats, config: FormationConfig) -> Floats:
    """The turn that makes `omega_dot = alpha` (rad/s^2, body): a moment (N m) or a rate (rad/s)."""
    if config.follower_actuation == MOMENT:
        J = np.array(config.vehicle.inertia)
        return J * alpha + cross(w, J * w)
    return w + config.vehicle.rate_lag * alpha


class TwoLoops(Tracker):
    """A tracker with a position loop and an attitude loop, whose gains may differ from world to world."""

    def __init__(self, config: FormationConfig, gains: AxisGains, most: Limits) -> None:
        super().__init__(config)
        self.gains, self.most = gains, most

    def stacked(self, others: Sequence[TwoLoops], worlds: int) -> TwoLoops:
        """A tracker of this kind that flies so many worlds in a row with the gains of each of `others`.

        A world's commands are those of the other tracker, bit for bit.
        """
        one = copy(self)
        one.gains = by_world([other.gains for other in others], worlds)
        one.most = by_world([other.most for other in others], worlds)
        return one


class Cascade(TwoLoops):
    """A position loop, and an attitude loop that turns the thrust to where it wants it.

        a     = a_d + kp (p_d - p) + kv (v_d - v), limited          the wanted acceleration
        b     = g k - a,   T = m b . r3,   r3d = b / |b|
        alpha = kR R^T (r3 x r3d) - kw omega

    With `r3 = r3d` and no limit met, `e = p - p_d` obeys `e_ddot + kv e_dot + kp e = 0` on each axis: with
    the trajectory's acceleration fed forward nothing is left to follow it with. The yaw angle is free, so
    only its rate is damped. The attitude loop takes `r3d` as resting, so the tilt lags behind a wanted one
    that turns, by `kw / kR` s. Where `b` vanishes, in free fall, `r3d` is down.
    """

    def wanted(self, e: Floats, ev: Floats, ahead: Floats, a: Floats) -> Floats:
        """The wanted acceleration (m/s^2) for errors `p_d - p` (m), `v_d - v` (m/s) and `a_d` (m/s^2).

        `ahead` is the horizontal direction of the first axis of the gains.
        """
        right = cross(DOWN, ahead)
        kp, kv = self.gains.position, self.gains.velocity
        x, y = (
            kp[..., k] * dot(e, n) + kv[..., k] * dot(ev, n) for k, n in enumerate((ahead, right))
        )
        z = kp[..., 2] * e[..., 2] + kv[..., 2] * ev[..., 2]
        pull = each(x) * ahead + each(y) * right + each(z) * DOWN
        return limited(a + pull, self.most)

    def command(self, motion: Motion, point: Points) -> Wrench:
        p, v, R, w = motion
        ahead = unit(R[..., :, 0] * np.array((1.0, 1.0, 0.0)), NORTH)
        b = GRAVITY * DOWN - self.wanted(point.p - p, point.v - v, ahead, point.a)
        tilt = to_body(R, cross(R[..., :, 2], unit(b, DOWN)))
        alpha = self.gains.attitude * tilt - self.gains.rate * w
        thrust: Any = self.config.vehicle.mass * dot(b, R[..., :, 2])
        return Wrench(thrust, turning(alpha, w, self.config))  # type: ignore[arg-type]

    def acceleration(self, p: Floats, v: Floats, point: Points, velocity_after: Floats) -> Floats:
        """The wanted acceleration of the virtual followers; the first axis is north."""
        return self.wanted(point.p - p, point.v - v, NORTH, point.a)


@final
class Feedforward(Cascade):
    """The tracker of `ff`: `Cascade` with the same gains along and about every axis."""

    def __init__(self, config: FormationConfig, gains: LoopGains | None = None) -> None:
        super().__init__(config, *two_loops(gains))
