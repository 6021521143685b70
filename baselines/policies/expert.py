"""The paper's system as a policy: planner and tracker composed, from the observation alone.

    observation --> planner (21), (33) --> virtual follower (35) --> tracker (54), (67) --> action

Each follower carries a virtual unicycle. It starts with null errors (II-E), waits for the trigger
(40), and then follows the leader as measured; the tracker flies the vehicle along it. At action level
`rates` the tracker is the variant that makes `e4 = 0`, at level `reference` the environment's own
tracker flies and the expert only says how the virtual follower accelerates.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.base import Policy, Rows
from baselines.policies.expert_lanes import (
    ROOM,
    VIRTUAL,
    decide,
    open_room,
    plan_tile,
    planner_law,
    recall,
    seen,
    start,
    take,
    waiting,
)
from formation_env import FormationConfig
from formation_env._jit import device, kernel
from formation_env.blocks import LANES, carve
from formation_env.checks import boolean, choice, refuse
from formation_env.lanes import load_reference
from formation_env.memory import Settings, flatten, tiles, unpack
from formation_env.planner import PlannerLaw, Virtual, errors, plane
from formation_env.quadrotor import MOMENT
from formation_env.task import CORE
from formation_env.tracker import errors as tracker_errors

Floats = NDArray[np.float64]

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


@device
def _note_plan(out: Any, f: Virtual, rows: Any, lane: Any, law: PlannerLaw) -> None:
    """Fill in what concerns the virtual follower."""
    s = seen(rows, lane)
    p = errors(f, plane(s.leader.p), plane(s.leader.v), plane(s.offset), law)
    out[6], out[7], out[8], out[9] = p.e1.real, p.e1.imag, p.e2.real, p.e2.imag
    out[10] = s.leader.p[2] - f.z - s.offset[2]
    out[23], out[24], out[25] = f.theta, f.u, f.omega


@device
def _note_flight(out: Any, rows: Any, refs: Any, lane: Any, s: Settings) -> None:
    """Fill in what concerns the vehicle and the trajectory that it follows."""
    ref = load_reference(refs, lane)
    moment = s.world.follower_actuation == MOMENT
    gains = s.world.tracker if moment else s.world.rates_tracker
    t = tracker_errors(seen(rows, lane).motion, ref, gains)
    for k in range(3):
        out[k], out[3 + k] = ref.p[k], ref.v[k]
        out[11 + k], out[14 + k], out[17 + k], out[20 + k] = t.e1[k], t.e2[k], t.e3[k], t.e4[k]


@kernel
def _note(
    rows: Rows,
    memory: Floats,
    settings: Floats,
    gains: Floats,
    derived: bool,
    fresh: bool,
    space: Floats,
    record: Floats,
) -> None:
    """What `decide` is about to see and to follow, `(N, 26)`; its other arguments, `memory` a copy."""
    s, room = unpack(settings), open_room(space)
    law = planner_law(gains)
    for t in range(len(memory)):
        x = carve(memory, t * VIRTUAL * LANES, (VIRTUAL * LANES,))
        take(rows, t, CORE, room)
        if fresh and waiting(x):
            start(room.rows, x)
        own = record[t * LANES : (t + 1) * LANES]
        for lane in range(len(own)):
            _note_plan(own[lane], recall(x, np.uint64(lane)), room.rows, np.uint64(lane), law)
        plan_tile(room, x, s.world.clock.period, law, derived)
        for lane in range(len(own)):
            _note_flight(own[lane], room.rows, room.refs, np.uint64(lane), s)


@final
class Expert(Policy):
    """Planner and tracker of the paper at the configuration's own gains and action level.

    `feedforward` says where the reference's third and fourth derivatives come from: `"zero"`, as in
    the paper's experiment, or `"derived"`, from the law itself with the leader's jerk and snap taken
    as zero because nobody measures them.

    Whatever finite numbers it observes, its actions are finite. A virtual follower that they drive further
    than can be computed (a leader at 90 m/s does within half a second) begins again with null errors, and
    an action that cannot be computed, as with `d_x = 0`, is zero. Raises `ValueError` naming the argument.
    """

    name = "expert"

    def __init__(
        self, config: FormationConfig, feedforward: str = "zero", keep_record: bool = False
    ) -> None:
        super().__init__(config)
        self._derived = choice("feedforward", feedforward, ("zero", "derived")) == "derived"
        self._settings = np.array(flatten(Settings(config.world, config.reward, config.limits)))
        self._gains = np.array(config.planner.law())
        self._keep_record = boolean("keep_record", keep_record)
        self._memory = np.zeros((0, VIRTUAL * LANES))
        self._room = np.zeros(ROOM)
        self._record = np.zeros((0, _RECORD))
        self._fresh = True

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        rows = len(seeds) * self.config.followers
        self._memory = np.full((tiles(rows), VIRTUAL * LANES), np.nan)
        self._record = np.zeros((rows if self._keep_record else 0, _RECORD))
        self._fresh = True

    def begin_again(self, mask: NDArray[np.bool_]) -> None:
        rows = np.flatnonzero(np.repeat(mask, self.config.followers))
        self._memory[rows // LANES, rows % LANES] = np.nan
        self._fresh = True

    def decide(self, rows: Rows) -> Rows:
        worlds, n, size = rows.shape
        actions = np.empty((worlds * n, self.config.action_size), dtype=np.float32)
        flat, laws = rows.reshape(worlds * n, size), (self._settings, self._gains, self._derived)
        if self._keep_record:
            memory = self._memory.copy()
            _note(flat, memory, *laws, self._fresh, self._room, self._record)
        self._fresh = decide(flat, self._memory, *laws, self._fresh, self._room, actions)
        return actions.reshape(worlds, n, -1)

    def get_state(self) -> dict[str, NDArray[Any]]:
        """What it remembers of the worlds of the last reset, as copies of arrays by name."""
        return {"memory": self._memory.copy()}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Continue from what `get_state` returned for as many worlds; `ValueError` otherwise."""
        memory, own = state.get("memory"), self._memory
        fits = isinstance(memory, np.ndarray) and (memory.shape, memory.dtype) == (
            own.shape,
            own.dtype,
        )
        if not isinstance(memory, np.ndarray) or not fits or np.isinf(memory).any():
            refuse("state['memory']", memory, f"float64 numbers of shape {own.shape}")
        self._memory, self._fresh = memory.copy(order="C"), True
        self.look_away()

    @property
    def record(self) -> dict[str, Floats]:
        """Errors and virtual followers at the last decision, `(worlds, followers, ...)` each; needs
        `keep_record=True`. Frames and units as in `RECORD`."""
        rows = self._record.reshape(-1, self.config.followers, _RECORD)
        return {name: rows[..., where].copy() for name, where in RECORD.items()}
