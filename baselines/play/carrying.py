"""Lets a flight go on under another configuration, or with a follower less, in another simulation.

The simulation of the new configuration has been reset from the same seed. What is flown, measured,
counted and disturbed in the old one is put into its state, by `get_state` and `set_state`, which check it. A
flight cannot go on where the leader's path of the episode or the control period is another, or followers
are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from baselines.policies.base import Policy
from formation_env.core.arrays import Counters, rows
from formation_env.core.simulation import Simulation, Snapshot
from formation_env.memory.records import LANES, size
from formation_env.physics.sensors import Measured

_MEASURED = size(Measured) * LANES
_COURSE = ("begins", "courses", "tables")  # what is drawn of the leader's path
Arrays = dict[str, Any]


def carry(old: Simulation, new: Simulation, kept: Sequence[int] | None = None) -> bool:
    """Put `new` where `old` is, both of one world; whether that is possible. If not, `new` is as it was.

    `kept` are the followers of `old` that `new` has, all by default, if it has as many.
    """
    n = old.config.followers
    kept = range(n) if kept is None else kept
    if old.ended(0) or len(kept) != new.config.followers:
        return False
    a, b = old.get_state().state, new.get_state().state
    before, after = old.config.world, new.config.world
    if before.clock.period != after.clock.period or not _same_course(a, b):
        return False
    if before.level != after.level:
        return False
    vehicles = [0, *(1 + i for i in kept)]
    common = min(a["vehicles"].shape[-1], b["vehicles"].shape[-1])
    b["vehicles"][..., :common] = a["vehicles"][:, vehicles, :common]
    b["followers"][...] = a["followers"][:, list(kept)]
    b["counters"][...] = a["counters"]
    _carry_measurements(a, b, vehicles, before.clock == after.clock)
    try:
        new.set_state(Snapshot(new.config, b))
    except ValueError:  # a state that can no longer be computed
        return False
    return True


def _same_course(a: Arrays, b: Arrays) -> bool:
    """Whether the leader is to fly the same path, from the same point on."""
    first = [rows(x["counters"], Counters)["first"][0, 0, 0] for x in (a, b)]
    return bool(first[0] == first[1]) and all(np.array_equal(a[n], b[n]) for n in _COURSE)


def _carry_measurements(a: Arrays, b: Arrays, vehicles: Sequence[int], same_clock: bool) -> None:
    """What was measured lately; where that was at other times, what is true now."""
    if same_clock and a["samples"].shape[2] == b["samples"].shape[2]:
        b["samples"][...] = a["samples"][:, vehicles]
    else:
        b["samples"][...] = b["vehicles"][:, :, None, :_MEASURED]
    if same_clock and a["speeds"].shape == b["speeds"].shape:
        b["speeds"][...] = a["speeds"]
    else:
        b["speeds"][...] = rows(b["vehicles"][:, 0], Measured)["v"][0, :, 0]


def carry_memory(old: Policy, new: Policy) -> None:
    """Let a policy remember what another one of its kind does, if it can be asked; else it begins anew.

    Of the baselines the expert can.
    """
    get, put = getattr(old, "get_state", None), getattr(new, "set_state", None)
    if type(old) is type(new) and get is not None and put is not None:
        try:
            put(get())
        except ValueError:  # of another number of followers
            return


def pushed(simulation: Simulation, vehicle: int, change: Sequence[float]) -> None:
    """Change the true velocity of a vehicle (0: the leader) of the first world by so much, m/s, inertial.

    Raises `ValueError` where the state would be one that cannot be computed.
    """
    snapshot = simulation.get_state()
    rows(snapshot.state["vehicles"], Measured)["v"][0, vehicle, :, 0] += np.asarray(change)
    simulation.set_state(snapshot)
