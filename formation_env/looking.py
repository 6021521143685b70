"""Where a single follower should be, for reset and trigger; `lanes.locate` does it for a tile."""

from __future__ import annotations

from formation_env._jit import device
from formation_env.memory import (
    HEADING,
    LANES,
    STARTED,
    Constants,
    State,
    follower,
    load,
    vehicle,
)
from formation_env.slots import Slot, slot
from formation_env.so3 import Vector


@device
def begin_of(state: State, w: int) -> Vector:
    """The leader's first reference point in world `w`."""
    return load(state.begins[w // LANES, :, w % LANES], 0)


@device
def slot_of(state: State, c: Constants, w: int, i: int) -> Slot:
    """Where follower `i` should be: relative to the leader, or to the waiting reference (40)."""
    x = follower(state, w, i)
    R = complex(x[HEADING], x[HEADING + 1])
    d = load(c.offsets[i], 0)
    if state.counters[w, STARTED] == 0:
        return slot(R, begin_of(state, w), (0.0, 0.0, 0.0), d)
    leader = vehicle(state, w, 0)
    return slot(R, load(leader, 0), load(leader, 3), d)
