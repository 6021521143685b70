"""Where the picture is taken from, and the perspective projection.

Everything is in the inertial frame (north, east, down), m; pixels count from the upper left corner.
The camera looks from a fixed side and height, so that north stays where it is on the screen, and
only its aim and its distance follow the formation.
"""

from __future__ import annotations

from math import cos, exp, radians, sin, tan
from typing import NamedTuple, final

import numpy as np

from formation_env.paths.references import Floats

AZIMUTH = radians(32.0)  # of the view, from north towards east
ELEVATION = radians(25.0)  # of the camera above the formation; half the field of view and more, so
# that the horizon is above the picture and everything has the floor behind it
FIELD = radians(38.0)  # of view, across the shorter side of the picture
FILL = 0.74  # share of the picture that the formation may take
CLOSEST = 3.4  # m
NEAR = 0.05  # share of the distance to the aim; what is nearer than that is not drawn


def _axes() -> Floats:
    """Those of every camera, `(3, 3)`: see `Camera.axes`."""
    forward = np.array(
        [cos(ELEVATION) * cos(AZIMUTH), cos(ELEVATION) * sin(AZIMUTH), sin(ELEVATION)]
    )
    right = np.array([-sin(AZIMUTH), cos(AZIMUTH), 0.0])
    return np.stack([right, np.cross(forward, right), forward])


AXES = _axes()


class Camera(NamedTuple):
    """A pinhole camera."""

    eye: Floats  # (3,), m
    axes: Floats  # (3, 3), rows: right, down in the picture, and forward; orthonormal
    focal: float  # px
    centre: Floats  # (2,), px, where the axis meets the picture
    distance: float  # m, from the eye to what it is aimed at


def look(aim: Floats, distance: float, size: tuple[int, int]) -> Camera:
    """The camera `distance` m from `aim` for a picture of `size` (width, height) px."""
    return Camera(
        eye=aim - distance * AXES[2],
        axes=AXES,
        focal=0.5 * min(size) / tan(0.5 * FIELD),
        centre=0.5 * np.array(size, dtype=np.float64),
        distance=distance,
    )


def project(camera: Camera, points: Floats) -> tuple[Floats, Floats]:
    """Pixels `(..., 2)` and depths `(...)` (m along the axis) of `points` `(..., 3)`.

    The pixel of a point at no positive depth means nothing; callers look at the depth first.
    """
    in_axes = (points - camera.eye) @ camera.axes.T
    depth = in_axes[..., 2]
    scale = camera.focal / np.maximum(depth, 1e-9)
    return camera.centre + scale[..., None] * in_axes[..., :2], depth


@final
class Follow:
    """Aims the camera at the formation and keeps all of it in the picture, smoothly.

    Low-pass filters in simulated time, so the same scenes give the same pictures at any frame rate
    of the screen. The first scene after `clear`, or after a jump back in time, is taken at once.
    """

    AIM_LAG = 0.35  # s
    DISTANCE_LAG = 1.0  # s

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget the last scene."""
        self._time: float | None = None
        self._aim = np.zeros(3)
        self._distance = 0.0

    def update(self, time: float, points: Floats, size: tuple[int, int]) -> Camera:
        """The camera at `time` (s) for vehicles and slots at `points` `(N, 3)`."""
        aim, distance = _frame(points, size)
        if self._time is None or time < self._time:
            self._aim, self._distance = aim, distance
        else:
            dt = time - self._time
            self._aim = aim + exp(-dt / self.AIM_LAG) * (self._aim - aim)
            held = exp(-dt / self.DISTANCE_LAG) * (self._distance - distance)
            self._distance = distance + held
        self._time = time
        return look(self._aim, self._distance, size)


def _frame(points: Floats, size: tuple[int, int]) -> tuple[Floats, float]:
    """The aim and the distance that just show `points` and, unless they fly high, their shadows."""
    extent = max(float(np.ptp(points, axis=0).max()), 0.5)
    below = points.copy()
    below[:, 2] = np.minimum(0.0, points[:, 2] + 2.5 * extent)
    shown = np.concatenate([points, below])
    aim = 0.5 * (shown.min(axis=0) + shown.max(axis=0))
    camera = look(aim, 0.0, size)
    x, y, depth = (camera.axes @ (shown - aim).T).tolist()
    reach = FILL * camera.centre / camera.focal  # tangents of the usable half angles
    # |x| / (depth + distance) <= reach, and the same for y.
    wanted = np.maximum(np.abs(x) / reach[0], np.abs(y) / reach[1]) - depth
    return aim, max(float(wanted.max()), CLOSEST)
