"""Noticing that a new episode has begun, from observations alone.

After a reset every follower's `previous_action` is exactly zero. In flight it is so only where
nothing but zeros was commanded, and then one tick explains what has changed in between. So a world has
begun anew if all its previous actions are zero and

- its trigger (40) is no longer fired, which never happens in flight, or
- its heading turned by more than the zero dynamics (23) turn it at the leader's velocity, or
- a follower moved by more than its velocity and the strongest acceleration explain, noise included.

None of these can happen in flight. It counts as begun anew, too, if the actions before were not zero and
the trigger has not fired yet: should zeros have been commanded, a virtual follower that is placed
again stands where it stood. After the trigger that case is in doubt.
"""

from __future__ import annotations

from math import ceil, inf, sqrt
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from formation_env import FormationConfig
from formation_env._jit import device, kernel
from formation_env.laws.slots import out_of_frame
from formation_env.maths.so3 import Vector, sub
from formation_env.memory.records import at, line_loader, size
from formation_env.physics.quadrotor import GRAVITY
from formation_env.task import ANYWHERE, RATE_BOUND, Observation

Rows = NDArray[np.float32]

NEW, DOUBTFUL = 1, 2  # bits of what `compare` returns

# Columns of an observation row, the same at every action level.
_PREVIOUS, _STARTED = at(Observation, "previous_action"), at(Observation, "started")
_NOTED = size(Observation)  # so many of a world's first follower are kept
_read = line_loader(Observation)

_DEVIATIONS = 6.8  # of noise: `rng.normals` never gives more
_ROUNDING = 1e-6  # of float32, relative
_GUST_DEVIATIONS = 12.0  # of a sum of many draws


class Motion(NamedTuple):
    """What one tick can do."""

    shortest: float  # s, between the measurements behind two observations
    longest: float  # s
    slack: float  # m, by acceleration and noise
    period: float  # s


def motion(config: FormationConfig) -> Motion:
    """What one tick can do in a configuration."""
    clock, noise = config.world.clock, config.noise
    sample = clock.sample_every * clock.period / clock.substeps
    at_once = clock.sample_every == clock.substeps
    longest = clock.period if at_once else clock.period + sample
    tracked = GRAVITY + sqrt(3.0) * (
        max(config.reference_max) + max(config.tracker.sigma_max, config.rates_tracker.sigma_max)
    )
    thrust = max(config.vehicle.full_thrust / config.vehicle.mass, tracked)
    acceleration = thrust + GRAVITY + _GUST_DEVIATIONS * config.gust
    jitter = 2.0 * noise.position + longest * noise.velocity
    if clock.window > 0:  # velocities are differences of positions
        jitter += 2.0 * ceil(longest / sample) * noise.position
    slack = acceleration * longest * longest + _DEVIATIONS * jitter
    delayed = not at_once or clock.delay > 0
    return Motion(0.0 if delayed else clock.period, longest, slack, clock.period)


@device
def _heading(o: Observation) -> complex:
    return complex(o.heading[0], o.heading[1])


@device
def _saturates(a: Vector) -> bool:
    """Whether a component of an observed velocity is clipped."""
    return max(abs(a[0]), abs(a[1]), abs(a[2])) >= RATE_BOUND


@device
def _velocity(o: Observation) -> Vector:
    """A follower's own velocity, m/s, inertial; infinite where the observation saturates."""
    if _saturates(o.relative_velocity) or _saturates(o.leader_velocity):
        return (inf, inf, inf)
    return out_of_frame(_heading(o), sub(o.leader_velocity, o.relative_velocity))


@device
def _fastest(o: Observation) -> float:
    """The larger component of the leader's velocity in the plane, m/s."""
    return max(abs(o.leader_velocity[0]), abs(o.leader_velocity[1]))


@device
def _at_rest(o: Observation) -> bool:
    """Whether a follower's previous action is exactly zero."""
    a, b, c, d = o.previous_action
    return a == 0.0 and b == 0.0 and c == 0.0 and d == 0.0


