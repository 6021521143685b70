"""The linear-quadratic regulator about hover, with the trajectory's acceleration fed forward.

The state is the error to the trajectory, in axes that are level and ahead along the vehicle's own yaw,

    x = (e, e_dot, phi, omega),    e = p - p_d (m),  phi = tilt about x and y (rad),  omega (rad/s, body)
    u = (dT, turn),                thrust beyond the weight (N), moment (N m) or rate command (rad/s)

11 numbers and 4; the yaw angle is no part of it, as the task asks for no yaw. About hover

    e_ddot   = (-g phi_y, g phi_x, -dT / m),     phi_dot = (omega_x, omega_y)
    omega_dot = J^-1 turn,   or   (turn - omega) / rate_lag for vehicles that are turned by rates

and `u = -K x`, `K = R^-1 B^T P` with the solution `P` of `A^T P + P A - P B R^-1 B^T P + Q = 0`, minimises
the integral of `x^T Q x + u^T R u`.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple, final

import numpy as np

from baselines.policies.cascade import SIDEWAYS, UPWARDS, AxisGains, Cascade, Limits
from baselines.policies.parts import Tracker
from baselines.policies.vectors import Floats
from formation_env import FormationConfig
from formation_env.configuration.parts import part
from formation_env.physics.quadrotor import GRAVITY, MOMENT
from formation_env.validation.checks import Within

_SIZE = Within(1e-3, 1e3)
_P, _V, _TILT, _W = slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 11)


class LqrWeights(NamedTuple):
    """Largest acceptable sizes, of which `Q` and `R` follow by Bryson's rule: diagonal, `1 / size^2`.

    An error of each state alone then costs as much at its size as each input does at its own. The plain ones:
    a quarter of a metre, half a metre a second, 15 degrees, 3 rad/s, a quarter of the thrust above the
    weight, and of the moment or rate, that the vehicle has.
    """

    position: Annotated[float, _SIZE] = 0.25  # m
    velocity: Annotated[float, _SIZE] = 0.5  # m/s
    tilt: Annotated[float, _SIZE] = 0.26  # rad
    rate: Annotated[float, _SIZE] = 3.0  # rad/s
    thrust: Annotated[float, _SIZE] = 0.25  # of the vehicle's most, less its weight
    turn: Annotated[float, _SIZE] = 0.25  # of the vehicle's most moment or rate, about each axis
    sideways: Annotated[float, SIDEWAYS] = 5.0  # m/s^2, as in `LoopGains`
    upwards: Annotated[float, UPWARDS] = 5.0  # m/s^2


class Hover(NamedTuple):
    """The linearisation about hover and its cost."""

    A: Floats  # (11, 11)
    B: Floats  # (11, 4)
    Q: Floats  # (11, 11), diagonal
    R: Floats  # (4, 4), diagonal


def hover(config: FormationConfig, weights: LqrWeights) -> Hover:
    """`A`, `B`, `Q`, `R` of a configuration's followers."""
    vehicle = config.vehicle
    A, B = np.zeros((11, 11)), np.zeros((11, 4))
    A[_P, _V] = np.eye(3)
    A[3, 7], A[4, 6] = -GRAVITY, GRAVITY
    A[_TILT, 8:10] = np.eye(2)
    B[5, 0] = -1.0 / vehicle.mass
    if config.follower_actuation == MOMENT:
        B[_W, 1:] = np.diag(1.0 / np.array(vehicle.inertia))
        most = vehicle.moment_max
    else:
        A[_W, _W] = -np.eye(3) / vehicle.rate_lag
        B[_W, 1:] = np.eye(3) / vehicle.rate_lag
        most = vehicle.rate_max
    sizes = np.repeat(weights[:4], (3, 3, 2, 3))
    room = vehicle.full_thrust - vehicle.mass * GRAVITY
    inputs = np.array((weights.thrust * room, *(weights.turn * m for m in most)))
    return Hover(A, B, np.diag(sizes**-2.0), np.diag(inputs**-2.0))


def riccati(h: Hover) -> Floats:
    """The gain `K` `(4, 11)`."""
    from scipy.linalg import solve_continuous_are  # slow to import

    P = solve_continuous_are(h.A, h.B, h.Q, h.R)
    return np.asarray(np.linalg.solve(h.R, h.B.T @ P))


def axis_gains(K: Floats, config: FormationConfig) -> AxisGains:
    """The same law as two loops: `alpha` and the wanted acceleration that make `u = -K x` near hover.

    A tilt `phi` asks for the moment `-K_phi (phi - phi_d)` where `K_phi phi_d = -K_p e - K_v e_dot`, and it
    accelerates by `g phi`. `alpha` is the angular acceleration by the moment, or of the rate loop.
    """
    vehicle = config.vehicle
    if config.follower_actuation == MOMENT:
        per_turn, own = 1.0 / np.array(vehicle.inertia), np.zeros(3)
    else:
        per_turn = np.full(3, 1.0 / vehicle.rate_lag)
        own = per_turn
    roll, pitch = K[1], K[2]  # about x, which accelerates to the right, and about y, backwards
    ahead, right, down = -GRAVITY / pitch[7], GRAVITY / roll[6], -1.0 / vehicle.mass
    position = np.array((pitch[0] * ahead, roll[1] * right, K[0, 2] * down))
    velocity = np.array((pitch[3] * ahead, roll[4] * right, K[0, 5] * down))
    attitude = per_turn * np.array((roll[6], pitch[7], 0.0))
    rate = per_turn * np.array((roll[8], pitch[9], K[3, 10])) + own
    return AxisGains(position, velocity, attitude, rate)


@final
class Lqr(Cascade):
    """The tracker of `lqr`: `u = -K x` about the hover that the trajectory's acceleration asks for.

    Written as the two loops of `Cascade`, whose wanted acceleration is limited; up to there and for small
    tilts the closed loop is `A - B K`. At action level `reference` the gains of its position loop accelerate
    the virtual follower, its first axis north. Raises `ValueError` naming a weight out of its bounds.
    """

    def __init__(self, config: FormationConfig, weights: Any = None) -> None:
        Tracker.__init__(self, config)  # which checks what is about to be used
        self.weights: LqrWeights = part(
            "weights", LqrWeights() if weights is None else weights, LqrWeights()
        )
        self.hover = hover(config, self.weights)
        self.K = riccati(self.hover)
        limits = Limits(self.weights.sideways, self.weights.upwards)
        super().__init__(config, axis_gains(self.K, config), limits)
