"""The text over a picture: time, slot errors, what the formation waits for, the compass.

Needs pygame; loaded when a renderer is made.
"""

from __future__ import annotations

from contextlib import suppress
from math import sqrt
from typing import final

import numpy as np
import pygame

from formation_env.paths.references import Floats
from formation_env.rendering import style
from formation_env.rendering.camera import Camera
from formation_env.rendering.geometry import grid_spacing
from formation_env.rendering.scene import Scene
from formation_env.rendering.style import Colour

LISTED = 8  # followers up to which each has a line of text; more are shown as a field of cells
LARGE_ERROR = 0.5  # m, at which a cell is fully red


@final
class Hud:
    """Writes on pictures of `size` (width, height) px; the text grows with the picture."""

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self._line = max(10, round(size[1] / 32))  # px from line to line
        self._text_size = max(9, round(0.78 * self._line))
        self._font: pygame.font.Font | None = None
        self._labels: dict[tuple[str, Colour], pygame.Surface] = {}

    def draw(self, picture: pygame.Surface, camera: Camera, scene: Scene) -> None:
        """Write on `picture`, in place."""
        errors = np.linalg.norm(scene.positions[1:] - scene.slots, axis=1)
        self._errors(picture, scene, errors)
        if not scene.started:
            self._banner(picture, "waiting for trigger")
        self._compass(picture, camera)

    def _errors(self, picture: pygame.Surface, scene: Scene, errors: Floats) -> None:
        step, many = self._line, len(errors) > LISTED
        if many:
            columns = int(np.ceil(sqrt(4.0 * len(errors))))
            cell = max(2, min(step // 2, 13 * step // columns))
            rows = -(-len(errors) // columns)
            wide, high = float(max(13 * step, columns * cell)), 3.2 * step + rows * cell
        else:
            wide, high = 9.2 * step, (1.2 + len(errors)) * step
        self._panel(picture, pygame.Rect(step // 2, step // 2, wide + step, high + 0.8 * step))
        x, y = step, round(0.85 * step)
        self._write(picture, f"t = {scene.time:.2f} s", (x, y), style.INK)
        y += round(1.25 * step)
        if many:
            worst = int(errors.argmax())
            line = f"slot error of {len(errors)}: median {np.median(errors):.2f} m"
            self._write(picture, line, (x, y), style.FAINT)
            line = f"largest {errors[worst]:.2f} m (follower_{worst})"
            self._write(picture, line, (x, y + step), style.FAINT)
            self._cells(picture, errors, (x, y + round(2.1 * step)), columns, cell)
            return
        for i, error in enumerate(errors.tolist()):
            middle = (x + step // 4, y + round(0.4 * step))
            pygame.draw.circle(picture, style.vehicle(i + 1), middle, max(2, step // 4))
            label = self._label(f"follower_{i}", style.FAINT)
            picture.blit(label, (x + round(0.9 * step), y))
            colour = style.mix(style.INK, style.BAD, min(error / LARGE_ERROR, 1.0))
            self._write(picture, f"{error:.3f} m", (x + round(6.1 * step), y), colour)
            y += step

    def _cells(
        self,
        picture: pygame.Surface,
        errors: Floats,
        corner: tuple[int, int],
        columns: int,
        cell: int,
    ) -> None:
        """One square per follower, in reading order, the redder the larger its error."""
        calm = style.mix(style.PANEL, style.FOLLOWERS[1], 0.45)
        for i, error in enumerate(errors.tolist()):
            row, column = divmod(i, columns)
            colour = style.mix(calm, style.BAD, min(error / LARGE_ERROR, 1.0))
            left, top = corner[0] + column * cell, corner[1] + row * cell
            picture.fill(colour, (left, top, max(1, cell - 1), max(1, cell - 1)))

    def _banner(self, picture: pygame.Surface, text: str) -> None:
        word = self._label(text, style.LEADER)
        box = word.get_rect(midtop=(self._size[0] // 2, self._line))
        self._panel(picture, box.inflate(2 * self._line, round(0.8 * self._line)))
        picture.blit(word, box)

    def _compass(self, picture: pygame.Surface, camera: Camera) -> None:
        """North and east as they lie on the floor, and the size of the grid's cells."""
        length = 1.7 * self._line
        root = np.array([1.9 * self._line, self._size[1] - 2.3 * self._line])
        for name, axis, colour in (("N", 0, style.NORTH), ("E", 1, style.EAST)):
            # The axis as seen from afar, without perspective.
            tip = root + length * camera.axes[:2, axis]
            pygame.draw.line(picture, colour, root.tolist(), tip.tolist(), 2)
            word = self._label(name, colour)
            at = root + 1.35 * length * camera.axes[:2, axis]
            picture.blit(word, word.get_rect(center=np.rint(at).astype(int).tolist()))
        text = f"grid {grid_spacing(camera.distance):g} m"
        self._write(
            picture, text, (self._line, self._size[1] - round(1.3 * self._line)), style.FAINT
        )

    def _panel(self, picture: pygame.Surface, box: pygame.Rect) -> None:
        panel = pygame.Surface(box.size, pygame.SRCALPHA, 32)
        pygame.draw.rect(
            panel, (*style.PANEL, 190), panel.get_rect(), border_radius=self._line // 2
        )
        picture.blit(panel, box)

    def _write(
        self, picture: pygame.Surface, text: str, corner: tuple[int, int], colour: Colour
    ) -> None:
        picture.blit(self._word(text, colour), corner)

    def _word(self, text: str, colour: Colour) -> pygame.Surface:
        if self._font is not None:
            # A font does not survive `pygame.quit`, which other renderers call.
            with suppress(pygame.error):
                return self._font.render(text, True, colour)
        if not pygame.font.get_init():
            pygame.font.init()
        # Kept, because it keeps the letters it has drawn: that is most of the time of a text.
        self._font = pygame.font.Font(None, round(1.45 * self._text_size))
        return self._font.render(text, True, colour)

    def _label(self, text: str, colour: Colour) -> pygame.Surface:
        """A word that does not change from picture to picture."""
        if (text, colour) not in self._labels:
            self._labels[text, colour] = self._word(text, colour)
        return self._labels[text, colour]