@device
def _all_at_rest(rows: Any) -> bool:
    """The same of all followers of a world."""
    resting = True
    for row in rows:
        resting = resting and _at_rest(_read(row))
    return resting


@device
def _turned(before: Observation, now: Observation, m: Motion) -> bool:
    """Whether the heading turned by more than the zero dynamics (23) can, `h |v_L| / d_x`."""
    fastest, d_x = max(_fastest(before), _fastest(now)), now.offset[0]
    if fastest >= RATE_BOUND or not d_x > 0.0:
        return False
    most = sqrt(2.0) * m.period * fastest / d_x
    # A chord is shorter than its arc.
    return bool(abs(_heading(before) - _heading(now)) > 1.01 * most + 10.0 * _ROUNDING)


@device
def _jumped(before: Observation, now: Observation, m: Motion) -> bool:
    """Whether a vehicle is where neither its velocity before nor the one after can have taken it."""
    p0, v0, p1, v1 = before.position, _velocity(before), now.position, _velocity(now)
    for k in range(3):
        if abs(p1[k]) >= ANYWHERE or not abs(v0[k]) + abs(v1[k]) < inf:
            return False
        low, high = min(v0[k], v1[k]), max(v0[k], v1[k])
        low = min(m.shortest * low, m.longest * low)
        high = max(m.shortest * high, m.longest * high)
        moved = p1[k] - p0[k]
        slack = m.slack + 4.0 * _ROUNDING * (abs(p1[k]) + m.longest * RATE_BOUND)
        if moved < low - slack or moved > high + slack:
            return True
    return False


@device
def _began(before: Observation, now: Observation, m: Motion) -> bool:
    """Whether a first follower cannot have flown from where `before` was observed to where `now` was."""
    unfired = before.started > 0.5 and now.started <= 0.5
    return unfired or _turned(before, now, m) or _jumped(before, now, m)


@kernel
def compare(rows: Rows, notes: Rows, m: Motion, began: NDArray[np.bool_]) -> int:
    """Mark the worlds that began anew, and note the observations of their first followers.

    `rows` `(worlds, followers, entries)`; `notes` `(worlds, _NOTED)` are the first followers' observations
    before, without neighbours, with NaN for the trigger where there are none. Returns the bits `NEW` and
    `DOUBTFUL` of all worlds together.
    """
    found = 0
    for w in range(len(rows)):
        began[w] = False
        # Most worlds are in flight, which one number tells: views on a world cost more than all the rest.
        flies = rows[w, 0, _PREVIOUS] != 0.0 or notes[w, _STARTED] != notes[w, _STARTED]
        if not flies and _all_at_rest(rows[w]):
            before, now = _read(notes[w]), _read(rows[w, 0])
            # A world whose trigger fires just now has flown: an episode begins before it.
            acted, waits = not _at_rest(before), now.started <= 0.5
            began[w] = _began(before, now, m) or (acted and waits)
            if began[w]:
                found |= NEW
            elif acted:
                found |= DOUBTFUL
        for k in range(_NOTED):
            notes[w, k] = rows[w, 0, k]
    return found


@final
class Watch:
    """Looks for worlds that began anew, observation by observation."""

    def __init__(self, config: FormationConfig, worlds: int) -> None:
        self._motion = motion(config)
        self._notes = np.full((worlds, _NOTED), np.nan, dtype=np.float32)
        self.began = np.zeros(worlds, dtype=np.bool_)  # in the last observation

    def look(self, rows: Rows) -> int:
        """Compare observations with those before; `began` says in which worlds an episode began."""
        return int(compare(rows, self._notes, self._motion, self.began))

    def forget(self, mask: NDArray[np.bool_]) -> None:
        """The next observations of the worlds of `mask` are the first, whatever they are."""
        self._notes[mask, _STARTED] = np.nan
