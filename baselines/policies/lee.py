"""Geometric tracking on SE(3).

T. Lee, M. Leok, N. H. McClamroch, *Geometric Tracking Control of a Quadrotor UAV on SE(3)*, CDC 2010.
Their frame is this package's: north-east-down, thrust along `-r3`. With `e_x = p - p_d`, `e_v = v - v_d`,

    b       = g k - a_d + k_x e_x + k_v e_v                    thrust vector over the mass (their A is -m b)
    f       = m b . r3                                                                 (their 19)
    R_d     = [b1 b2 b3],  b3 = b / |b|,  b1 nearest to the vehicle's r1, b2 = b3 x b1
    e_R     = (R_d^T R - R^T R_d)^v / 2                                                (their 10)
    e_omega = omega - R^T R_d omega_d                                                  (their 11)
    M       = -k_R e_R - k_omega e_omega + omega x J omega
              - J (S(omega) R^T R_d omega_d - R^T R_d omega_d_dot)                     (their 20)

The moment is here that of an angular acceleration, `M = J alpha + omega x J omega`, so that the same law
gives the command to vehicles that are turned by rates.
"""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np

from baselines.policies.cascade import DOWN, LoopGains, TwoLoops, limited, turning, two_loops
from baselines.policies.parts import Motion, Points
from baselines.policies.vectors import Floats, cross, dot, each, norm, to_body, to_inertial, unit
from formation_env import FormationConfig
from formation_env.physics.quadrotor import GRAVITY, Wrench


class Wanted(NamedTuple):
    """The wanted attitude and its motion, inertial; `(worlds, followers, 3)`."""

    b: Floats  # thrust vector over the mass, m/s^2
    b3: Floats  # its direction
    w: Floats  # rad/s, angular velocity of the wanted attitude
    w_dot: Floats  # rad/s^2


class Errors(NamedTuple):
    """Attitude errors in body axes, `(worlds, followers, 3)`."""

    R: Floats  # their (10)
    w: Floats  # rad/s, their (11)


@final
class Lee(TwoLoops):
    """The tracker of `lee`.

    The task asks for no yaw, so the wanted first axis is the vehicle's own `r1`, projected as theirs is, and
    the wanted attitude does not turn about `b3`. `omega_d` and its rate are closed forms, no differences:
    those of `e_v` follow from the model under `f`, the trajectory's jerk and snap from the point, which
    has zeros where they are not measured. With limits met, what is limited counts as constant. Where `b`
    vanishes `b3` is down.

    On SO(3), with `omega_d` exact, `alpha` makes `e_omega_dot = -k_R e_R - k_omega e_omega`, so that
    `k_R (3 - tr(R_d^T R)) / 2 + |e_omega|^2 / 2` falls as `-k_omega |e_omega|^2` (their proposition 1).

    Action level `rates`: the command is `omega + rate_lag alpha`, the attitude part sent through the inverse
    of the rate loop's lag, with the thrust of (19). Level `reference`: the acceleration `g k - b` alone.
    """

    def __init__(self, config: FormationConfig, gains: LoopGains | None = None) -> None:
        super().__init__(config, *two_loops(gains))

    def acceleration(self, p: Floats, v: Floats, point: Points, velocity_after: Floats) -> Floats:
        """The wanted acceleration of the virtual followers, `g k - b`."""
        return limited(self._free(point.p - p, point.v - v, point.a), self.most)

    def _free(self, e: Floats, ev: Floats, a: Floats) -> Floats:
        """The wanted acceleration, or one of its derivatives, before any limit."""
        return a + self.gains.position * e + self.gains.velocity * ev

    def wanted(self, motion: Motion, point: Points) -> Wanted:
        """The wanted attitude with its exact derivatives along the model's motion."""
        p, v, R, w = motion
        e, ev = point.p - p, point.v - v
        free = self._free(e, ev, point.a)
        a = limited(free, self.most)
        b = GRAVITY * DOWN - a
        sideways = norm(free * np.array((1.0, 1.0, 0.0))) <= self.most.sideways
        upwards = np.abs(free[..., 2]) <= self.most.upwards
        within = np.stack((sideways, sideways, upwards), axis=-1)
        # The vehicle accelerates by g k - lift r3.
        r3 = R[..., :, 2]
        turned = np.stack((w[..., 1], -w[..., 0], np.zeros_like(w[..., 0])), axis=-1)
        lift, r3_dot = dot(b, r3), to_inertial(R, turned)  # R S(omega) k
        ev_dot = point.a - GRAVITY * DOWN + each(lift) * r3
        b_dot = np.where(within, -self._free(ev, ev_dot, point.j), 0.0)
        lift_dot = dot(b_dot, r3) + dot(b, r3_dot)
        ev_ddot = point.j + each(lift_dot) * r3 + each(lift) * r3_dot
        b_ddot = np.where(within, -self._free(ev_dot, ev_ddot, point.s), 0.0)
        n = norm(b)
        sound = n > 1e-3
        n = np.where(sound, n, 1.0)
        b3 = unit(b, DOWN)
        n_dot = dot(b3, b_dot)
        b3_dot = (b_dot - each(n_dot) * b3) / each(n)
        # b3_ddot has n_ddot only along b3, where the vector product does not see it.
        bend = (b_ddot - 2.0 * each(n_dot) * b3_dot) / each(n)
        turns = each(sound)
        w_d = np.where(turns, cross(b3, b3_dot), 0.0)
        return Wanted(b, b3, w_d, np.where(turns, cross(b3, bend), 0.0))

    def errors(self, motion: Motion, d: Wanted) -> Errors:
        """The errors on SO(3)."""
        R = motion.R
        b2 = unit(cross(d.b3, R[..., :, 0]), R[..., :, 1])
        axes = (cross(b2, d.b3), b2, d.b3)
        # (R_d^T R - R^T R_d)^v / 2 is half the sum of the products of wanted and true axes.
        x, y, z = (cross(axis, R[..., :, k]) for k, axis in enumerate(axes))
        return Errors(to_body(R, 0.5 * (x + y + z)), motion.w - to_body(R, d.w))

    def command(self, motion: Motion, point: Points) -> Wrench:
        d, w = self.wanted(motion, point), motion.w
        e = self.errors(motion, d)
        alpha = -self.gains.attitude * e.R - self.gains.rate * e.w
        alpha = alpha + to_body(motion.R, d.w_dot) - cross(w, to_body(motion.R, d.w))
        thrust: Any = self.config.vehicle.mass * dot(d.b, motion.R[..., :, 2])
        return Wrench(thrust, turning(alpha, w, self.config))  # type: ignore[arg-type]
