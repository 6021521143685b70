"""Policies to compare the expert with: doing nothing, doing anything, and a plain position controller."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.actions import clipped
from baselines.policies.base import Policy, Rows
from formation_env import FormationConfig
from formation_env._jit import kernel, plain
from formation_env.laws.levels import acceleration_action, wrench_action
from formation_env.maths.rng import POLICY, uniforms
from formation_env.physics.quadrotor import GRAVITY, MOMENT, Wrench

Floats = NDArray[np.float64]


@final
class Hover(Policy):
    """The zero action: level hovering thrust and no turning, or an unaccelerated virtual follower."""

    name = "hover"

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        pass

    def decide(self, rows: Rows) -> Rows:
        return np.zeros((*rows.shape[:2], self.config.action_size), dtype=np.float32)


@kernel
def _draw(seeds: NDArray[np.uint64], tick: int, actions: Rows) -> None:
    worlds, n, size = actions.shape
    for w in range(worlds):
        for i in range(n):
            u = uniforms(seeds[w], POLICY, i, tick, 0)
            for k in range(size):
                actions[w, i, k] = 2.0 * u[k] - 1.0


@final
class Random(Policy):
    """Uniform in [-1, 1], anew every tick. A draw depends on the world's seed, follower and tick only.

    The tick is counted from `reset`: a world that is restarted goes on drawing.
    """

    name = "random"

    def __init__(self, config: FormationConfig) -> None:
        super().__init__(config)
        self._seeds = np.zeros(0, dtype=np.uint64)
        self._tick = 0

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        self._seeds = seeds.copy()
        self._tick = 0

    def decide(self, rows: Rows) -> Rows:
        actions = np.empty((*rows.shape[:2], self.config.action_size), dtype=np.float32)
        _draw(self._seeds, self._tick, actions)
        self._tick += 1
        return actions


# Position loop: critically damped, both poles at -2 1/s. Textbook separation of loops: the attitude
# is five times faster, both poles at -10 1/s.
_POSITION = 4.0  # 1/s^2
_VELOCITY = 4.0  # 1/s
_ATTITUDE = 100.0  # 1/s^2
_RATE = 20.0  # 1/s
# The rate loop of the vehicle lags; a proportional loop around a lag of tau is critically damped at
# 1 / (4 tau), 5 1/s for the default lag of 0.05 s.
_TURNING = 0.25
# Wanted accelerations are limited so that the thrust stays within its bounds and the vehicle below
# about 30 degrees of tilt.
_SIDEWAYS = 5.0  # m/s^2, length of the horizontal part
_UPWARDS = 5.0  # m/s^2


@final
class Pd(Policy):
    """A plain position controller on the slot error, the leader's velocity fed forward.

        a = kp e + kd (v_L - v)

    with `e` the slot error, in the formation frame {F}; before the trigger (40) the velocity fed
    forward is zero. It ignores that the slot also moves when the formation turns, and the leader's
    acceleration. Thrust points along `g k - a`. Level `wrench`: a PD law on the angle between `r3` and
    that direction and on the angular velocity; level `rates`: a proportional one on the angle; level
    `reference`: `a` itself, with position and velocity of the virtual follower, which is what the
    action accelerates.
    """

    name = "pd"

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        pass

    def decide(self, rows: Rows) -> Rows:
        entries = self.layout.unpack(rows.astype(np.float64))
        wanted, reach = _wanted(entries), self.config.world.reach
        if self.config.action == "reference":
            action: Any = plain(acceleration_action)(_components(wanted), reach)
        else:
            action = plain(wrench_action)(self._wrench(entries, wanted), reach)
        return clipped(np.stack(action, axis=-1, dtype=np.float32))

    def _wrench(self, entries: dict[str, Floats], wanted: Floats) -> Wrench:
        """Thrust and turn that accelerate the vehicle by `wanted` (m/s^2, {F}), as arrays."""
        vehicle = self.config.vehicle
        body_x, body_z = entries["body_x"], entries["body_z"]
        pull = np.array((0.0, 0.0, GRAVITY)) - wanted
        thrust = vehicle.mass * _dot(pull, body_z)
        tilt = _cross(body_z, pull / np.sqrt(_dot(pull, pull))[..., None])
        # Along the body axes x and y; the yaw angle is free, so only its rate is damped.
        yaw = np.zeros_like(thrust)
        angles = (_dot(body_x, tilt), _dot(_cross(body_z, body_x), tilt), yaw)
        turn: Any
        if self.config.follower_actuation == MOMENT:
            rates = _components(entries["angular_velocity"])
            inertia = zip(vehicle.inertia, angles, rates, strict=True)
            turn = tuple(J * (_ATTITUDE * angle - _RATE * w) for J, angle, w in inertia)
        else:
            turn = tuple(_TURNING / vehicle.rate_lag * angle for angle in angles)
        return Wrench(thrust, turn)


def _components(a: Floats) -> Any:
    """Vectors `(..., 3)` as a tuple of their components."""
    return tuple(np.moveaxis(a, -1, 0))


def _wanted(entries: dict[str, Floats]) -> Floats:
    """The acceleration of the position loop, limited, m/s^2 in {F}."""
    e = entries["slot_error"]
    ev = entries["relative_velocity"] - (1.0 - entries["started"]) * entries["leader_velocity"]
    if "guide_position" in entries:
        e, ev = e - entries["guide_position"], ev - entries["guide_velocity"]
    a = _POSITION * e + _VELOCITY * ev
    sideways = np.sqrt(a[..., 0] * a[..., 0] + a[..., 1] * a[..., 1])
    a[..., :2] *= (_SIDEWAYS / np.maximum(sideways, _SIDEWAYS))[..., None]
    a[..., 2] = np.clip(a[..., 2], -_UPWARDS, _UPWARDS)
    return a


# Element by element rather than by matrix routines, whose rounding depends on the number of rows.
def _dot(a: Floats, b: Floats) -> Any:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def _cross(a: Floats, b: Floats) -> Floats:
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.stack((x, y, z), axis=-1)
