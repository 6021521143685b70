"""Separations and neighbours in the worlds of a tile: every pair of few vehicles, a sweep of many."""

from __future__ import annotations

from typing import Any

from formation_env._jit import cold, step
from formation_env.core import arrays, judging
from formation_env.core.arrays import SIGHT, Candidate, Squares
from formation_env.core.measuring import in_hand
from formation_env.core.nearest import (
    BLOCK,
    MARGIN,
    QUEUE_ROWS,
    find_nearest,
    found_number,
    found_square,
    number_at,
    put_in_order,
)
from formation_env.memory.records import LANES, at, size
from formation_env.memory.shuffles import carve, copy, turn_square
from formation_env.task import Neighbour, Passing

# With more than this many vehicles, or followers where neighbours are sought, the sweep of `nearest` is
# faster than trying every pair.
MOST_PAIRWISE = 30

_SEPARATION, _NUMBER = at(Squares, "separation") * LANES, at(Candidate, "number")
_NEIGHBOUR, _PASSING = size(Neighbour), size(Passing)


@step
def approach_others(memory: Any, room: Any, t: int, i: int) -> None:
    """The least squared distance between follower `i` and the other followers, few of them."""
    for j in range(arrays.vehicles(memory) - 1):
        if j != i:
            one, other = arrays.vehicle(memory, t, i + 1), arrays.vehicle(memory, t, j + 1)
            judging.approach(one, other, arrays.squares(room, i))


@step
def put_down(x: Any, i: int, m: int, room: Any) -> None:
    """Position and velocity of vehicle `i` of `m`, world by world, into `points`.

    Number by number this would take a cache line for each.
    """
    stride = m * SIGHT
    for lane in range(0, LANES, SIGHT):
        turn_square(x, lane, arrays.points(room), lane * stride + i * SIGHT, stride)


@cold
def order_world(room: Any, lane: int, m: int) -> int:
    """Put the `m` vehicles of one world in order along an axis, which is returned."""
    points = carve(arrays.points(room), lane * m * SIGHT, (m, SIGHT))
    queue = queue_of(room, m)
    return put_in_order(arrays.cells(room), arrays.ends(room), queue, points, m)


@step
def queue_of(room: Any, m: int) -> Any:
    """The places of `m` vehicles in order."""
    return carve(arrays.queue(room), 0, (QUEUE_ROWS, m + 2 * MARGIN))


@cold
def separate_many(memory: Any, room: Any, t: int, here: int) -> None:
    """Squared distances to the nearest other vehicle in `here` worlds of a tile, many vehicles each."""
    m = arrays.vehicles(memory)
    for i in range(m):
        put_down(arrays.vehicle(memory, t, i), i, m, room)
    queue, seekers = queue_of(room, m), arrays.seekers(room)
    for lane in range(here):
        axis = order_world(room, lane, m)
        for first in range(0, m, BLOCK):
            find_nearest(queue, seekers, arrays.meeting(room), axis, m, first, 0)
            for k in range(min(BLOCK, m - first)):
                i = number_at(queue, first + k) - 1
                if i >= 0:
                    arrays.squares(room, i)[_SEPARATION + lane] = found_square(seekers, k, 0)


@cold
def find_neighbours_of_many(memory: Any, room: Any, t: int, here: int) -> None:
    """Numbers of the neighbours of all followers as measured, if there are many."""
    m, K = arrays.vehicles(memory) - 1, arrays.neighbours(memory)
    if m <= MOST_PAIRWISE or K == 0:
        return
    for i in range(m):
        put_down(in_hand(memory, room, t, i + 1), i, m, room)
    queue, seekers = queue_of(room, m), arrays.seekers(room)
    for lane in range(here):
        axis = order_world(room, lane, m)
        for first in range(0, m, BLOCK):
            find_nearest(queue, seekers, arrays.meeting(room), axis, m, first, K)
            for k in range(min(BLOCK, m - first)):
                i = number_at(queue, first + k)
                for rank in range(K):
                    arrays.neighbour(room, i, rank)[lane] = found_number(seekers, k, rank)


@cold
def find_neighbours_of_few(memory: Any, room: Any, t: int, i: int) -> None:
    """Numbers of the neighbours of follower `i` as measured, among few followers."""
    n, K = arrays.vehicles(memory) - 1, arrays.neighbours(memory)
    ranks, candidate = min(n - 1, K), arrays.candidate(room, K)
    for rank in range(ranks):
        judging.clear_candidate(arrays.candidate(room, rank))
    for j in range(n):
        if j != i:
            own, other = in_hand(memory, room, t, i + 1), in_hand(memory, room, t, j + 1)
            first = arrays.candidate(room, 0)
            if ranks > 1:
                second = arrays.candidate(room, 1)
                judging.insert_two(other, own, float(j), first, second, candidate)
            else:
                judging.measure(other, own, float(j), candidate)
                judging.insert(candidate, first)
            for rank in range(2, ranks):
                judging.insert(candidate, arrays.candidate(room, rank))
    for rank in range(ranks):
        copy(arrays.candidate(room, rank), _NUMBER, arrays.neighbour(room, i, rank), 0, 1)


@step
def fetch_neighbour(memory: Any, room: Any, t: int, i: int, rank: int) -> None:
    """Position and velocity of a neighbour of follower `i` in each world, its own where there is none."""
    numbers, other = arrays.neighbour(room, i, rank), arrays.other(room)
    for lane in range(LANES):
        j = int(numbers[lane])
        x = in_hand(memory, room, t, (i if j < 0 else j) + 1)
        for row in range(_PASSING):
            other[row * LANES + lane] = x[row * LANES + lane]


@cold
def fetch_neighbour_of_many(memory: Any, room: Any, i: int, rank: int) -> None:
    """The same from what `find_neighbours_of_many` has put down: a line each, which are turned."""
    numbers, points, lines = (
        arrays.neighbour(room, i, rank),
        arrays.points(room),
        arrays.lines(room),
    )
    stride = (arrays.vehicles(memory) - 1) * SIGHT
    for lane in range(LANES):
        j = int(numbers[lane])
        start = lane * stride + (i if j < 0 else j) * SIGHT
        for k in range(SIGHT):
            lines[lane * LANES + k] = points[start + k]
    for lane in range(0, LANES, SIGHT):
        turn_square(lines, lane * LANES, arrays.other(room), lane, LANES)


@step
def show_neighbours(memory: Any, room: Any, t: int, i: int) -> None:
    """What follower `i` observes of its nearest neighbours, in the last rows of an observation.

    Rows beyond the number of others stay as zero as they were made.
    """
    n, K = arrays.vehicles(memory) - 1, arrays.neighbours(memory)
    if n > 2 and n <= MOST_PAIRWISE and K > 0:
        find_neighbours_of_few(memory, room, t, i)
    x, own, rows = (
        arrays.follower(memory, t, i),
        in_hand(memory, room, t, i + 1),
        arrays.observation(room),
    )
    first = len(rows) - K * _NEIGHBOUR * LANES
    for rank in range(min(n - 1, K)):
        sink = carve(rows, first + rank * _NEIGHBOUR * LANES, (_NEIGHBOUR * LANES,))
        other, numbers = arrays.other(room), arrays.neighbour(room, i, rank)
        if n == 2:
            other = in_hand(memory, room, t, 2 - i)
        elif n > MOST_PAIRWISE:
            fetch_neighbour_of_many(memory, room, i, rank)
        else:
            fetch_neighbour(memory, room, t, i, rank)
        judging.show_neighbour(numbers, x, own, other, sink)
