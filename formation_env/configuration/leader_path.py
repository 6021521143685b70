"""What the leader's path asks: of the bounds of an observation, and of the vehicle that flies it.

A quantity beyond its bound in the observation (`task`) would be clipped without a word, so it is
refused. A path that the actuators cannot fly is warned about: it is possible, and the leader leaves it.

On the path the thrust is `T/m = |b|` along `r3d = b / |b|` with `b = g k - p_ddot` (51)-(52), and with

    b_dot = -p_dddot,    n = |b|,    r3d_dot = (b_dot - n_dot r3d) / n

the vehicle turns at `A = r3d x r3d_dot` and `A_dot = r3d x r3d_ddot`: the tracker's own feedforward
(67). So a path is flown exactly while `|b| <= thrust_max / m`, `b_z > 0` (else the thrust, which pulls
along `-r3`, would have to point down), and `|A_dot|` is within `moment_max / J` or, for a vehicle driven
by rates, `|A + lag A_dot|` within `rate_max`. Measured: leaders within all three stayed within 5 cm of
their paths, and noise of 0.2 micrometres in a log at 100 Hz, which changes the thrust by a hundredth,
turned the leader over. The bound (53), `sigma_max < b_z`, is left out: it covers errors that a leader
on its path has not, and paths down to `b_z = 0.01 m/s^2` were flown.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import ceil, hypot, inf
from typing import NamedTuple

import numpy as np

from formation_env.maths.so3 import Vector
from formation_env.paths import tables
from formation_env.paths.random_paths import FASTEST
from formation_env.paths.references import FAMILIES, Floats, by_name
from formation_env.paths.trajectory import Trajectory
from formation_env.physics.quadrotor import GRAVITY, RATES
from formation_env.physics.vehicle import Vehicle
from formation_env.task import ANYWHERE, NEAR, RATE_BOUND
from formation_env.validation.checks import refuse, require, shortened, shown
from formation_env.validation.warning import warn_user

_DRAWS = 8  # paths of a random trajectory that are looked at
_ANGLE = 0.1  # rad of the fastest sine, between two samples
_MOST_SAMPLES = 20_000
_EACH_PIECE = 4  # samples of a piece of a spline

# What to do.
_MOVE = "shorten `duration`, or move the origin: subtract one of the path's points from all"
_EASE = "slow it down or widen its turns"


class FlightWarning(UserWarning):
    """The leader's path asks for more than its actuators can give: the leader will leave it."""


class Peak(NamedTuple):
    """The largest value of a quantity on a path, and when."""

    value: float
    time: float  # s; infinite for a bound that some episode comes near

    @property
    def when(self) -> str:
        """The time, for a message."""
        return "in some episode" if self.time == inf else f"at t = {self.time:.4g} s"


class Demands(NamedTuple):
    """What a path asks for at its worst moments."""

    position: Peak  # m, the largest coordinate
    velocity: Peak  # m/s, the larger of the planar and the vertical part
    acceleration: Peak  # m/s^2, norm
    thrust: Peak  # m/s^2, |g k - a|, per mass
    descent: Peak  # m/s^2, downward acceleration
    turning: Peak  # rad/s^2, of the thrust's direction
    command: Peak  # rad/s, turning rate plus lag times turning


class Reach(NamedTuple):
    """What the leader's actuators can give."""

    thrust: float  # m/s^2, per mass
    turning: float  # rad/s^2, about the stronger diagonal of the body's x and y
    command: float  # rad/s, likewise
    lag: float  # s


def reach_of(vehicle: Vehicle, actuation: int) -> Reach:
    """The limits of a vehicle driven by moments or by rates; infinite where it has none."""
    if not vehicle.limited:
        return Reach(inf, inf, inf, vehicle.rate_lag)
    thrust = vehicle.full_thrust / vehicle.mass
    if actuation == RATES:
        return Reach(thrust, inf, hypot(*vehicle.rate_max[:2]), vehicle.rate_lag)
    (x, y, _), (a, b, _) = vehicle.moment_max, vehicle.inertia
    return Reach(thrust, hypot(x / a, y / b), inf, vehicle.rate_lag)


