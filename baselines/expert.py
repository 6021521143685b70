"""The paper's system as a policy: planner and tracker composed, from the observation alone.

    observation --> planner (21), (33) --> virtual follower (35) --> tracker (54), (67) --> action

Each follower carries a virtual unicycle. It starts with null errors (II-E), waits for the trigger
(40), and then follows the leader as measured; the tracker flies the vehicle along it. At action level
`rates` the tracker is the variant that makes `e4 = 0`, at level `reference` the environment's own
tracker flies and the expert only says how the virtual follower accelerates.
"""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from baselines.policy import Policy, Rows
from formation_env import FormationConfig
from formation_env._jit import device, kernel
from formation_env.feedforward import full_reference
from formation_env.memory import Settings, flatten, unpack
from formation_env.planner import (
    Leader,
    PlannerLaw,
    Virtual,
    advance,
    errors,
    place,
    plane,
    reference,
)
from formation_env.quadrotor import MOMENT
from formation_env.slots import in_frame, out_of_frame
from formation_env.so3 import Vector, add, cross, scale, sub
from formation_env.task import CORE
from formation_env.tracker import Motion
from formation_env.tracker import errors as tracker_errors
from formation_env.trajectories import Reference
from formation_env.world import REFERENCE, Reach, World, track

Floats = NDArray[np.float64]

# Columns of a follower's memory: its virtual follower, and whether it has one yet.
_MEMORY = 10
_PLACED = 9

# Columns of the record of one decision, for plots.
RECORD = {
    "virtual_p": slice(0, 3),  # m, inertial
    "virtual_v": slice(3, 6),  # m/s
    "planner_e1": slice(6, 8),  # m, {F} of the virtual follower (7)
    "planner_e2": slice(8, 10),  # m (11)
    "planner_ez": slice(10, 11),  # m (32)
    "tracker_e1": slice(11, 14),  # m (48)
    "tracker_e2": slice(14, 17),  # m/s (49)
    "tracker_e3": slice(17, 20),  # (62)
    "tracker_e4": slice(20, 23),  # rad/s (65)
    "heading": slice(23, 24),  # rad
    "speed": slice(24, 25),  # m/s
    "turn_rate": slice(25, 26),  # rad/s
}
_RECORD = 26


class _Seen(NamedTuple):
    """What an observation row says, back in the inertial frame."""

    motion: Motion  # of the vehicle itself
    leader: Leader
    heading: complex  # the estimated one
    offset: Vector
    started: bool
    guide_p: Vector  # inertial, of the `reference` level's virtual follower
    guide_v: Vector


@device
def _vector(row: Any, i: int) -> Vector:
    return (np.float64(row[i]), np.float64(row[i + 1]), np.float64(row[i + 2]))


@device
def _read(row: Any, level: int) -> _Seen:
    """The measurements behind a row: the observation is a change of frame, undone here."""
    R = complex(np.float64(row[21]), np.float64(row[22]))
    d = _vector(row, 23)
    p = _vector(row, 31)
    v_L = out_of_frame(R, _vector(row, 6))
    v = sub(v_L, out_of_frame(R, _vector(row, 3)))
    p_L = add(p, out_of_frame(R, add(_vector(row, 0), d)))
    r1, r3 = out_of_frame(R, _vector(row, 12)), out_of_frame(R, _vector(row, 15))
    o = (0.0, 0.0, 0.0)
    leader = Leader(p_L, v_L, out_of_frame(R, _vector(row, 9)), o, o)
    motion = Motion(p, v, (r1, cross(r3, r1), r3), _vector(row, 18))
    guide_p, guide_v = o, o
    if level == REFERENCE:
        guide_p = add(p, out_of_frame(R, _vector(row, CORE)))
        guide_v = add(v, out_of_frame(R, _vector(row, CORE + 3)))
    return _Seen(motion, leader, R, d, row[30] > 0.5, guide_p, guide_v)


@device
def _recall(m: Any) -> Virtual:
    return Virtual(complex(m[0], m[1]), m[2], m[3], m[4], complex(m[5], m[6]), m[7], m[8])


@device
def _remember(m: Any, f: Virtual) -> None:
    m[0], m[1], m[2], m[3], m[4] = f.p.real, f.p.imag, f.theta, f.u, f.omega
    m[5], m[6], m[7], m[8] = f.xi.real, f.xi.imag, f.z, f.w


@device
def _plan(f: Virtual, seen: _Seen, law: PlannerLaw, derived: bool) -> Reference:
    """The trajectory of the virtual follower now: at rest before the trigger, then (35)."""
    o = (0.0, 0.0, 0.0)
    if not seen.started:
        return Reference((f.p.real, f.p.imag, f.z), o, o, o, o)
    if derived:
        return full_reference(f, seen.leader, seen.offset, law)
    return reference(f, seen.leader, seen.offset, law)


