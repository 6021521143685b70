"""Pictures of a formation in flight: `Renderer` draws a `Scene` with pygame, on the processor.

`rgb_array` needs neither a display nor a graphics card and opens no window. The same sequence of
scenes gives the same pixels. pygame (extra `render`) is imported when a `Renderer` is made.
"""

from __future__ import annotations

import copy
import os
import sys
from collections import deque
from typing import Any, NamedTuple, final

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from formation_env.paths.references import Floats
from formation_env.rendering.camera import Follow
from formation_env.rendering.scene import Scene
from formation_env.validation.checks import choice, integer, number, require

__all__ = ["Memory", "Renderer", "Scene"]

TRAIL_STEP = 0.08  # s between the points of a trail
TRAIL_LENGTH = 64  # points
TRAIL_BUDGET = 1500  # points of all trails together, which keeps hundreds of vehicles fluid


def _pygame() -> Any:
    try:
        import pygame
    except ImportError as error:
        raise DependencyNotInstalled(
            'rendering needs pygame: run pip install "formation-env[render]"'
        ) from error
    return pygame


class Memory(NamedTuple):
    """What the next picture depends on besides its scene."""

    trail: tuple[tuple[float, Floats], ...]  # times and positions, the oldest first
    follow: Follow


@final
class Renderer:
    """Draws scenes one after the other; remembers the trails and where the camera was.

    `render_mode` is `"rgb_array"` (pictures are returned) or `"human"` (shown in a window at up to
    `fps` pictures a second); `size` is (width, height) in pixels. In the window Escape or its close
    button ends the showing: later scenes are ignored, the program goes on. `memory` is another
    renderer's, which this one continues.

    Raises `ValueError` for an impossible argument, `gymnasium.error.DependencyNotInstalled` without
    pygame, and, when it draws, `RuntimeError` where there is no display for a window.
    """

    def __init__(
        self,
        render_mode: str,
        fps: float,
        size: tuple[int, int] = (960, 540),
        memory: Memory | None = None,
    ) -> None:
        choice("render_mode", render_mode, ("rgb_array", "human"))
        fps = number("fps", fps, 0.0)
        require(
            isinstance(size, tuple) and len(size) == 2, "size", size, "(width, height) in pixels"
        )
        size = (integer("width", size[0], 16, 16384), integer("height", size[1], 16, 16384))
        self._pygame = _pygame()
        from formation_env.rendering.hud import Hud
        from formation_env.rendering.painter import Painter

        self._size = size
        self._painter = Painter(size)
        self._hud = Hud(size)
        self._follow = Follow()
        self._trail: deque[tuple[float, Floats]] = deque(maxlen=TRAIL_LENGTH)
        if memory is not None:
            self._trail.extend(memory.trail)
            self._follow = copy.copy(memory.follow)
        self._window = _Window(self._pygame, fps, size) if render_mode == "human" else None

    def memory(self) -> Memory:
        """The trails and where the camera is."""
        return Memory(tuple(self._trail), copy.copy(self._follow))

    def clear(self) -> None:
        """Forget the trails and where the camera was: a new episode begins."""
        self._trail.clear()
        self._follow.clear()

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """The picture of `scene`, `(height, width, 3)`; in human mode it is shown, and None."""
        if self._window is not None and not self._window.ready():
            return None
        if self._trail and self._trail[0][1].shape != scene.positions.shape:
            self.clear()
        points = np.concatenate([scene.positions, scene.slots])
        camera = self._follow.update(scene.time, points, self._size)
        picture = self._painter.paint(camera, scene, self._extend_trail(scene))
        self._hud.draw(picture, camera, scene)
        if self._window is not None:
            self._window.show(picture)
            return None
        return _pixels(picture)

    def close(self) -> None:
        """Close the window, if there is one. Harmless when repeated."""
        if self._window is not None:
            self._window.close()

    def _extend_trail(self, scene: Scene) -> Floats:
        """Past positions, the oldest first, and the present ones; `(T, 1+n, 3)`."""
        if self._trail and scene.time < self._trail[-1][0]:
            self._trail.clear()
        # Half a microsecond, because times are sums of rounded periods.
        if not self._trail or scene.time - self._trail[-1][0] >= TRAIL_STEP - 5e-7:
            self._trail.append((scene.time, scene.positions.copy()))
        keep = max(6, TRAIL_BUDGET // len(scene.positions))
        past = [positions for _, positions in self._trail][-keep:]
        return np.stack([*past, scene.positions])


def _pixels(picture: Any) -> NDArray[np.uint8]:
    """A copy of a surface of 32 bits a pixel, `(height, width, 3)`."""
    width, height = picture.get_size()
    words = np.frombuffer(picture.get_buffer(), dtype=np.uint8).reshape(height, -1, 4)
    pixels = np.empty((height, width, 3), dtype=np.uint8)
    # Colour by colour, which takes half the time of `pygame.image.tobytes` and a copy.
    for colour, shift in enumerate(picture.get_shifts()[:3]):
        byte = shift // 8 if sys.byteorder == "little" else 3 - shift // 8
        pixels[..., colour] = words[:, :width, byte]
    return pixels


@final
class _Window:
    """The window of human mode, opened by the first picture."""

    def __init__(self, pygame: Any, fps: float, size: tuple[int, int]) -> None:
        self._pygame = pygame
        self._fps = fps
        self._size = size
        self._clock = pygame.time.Clock()
        self._surface: Any = None
        self._dismissed = False

    def ready(self) -> bool:
        """Handle the user's input; whether there is a window to draw for."""
        if self._surface is None and not self._dismissed:
            self._open()
        if self._surface is not None:
            for event in self._pygame.event.get():
                escape = event.type == self._pygame.KEYDOWN and event.key == self._pygame.K_ESCAPE
                if escape or event.type == self._pygame.QUIT:
                    self.close()
                    break
        return self._surface is not None

    def _open(self) -> None:
        display = self._pygame.display
        try:
            display.init()
            # Without a display some builds of SDL draw an invisible window.
            chosen = any(name in os.environ for name in ("SDL_VIDEODRIVER", "SDL_VIDEO_DRIVER"))
            if not chosen and display.get_driver() in ("dummy", "offscreen"):
                raise self._pygame.error("no display found")
            self._surface = display.set_mode(self._size)
            display.set_caption("Formation")
        except self._pygame.error as error:
            display.quit()
            raise RuntimeError(
                f"render_mode = 'human' cannot open a window ({error}): use render_mode='rgb_array', "
                "which needs no display"
            ) from error

    def show(self, picture: Any) -> None:
        self._surface.blit(picture, (0, 0))
        self._pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        self._dismissed = True
        if self._surface is not None:
            self._surface = None
            self._pygame.display.quit()
