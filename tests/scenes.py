"""Scenes to draw, and what is found in their pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from formation_env.paths.references import Floats
from formation_env.rendering import Renderer, Scene
from formation_env.rendering.camera import Camera, Follow
from formation_env.rendering.style import FAR, NEAR

SIZE = (320, 180)
NO_PATH = np.zeros((0, 3))


def scene(followers: int = 2, time: float = 0.0, started: bool = True, east: float = 0.0) -> Scene:
    """A leader above the origin and a line of followers, level, exactly in their slots."""
    slots = np.zeros((followers, 3))
    slots[:, 0] = -0.5
    slots[:, 1] = east + 0.7 * (np.arange(followers) - 0.5 * (followers - 1))
    slots[:, 2] = -1.2
    positions = np.vstack([[0.0, east, -1.5], slots])
    attitudes = np.tile([1.0, 0.0, 0.0, 0.0], (followers + 1, 1))
    return Scene(time, started, positions, attitudes, slots, NO_PATH)


def picture(*scenes: Scene, size: tuple[int, int] = SIZE) -> NDArray[np.int64]:
    """The last of the frames of a new renderer."""
    renderer = Renderer("rgb_array", 50.0, size)
    frames = [renderer.draw(s) for s in scenes]
    assert frames[-1] is not None
    return frames[-1].astype(np.int64)


def camera_of(s: Scene, size: tuple[int, int] = SIZE) -> Camera:
    return Follow().update(s.time, np.concatenate([s.positions, s.slots]), size)


def coloured(frame: NDArray[np.int64], colour: tuple[int, int, int]) -> Floats:
    """Pixels (x, y) where the floor is at least a third covered by a colour and no other."""
    floor = 0.5 * (np.array(FAR) + np.array(NEAR))
    paint, seen = np.array(colour) - floor, frame - floor
    share = seen @ paint / (paint @ paint)
    off = np.linalg.norm(seen - share[..., None] * paint, axis=-1)
    covered = (share > 0.33) & (off < 0.2 * share * np.linalg.norm(paint))
    rows, columns = np.nonzero(covered)
    return np.stack([columns, rows], axis=1).astype(np.float64)