@device
def _guide_action(f: Virtual, after: Virtual, seen: _Seen, h: float, reach: Reach) -> Vector:
    """The constant acceleration that takes the environment's virtual follower along with ours.

    It matches our velocity at the end of the tick, and removes what is left of a difference in
    position (after a saturated action) with a time constant of half a second.
    """
    v = after.u * np.exp(1j * after.theta)
    p = (f.p.real, f.p.imag, f.z)
    wanted = sub((v.real, v.imag, after.w), seen.guide_v)
    a = add(scale(1.0 / h, wanted), scale(2.0, sub(p, seen.guide_p)))
    b = in_frame(seen.heading, a)
    return (
        b[0] / reach.acceleration[0],
        b[1] / reach.acceleration[1],
        b[2] / reach.acceleration[2],
    )


@device
def _act(seen: _Seen, ref: Reference, world: World) -> tuple[float, float, float, float]:
    """The tracker's command in units of the action."""
    reach = world.reach
    w = track(seen.motion, ref, world.follower_actuation, world)
    return (
        2.0 * w.thrust / reach.thrust - 1.0,
        w.turn[0] / reach.turn[0],
        w.turn[1] / reach.turn[1],
        w.turn[2] / reach.turn[2],
    )


@device
def _note(out: Any, f: Virtual, seen: _Seen, ref: Reference, s: Settings, law: PlannerLaw) -> None:
    """Fill a row of the record."""
    p = errors(f, plane(seen.leader.p), plane(seen.leader.v), plane(seen.offset), law)
    moment = s.world.follower_actuation == MOMENT
    gains = s.world.tracker if moment else s.world.rates_tracker
    t = tracker_errors(seen.motion, ref, gains)
    for k in range(3):
        out[k], out[3 + k] = ref.p[k], ref.v[k]
        out[11 + k], out[14 + k], out[17 + k], out[20 + k] = t.e1[k], t.e2[k], t.e3[k], t.e4[k]
    out[6], out[7], out[8], out[9] = p.e1.real, p.e1.imag, p.e2.real, p.e2.imag
    out[10] = seen.leader.p[2] - f.z - seen.offset[2]
    out[23], out[24], out[25] = f.theta, f.u, f.omega


@kernel
def _decide(
    rows: Rows,
    memory: Floats,
    settings: Floats,
    gains: Floats,
    derived: bool,
    actions: Rows,
    record: Floats,
) -> None:
    """One decision for every row `(N, entries)`; `memory` is `(N, 10)`, `record` `(N or 0, 26)`."""
    s = unpack(settings)
    law = PlannerLaw(gains[0], gains[1], gains[2], gains[3], gains[4], gains[5], gains[6])
    h = s.world.clock.period
    for i in range(len(rows)):
        seen = _read(rows[i], s.world.level)
        m = memory[i]
        if m[_PLACED] == 0.0:
            f = place(seen.leader.p, seen.leader.v, seen.offset, seen.heading, seen.started)
            m[_PLACED] = 1.0
        else:
            f = _recall(m)
        ref = _plan(f, seen, law, derived)
        if len(record) > 0:
            _note(record[i], f, seen, ref, s, law)
        after = f
        if seen.started:
            after = advance(f, seen.leader, seen.offset, h, law)
        if s.world.level == REFERENCE:
            b = _guide_action(f, after, seen, h, s.world.reach)
            a = (b[0], b[1], b[2], 0.0)
        else:
            a = _act(seen, ref, s.world)
        for k in range(actions.shape[1]):
            actions[i, k] = min(max(a[k], -1.0), 1.0)
        _remember(m, after)


@final
class Expert(Policy):
    """Planner and tracker of the paper at the configuration's own gains and action level.

    `feedforward` says where the reference's third and fourth derivatives come from: `"zero"`, as in
    the paper's experiment, or `"derived"`, from the law itself with the leader's jerk and snap taken
    as zero because nobody measures them.
    """

    name = "expert"

    def __init__(
        self, config: FormationConfig, feedforward: str = "zero", keep_record: bool = False
    ) -> None:
        super().__init__(config)
        if feedforward not in ("zero", "derived"):
            raise ValueError(f"feedforward = {feedforward!r}: expected 'zero' or 'derived'")
        self._derived = feedforward == "derived"
        self._settings = np.array(flatten(Settings(config.world, config.reward, config.limits)))
        self._gains = np.array(config.planner.law())
        self._keep_record = keep_record
        self._memory = np.zeros((0, _MEMORY))
        self._record = np.zeros((0, _RECORD))

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        rows = len(seeds) * self.config.followers
        self._memory = np.zeros((rows, _MEMORY))
        self._record = np.zeros((rows if self._keep_record else 0, _RECORD))

    def decide(self, rows: Rows) -> Rows:
        worlds, n, size = rows.shape
        actions = np.empty((worlds * n, self.config.action_size), dtype=np.float32)
        _decide(
            rows.reshape(worlds * n, size),
            self._memory,
            self._settings,
            self._gains,
            self._derived,
            actions,
            self._record,
        )
        return actions.reshape(worlds, n, -1)

    @property
    def record(self) -> dict[str, Floats]:
        """Errors and virtual followers at the last decision, `(worlds, followers, ...)` each; needs
        `keep_record=True`. Frames and units as in `RECORD`."""
        rows = self._record.reshape(-1, self.config.followers, _RECORD)
        return {name: rows[..., where].copy() for name, where in RECORD.items()}
