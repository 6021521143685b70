"""Kalman filters, steady after their first seconds, of what a follower measures of itself and its leader.

Each axis of the inertial frame is filtered by itself and alike. With `h` the control period,

    follower:  p' = p + h v + h^2 u / 2,  v' = v + h u        u the acceleration that its thrust gives
    leader:    p' = p + h v + h^2 a / 2 + h^3 j / 6,  v' = v + h a + h^2 j / 2,  a' = a + h j

The process noise is a white push on `u` and `a`, and for the leader a white jerk `j`, each held for a tick
(`left_out` says how large); the measurement noise is `config.noise`. The gain is that of the filter after
long time,

    K = S H^T (H S H^T + V)^-1,    S = F S F^T - F S H^T (H S H^T + V)^-1 H S F^T + W

where `S` is the covariance of the prediction, found once (`scipy.linalg.solve_discrete_are`). Predictions are
far better than measurements, so `K` is small, and a first estimate, which is one measurement, would stay
for ten seconds. The gains of the first ticks are those of the same recursion from that estimate's covariance,
down to `K`. Without measurement noise all pass on what is measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import lru_cache
from math import exp, hypot, sqrt
from typing import Annotated, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.parts import Estimator, Measured
from baselines.policies.vectors import Floats, each, to_inertial
from formation_env import FormationConfig
from formation_env._jit import plain
from formation_env.configuration.parts import part
from formation_env.laws.levels import driven
from formation_env.physics.quadrotor import GRAVITY
from formation_env.trajectories import Trajectory
from formation_env.validation.checks import Within

# At least so much process and measurement noise, m, m/s and m/s^2, so that the gain exists: a measurement
# without noise counts as a thousand times finer than any prediction.
_ROUGHEST, _FINEST = 1e-6, 1e-9
_LONGEST = 2000  # ticks with gains of their own, at most
# Of a measurement that is not to be used: the acceleration by differences comes a second late.
_USELESS = 1e3
_UNKNOWN = 10.0  # of a first estimate that is such a measurement


_SAMPLES, _DRAWS = 1000, 8  # of a path
_FACTOR = Within(1e-3, 1e3)


class Factors(NamedTuple):
    """Factors on the process noise that follows from the configuration, `left_out`."""

    own_push: Annotated[float, _FACTOR] = 1.0
    lead_push: Annotated[float, _FACTOR] = 1.0
    jerk: Annotated[float, _FACTOR] = 1.0


class LeftOut(NamedTuple):
    """Process noise: what the models leave out, standard deviations."""

    own_push: float  # m/s^2, on a follower
    lead_push: float  # m/s^2, on its leader
    jerk: float  # m/s^3, of its leader


def left_out(config: FormationConfig) -> LeftOut:
    """The process noise of a configuration.

    A follower's thrust is known and its direction is measured, so that the error of `u` is, beside gusts,

        own^2  = (g sigma_attitude)^2 + gust^2 (1 + k) / (1 - k),   k = exp(-h / gust_time)

    Gusts are no white noise: `k` of one is left in the next tick. A white push of the variance given moves
    a vehicle as far in the end, since the covariances of a gust with all others add up to that.

    The leader's acceleration is measured, gusts included. It changes along the path, by the gusts' change
    from tick to tick, and since the leader corrects errors that it measures with noise. By its tracker (50)
    it then wants an acceleration of

        sigma_u = sigma_max / sqrt(c) sqrt((k1 sigma_position)^2 + (k2 sigma_velocity)^2)

    beside the path's, white, and turns its thrust there at the rate `k3` (65), so that

        jerk^2 = (k3 sigma_u)^2 + 2 (1 - k) gust^2 / h^2 + path_jerk^2

    The vertical part follows at once, without turning, and comes back as soon: it is left out. Where the
    acceleration steps, as with thrust and gusts, and is not the ramp that the model has, the model is off by
    half the step,

        lead   = h jerk / 2
    """
    noise, h = config.noise, config.control_period
    position, velocity, _ = measurement_noise(config)
    kept = exp(-h / config.gust_time)
    law = config.tracker if config.leader_actuation == "moment" else config.rates_tracker
    wanted = law.sigma_max / sqrt(law.c) * hypot(law.k1 * position, law.k2 * velocity)
    own = hypot(GRAVITY * noise.attitude, config.gust * sqrt((1.0 + kept) / (1.0 - kept)))
    gusts = config.gust * sqrt(2.0 * (1.0 - kept)) / h
    jerk = hypot(law.k3 * wanted, gusts, path_jerk(config.trajectory, config.span))
    return LeftOut(own, 0.5 * h * jerk, jerk)


@lru_cache(maxsize=64)
def path_jerk(path: Trajectory, span: float) -> float:
    """Root mean square jerk of the first `span` seconds of a path, m/s^3; of a random one, of some draws."""
    keys = range(1 if path.random is None else _DRAWS)
    times = np.linspace(0.0, span, _SAMPLES)
    jerks = np.stack([path.drawn(key)(times)[:, 3] for key in keys])
    return float(np.sqrt((jerks**2).sum(axis=-1).mean()))


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

    k, V = len(noise), np.diag(np.maximum(noise, _FINEST) ** 2)
    W = W + _ROUGHEST**2 * np.eye(len(F))

    def corrected(S: Floats) -> tuple[Floats, Floats]:
        HS = S[:k]  # H S, since the measurements are the first of the states
        K: Floats = np.asarray(np.linalg.solve(HS[:, :k] + V, HS).T, dtype=np.float64)
        return K, S - K @ HS

    steady, final = corrected(solve_discrete_are(F.T, np.eye(len(F), k), W, V))
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


class Filters(NamedTuple):
    """The filters of a configuration."""

    own: Filter  # of a follower
    lead: Filter  # of its leader
    waiting: (
        Floats  # (T, 3, 3), gains of the leader's before the trigger: none of or for its position
    )


def filters(config: FormationConfig, factors: Factors) -> Filters:
    """The filter of a follower and those of its leader."""
    own_push, lead_push, jerks = (x * f for x, f in zip(left_out(config), factors, strict=True))
    h, noise = config.control_period, measurement_noise(config)
    F = np.array(((1.0, h, h * h / 2.0), (0.0, 1.0, h), (0.0, 0.0, 1.0)))
    push = np.array((h * h / 2.0, h, 0.0))
    jerk = np.array((h**3 / 6.0, h * h / 2.0, h))
    own = own_push**2 * np.outer(push, push)
    lead = lead_push**2 * np.outer(push, push) + jerks**2 * np.outer(jerk, jerk)
    of_itself = filter_of(F[:2, :2], push[:2], own[:2, :2], noise[:2], 0.0)
    if config.start != "ground":
        return Filters(of_itself, filter_of(F, jerk, lead, noise, 0.0), np.zeros((1, 3, 3)))
    # Where the leader is when the trigger fires is known by the trigger alone, a ball.
    of_leader = filter_of(F, jerk, lead, noise, config.trigger / sqrt(5.0))
    waiting = filter_of(F[1:, 1:], jerk[1:], lead[1:, 1:], noise[1:], 0.0)
    return Filters(of_itself, of_leader, np.pad(waiting.K, ((0, 0), (1, 0), (1, 0))))


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


def _padded(gains: Sequence[Floats]) -> Floats:
    """Gains `(T, n, k)` of several filters as `(filters, most T, n, k)`, the last of each repeated."""
    most = max(map(len, gains))
    return np.stack([K[np.minimum(np.arange(most), len(K) - 1)] for K in gains])


def _corrected(K: Floats, ahead: Floats, seen: Floats) -> Floats:
    """Predictions corrected by what is measured; at the start of an episode the measurements."""
    x = ahead + _linear(K, seen - ahead[..., : K.shape[-1], :])
    return np.where(np.isnan(ahead[..., :1, :1]), seen, x)


@final
class Kalman(Estimator):
    """The estimator of `ff-filter`: the follower's position and velocity, its leader's with acceleration.

    An episode begins with what is measured. Until the trigger (40) the leader's position is given as the
    point where it is awaited, and is taken as that; its velocity and acceleration are filtered by themselves.
    Of the position's filter that point is the first estimate. At action level `reference` a follower's own
    motion is not filtered: the environment's tracker flies it.
    """

    def __init__(self, config: FormationConfig, factors: Factors | None = None) -> None:
        super().__init__(config)
        factors = part("factors", Factors() if factors is None else factors, Factors())
        self.own, self.lead, self.waiting = filters(config, factors)
        # By filter of `Filters`: (laws, ticks, n, k), see `stacked`.
        self._gains = [K[None] for K in (self.own.K, self.lead.K, self.waiting)]
        self._law: Any = 0  # that flies each world, (worlds, 1)
        self.begin(0)

    def stacked(self, others: Sequence[Kalman], worlds: int) -> Kalman:
        """An estimator for so many worlds in a row with the gains of each of `others`.

        A world's estimates are those of the other estimator, bit for bit.
        """
        one = copy(self)
        tables = zip(*(other._gains for other in others), strict=True)
        one._gains = [_padded([K[0] for K in table]) for table in tables]
        one._law = np.repeat(np.arange(len(others)), worlds)[:, None]
        return one

    def begin(self, worlds: int) -> None:
        shape = (worlds, self.config.followers)
        self._own, self._lead = np.full((*shape, 2, 3), np.nan), np.full((*shape, 3, 3), np.nan)
        self._ticks = np.zeros((len(self._gains), *shape), dtype=np.intp)  # that each has corrected

    def begin_again(self, mask: NDArray[np.bool_]) -> None:
        self._own[mask] = self._lead[mask] = np.nan
        self._ticks[:, mask] = 0

    def estimate(self, m: Measured) -> Measured:
        motion, leader = m.motion, m.leader
        waits = ~m.started & (self.config.start == "ground")
        seen = np.stack((leader.p, leader.v, leader.a), axis=-2)
        old = ~np.isnan(self._lead[..., 0, 0])  # where this is not an episode's first observation
        lead, waiting = self._next(1, ~waits & old), self._next(2, waits & old)
        K = np.where(waits[..., None, None], waiting, lead)
        x = _corrected(K, _linear(self.lead.F, self._lead), seen)
        x[..., 0, :] = np.where(each(m.started), x[..., 0, :], leader.p)
        self._lead = x
        leader = leader._replace(p=x[..., 0, :], v=x[..., 1, :], a=x[..., 2, :])
        if self.config.action != "reference":
            u = np.multiply.outer(self.own.G, self._acceleration(m))
            ahead = _linear(self.own.F, self._own) + np.moveaxis(u, 0, -2)
            seen = np.stack((motion.p, motion.v), axis=-2)
            y = _corrected(self._next(0, old), ahead, seen)
            self._own = y
            motion = motion._replace(p=y[..., 0, :], v=y[..., 1, :])
        return m._replace(motion=motion, leader=leader)

    def _next(self, which: int, corrects: NDArray[np.bool_]) -> Floats:
        """The gains `(worlds, followers, n, k)` of a filter for this tick, counted where it `corrects`."""
        gains, ticks = self._gains[which], self._ticks[which]
        K: Floats = gains[self._law, ticks]
        ticks[...] = np.minimum(ticks + corrects, gains.shape[1] - 1)
        return K

    def _acceleration(self, m: Measured) -> Floats:
        """A follower's acceleration by the thrust that the last action asked for, m/s^2.

        Along the vehicle's axis in the middle of the tick, `r3 - h/2 R S(omega) k`.
        """
        action: Any = tuple(np.moveaxis(m.entries["previous_action"], -1, 0))
        lift = each(plain(driven)(action, self.config.world).thrust / self.config.vehicle.mass)
        R, w = m.motion.R, m.motion.w
        turned = np.stack((w[..., 1], -w[..., 0], np.zeros_like(w[..., 0])), axis=-1)
        r3 = R[..., :, 2] - 0.5 * self.config.control_period * to_inertial(R, turned)
        a: Floats = np.array((0.0, 0.0, GRAVITY)) - lift * r3
        return a
