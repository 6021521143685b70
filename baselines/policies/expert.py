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

from baselines.policies.base import Policy, Rows
from baselines.policies.expert_lanes import (
    OBSERVED,
    ROOM,
    VIRTUAL,
    WAITS,
    Measurements,
    decide,
    load_observation,
    load_point,
    load_virtual,
    measurements,
    open_room,
    plan_tile,
    planner_law,
    read_world,
    start,
    take_rows,
    waiting,
)
from formation_env import FormationConfig
from formation_env._jit import device, kernel
from formation_env.core.arrays import tiles
from formation_env.laws.planner import PlannerLaw, Virtual, errors, plane
from formation_env.laws.tracker import errors as tracker_errors
from formation_env.laws.world import World
from formation_env.maths.so3 import Vector
from formation_env.memory.records import (
    LANES,
    at,
    fields,
    flatten,
    line_storer,
    size,
    slices,
)
from formation_env.memory.shuffles import carve
from formation_env.paths.references import TrajectoryPoint
from formation_env.physics.quadrotor import MOMENT
from formation_env.validation.checks import boolean, choice, refuse

Floats = NDArray[np.float64]


class Flown(NamedTuple):
    """What is recorded of a vehicle and the trajectory that it follows, for plots."""

    virtual_p: Vector  # m, inertial
    virtual_v: Vector  # m/s
    tracker_e1: Vector  # m (48)
    tracker_e2: Vector  # m/s (49)
    tracker_e3: Vector  # (62)
    tracker_e4: Vector  # rad/s (65)


class Planned(NamedTuple):
    """What is recorded of a virtual follower."""

    planner_e1: complex  # m, {F} of the virtual follower (7)
    planner_e2: complex  # m (11)
    planner_ez: float  # m (32)
    heading: float  # rad
    speed: float  # m/s
    turn_rate: float  # rad/s


class Decision(NamedTuple):
    """What is recorded of one decision of one follower."""

    flown: Flown
    planned: Planned


_store_flown, _store_planned = line_storer(Flown), line_storer(Planned)
_PLANNED = at(Decision, "planned")


@device
def _flown(m: Measurements, ref: TrajectoryPoint, world: World) -> Flown:
    moment = world.follower_actuation == MOMENT
    e = tracker_errors(m.motion, ref, world.tracker if moment else world.rates_tracker)
    return Flown(ref.p, ref.v, e.e1, e.e2, e.e3, e.e4)


@device
def _planned(f: Virtual, m: Measurements, law: PlannerLaw) -> Planned:
    e = errors(f, plane(m.leader.p), plane(m.leader.v), plane(m.offset), law)
    e_z = m.leader.p[2] - f.z - m.offset[2]
    return Planned(e.e1, e.e2, e_z, f.theta, f.u, f.omega)


@kernel
def _record(
    rows: Rows,
    memory: Floats,
    settings: Floats,
    gains: Floats,
    derived: bool,
    fresh: bool,
    space: Floats,
    record: Floats,
) -> None:
    """What `decide` is about to do, a `Decision` in each row; its other arguments, `memory` a copy."""
    world, room = read_world(settings), open_room(space)
    law = planner_law(gains)
    for t in range(len(memory)):
        x = carve(memory, t * VIRTUAL * LANES, (VIRTUAL * LANES,))
        take_rows(rows, t, OBSERVED, room)
        if fresh and waiting(x):
            start(room.rows, x)
        own = record[t * LANES : (t + 1) * LANES]
        for lane in range(len(own)):
            m = measurements(load_observation(room.rows, np.uint64(lane)))
            f = load_virtual(x, np.uint64(lane))
            _store_planned(own[lane, _PLANNED:], _planned(f, m, law))
        plan_tile(room, x, world.clock.period, law, derived)
        for lane in range(len(own)):
            m = measurements(load_observation(room.rows, np.uint64(lane)))
            ref = load_point(room.points, np.uint64(lane))
            _store_flown(own[lane], _flown(m, ref, world))


@final
class Expert(Policy):
    """Planner and tracker of the paper at the configuration's own gains and action level.

    `feedforward` says where the reference's third and fourth derivatives come from: `"zero"`, as in
    the paper's experiment, or `"derived"`, from the law itself with the leader's jerk and snap taken
    as zero because they are not measured.

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
        self._settings = np.array(flatten(config.world))
        self._gains = np.array(config.planner.law())
        self._keep_record = boolean("keep_record", keep_record)
        self._memory = np.zeros((0, VIRTUAL * LANES))
        self._room = np.zeros(ROOM)
        self._record = np.zeros((0, size(Decision)))
        self._fresh = True

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        rows = len(seeds) * self.config.followers
        self._memory = np.full((tiles(rows), VIRTUAL * LANES), np.nan)
        self._record = np.zeros((rows if self._keep_record else 0, size(Decision)))
        self._fresh = True

    def begin_again(self, mask: NDArray[np.bool_]) -> None:
        rows = np.flatnonzero(np.repeat(mask, self.config.followers))
        self._memory[rows // LANES, int(WAITS) + rows % LANES] = np.nan
        self._fresh = True

    def decide(self, rows: Rows) -> Rows:
        worlds, n, size = rows.shape
        actions = np.empty((worlds * n, self.config.action_size), dtype=np.float32)
        flat, laws = rows.reshape(worlds * n, size), (self._settings, self._gains, self._derived)
        if self._keep_record:
            memory = self._memory.copy()
            _record(flat, memory, *laws, self._fresh, self._room, self._record)
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
        `keep_record=True`. Frames and units as in `Flown` and `Planned`."""
        rows = self._record.reshape(-1, self.config.followers, size(Decision))
        named: dict[str, Floats] = {}
        for part, kind in fields(Decision).items():
            numbers = rows[..., slices(Decision)[part]]
            named |= {name: numbers[..., where].copy() for name, where in slices(kind).items()}
        return named