def require_flyable(
    trajectory: Trajectory,
    duration: float,
    offsets: Sequence[Vector],
    neighbours: int,
    leader_start: Vector | None,
    follower_starts: Sequence[Vector] | None,
    vehicle: Vehicle,
    actuation: int,
) -> None:
    """Check the leader's path over `duration` seconds, the slots around it and the start points.

    Offsets and starts as the configuration has them (m, starts inertial); `actuation` is that of the
    leader, `neighbours` are those that a follower observes. Raises `ValueError` where an observation's
    bound is exceeded: coordinates of 10,000 m, a slot error at the start or a distance to an observed
    neighbour of 1,000 m, velocities of 100 m/s and, if the vehicle can reach it, an acceleration of
    100 m/s^2. Warns with `FlightWarning` where the actuators cannot give what the path asks for. A
    random trajectory is judged by its bounds and by a few of its draws, always the same.
    """
    reach = reach_of(vehicle, actuation)
    out = max(hypot(*d) for d in offsets)
    if not _plainly_flyable(trajectory, duration, out, reach):
        demands = _demands(trajectory, duration, reach.lag)
        _require_observable(trajectory, demands, out, reach)
        _warn_of(trajectory, demands, reach)
    starts = [] if leader_start is None else [("leader_start", leader_start)]
    starts += [(f"follower_starts[{i}]", p) for i, p in enumerate(follower_starts or ())]
    _require_starts_near(trajectory, starts)
    _require_neighbours_near(np.array(offsets), neighbours)


def _bounds(trajectory: Trajectory, duration: float) -> Floats:
    """Bounds of the norms of position to snap, which may be far above what the path has."""
    drawn = trajectory.random
    if drawn is None:
        return tables.reach(trajectory.kind, trajectory.table, duration)
    a = drawn.acceleration_max
    # Its sines swing by at most twice their amplitudes, each the share of a speed over a rate (`draw`).
    swing = 10.0 * drawn.variation / min(FASTEST, 2.0 * a / max(drawn.variation, 1e-9))
    far = min(drawn.speed_max * duration, drawn.speed * duration + swing)
    height = drawn.height + drawn.climb
    return np.array([max(far, height), drawn.speed_max, a, FASTEST * a, FASTEST * FASTEST * a])


def _plainly_flyable(trajectory: Trajectory, duration: float, out: float, reach: Reach) -> bool:
    """Whether bounds alone show that nothing is exceeded, as for most paths; costs microseconds."""
    p, v, a, j, s = _bounds(trajectory, duration)
    n = GRAVITY - a
    if not n > 0.0:
        return False
    rate = j / n
    turning = (s + 2.0 * j * rate) / n
    return bool(
        p + out <= ANYWHERE
        and max(v, a) <= RATE_BOUND
        and GRAVITY + a <= reach.thrust
        and turning <= reach.turning
        and rate + reach.lag * turning <= reach.command
    )


# -- looking at the path ------------------------------------------------------------------------------


def _times(curve: Trajectory, duration: float) -> Floats:
    """Times at which to look at a path: of a spline all pieces, of sines a long run and the end."""
    swings = FAMILIES[curve.kind].fastest
    if swings is None:
        breaks = curve.table[1 : int(curve.table[0]) + 2]
        between = np.arange(_EACH_PIECE) / _EACH_PIECE
        times = (breaks[:-1, None] + np.diff(breaks)[:, None] * between).ravel()
        times = np.concatenate([times, np.linspace(0.0, min(duration, breaks[-1]), 2001)])
        return np.unique(times[(times >= 0.0) & (times <= duration)])
    fastest = swings(curve.table)
    wanted = max(2.0, duration * fastest / _ANGLE)
    count = ceil(min(wanted, _MOST_SAMPLES))
    run = np.linspace(0.0, duration * min(1.0, count / wanted), count + 1)
    return np.unique(np.concatenate([run, duration - run]))


@lru_cache(maxsize=64)
def _demands(trajectory: Trajectory, duration: float, lag: float) -> Demands:
    """What the path asks for; of a random trajectory, the worst of some draws."""
    keys = range(_DRAWS if trajectory.random is not None else 1)
    each = [_demands_of(trajectory.drawn(key), duration, lag) for key in keys]
    demands = Demands(*(max(peaks) for peaks in zip(*each, strict=True)))
    if trajectory.random is None:
        return demands
    position, velocity, *_ = _bounds(trajectory, duration)
    return demands._replace(position=Peak(position, inf), velocity=Peak(velocity, inf))


def _demands_of(curve: Trajectory, duration: float, lag: float) -> Demands:
    times = _times(curve, duration)
    p, v, a, j, s = np.moveaxis(curve(times), 1, 0)
    b = np.array([0.0, 0.0, GRAVITY]) - a
    n = np.maximum(np.linalg.norm(b, axis=1), 1e-9)[:, None]
    r3d = b / n
    n_dot = -_dot(r3d, j)
    r3d_dot = (-j - n_dot * r3d) / n
    turning = np.cross(r3d, (-s - 2.0 * n_dot * r3d_dot) / n)
    command = np.cross(r3d, r3d_dot) + lag * turning

    def peak(values: Floats) -> Peak:
        # The first of those that are equal but for rounding, as along a circle.
        at = int(np.argmax(values >= values.max() * (1.0 - 1e-9)))
        return Peak(float(values[at]), float(times[at]))

    planar = np.hypot(v[:, 0], v[:, 1])
    return Demands(
        peak(np.abs(p).max(axis=1)),
        peak(np.maximum(planar, np.abs(v[:, 2]))),
        peak(np.linalg.norm(a, axis=1)),
        peak(n[:, 0]),
        peak(a[:, 2]),
        peak(np.linalg.norm(turning, axis=1)),
        peak(np.linalg.norm(command, axis=1)),
    )


