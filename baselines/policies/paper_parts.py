"""The paper's planner (section II) and tracker (section III-B) as parts, to be put together with others.

    Composed(config, PaperPlanner(config), PaperTracker(config))

is the expert. `baselines.policies.expert` does the same in one pass of vector code, and is what flies under
that name.
"""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.expert_lanes import VIRTUAL, in_reach, planner_law, point_of, read_world
from baselines.policies.parts import Measured, Motion, Planner, Points, Tracker
from baselines.policies.vectors import Floats
from formation_env import FormationConfig
from formation_env._jit import kernel
from formation_env.laws import tracker
from formation_env.laws.planner import Virtual, advance, place, scaled
from formation_env.laws.world import track
from formation_env.maths.elementary import phase
from formation_env.maths.so3 import ZERO, Vector
from formation_env.memory.records import at, flatten, line_loader, line_storer, size, slices
from formation_env.paths.references import TrajectoryPoint
from formation_env.physics.quadrotor import Wrench
from formation_env.validation.checks import choice


class Followed(NamedTuple):
    """What a virtual follower is moved by, of one follower's measurements."""

    p: Vector  # leader's position, m, inertial
    v: Vector  # m/s
    a: Vector  # m/s^2
    heading: complex  # exp(j theta) of the estimated theta
    offset: Vector  # d, m, {F}
    started: bool  # whether the trigger (40) has fired


_WAITS = at(Virtual, "p")  # NaN there: a virtual follower that waits for its start
_read_followed, _read_virtual = line_loader(Followed), line_loader(Virtual)
_read_motion, _read_point = line_loader(tracker.Motion), line_loader(TrajectoryPoint)
_store_virtual, _store_point = line_storer(Virtual), line_storer(TrajectoryPoint)
_store_vector, _store_wrench = line_storer(Vector), line_storer(Wrench)


@kernel
def _plan(
    given: Floats,
    memory: Floats,
    period: float,
    gains: Floats,
    derived: bool,
    points: Floats,
    after: Floats,
) -> None:
    """Points of the virtual followers in `memory` `(N, VIRTUAL)`, which then go on; velocities after that."""
    law = planner_law(gains)
    for i in range(len(given)):
        m = _read_followed(given[i])
        leader = TrajectoryPoint(m.p, m.v, m.a, ZERO, ZERO)
        if memory[i, _WAITS] != memory[i, _WAITS]:
            _store_virtual(memory[i], place(m.p, m.v, m.offset, m.heading, m.started))
        f = _read_virtual(memory[i])
        _store_point(points[i], point_of(f, leader, m.offset, m.started, law, derived))
        if m.started:
            f = advance(f, leader, m.offset, period, law)
        v = scaled(f.u, phase(f.theta))
        _store_vector(after[i], (v.real, v.imag, f.w))
        _store_virtual(memory[i], f)
        if not in_reach(f):
            memory[i, _WAITS] = np.nan


@kernel
def _track(motions: Floats, points: Floats, settings: Floats, wrenches: Floats) -> None:
    """The tracker's commands, `(N, 4)`."""
    world = read_world(settings)
    for i in range(len(motions)):
        m, ref = _read_motion(motions[i]), _read_point(points[i])
        _store_wrench(wrenches[i], track(m, ref, world.follower_actuation, world))


def _lines(*parts: Any) -> Floats:
    """Arrays `(worlds, followers, ...)` side by side, a line of numbers for each follower."""
    n = parts[0].shape[0] * parts[0].shape[1]
    return np.concatenate([np.asarray(part, dtype=np.float64).reshape(n, -1) for part in parts], 1)


@final
class PaperPlanner(Planner):
    """A virtual unicycle for each follower (21), (33), (35), that starts with null errors (II-E).

    `feedforward` is as in `Expert`; gains are the configuration's. A virtual follower that the observations
    drive further than can be computed begins again, and one that has no finite point waits where its vehicle
    is. Raises `ValueError` naming the argument.
    """

    def __init__(self, config: FormationConfig, feedforward: str = "zero") -> None:
        super().__init__(config)
        self._derived = choice("feedforward", feedforward, ("zero", "derived")) == "derived"
        self._gains = np.array(config.planner.law())
        self._memory = np.zeros((0, VIRTUAL))
        self._after = np.zeros((0, 3))

    def begin(self, worlds: int) -> None:
        self._memory = np.full((worlds * self.config.followers, VIRTUAL), np.nan)

    def begin_again(self, mask: NDArray[np.bool_]) -> None:
        self._memory[np.repeat(mask, self.config.followers)] = np.nan

    def plan(self, m: Measured) -> Points:
        shape, leader = m.motion.p.shape, m.leader
        heading = (m.heading.real, m.heading.imag)
        given = _lines(leader.p, leader.v, leader.a, *heading, m.offset, m.started)
        points, self._after = (
            np.empty((len(given), size(TrajectoryPoint))),
            np.empty((len(given), 3)),
        )
        laws = (self.config.control_period, self._gains, self._derived)
        _plan(given, self._memory, *laws, points, self._after)
        lost = ~np.isfinite(points).all(axis=1) | ~np.isfinite(self._after).all(axis=1)
        if lost.any():
            points[lost], self._after[lost] = 0.0, 0.0
            points[lost, :3] = _lines(m.motion.p)[lost]
        named = (points[:, where].reshape(shape) for where in slices(TrajectoryPoint).values())
        return Points(*named)

    def velocity_after(self, point: Points) -> Floats:
        return self._after.reshape(point.v.shape)


@final
class PaperTracker(Tracker):
    """The backstepping law: thrust (54) and moment (67) with (46).

    At `rates` it is the variant that makes `e4 = 0` through the lag of the rate loop, which is not the
    paper's (`tracker.rate_command_through_lag`); at `reference` the environment's own flies. A
    command that is no finite number is no turn and the thrust of action 0.
    """

    def __init__(self, config: FormationConfig) -> None:
        super().__init__(config)
        self._settings = np.array(flatten(config.world))

    def command(self, motion: Motion, point: Points) -> Wrench:
        shape = motion.p.shape
        R = np.swapaxes(motion.R, -1, -2)  # column by column
        motions, points = _lines(motion.p, motion.v, R, motion.w), _lines(*point)
        wrenches = np.empty((len(motions), size(Wrench)))
        _track(motions, points, self._settings, wrenches)
        lost = ~np.isfinite(wrenches).all(axis=1)
        if lost.any():
            wrenches[lost] = (0.5 * self.config.world.reach.thrust, 0.0, 0.0, 0.0)
        thrust: Any = wrenches[:, 0].reshape(shape[:2])
        turn: Any = wrenches[:, 1:].reshape(shape)
        return Wrench(thrust, turn)
