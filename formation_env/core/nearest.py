"""Nearest neighbours among many points: a sweep, for formations too large to try every pair.

Points are put roughly in order along the axis on which they are spread most. A block of them at a time
is compared with those further and further along to both sides, until along that axis alone no point left
can be nearer than the ones found. The result is exactly that of trying every pair: the same points in the
same order, by squared distance as computed and, where that is equal, by number.

Loops over a block are the ones that the compiler vectorises; the rules are those of `tiles`. So the search
does not stop point by point: a branch that goes this way for one point and that way for the next costs more
than the few distances it saves.

Arrays, for `m` points and the `K` nearest of each: `cells` `(m,)`, which stretch of the axis each is in;
`ends` `(m + 1,)`, where in the order those of a stretch lie; `queue` `(QUEUE_ROWS, m + 2 MARGIN)`, the points
in order; `seekers` `((SEEKER_ROWS + 2 max(K, 2)) BLOCK,)`, the block whose neighbours are sought and, by
rank, the squared distances and numbers found; `meeting` `(MEETING_ROWS BLOCK,)`, what to compare them with.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device, loop
from formation_env.memory.shuffles import carve

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]

BLOCK = 16  # points whose neighbours are sought side by side
STEPS = 4  # others each of them is compared with at a time
MARGIN = BLOCK + STEPS  # empty places before and behind the points in order

# Rows of `queue`: after x, y and z of each place.
_NUMBER, _BEHIND, _AHEAD, QUEUE_ROWS = 3, 4, 5, 6
# Rows of `seekers`: x, y, z, where along the axis, and pairs of squared distance and number.
_ALONG, SEEKER_ROWS = 3, 4
_NEAREST, _SECOND = 4, 6
MEETING_ROWS = 2 * STEPS

_BLOCK = np.uint64(BLOCK)


@device
def _mean(points: Any, m: int, off: Vector, once: float) -> Vector:
    """The mean over some of the points of how far from `off` they are, or with `once = 0` of where.

    As far as they are finite.
    """
    step = (1 + m // 32) | 1
    a, b, c, n = 0.0, 0.0, 0.0, 0.0
    for i in range(0, m, step):
        x, y, z = points[i, 0] - off[0], points[i, 1] - off[1], points[i, 2] - off[2]
        on = abs(x) + abs(y) + abs(z) < np.inf
        a += (x if once == 0.0 else abs(x)) if on else 0.0
        b += (y if once == 0.0 else abs(y)) if on else 0.0
        c += (z if once == 0.0 else abs(z)) if on else 0.0
        n += 1.0 if on else 0.0
    n = max(n, 1.0)
    return (a / n, b / n, c / n)


@device
def _spread(points: Any, m: int) -> tuple[int, float, float]:
    """The axis along which the points are spread most, and where most of them begin and end there.

    A guess from some of them: speed depends on it, results do not. The mean deviation is not much
    moved by one that is far away.
    """
    mean = _mean(points, m, (0.0, 0.0, 0.0), 0.0)
    off = _mean(points, m, mean, 1.0)
    best, low, reach = 0, mean[0], 2.5 * off[0]
    if 2.5 * off[1] > reach:
        best, low, reach = 1, mean[1], 2.5 * off[1]
    if 2.5 * off[2] > reach:
        best, low, reach = 2, mean[2], 2.5 * off[2]
    return best, low - reach, low + reach


@device
def _mark_empty(queue: Floats, place: int) -> None:
    """Mark a place as empty: infinitely far before or behind all."""
    for row in range(3):
        queue[row, place] = np.inf
    queue[_NUMBER, place] = -1.0
    queue[_BEHIND, place], queue[_AHEAD, place] = -np.inf, np.inf


@device
def put_in_order(cells: Any, ends: Any, queue: Any, points: Any, m: int) -> int:
    """Put the first `m` of `points`, rows that begin with x, y and z, in order; returns the axis.

    The order is that of equal stretches of the axis, and within one that of the numbers.
    """
    axis, low, high = _spread(points, m)
    last = float(m - 1)
    scale = m / (high - low) if high > low else 0.0
    for c in range(m + 1):
        ends[c] = 0
    for i in range(m):
        u = (points[i, axis] - low) * scale
        u = u if u > 0.0 else 0.0
        cell = int(u if u < last else last)
        cells[i] = cell
        ends[cell + 1] += 1
    for c in range(m):
        ends[c + 1] += ends[c]
    for i in range(m):
        place = ends[cells[i]] + MARGIN
        ends[cells[i]] += 1
        for k in range(3):
            queue[k, place] = points[i, k]
        queue[_NUMBER, place] = float(i)
    for k in range(MARGIN):
        _mark_empty(queue, k)
        _mark_empty(queue, m + MARGIN + k)
    _bound(queue, axis, m)
    return axis


@device
def _bound(queue: Floats, axis: int, m: int) -> None:
    """How far along the axis those up to a place reach at most, and those from it on at least."""
    furthest, nearest = -np.inf, np.inf
    for place in range(m):
        front, back = MARGIN + place, MARGIN + m - 1 - place
        x, y = queue[axis, front], queue[axis, back]
        furthest = x if x > furthest else furthest
        nearest = y if y < nearest else nearest
        queue[_BEHIND, front], queue[_AHEAD, back] = furthest, nearest


@partial(device, literal=False)
def _at(row: int, k: Any) -> Any:
    """Where row `row` of a block has its entry for the one at `k`."""
    return np.uint64(row) * _BLOCK + k


# A loop whose length the compiler knows is unrolled before it is vectorised, and then is not: so all are
# given their length, `many`, which is BLOCK.


@loop
def _begin(queue: Floats, axis: int, here: int, seekers: Any, many: int) -> None:
    """The points from place `here` on become those whose neighbours are sought."""
    for k in range(np.uint64(many)):
        place = np.uint64(here) + k
        seekers[_at(0, k)], seekers[_at(1, k)] = queue[0, place], queue[1, place]
        seekers[_at(2, k)], seekers[_at(_ALONG, k)] = queue[2, place], queue[axis, place]


@loop
def _clear_rank(seekers: Any, rank: Any, many: int) -> None:
    """Nothing found of this rank: infinitely far, or, for a point that is not finite, never (-1)."""
    for k in range(np.uint64(many)):
        x, y, z = seekers[_at(0, k)], seekers[_at(1, k)], seekers[_at(2, k)]
        sound = (abs(x) < np.inf) & (abs(y) < np.inf) & (abs(z) < np.inf)
        rank[k], rank[_at(1, k)] = np.inf if sound else -1.0, -1.0


@device
def _before(r: float, j: float, held: float, holder: float) -> Any:
    """Whether point `j` at squared distance `r` comes before the one held, number `holder`."""
    return (r < held) | ((r == held) & (j < holder))


@device
def _square(queue: Floats, place: Any, x: float, y: float, z: float) -> float:
    a, b, c = queue[0, place] - x, queue[1, place] - y, queue[2, place] - z
    return float(a * a + b * b + c * c)


@device
def _may_be_nearer(gap: float, held: float) -> Any:
    """Whether a point at least `gap` further along might be as near as the one held.

    A sum of squares is not rounded below one of them.
    """
    return (held >= 0.0) & ((gap <= 0.0) | (gap * gap <= held))


# The commonest two searches keep what they find in registers, and in one array with the seekers:
# with two, the compiler takes half a block at a time out of the vector loop.


@loop
def _approach(queue: Floats, there: int, sign: float, seekers: Any, many: int) -> int:
    """Keep the least squared distance to the next few from place `there` on, and how many are not done."""
    count, side, after = 0, _AHEAD, there + STEPS
    if sign < 0.0:
        side, after = _BEHIND, there - 1
    for k in range(np.uint64(many)):
        x, y, z = seekers[_at(0, k)], seekers[_at(1, k)], seekers[_at(2, k)]
        place = np.uint64(there) + k
        least = seekers[_at(_NEAREST, k)]
        for s in range(STEPS):
            r = _square(queue, place + np.uint64(s), x, y, z)
            least = r if r < least else least
        seekers[_at(_NEAREST, k)] = least
        gap = sign * (queue[side, np.uint64(after) + k] - seekers[_at(_ALONG, k)])
        count += _may_be_nearer(gap, least)
    return count


@loop
def _choose_two(queue: Floats, there: int, seekers: Any, many: int) -> None:
    """Keep the nearest two among the next few from place `there` on."""
    for k in range(np.uint64(many)):
        x, y, z = seekers[_at(0, k)], seekers[_at(1, k)], seekers[_at(2, k)]
        place = np.uint64(there) + k
        held, holder = seekers[_at(_NEAREST, k)], seekers[_at(_NEAREST + 1, k)]
        other, second = seekers[_at(_SECOND, k)], seekers[_at(_SECOND + 1, k)]
        for s in range(STEPS):
            r, j = (
                _square(queue, place + np.uint64(s), x, y, z),
                queue[_NUMBER, place + np.uint64(s)],
            )
            on = _before(r, j, held, holder)
            r, held = held if on else r, r if on else held
            j, holder = holder if on else j, j if on else holder
            on = _before(r, j, other, second)
            other, second = r if on else other, j if on else second
        seekers[_at(_NEAREST, k)], seekers[_at(_NEAREST + 1, k)] = held, holder
        seekers[_at(_SECOND, k)], seekers[_at(_SECOND + 1, k)] = other, second


@loop
def _compare(queue: Floats, there: int, seekers: Any, meeting: Any, rank: Any, many: int) -> int:
    """Squared distances and numbers of the next few; how many are as near as the one held."""
    near = 0
    for k in range(np.uint64(many)):
        x, y, z = seekers[_at(0, k)], seekers[_at(1, k)], seekers[_at(2, k)]
        place = np.uint64(there) + k
        least = np.inf
        for s in range(STEPS):
            r = _square(queue, place + np.uint64(s), x, y, z)
            meeting[_at(2 * s, k)] = r
            meeting[_at(2 * s + 1, k)] = queue[_NUMBER, place + np.uint64(s)]
            least = r if r < least else least
        near += least <= rank[k]
    return near


@loop
def _insert(meeting: Any, rank: Any, many: int) -> None:
    """Exchange the points compared with the one of this rank where they come before it."""
    for k in range(np.uint64(many)):
        held, holder = rank[k], rank[_at(1, k)]
        for s in range(STEPS):
            r, j = meeting[_at(2 * s, k)], meeting[_at(2 * s + 1, k)]
            on = _before(r, j, held, holder)
            meeting[_at(2 * s, k)] = held if on else r
            meeting[_at(2 * s + 1, k)] = holder if on else j
            held, holder = r if on else held, j if on else holder
        rank[k], rank[_at(1, k)] = held, holder


@loop
def _unfinished(queue: Floats, there: int, sign: float, seekers: Any, rank: Any, many: int) -> int:
    """How many are not done after the next few from place `there` on."""
    count, side, after = 0, _AHEAD, there + STEPS
    if sign < 0.0:
        side, after = _BEHIND, there - 1
    for k in range(np.uint64(many)):
        gap = sign * (queue[side, np.uint64(after) + k] - seekers[_at(_ALONG, k)])
        count += _may_be_nearer(gap, rank[k])
    return count


@partial(device, literal=False)
def _rank(seekers: Any, rank: int) -> Any:
    """Squared distances and numbers found of one rank, for the points of the block."""
    return carve(seekers, (SEEKER_ROWS + 2 * rank) * BLOCK, (2 * BLOCK,))


@device
def _compare_with(queue: Any, seekers: Any, meeting: Any, there: int, sign: float, K: int) -> int:
    """Compare the block with the next few from place `there` on; how many are not done."""
    if K == 0:
        return _approach(queue, there, sign, seekers, BLOCK)
    last = _rank(seekers, K - 1)
    if K == 2:
        _choose_two(queue, there, seekers, BLOCK)
    elif _compare(queue, there, seekers, meeting, last, BLOCK) > 0:
        for rank in range(K):
            _insert(meeting, _rank(seekers, rank), BLOCK)
    return _unfinished(queue, there, sign, seekers, last, BLOCK)


@device
def find_nearest(
    queue: Any, seekers: Any, meeting: Any, axis: int, m: int, first: int, K: int
) -> None:
    """The `K` nearest of those at the `BLOCK` places from `first` on, into `seekers`.

    Of the `m` points put in order along `axis`. With `K = 0` the squared distance to the nearest and no
    number. Where there is none, the number is -1.
    """
    here, d = first + MARGIN, 1
    _begin(queue, axis, here, seekers, BLOCK)
    for rank in range(max(K, 1)):
        _clear_rank(seekers, _rank(seekers, rank), BLOCK)
    up = down = True
    while up or down:
        if up:
            more = _compare_with(queue, seekers, meeting, here + d, 1.0, K) > 0
            up = more and first + d + STEPS < m
        if down:
            more = _compare_with(queue, seekers, meeting, here - d - STEPS + 1, -1.0, K) > 0
            down = more and first + BLOCK > d + STEPS
        d += STEPS


@device
def number_at(queue: Any, place: int) -> int:
    """The number of the point at a place of the order."""
    return int(queue[_NUMBER, MARGIN + place])


@device
def found_square(seekers: Any, k: int, rank: int) -> float:
    """Squared distance from the `k`-th of the block to its nearest of that rank; infinity if none."""
    r = _rank(seekers, rank)[k]
    return float(r) if r >= 0.0 else np.inf


@device
def found_number(seekers: Any, k: int, rank: int) -> float:
    """The number of that nearest, or -1 if there is none."""
    return float(_rank(seekers, rank)[BLOCK + k])
