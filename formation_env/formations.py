"""Offsets `d_i` of the usual formations, for any number of followers.

`d_i` is where follower `i` sees the leader in its own formation frame: x forward, y right, z down,
in metres. All helpers put the followers behind the leader (`d_x > 0`, which the planner needs) and
`below` it: `d_z = -below`, so with `below = 0.3` the leader is 0.3 m above them.
A formation is rigid exactly if all `d_x` are equal: then all headings follow the same zero dynamics
(23) and the followers keep their distances from each other (II-D). Otherwise they lag by different
times and the formation bends in curves; each follower still keeps its own offset.

| helper           | seen from above or behind                  | rigid                      |
|------------------|--------------------------------------------|----------------------------|
| `paper_pair`     | two, left and right behind the leader      | yes                        |
| `line`           | side by side, across the direction         | yes                        |
| `stack`          | pairs above each other                     | yes                        |
| `grid` in `yz`   | an upright wall of rows                    | yes                        |
| `circle` in `yz` | an upright ring                            | yes                        |
| `wedge`          | a V with the leader at its tip             | up to 2 followers          |
| `column`         | one behind the other                       | 1 follower                 |
| `grid` in `xy`   | rows behind each other                     | one row                    |
| `circle` in `xy` | a flat ring behind the leader              | 1 follower                 |

Followers with `d_y > 0` see the leader on their right: they fly on its left.
"""

from __future__ import annotations

from math import cos, inf, pi, sin, sqrt
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from formation_env.checks import require
from formation_env.references import Floats

Plane = Literal["xy", "yz"]


def paper_pair() -> Floats:
    """The two followers of III-C: `d = (0.35, +-0.35, -0.3)` m. Rigid."""
    return np.array([[0.35, 0.35, -0.3], [0.35, -0.35, -0.3]])


def stack(n: int, spacing: float = 0.7, ahead: float = 0.35, below: float = 0.3) -> Floats:
    """III-C's pair, and more such pairs above it, each `spacing` m above the last. Rigid.

    However many there are, `|(d_x, d_y)|` stays small: no virtual follower inverts on a path on which
    the pair does not (29)-(30). Left and right are `spacing` m apart.
    """
    _check(n, below, spacing=spacing, ahead=ahead)
    level, side = np.divmod(np.arange(n), 2)
    across = 0.5 * spacing * (1.0 - 2.0 * side)
    return _offsets(np.full(n, ahead), across, below - spacing * level)


def line(n: int, spacing: float = 0.7, ahead: float = 0.35, below: float = 0.3) -> Floats:
    """Side by side, `spacing` m apart, the leader `ahead` m before the middle. Rigid.

    From left to right; `line(2)` is the paper's pair.
    """
    _check(n, below, spacing=spacing, ahead=ahead)
    return _offsets(np.full(n, ahead), _abreast(n, spacing), np.full(n, below))


def wedge(n: int, spacing: float = 0.7, half_angle: float = pi / 4, below: float = 0.3) -> Floats:
    """A V with the leader at its tip, `spacing` m along each arm. Rigid up to two followers.

    Left and right in turn; `half_angle` (rad, between 0 and pi/2) is that between an arm and the
    direction of flight. Wide wedges keep `d_x` small, which curves of the leader ask for (29)-(30).
    """
    _check(n, below, spacing=spacing)
    require(0.0 < half_angle < 0.5 * pi, "half_angle", half_angle, "between 0 and pi/2 rad")
    rank = 1.0 + np.arange(n) // 2
    side = np.where(np.arange(n) % 2 == 0, 1.0, -1.0)
    across = side * rank * spacing * sin(half_angle)
    return _offsets(rank * spacing * cos(half_angle), across, np.full(n, below))


def column(n: int, spacing: float = 0.7, below: float = 0.3) -> Floats:
    """One behind the other, `spacing` m apart, the first that far behind the leader. Not rigid."""
    _check(n, below, spacing=spacing)
    return _offsets(spacing * (1.0 + np.arange(n)), np.zeros(n), np.full(n, below))


