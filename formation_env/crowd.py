"""Nearest neighbours among many points: a sweep, for formations too large to try every pair.

Points are put in order along the axis on which they are spread most; the neighbours of one are looked
for to both sides of it until the distance along that axis alone is more than that of the neighbours
found. The result is that of trying every pair: the same points in the same order, by distance and,
where distances are equal, by number.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]


class Crowd(NamedTuple):
    """m points, and room to put them in order."""

    points: Floats  # (m, 3)
    order: Counts  # (m,): their numbers in the order of the last call, or zeros
    queue: Floats  # (m, 3): the points in order, the axis of the sweep first
    rank: Counts  # (m,): the place of each in the queue


@device
def _widest(points: Floats) -> int:
    """The axis along which the points are spread most, as far as they are finite."""
    best, widest = 0, -1.0
    for axis in range(3):
        low, high = np.inf, -np.inf
        for i in range(len(points)):
            x = points[i, axis]
            if abs(x) < np.inf:
                low, high = min(low, x), max(high, x)
        if high - low > widest:
            best, widest = axis, high - low
    return best


@device
def _key(x: float) -> float:
    """Where a coordinate stands in the queue: what is not finite comes last."""
    return x if abs(x) < np.inf else np.inf


@device
def line_up(crowd: Crowd) -> None:
    """Put the points in order along their widest axis.

    Starts from the order of the last call: points that have moved a little are in order almost at
    once. The result does not depend on it, equal coordinates being ordered by number.
    """
    points, order, queue = crowd.points, crowd.order, crowd.queue
    m, axis = len(points), _widest(points)
    if m > 1 and order[0] == order[1]:
        for i in range(m):
            order[i] = i
    for place in range(m):
        i = order[place]
        x = _key(points[i, axis])
        k = place
        while k > 0 and (queue[k - 1, 0] > x or (queue[k - 1, 0] == x and order[k - 1] > i)):
            queue[k, 0], order[k] = queue[k - 1, 0], order[k - 1]
            k -= 1
        queue[k, 0], order[k] = x, i
    for place in range(m):
        i = order[place]
        crowd.rank[i] = place
        queue[place, 1] = points[i, (axis + 1) % 3]
        queue[place, 2] = points[i, (axis + 2) % 3]


@device
def _insert(r: float, j: int, squares: Any, numbers: Any) -> None:
    """Take point `j` at squared distance `r` in among the nearest, if it belongs there."""
    for k in range(len(numbers)):
        held, holder = squares[k], numbers[k]
        if r < held or (r == held and j < holder):
            squares[k], numbers[k] = r, j
            r, j = held, holder


@device
def find_nearest(crowd: Crowd, i: int, squares: Any, numbers: Any) -> None:
    """The points nearest to point `i`, as many as `numbers` is long: squared distances and numbers.

    Where there are fewer the rest is infinity and -1.
    """
    for k in range(len(numbers)):
        squares[k], numbers[k] = np.inf, -1
    queue, order, place = crowd.queue, crowd.order, crowd.rank[i]
    x, y, z = queue[place, 0], queue[place, 1], queue[place, 2]
    for step in (-1, 1):
        k = place + step
        while 0 <= k < len(queue):
            a, b, c = queue[k, 0] - x, queue[k, 1] - y, queue[k, 2] - z
            # Nobody further along is nearer: a sum of squares is not rounded below one of them.
            if a * a > squares[-1]:
                break
            r = a * a + b * b + c * c
            if r <= squares[-1]:
                _insert(r, order[k], squares, numbers)
            k += step
