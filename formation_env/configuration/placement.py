"""Where vehicles are: the formation's offsets and the starts, against each other and the floor."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import ceil, inf, sqrt
from typing import Any

import numpy as np

from formation_env.formations import MAX_FOLLOWERS, grid, min_separation
from formation_env.maths.so3 import Vector
from formation_env.paths.references import Floats, by_name
from formation_env.trajectories import Trajectory
from formation_env.validation.checks import require

_NEAREST = 1e-3  # m, least d_x: headings turn at up to V_L / d_x (23)
_RESOLVED = 1000.0  # s
_ASSIGNED = 1024  # followers, in a second or two


def judged(trajectory: Trajectory, duration: float) -> float:
    """Seconds of the path that are looked at: of one without an end no more than are resolved.

    Such paths repeat themselves, and a billion seconds in steps of hours would show inversions that
    there are not.
    """
    return min(duration, _RESOLVED) if trajectory.duration == inf else duration


@lru_cache(maxsize=64)
def lowest(trajectory: Trajectory, duration: float) -> float:
    """Largest `p_z` (lowest point) of the reference, m; the floor is 0."""
    if trajectory.random is not None:
        return -trajectory.random.height + trajectory.random.climb
    span = judged(trajectory, min(duration, trajectory.duration))
    times = np.linspace(0.0, span, max(501, ceil(span / 0.04) + 1))
    return float(by_name(trajectory(times))["p"][:, 2].max())


def check_offsets(
    offsets: Sequence[Vector], trajectory: Trajectory, duration: float, collision: float
) -> None:
    """Offsets (m) with a leader ahead, further apart than `collision` (m), with slots above the floor."""
    require(
        len(offsets) <= MAX_FOLLOWERS,
        "offsets",
        f"{len(offsets)} rows",
        f"at most {MAX_FOLLOWERS} followers",
    )
    for i, d in enumerate(offsets):
        require(
            d[0] >= _NEAREST,
            f"offsets[{i}]",
            d,
            "d_x > 0: Gamma (14) needs d_x != 0, and with the heading started along the leader's "
            f"the zero dynamics (26) are stable only for a leader ahead; {_NEAREST:g} m at least",
        )
    gap = min_separation(np.array(offsets))
    _require_apart("offsets", f"{gap:.3g} m apart", "vehicles", gap, collision)
    low = lowest(trajectory, duration)
    for i, d in enumerate(offsets):
        require(
            low - d[2] < 0.0,
            f"offsets[{i}]",
            d,
            f"a slot above the floor: the leader comes down to p_z = {low:.3g} m "
            "and the slot's height is p_Lz - d_z (32)",
        )


def ground_rows(offsets: Sequence[Vector]) -> Floats:
    """Places on the floor for a formation, `(n, 2)`, m: where each sees the leader from there.

    Rows behind the leader, 0.7 m apart. Who stands where makes the sum of squared distances from place to
    slot least, for then no way crosses another: with `a` between two places and `b` between their slots
    `a . b >= 0`, so that vehicles which get on alike stay `min(|a|, |b|) / sqrt(2)` apart (M. Turpin,
    N. Michael, V. Kumar, *CAPT*, IJRR 33(1), 2014). Above 1,024 followers by blocks of neighbours.
    """
    from scipy.optimize import linear_sum_assignment

    slots = np.array(offsets)[:, :2]
    places = grid(len(slots), ceil(sqrt(len(slots))), ahead=0.7, plane="xy")[:, :2]
    found, blocks = np.empty_like(places), ceil(len(slots) / _ASSIGNED)
    to, of = (np.array_split(np.lexsort(x.T), blocks) for x in (slots, places))
    for slot, place in zip(to, of, strict=True):
        slot, place = np.sort(slot), np.sort(place)
        cost = ((slots[slot, None] - places[place]) ** 2).sum(axis=-1)
        # Of alike ones that in which the first stand in front.
        cost += 1e-9 * np.abs(slot[:, None] - place)
        i, k = linear_sum_assignment(cost)
        found[slot[i]] = places[place[k]]
    return found


def check_ground_starts(points: Sequence[Vector], collision: float) -> None:
    """Start points (m, inertial) on the floor, further apart than `collision` (m)."""
    name = "leader_start and follower_starts"
    on_floor = all(p[2] == 0.0 for p in points)
    heights = f"the heights p_z of {name}"
    require(on_floor, heights, [p[2] for p in points], "p_z = 0, the floor, for each")
    gap = _least_distance(points)
    _require_apart(name, f"{gap:.3g} m apart", "vehicles that start", gap, collision)


def check_start_offset(offsets: Sequence[Vector], radius: float, collision: float) -> None:
    """Balls of `radius` (m) around the slots, further apart than `collision` (m)."""
    to_leader = float(np.linalg.norm(np.array(offsets), axis=1).min())
    gap = min(_least_distance(offsets) - 2.0 * radius, to_leader - radius)
    _require_apart("start_offset", radius, "vehicles that start", gap, collision)


def _require_apart(name: str, value: object, who: str, gap: float, collision: float) -> None:
    expected = f"{who} further apart than limits.collision = {collision:g} m"
    require(gap > collision, name, value, expected)


def _least_distance(points: Any) -> float:
    """Least distance between two of `points`, `(N, 3)`."""
    if len(points) < 2:
        return inf
    from scipy.spatial import cKDTree

    return float(cKDTree(np.array(points)).query(points, k=2)[0][:, 1].min())