def grid(
    n: int,
    columns: int,
    spacing: float = 0.7,
    ahead: float = 0.35,
    below: float = 0.3,
    plane: Plane = "xy",
) -> Floats:
    """Rows of `columns` followers, `spacing` m apart both ways; the last row may be shorter.

    In `"xy"` the rows fly one behind the other, the first `ahead` m behind the leader: not rigid
    beyond one row. In `"yz"` they fly one above the other, all `ahead` m behind, from the top row
    down, the wall's middle `below` m below the leader: rigid, but keep its foot off the floor.
    """
    _check(n, below, spacing=spacing, ahead=ahead)
    _whole("columns", columns)
    _plane(plane)
    row = np.arange(n) // columns
    across = np.concatenate(
        [_abreast(min(columns, n - first), spacing) for first in range(0, n, columns)]
    )
    if plane == "xy":
        return _offsets(ahead + spacing * row, across, np.full(n, below))
    return _offsets(np.full(n, ahead), across, below + spacing * (row - 0.5 * row[-1]))


def circle(
    n: int, radius: float = 1.0, ahead: float = 1.5, below: float = 0.3, plane: Plane = "xy"
) -> Floats:
    """A ring of `radius` m with its centre `ahead` m behind the leader, evenly filled.

    In `"xy"` it lies flat and needs `ahead > radius`, so that all followers are behind the leader:
    not rigid. In `"yz"` it stands upright across the direction of flight: rigid.
    """
    _check(n, below, radius=radius, ahead=ahead)
    _plane(plane)
    angle = 2.0 * pi * np.arange(n) / n
    if plane == "yz":
        down = below - radius * np.sin(angle)
        return _offsets(np.full(n, ahead), radius * np.cos(angle), down)
    require(ahead > radius, "ahead", ahead, f"more than the radius {radius} m (d_x > 0)")
    return _offsets(ahead + radius * np.cos(angle), radius * np.sin(angle), np.full(n, below))


def is_rigid(offsets: ArrayLike) -> bool:
    """Whether the followers keep their distances from each other: all `d_x` equal (II-D)."""
    d = _rows(offsets)
    return bool((d[:, 0] == d[0, 0]).all())


def min_separation(offsets: ArrayLike) -> float:
    """The least distance between any two vehicles, the leader included, m.

    Of the formation as `d_i` describes it, all headings equal: exact for a rigid one at all times,
    for others along a straight line.
    """
    points = np.vstack([_rows(offsets), np.zeros(3)])
    least = inf
    for i in range(1, len(points)):
        step = points[:i] - points[i]
        least = min(least, float(np.einsum("ij,ij->i", step, step).min()))
    return sqrt(least)


def _offsets(ahead: ArrayLike, right: ArrayLike, below: ArrayLike) -> Floats:
    """Rows `(d_x, d_y, d_z)`: the leader `ahead`, to the `right`, and `below` the leader."""
    return np.stack([ahead, right, np.negative(below)], axis=1, dtype=np.float64)


def _abreast(n: int, spacing: float) -> Floats:
    """`d_y` of `n` followers side by side, from left to right, about the middle."""
    return spacing * (0.5 * (n - 1) - np.arange(n, dtype=np.float64))


def _rows(offsets: ArrayLike) -> Floats:
    d = np.asarray(offsets, dtype=np.float64)
    good = d.ndim == 2 and d.shape[1] == 3 and len(d) > 0 and bool(np.isfinite(d).all())
    require(good, "offsets", offsets, "one row of 3 finite numbers per follower")
    return d


def _whole(name: str, value: object) -> None:
    whole = isinstance(value, (int, np.integer)) and value >= 1
    require(bool(whole), name, value, "a whole number from 1")


def _check(n: int, below: float, **lengths: float) -> None:
    _whole("n", n)
    require(bool(np.isfinite(below)), "below", below, "a finite length, m")
    for name, value in lengths.items():
        good = bool(np.isfinite(value)) and value > 0.0
        require(good, name, value, "a finite length above 0 m")


def _plane(plane: str) -> None:
    require(plane in ("xy", "yz"), "plane", plane, '"xy" or "yz"')
