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
All give an array of shape `(n, 3)` for `n` up to 4,096 and raise `ValueError` naming the argument.
"""

from __future__ import annotations

from math import cos, inf, pi, sin, sqrt
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from formation_env.paths.references import Floats
from formation_env.paths.tables import LARGEST
from formation_env.validation.checks import array, choice, integer, number, require

Plane = Literal["xy", "yz"]
_PLANES = ("xy", "yz")

MAX_FOLLOWERS = 4096


def paper_pair() -> Floats:
    """The two followers of III-C: `d = (0.35, +-0.35, -0.3)` m. Rigid."""
    return np.array([[0.35, 0.35, -0.3], [0.35, -0.35, -0.3]])


def stack(n: int, spacing: float = 0.7, ahead: float = 0.35, below: float = 0.3) -> Floats:
    """III-C's pair, and more such pairs above it, each `spacing` m above the last. Rigid.

    However many there are, `|(d_x, d_y)|` stays small: no virtual follower inverts on a path on which
    the pair does not (29)-(30). Left and right are `spacing` m apart.
    """
    n, below = _count("n", n), _height(below)
    spacing, ahead = _length("spacing", spacing), _length("ahead", ahead)
    level, side = np.divmod(np.arange(n), 2)
    across = 0.5 * spacing * (1.0 - 2.0 * side)
    return _offsets(np.full(n, ahead), across, below - spacing * level)


def line(n: int, spacing: float = 0.7, ahead: float = 0.35, below: float = 0.3) -> Floats:
    """Side by side, `spacing` m apart, the leader `ahead` m before the middle. Rigid.

    From left to right; `line(2)` is the paper's pair.
    """
    n, below = _count("n", n), _height(below)
    spacing, ahead = _length("spacing", spacing), _length("ahead", ahead)
    return _offsets(np.full(n, ahead), _abreast(n, spacing), np.full(n, below))


def wedge(n: int, spacing: float = 0.7, half_angle: float = pi / 4, below: float = 0.3) -> Floats:
    """A V with the leader at its tip, `spacing` m along each arm. Rigid up to two followers.

    Left and right in turn; `half_angle` (rad, between 0 and pi/2) is that between an arm and the
    direction of flight. Wide wedges keep `d_x` small, which curves of the leader ask for (29)-(30).
    """
    n, spacing, below = _count("n", n), _length("spacing", spacing), _height(below)
    angle = number("half_angle", half_angle)
    require(0.0 < angle < 0.5 * pi, "half_angle", half_angle, "between 0 and pi/2 rad")
    rank = 1.0 + np.arange(n) // 2
    side = np.where(np.arange(n) % 2 == 0, 1.0, -1.0)
    across = side * rank * spacing * sin(angle)
    return _offsets(rank * spacing * cos(angle), across, np.full(n, below))


def column(n: int, spacing: float = 0.7, below: float = 0.3) -> Floats:
    """One behind the other, `spacing` m apart, the first that far behind the leader. Not rigid."""
    n, spacing, below = _count("n", n), _length("spacing", spacing), _height(below)
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
    n, columns = _count("n", n), _count("columns", columns)
    spacing, ahead, below = _length("spacing", spacing), _length("ahead", ahead), _height(below)
    choice("plane", plane, _PLANES)
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
    n, below = _count("n", n), _height(below)
    radius, ahead = _length("radius", radius), _length("ahead", ahead)
    choice("plane", plane, _PLANES)
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
    """Offsets `(followers, 3)`, m."""
    return array("offsets", offsets, (None, 3), -LARGEST, LARGEST)


def _count(name: str, value: int) -> int:
    """A number of followers."""
    return integer(name, value, 1, MAX_FOLLOWERS)


def _length(name: str, value: float) -> float:
    """A length above 0, m."""
    return number(name, value, 0.0, LARGEST)


def _height(below: float) -> float:
    """The height of the leader above the followers, of either sign, m."""
    return number("below", below, -LARGEST, LARGEST)
