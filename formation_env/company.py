"""Who is near whom: separations and neighbours in the worlds of a tile."""

from __future__ import annotations

from typing import Any

from formation_env._jit import device
from formation_env.blocks import LANES, carve, turn_square
from formation_env.crowd import (
    BLOCK,
    find_nearest,
    found_number,
    found_square,
    line_up,
    number_at,
)
from formation_env.lanes import (
    copy,
    forget,
    insert,
    measure,
    meet,
    see_neighbour,
)
from formation_env.memory import (
    SEPARATION_SQUARED,
    SIGHT,
    Scratch,
)
from formation_env.task import NEIGHBOUR

# From this many vehicles on a sweep finds who is near faster than trying every pair.
CROWD = 30


@device
def _part(vehicles: Any, first: int, room: Scratch) -> int:
    """Positions and velocities of the vehicles of a tile from `first` on, world by world.

    Returns how many there are in a world. Number by number this would take a cache line for each.
    """
    points, m = room.points, len(vehicles) - first
    stride = len(vehicles) * SIGHT
    for i in range(m):
        for lane in range(0, LANES, SIGHT):
            turn_square(vehicles[first + i], lane, points, lane * stride + i * SIGHT, stride)
    return m


@device
def _world(vehicles: Any, lane: int, room: Scratch) -> Any:
    """What `_part` has put down for one world, a row for each vehicle."""
    m = len(vehicles)
    return carve(room.points, lane * m * SIGHT, (m, SIGHT))


@device
def separate_crowd(tile: Any, here: int, room: Scratch) -> None:
    """Squared distances to the nearest other vehicle in `here` worlds of a tile, many vehicles each."""
    crowd = room.crowd
    m = _part(tile, 0, room)
    for lane in range(here):
        axis = line_up(crowd, _world(tile, lane, room), m)
        for first in range(0, m, BLOCK):
            find_nearest(crowd, axis, m, first, 0)
            for k in range(min(BLOCK, m - first)):
                i = number_at(crowd, first + k) - 1
                if i >= 0:
                    room.outcomes[i, SEPARATION_SQUARED * LANES + lane] = found_square(crowd, k, 0)


@device
def know_crowd(seen: Any, here: int, room: Scratch) -> None:
    """Numbers of the neighbours of all followers as measured, in `here` worlds of a tile."""
    crowd = room.crowd
    m, K = _part(seen, 1, room), room.neighbours.shape[1] // LANES
    for lane in range(here):
        axis = line_up(crowd, _world(seen, lane, room), m)
        for first in range(0, m, BLOCK):
            find_nearest(crowd, axis, m, first, K)
            for k in range(min(BLOCK, m - first)):
                i = number_at(crowd, first + k)
                for rank in range(K):
                    number = found_number(crowd, k, rank)
                    room.neighbours[i, rank * LANES + lane] = number


@device
def know_few(seen: Any, i: int, room: Scratch) -> None:
    """Numbers of the neighbours of follower `i` as measured, in all worlds of a tile, few of them."""
    n = len(room.actions)
    K = room.neighbours.shape[1] // LANES
    here, candidate = min(n - 1, K), room.nearest[K]
    for m in range(here):
        forget(room.nearest[m])
    for j in range(n):
        if j != i:
            own, other = seen[i + 1], seen[j + 1]
            if here > 1:
                meet(own, other, float(j), room.nearest[0], room.nearest[1], candidate)
            else:
                measure(own, other, float(j), candidate)
                insert(candidate, room.nearest[0])
            for m in range(2, here):
                insert(candidate, room.nearest[m])
    for m in range(here):
        copy(room.nearest[m], 1, room.neighbours[i], m, 1)


@device
def _fetch(tile: Any, known: Any, i: int, room: Scratch) -> None:
    """Rows 0-5 of the followers of those numbers, a lane each, into `room.other`."""
    for lane in range(LANES):
        j = int(known[lane])
        other = i if j < 0 else j
        for row in range(6):
            room.other[row * LANES + lane] = tile[other + 1, row * LANES + lane]


@device
def _fetch_from_crowd(tile: Any, known: Any, i: int, room: Scratch) -> None:
    """The same from what `know_crowd` has put down: a line each, which are turned."""
    stride, lines = len(tile) * SIGHT, room.lines
    for lane in range(LANES):
        j = int(known[lane])
        start = lane * stride + (i if j < 0 else j) * SIGHT
        for k in range(SIGHT):
            lines[lane * LANES + k] = room.points[start + k]
    for lane in range(0, LANES, SIGHT):
        turn_square(lines, lane * LANES, room.other, lane, LANES)


@device
def see_neighbours(x: Any, seen: Any, i: int, k: int, room: Scratch) -> None:
    """What follower `i` sees of its nearest neighbours, from row `k` of the observation on.

    Rows beyond the number of others stay as zero as they were made.
    """
    n = len(room.actions)
    for m in range(min(n - 1, room.neighbours.shape[1] // LANES)):
        if n == 2:
            see_neighbour(x, seen[i + 1], seen[2 - i], room.neighbours[i], k, room.rows)
            return
        known = carve(room.neighbours[i], m * LANES, (LANES,))
        if n > CROWD:
            _fetch_from_crowd(seen, known, i, room)
        else:
            _fetch(seen, known, i, room)
        see_neighbour(x, seen[i + 1], room.other, known, k + m * NEIGHBOUR, room.rows)
