"""Kalman filters, steady after their first seconds, of what a follower measures of itself and its leader.

Each axis of the inertial frame is filtered by itself and alike. With `h` the control period,

    follower:  p' = p + h v + h^2 u / 2,  v' = v + h u        u the acceleration that its thrust gives
    leader:    p' = p + h v + h^2 a / 2 + h^3 j / 6,  v' = v + h a + h^2 j / 2,  a' = a + h j

The process noise is a white push on `u` and `a`, and for the leader a white jerk `j`, each held for a tick;
the measurement noise is `config.noise`. The gain is that of the filter after long time,

    K = S H^T (H S H^T + V)^-1,    S = F S F^T - F S H^T (H S H^T + V)^-1 H S F^T + W

where `S` is the covariance of the prediction, found once (`scipy.linalg.solve_discrete_are`). Predictions are
far better than measurements, so `K` is small, and a first estimate, which is one measurement, would stay
for ten seconds. The gains of the first ticks are those of the same recursion from that estimate's covariance,
down to `K`. Without measurement noise all pass on what is measured.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.parts import Estimator, Measured
from baselines.policies.vectors import Floats, each
from formation_env import FormationConfig
from formation_env._jit import plain
from formation_env.laws.levels import driven
from formation_env.physics.quadrotor import GRAVITY

# Process noise: what the models leave out, standard deviations.
PUSH = 0.2  # m/s^2 on any vehicle, beside gusts: what is between two measured accelerations
JERK = 10.0  # m/s^3 of a leader that corrects its own errors, on noisy measurements
# At least so much process and measurement noise, m, m/s and m/s^2, so that the gain exists: a measurement
# without noise counts as a thousand times finer than any prediction.
_ROUGHEST, _FINEST = 1e-6, 1e-9
_LONGEST = 2000  # ticks with gains of their own, at most
# Of a measurement that is not to be used: the acceleration by differences comes a second late.
_USELESS = 1e3
_UNKNOWN = 10.0  # of a first estimate that is such a measurement


class Filter(NamedTuple):
    """A filter of one axis with `n` states and `k` measurements, the first of the states."""

    F: Floats  # (n, n), a tick of the model
    G: Floats  # (n,), what a unit of the input, held for a tick, adds
    K: Floats  # (T, n, k), the gains of the first ticks; the last is the steady one
    P: Floats  # (n, n), covariance of an estimate in the end


def filter_of(F: Floats, G: Floats, W: Floats, noise: Floats, position: float) -> Filter:
    """The filter for process noise of covariance `W` `(n, n)` and measurement noise `(k,)`.

    Its first estimate is a measurement; if `position` (m) is above 0 it is one that has been filtered for
    long but for its position, whose standard deviation that is.
    """
    from scipy.linalg import solve_discrete_are  # slow to import

    H, V = np.eye(len(noise), len(F)), np.diag(np.maximum(noise, _FINEST) ** 2)
    W = W + _ROUGHEST**2 * np.eye(len(F))

    def corrected(S: Floats) -> tuple[Floats, Floats]:
        K: Floats = np.asarray(np.linalg.solve(H @ S @ H.T + V, H @ S).T, dtype=np.float64)
        return K, S - K @ H @ S

    steady, final = corrected(solve_discrete_are(F.T, H.T, W, V))
    P, gains = np.diag(np.minimum(noise, _UNKNOWN) ** 2), list[Floats]()
    if position > 0.0:
        P = final.copy()
        P[0], P[:, 0] = 0.0, 0.0
        P[0, 0] = position**2
    while len(gains) < _LONGEST and (
        not gains or np.abs(gains[-1] - steady).max() > 1e-3 * np.abs(steady).max()
    ):
        K, P = corrected(F @ P @ F.T + W)
        gains.append(K)
    return Filter(F, G, np.stack((*gains, steady)), final)


def measurement_noise(config: FormationConfig) -> Floats:
    """Standard deviations of measured position, velocity and acceleration (m, m/s, m/s^2), `(3,)`.

    Where velocities are differences of positions: that of the difference of two.
    """
    noise = config.noise
    if config.estimator == "direct":
        return np.array((noise.position, noise.velocity, noise.acceleration))
    clock = config.world.clock
    sample = clock.sample_every * clock.period / clock.substeps
    return np.array((noise.position, sqrt(2.0) * noise.position / sample, _USELESS))


def filters(config: FormationConfig) -> tuple[Filter, Filter]:
    """The filter of a follower and that of its leader."""
    h, noise = config.control_period, measurement_noise(config)
    F = np.array(((1.0, h, h * h / 2.0), (0.0, 1.0, h), (0.0, 0.0, 1.0)))
    push = np.array((h * h / 2.0, h, 0.0))
    jerk = np.array((h**3 / 6.0, h * h / 2.0, h))
    own = (PUSH**2 + config.gust**2) * np.outer(push, push)
    lead = own + JERK**2 * np.outer(jerk, jerk)
    # Where the leader is when the trigger fires is known by the trigger alone, a ball.
    position = config.trigger / sqrt(5.0) if config.start == "ground" else 0.0
    return (
        filter_of(F[:2, :2], push[:2], own[:2, :2], noise[:2], 0.0),
        filter_of(F, jerk, lead, noise, position),
    )


def _linear(M: Floats, x: Floats) -> Floats:
    """`M x` for matrices `(..., n, k)` and states `(worlds, followers, k, 3)`, element by element."""
    n, k = M.shape[-2:]
    rows = []
    for i in range(n):
        row = each(M[..., i, 0]) * x[..., 0, :]
        for j in range(1, k):
            row = row + each(M[..., i, j]) * x[..., j, :]
        rows.append(row)
    return np.stack(rows, axis=-2)


@final
class Kalman(Estimator):
    """The estimator of `ff-filter`: the follower's position and velocity, its leader's with acceleration.

    An episode begins with what is measured. Until the trigger (40) the leader's position is given as the
    point where it is awaited, and is taken as that; of its filter that is the first estimate. At action level
    `reference` a follower's own motion is not filtered: the environment's tracker flies it.
    """

    def __init__(self, config: FormationConfig) -> None:
        super().__init__(config)
        self.own, self.lead = filters(config)
        self._own = np.zeros((0, config.followers, 2, 3))
        self._lead = np.zeros((0, config.followers, 3, 3))
        self._ticks = np.zeros(
            (2, 0, config.followers), dtype=np.intp
        )  # of own and lead, corrected

    def begin(self, worlds: int) -> None:
        n = self.config.followers
        self._own, self._lead = (
            np.full((worlds, n, 2, 3), np.nan),
            np.full((worlds, n, 3, 3), np.nan),
        )
        self._ticks = np.zeros((2, worlds, n), dtype=np.intp)

    def begin_again(self, mask: NDArray[np.bool_]) -> None:
        self._own[mask] = self._lead[mask] = np.nan
        self._ticks[:, mask] = 0

    def estimate(self, m: Measured) -> Measured:
        motion, leader, f, g = m.motion, m.leader, self.own, self.lead
        waits = ~m.started & (self.config.start == "ground")
        seen = np.stack((leader.p, leader.v, leader.a), axis=-2)
        x = self._corrected(g, _linear(g.F, self._lead), seen, self._ticks[1], waits)
        x[..., 0, :] = np.where(each(m.started), x[..., 0, :], leader.p)
        self._lead = x
        leader = leader._replace(p=x[..., 0, :], v=x[..., 1, :], a=x[..., 2, :])
        if self.config.action != "reference":
            u = np.multiply.outer(f.G, self._acceleration(m))
            ahead = _linear(f.F, self._own) + np.moveaxis(u, 0, -2)
            seen = np.stack((motion.p, motion.v), axis=-2)
            y = self._corrected(f, ahead, seen, self._ticks[0], np.zeros_like(waits))
            self._own = y
            motion = motion._replace(p=y[..., 0, :], v=y[..., 1, :])
        return m._replace(motion=motion, leader=leader)

    def _corrected(
        self, f: Filter, ahead: Floats, seen: Floats, ticks: NDArray[np.intp], waits: Any
    ) -> Floats:
        """Predictions corrected by what is measured; at the start of an episode the measurements.

        Those that wait for the trigger are corrected with the steady gain, and their ticks do not count yet.
        """
        K = f.K[np.where(waits, len(f.K) - 1, ticks)]
        x = ahead + _linear(K, seen - ahead[..., : K.shape[-1], :])
        first = np.isnan(ahead[..., 0, 0])
        ticks[...] = np.minimum(ticks + (~waits & ~first), len(f.K) - 1)
        return np.where(first[..., None, None], seen, x)

    def _acceleration(self, m: Measured) -> Floats:
        """A follower's acceleration by the thrust that the last action asked for, m/s^2."""
        action: Any = tuple(np.moveaxis(m.entries["previous_action"], -1, 0))
        lift = each(plain(driven)(action, self.config.world).thrust / self.config.vehicle.mass)
        a: Floats = np.array((0.0, 0.0, GRAVITY)) - lift * m.motion.R[..., :, 2]
        return a
