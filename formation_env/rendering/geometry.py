"""What is drawn, as points in space (inertial frame, m). No pixels here."""

from __future__ import annotations

from math import log2, log10, pi
from typing import NamedTuple

import numpy as np

from formation_env.maths.so3 import rotation
from formation_env.paths.references import Floats

ARM = 0.14  # m, from the middle of a quadrotor to a rotor's hub
HUBS = np.array([[1.0, 1.0, -0.08], [1.0, -1.0, -0.08], [-1.0, -1.0, -0.08], [-1.0, 1.0, -0.08]])
ROTOR = 0.6  # radius of a rotor in arms; neighbours would touch at 0.71
HULL = 0.3  # radius of the hull in arms
GRID_REACH = 2.8  # radius of the floor's grid in distances to the formation
RING = 1.75  # radius of a slot's ring in arms: around all the rotors


class Shapes(NamedTuple):
    """The outlines of `n` vehicles; body axes are forward, right, down."""

    hubs: Floats  # (n, 4, 3): front right, front left, rear left, rear right
    rotors: Floats  # (n, 4, K, 3)
    hull: Floats  # (n, K, 3)
    nose: Floats  # (n, 3), the tip of a short line that points forward
    up: Floats  # (n, 3), unit vector -r3, along the thrust


def rotations(attitudes: Floats) -> Floats:
    """Rotation matrices `(n, 3, 3)`, body to inertial, of quaternions `(n, 4)` (w, x, y, z)."""
    # The one implementation, as Python: its tuple elements may as well be arrays.
    plain = getattr(rotation, "py_func", rotation)
    columns: Floats = np.array(plain(tuple(attitudes.T)))
    return columns.transpose(2, 1, 0)


def circle(points: int) -> Floats:
    """A level unit circle, `(points, 3)`."""
    angle = 2.0 * pi * np.arange(points) / points
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(points)], axis=1)


def quadrotors(positions: Floats, attitudes: Floats, arm: float, points: int) -> Shapes:
    """Vehicles of the given `arm` (m), their circles drawn with so many `points`."""
    R = rotations(attitudes)
    hubs = arm * HUBS * np.array([0.5**0.5, 0.5**0.5, 1.0])
    disc = circle(points)
    rotors = hubs[:, None, :] + ROTOR * arm * disc
    nose = np.array([0.9 * arm, 0.0, 0.0])

    def placed(body: Floats) -> Floats:
        turned = np.einsum("nij,...j->n...i", R, body)
        origin = positions.reshape((len(positions),) + (1,) * (body.ndim - 1) + (3,))
        return np.asarray(origin + turned)

    return Shapes(
        placed(hubs), placed(rotors), placed(HULL * arm * disc), placed(nose), -R[:, :, 2]
    )


def on_floor(points: Floats) -> Floats:
    """The shadows of `points`, light falling straight down."""
    return np.asarray(points * np.array([1.0, 1.0, 0.0]))


def arm_length(distance: float) -> float:
    """The arm to draw (m): its true length, or more where the vehicle would be a speck."""
    return max(ARM, 0.0035 * distance)


def grid_spacing(distance: float) -> float:
    """1, 2 or 5 times a power of ten, m: about a sixth of the distance to the formation."""
    wanted = distance / 6.0
    power: float = 10.0 ** np.floor(log10(wanted))
    return power * min((1.0, 2.0, 5.0, 10.0), key=lambda k: abs(log10(k * power / wanted)))


def floor_grid(middle: Floats, distance: float) -> tuple[Floats, Floats]:
    """Short pieces `(m, 2, 3)` of the grid on the floor about `middle`, and which are on an axis.

    The second is 0 off the axes, 1 on the north axis, 2 on the east axis.
    """
    spacing = grid_spacing(distance)
    reach = int(GRID_REACH * distance / spacing)
    steps = np.arange(-reach, reach + 1)
    offsets = np.round(middle[:2] / spacing)  # whole cells, so that the lines stay where they are
    pieces, axis = [], []
    for along in (0, 1):
        lines = spacing * (steps + offsets[1 - along])
        knots = spacing * (steps[::4] + offsets[along])
        ends = np.zeros((len(lines), len(knots) - 1, 2, 3))
        ends[..., 1 - along] = lines[:, None, None]
        ends[..., 0, along] = knots[:-1]
        ends[..., 1, along] = knots[1:]
        pieces.append(ends.reshape(-1, 2, 3))
        on_axis = np.where(np.abs(lines) < 1e-9 * spacing + 1e-12, along + 1, 0)
        axis.append(np.repeat(on_axis, len(knots) - 1))
    return np.concatenate(pieces), np.concatenate(axis)


def dashes(path: Floats, distance: float) -> Floats:
    """`path` `(M, 3)` as dashes `(m, 2, 3)`, of a length that suits the distance of the camera.

    The length changes by powers of two only, so that dashes do not crawl as the camera moves.
    """
    if len(path) < 2:
        return np.zeros((0, 2, 3))
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    dash = max(0.08 * 2.0 ** round(log2(distance / 5.0)), length[-1] / 600.0)
    if length[-1] < dash:
        return np.zeros((0, 2, 3))
    starts = np.arange(0.0, length[-1], 1.8 * dash)
    at = np.stack([starts, np.minimum(starts + dash, length[-1])], axis=1)
    return np.stack([np.interp(at, length, path[:, i]) for i in range(3)], axis=-1)