def _dot(x: Floats, y: Floats) -> Floats:
    """Products of rows, as a column."""
    products: Floats = np.einsum("ij,ij->i", x, y)
    return products[:, None]


# -- verdicts -----------------------------------------------------------------------------------------


def _require_observable(trajectory: Trajectory, demands: Demands, out: float, reach: Reach) -> None:
    """Refuse what the observation would clip."""
    # A vehicle of little thrust cannot follow such accelerations, which `_warn_of` tells.
    reached = reach.thrust + GRAVITY > RATE_BOUND
    for peak, more, bound, what, unit, remedy in (
        (demands.position, out, ANYWHERE, "a position, slots included,", "m", _MOVE),
        (demands.velocity, 0.0, RATE_BOUND, "a velocity", "m/s", "slow it down"),
        (
            demands.acceleration,
            0.0,
            RATE_BOUND if reached else inf,
            "an acceleration",
            "m/s^2",
            _EASE,
        ),
    ):
        if peak.value + more > bound:
            found = f"trajectory = {shown(trajectory.name)} with {what} of {peak.value + more:g}"
            expected = f"at most {bound:g} {unit}, the bound of an observation: {remedy}"
            raise ValueError(shortened(f"{found} {unit} {peak.when}: expected {expected}"))


def _warn_of(trajectory: Trajectory, demands: Demands, reach: Reach) -> None:
    """Warn where the actuators cannot give what the path asks for."""
    reasons = []
    if demands.thrust.value > reach.thrust:
        found = f"a thrust per mass |g k - a| of {demands.thrust.value:.3g} m/s^2"
        allowed = f"vehicle.thrust_max / mass is {reach.thrust:.3g}"
        reasons.append(f"{found} {demands.thrust.when} where {allowed}")
    if demands.descent.value >= GRAVITY and reach.thrust < inf:
        found = f"a fall at {demands.descent.value:.3g} m/s^2, faster than gravity's,"
        reasons.append(f"{found} {demands.descent.when}")
    for peak, most, unit, limit in (
        (demands.turning, reach.turning, "rad/s^2", "vehicle.moment_max / inertia allows"),
        (demands.command, reach.command, "rad/s", "vehicle.rate_max allows"),
    ):
        if peak.value > most:
            found = f"turning the vehicle at {peak.value:.3g} {unit} {peak.when}"
            reasons.append(f"{found} where {limit} {most:.3g}")
    if reasons:
        peak = demands.acceleration
        drawn = " (one of its draws)" if trajectory.random is not None else ""
        message = (
            f"the leader cannot fly trajectory {shown(trajectory.name)}{drawn}, which accelerates at "
            f"up to {peak.value:.3g} m/s^2 {peak.when}: it needs {'; '.join(reasons)}. "
            f"{_EASE.capitalize()}; smooth a measured log or give fewer rows"
        )
        warn_user(shortened(message), FlightWarning)


def _require_starts_near(trajectory: Trajectory, starts: Sequence[tuple[str, Vector]]) -> None:
    """Refuse starts beyond a position's bound, or too far from the path for the slot error's."""
    for name, point in starts:
        within = max(map(abs, point)) <= ANYWHERE
        expected = f"coordinates within {ANYWHERE:g} m, the bound of an observed position"
        require(within, name, point, f"{expected}: move the origin to the path")
    if starts and trajectory.random is None:
        first = by_name(trajectory(0.0))["p"]
        for name, point in starts:
            apart = float(np.linalg.norm(first - point))
            if apart > NEAR:
                near = (
                    f"within {NEAR:g} m, the bound of an observed slot error, of the path's start"
                )
                refuse(name, point, f"a point {near}: it is {apart:g} m away")


def _require_neighbours_near(offsets: Floats, neighbours: int) -> None:
    """Refuse formations in which an observed neighbour's slot lies beyond the bound of its position."""
    observed = min(neighbours, len(offsets) - 1)
    if observed == 0 or np.linalg.norm(np.ptp(offsets, axis=0)) <= NEAR:
        return
    from scipy.spatial import cKDTree

    apart = cKDTree(offsets).query(offsets, k=observed + 1)[0][:, -1]
    worst = int(np.argmax(apart))
    expected = (
        f"an offset within {NEAR:g} m, the bound of an observed neighbour's position, of its "
        f"{observed} nearest: one is {apart[worst]:.4g} m away; or fewer `neighbours`"
    )
    require(bool(apart[worst] <= NEAR), f"offsets[{worst}]", offsets[worst].tolist(), expected)
