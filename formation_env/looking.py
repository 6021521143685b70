"""What is seen of a world: slots, separations, and the followers' observation rows."""

from __future__ import annotations

from typing import Any

import numpy as np

from formation_env._jit import device
from formation_env.memory import (
    ERROR,
    ESTIMATE,
    HEADING,
    SAMPLES,
    SEPARATION,
    SLOT,
    STARTED,
    Constants,
    State,
    latest,
    load,
    load_guide,
    previous_action,
    put,
)
from formation_env.sensors import Measured
from formation_env.slots import Slot, slot
from formation_env.so3 import Vector, sub
from formation_env.task import distance, observe, observe_guide, observe_neighbour
from formation_env.trajectories import Reference
from formation_env.world import REFERENCE, World


@device
def slot_of(state: State, c: Constants, w: int, i: int, begin: Reference) -> Slot:
    """Where follower `i` should be: relative to the leader, or to the waiting reference (40)."""
    x = state.followers[w, i]
    R = complex(x[HEADING], x[HEADING + 1])
    d = load(c.offsets[i], 0)
    if state.counters[w, STARTED] == 0:
        return slot(R, begin.p, (0.0, 0.0, 0.0), d)
    leader = state.vehicles[w, 0]
    return slot(R, load(leader, 0), load(leader, 3), d)


@device
def _write(row: Any, k: int, bound: Any, x: float) -> int:
    row[k] = min(max(x, -bound[k]), bound[k])
    return k + 1


@device
def _write_vector(row: Any, k: int, bound: Any, a: Vector) -> int:
    for x in a:
        k = _write(row, k, bound, x)
    return k


@device
def observe_follower(
    state: State, c: Constants, w: int, i: int, begin: Reference, row: Any, s: World
) -> None:
    """Write follower `i`'s observation."""
    x = state.followers[w, i]
    count, started = state.counters[w, SAMPLES], state.counters[w, STARTED] != 0
    R = complex(x[ESTIMATE], x[ESTIMATE + 1])
    leader = latest(state.samples[w, 0], count)
    own = latest(state.samples[w, i + 1], count)
    anchor = leader.p if started else begin.p
    o = observe(own, leader, anchor, R, load(c.offsets[i], 0), previous_action(x), started)
    b = c.bound
    k = _write_vector(row, 0, b, o.slot_error)
    k = _write_vector(row, k, b, o.relative_velocity)
    k = _write_vector(row, k, b, o.leader_velocity)
    k = _write_vector(row, k, b, o.leader_acceleration)
    k = _write_vector(row, k, b, o.body_x)
    k = _write_vector(row, k, b, o.body_z)
    k = _write_vector(row, k, b, o.angular_velocity)
    k = _write(row, k, b, o.heading[0])
    k = _write(row, k, b, o.heading[1])
    k = _write_vector(row, k, b, o.offset)
    for a in o.previous_action:
        k = _write(row, k, b, a)
    k = _write(row, k, b, o.started)
    k = _write_vector(row, k, b, o.position)
    if s.level == REFERENCE:
        g = observe_guide(own, load_guide(x), R)
        k = _write_vector(row, k, b, g.p)
        k = _write_vector(row, k, b, g.v)
    _observe_neighbours(state, c, w, i, own, R, row, k)


@device
def _observe_neighbours(
    state: State, c: Constants, w: int, i: int, own: Measured, R: complex, row: Any, k: int
) -> None:
    """The nearest followers by measured distance, nearest first; equal distances by number."""
    count = state.counters[w, SAMPLES]
    last, last_j = -1.0, -1
    for _ in range(c.neighbours):
        best, best_j = np.inf, -1
        for j in range(len(c.offsets)):
            if j != i:
                r = distance(latest(state.samples[w, j + 1], count).p, own.p)
                beyond = r > last or (r == last and j > last_j)
                if beyond and r < best:
                    best, best_j = r, j
        if best_j < 0:
            for _ in range(7):
                k = _write(row, k, c.bound, 0.0)
        else:
            o = observe_neighbour(own, latest(state.samples[w, best_j + 1], count), R)
            k = _write(row, k, c.bound, o.present)
            k = _write_vector(row, k, c.bound, o.position)
            k = _write_vector(row, k, c.bound, o.velocity)
            last, last_j = best, best_j


@device
def separation_of(state: State, w: int, i: int) -> float:
    """Distance from vehicle `i` to the nearest other one, m; infinite if it is alone."""
    x = state.vehicles[w]
    p = load(x[i], 0)
    nearest = np.inf
    for j in range(len(x)):
        if j != i:
            nearest = min(nearest, distance(p, load(x[j], 0)))
    return nearest


@device
def report(out: Any, target: Slot, p: Vector, separation: float) -> None:
    """Write the truth about one follower."""
    put(out, SLOT, target.p)
    put(out, ERROR, sub(target.p, p))
    out[SEPARATION] = separation
