"""Who is near whom: separations and neighbours in the worlds of a tile."""

from __future__ import annotations

from typing import Any

from formation_env._jit import device
from formation_env.blocks import LANES
from formation_env.crowd import Crowd, find_nearest, line_up
from formation_env.lanes import (
    copy,
    forget,
    insert,
    measure,
    see_neighbour,
)
from formation_env.memory import (
    SEPARATION_SQUARED,
    Scratch,
)
from formation_env.task import NEIGHBOUR

# From this many vehicles on a sweep finds who is near faster than trying every pair.
CROWD = 30


@device
def _line_up(tile: Any, lane: int, crowd: Crowd) -> None:
    """Put the vehicles of one world of a tile in order, whose positions are rows 0-2 each."""
    for i in range(len(crowd.points)):
        for k in range(3):
            crowd.points[i, k] = tile[i, k * LANES + lane]
    line_up(crowd)


@device
def separate_crowd(vehicles: Any, t: int, worlds: int, room: Scratch) -> None:
    """Squared distances to the nearest other vehicle in all worlds of tile `t`, many vehicles each."""
    square, number = room.squares[:1], room.numbers[:1]
    for lane in range(min(LANES, worlds - t * LANES)):
        _line_up(vehicles[t], lane, room.vehicles)
        for i in range(len(room.outcomes)):
            find_nearest(room.vehicles, i + 1, square, number)
            room.outcomes[i, SEPARATION_SQUARED * LANES + lane] = square[0]


@device
def know_crowd(t: int, worlds: int, room: Scratch) -> None:
    """Numbers of the neighbours of all followers as measured, in all worlds of tile `t`."""
    seen = room.seen[min(t, len(room.seen) - 1)]
    n, K = len(room.actions), room.neighbours.shape[1] // LANES
    for lane in range(min(LANES, worlds - t * LANES)):
        _line_up(seen[1:], lane, room.followers)
        for i in range(n):
            find_nearest(room.followers, i, room.squares, room.numbers)
            for m in range(K):
                room.neighbours[i, m * LANES + lane] = room.numbers[m]


@device
def know_few(t: int, i: int, room: Scratch) -> None:
    """Numbers of the neighbours of follower `i` as measured, in all worlds of tile `t`, few of them."""
    seen, n = room.seen[min(t, len(room.seen) - 1)], len(room.actions)
    K = room.neighbours.shape[1] // LANES
    here, candidate = min(n - 1, K), room.nearest[K]
    for m in range(here):
        forget(room.nearest[m])
    for j in range(n):
        if j != i:
            measure(seen[i + 1], seen[j + 1], float(j), candidate)
            for m in range(here):
                insert(candidate, room.nearest[m])
    for m in range(here):
        copy(room.nearest[m], 1, room.neighbours[i], m, 1)


@device
def see_neighbours(x: Any, t: int, i: int, k: int, room: Scratch) -> None:
    """What follower `i` sees of its nearest neighbours, from row `k` of the observation on.

    Rows beyond the number of others stay as zero as they were made.
    """
    seen, n = room.seen[min(t, len(room.seen) - 1)], len(room.actions)
    for m in range(min(n - 1, room.neighbours.shape[1] // LANES)):
        if n == 2:
            see_neighbour(x, seen[i + 1], seen[2 - i], room.neighbours[i], k, room.rows)
            return
        for lane in range(LANES):
            j = int(room.neighbours[i, m * LANES + lane])
            other = i if j < 0 else j
            for row in range(6):
                room.lines[row * LANES + lane] = seen[other + 1, row * LANES + lane]
        known = room.neighbours[i, m * LANES : (m + 1) * LANES]
        see_neighbour(x, seen[i + 1], room.lines, known, k + m * NEIGHBOUR, room.rows)
