"""Draws a scene: the floor first, then everything above it, the farthest first.

Drawn at twice the size and averaged down, which smooths all edges at once and is cheaper than
smoothing each. Needs pygame; loaded when a renderer is made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise, repeat
from typing import Any, final

import numpy as np
import pygame
from pygame import gfxdraw

from formation_env.paths.references import Floats
from formation_env.rendering import style
from formation_env.rendering.camera import NEAR, Camera, project
from formation_env.rendering.geometry import (
    GRID_REACH,
    RING,
    Shapes,
    arm_length,
    circle,
    dashes,
    floor_grid,
    on_floor,
    quadrotors,
)
from formation_env.rendering.scene import Scene
from formation_env.rendering.style import Colour

SUPERSAMPLING = 2
DETAILED = 40  # vehicles up to which circles are finer and heights are marked by a line
FINE = 12.0  # px on the canvas, of an arm; shorter ones get no rims and a plain shadow
ARMS = np.array([[0, 2], [1, 3]])  # hubs that a quadrotor's two arms join
LIMIT = 16_000.0  # px; gfxdraw takes 16-bit coordinates


@final
class Painter:
    """Paints scenes for pictures of `size` (width, height) px, without the text."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self._large = (SUPERSAMPLING * size[0], SUPERSAMPLING * size[1])
        self._canvas = pygame.Surface(self._large, 0, 32)
        self._picture = pygame.Surface(size, 0, 32)
        self._bands = _bands(self._large)
        self._tasks: list[tuple[float, Callable[..., Any], tuple[Any, ...]]] = []
        # Lines that are to be queued: ends, colours, strengths and widths.
        self._pieces: list[tuple[Floats, Floats, Floats, Any]] = []
        self._camera: Camera

    def paint(self, camera: Camera, scene: Scene, trail: Floats) -> pygame.Surface:
        """The picture of `scene`; `trail` `(T, 1+n, 3)` holds past positions, the oldest first.

        The surface is overwritten by the next call.
        """
        # The same view on the larger canvas.
        self._camera = camera._replace(
            focal=SUPERSAMPLING * camera.focal, centre=SUPERSAMPLING * camera.centre
        )
        arm = arm_length(camera.distance)
        detailed = len(scene.positions) <= DETAILED
        shapes = quadrotors(scene.positions, scene.attitudes, arm, 20 if detailed else 8)
        self._fine = self._camera.focal * arm > FINE * camera.distance
        # Filled: copying a background would take twice the time.
        for colour, area in self._bands:
            self._canvas.fill(colour, area)
        self._shadows(shapes)
        self._floor(camera.eye + camera.distance * camera.axes[2])
        self._tasks.clear()
        self._pieces.clear()
        self._path(scene.path)
        self._trails(trail)
        self._slots(scene, arm, 24 if detailed else 12)
        if detailed:
            self._plumb_lines(scene.positions)
        self._queue_lines()
        self._vehicles(scene.positions, shapes)
        for _, draw, arguments in sorted(self._tasks, key=lambda task: -task[0]):
            draw(*arguments)
        return pygame.transform.smoothscale(self._canvas, self.size, self._picture)

    # -- on the floor -----------------------------------------------------------------------------

    def _shadows(self, shapes: Shapes) -> None:
        if not self._fine:
            return self._shade(shapes.hubs, 60)
        self._shade(shapes.rotors, 34)
        self._shade(shapes.hull, 60)
        hubs, visible = self._pixels(on_floor(shapes.hubs))
        arms = hubs[visible.all(axis=-1)][:, ARMS].reshape(-1, 2, 2)
        colour = style.mix(style.NEAR, style.SHADOW, 0.35)
        self._lines(arms, repeat(colour), np.full(len(arms), 3))

    def _shade(self, outlines: Floats, alpha: int) -> None:
        """The shadows of polygons `(..., K, 3)`."""
        pixels, visible = self._pixels(on_floor(outlines))
        for polygon in pixels[visible.all(axis=-1)].tolist():
            gfxdraw.filled_polygon(self._canvas, polygon, (*style.SHADOW, alpha))

    def _floor(self, aim: Floats) -> None:
        pieces, axis = floor_grid(aim, self._camera.distance)
        away = np.linalg.norm(pieces.mean(axis=1)[:, :2] - aim[:2], axis=1)
        strength = np.clip(1.2 - 1.2 * away / (GRID_REACH * self._camera.distance), 0.0, 1.0)
        colours = np.array([style.GRID, style.NORTH, style.EAST], dtype=np.float64)[axis]
        widths = np.where(axis > 0, 3, 2)
        pixels, visible = self._pixels(pieces)
        shown = self._shown(pixels, visible) & (strength > 0.02)
        pixels = pixels[shown]
        tints = self._tint(colours[shown], 0.75 * strength[shown], pixels.mean(axis=1)[:, 1])
        self._lines(pixels, tints, widths[shown])

    # -- above the floor, farthest first ----------------------------------------------------------

    def _path(self, path: Floats) -> None:
        pieces = dashes(path, self._camera.distance)
        colours = np.broadcast_to(np.array(style.LEADER, dtype=np.float64), (len(pieces), 3))
        self._add_lines(pieces, colours, np.full(len(pieces), 0.55), np.full(len(pieces), 2))

    def _trails(self, trail: Floats) -> None:
        if len(trail) < 2:
            return
        pieces = np.stack([trail[:-1], trail[1:]], axis=2)  # (T-1, 1+n, 2, 3)
        steps, vehicles = pieces.shape[:2]
        age = np.arange(1, steps + 1) / steps  # 1 is new
        colours = np.array([style.vehicle(i) for i in range(vehicles)], dtype=np.float64)
        self._add_lines(
            pieces.reshape(-1, 2, 3),
            np.tile(colours, (steps, 1)),
            np.repeat(0.05 + 0.75 * age, vehicles),
            np.repeat(np.where(age > 0.5, 4, 3), vehicles),
        )

    def _slots(self, scene: Scene, arm: float, points: int) -> None:
        rings = scene.slots[:, None, :] + RING * arm * circle(points)
        pixels, visible = self._pixels(rings)
        depth = self._depth(scene.slots)
        for i in np.flatnonzero(visible.all(axis=-1)).tolist():
            arguments = (pixels[i].tolist(), style.vehicle(i + 1), 46, 0.5)
            # Under its own vehicle, which it surrounds.
            self._tasks.append((depth[i] + RING * arm, self._disc, arguments))
        links = np.stack([scene.slots, scene.positions[1:]], axis=1)
        colours = np.array([style.vehicle(i + 1) for i in range(len(links))], dtype=np.float64)
        self._add_lines(links, colours, np.full(len(links), 0.7), np.full(len(links), 3))

    def _plumb_lines(self, positions: Floats) -> None:
        lines = np.stack([positions, on_floor(positions)], axis=1)
        colours = np.broadcast_to(np.array(style.SHADOW, dtype=np.float64), (len(lines), 3))
        self._add_lines(lines, colours, np.full(len(lines), 0.25), np.full(len(lines), 2))

    def _vehicles(self, positions: Floats, shapes: Shapes) -> None:
        depth = self._depth(positions)
        hubs, visible = self._pixels(shapes.hubs)
        rotors, _ = self._pixels(shapes.rotors)
        hulls, _ = self._pixels(shapes.hull)
        noses, _ = self._pixels(shapes.nose)
        rotor_depth = self._depth(shapes.hubs)
        from_above = np.einsum("ni,ni->n", shapes.up, self._camera.eye - positions) > 0.0
        # The two arms, and the line from the middle to the nose.
        ahead = np.stack([hulls.mean(axis=1), noses], axis=1)
        beams = np.concatenate([hubs[:, ARMS], ahead[:, None]], axis=1)
        width = max(2, int(self._camera.focal * 0.02 / max(self._camera.distance, 1e-9)))
        widths = _widths(beams.reshape(-1, 2, 2), width).reshape(-1, 3).tolist()
        for i in np.flatnonzero(visible.all(axis=-1)).tolist():
            order = np.argsort(-rotor_depth[i]).tolist()
            outlines = [(k, rotors[i, k].tolist()) for k in order]
            frame = (beams[i].tolist(), widths[i], hulls[i].tolist())
            arguments = (frame, outlines, style.vehicle(i), bool(from_above[i]))
            self._tasks.append((float(depth[i]), self._vehicle, arguments))

    def _vehicle(
        self,
        frame: tuple[Any, Any, Any],
        rotors: list[tuple[int, Any]],
        colour: Colour,
        from_above: bool,
    ) -> None:
        """A cross with four discs; the front two are the darker. What is behind is drawn first."""
        if not from_above:
            self._frame(frame, colour)
        for k, outline in rotors:
            self._disc(outline, colour, 150 if k < 2 else 70, 0.85)
        if from_above:
            self._frame(frame, colour)

    def _frame(self, frame: tuple[Any, Any, Any], colour: Colour) -> None:
        beams, widths, hull = frame
        dark = style.mix(colour, style.INK, 0.45)
        tints = (dark, dark, style.INK) if self._fine else (dark, dark)
        for (a, b), tint, width in zip(beams, tints, widths, strict=False):
            pygame.draw.line(self._canvas, tint, a, b, width)
        if not self._fine:
            return
        pygame.draw.polygon(self._canvas, colour, hull)
        pygame.draw.lines(self._canvas, dark, True, hull, 2)

    # -- on the canvas ----------------------------------------------------------------------------

    def _add_lines(self, pieces: Floats, colours: Floats, strength: Floats, widths: Any) -> None:
        """Have lines `(m, 2, 3)` drawn in their turn, blended with the floor behind them."""
        self._pieces.append((pieces, colours, strength, widths))

    def _queue_lines(self) -> None:
        """Queue the lines that have been added, all at once."""
        pieces, colours, strength, widths = map(np.concatenate, zip(*self._pieces, strict=True))
        pixels, visible = self._pixels(pieces)
        shown = self._shown(pixels, visible)
        depth = self._depth(pieces[shown].mean(axis=1))
        pixels = pixels[shown]
        tints = self._tint(colours[shown], strength[shown], pixels.mean(axis=1)[:, 1])
        widths = _widths(pixels, widths[shown])
        for far, (a, b), tint, width in zip(
            depth.tolist(), pixels.tolist(), tints, widths.tolist(), strict=True
        ):
            self._tasks.append((far, pygame.draw.line, (self._canvas, tint, a, b, width)))

    def _lines(self, lines: Any, colours: Iterable[Any], widths: Any) -> None:
        """Draw lines `(m, 2, 2)` px at once."""
        for (a, b), colour, width in zip(
            lines.tolist(), colours, _widths(lines, widths).tolist(), strict=False
        ):
            pygame.draw.line(self._canvas, colour, a, b, width)

    def _disc(self, outline: Any, colour: Colour, alpha: int, rim: float) -> None:
        gfxdraw.filled_polygon(self._canvas, outline, (*colour, alpha))
        if self._fine:
            pygame.draw.lines(self._canvas, style.mix(style.FAR, colour, rim), True, outline, 2)

    def _pixels(self, points: Floats) -> tuple[Any, Any]:
        """Whole pixels `(..., 2)` on the canvas and whether each is in front of the camera `(...)`."""
        pixels, depth = project(self._camera, points)
        visible = (depth > NEAR * self._camera.distance) & (np.abs(pixels) < LIMIT).all(axis=-1)
        return np.rint(np.clip(pixels, -LIMIT, LIMIT)).astype(np.int64), visible

    def _shown(self, lines: Any, visible: Any) -> Any:
        """Which `lines` `(m, 2, 2)` px may cross the canvas."""
        inside = (lines.max(axis=1) >= 0) & (lines.min(axis=1) <= np.array(self._large))
        return visible.all(axis=-1) & inside.all(axis=-1)

    def _depth(self, points: Floats) -> Any:
        return project(self._camera, points)[1]

    def _tint(self, colours: Floats, strength: Floats, rows: Floats) -> list[list[int]]:
        tinted: list[list[int]] = style.over_ground(
            colours, strength, rows, self._large[1]
        ).tolist()
        return tinted


def _bands(size: tuple[int, int]) -> list[tuple[list[int], tuple[int, int, int, int]]]:
    """The floor's colours from the top to the bottom of a canvas, and the areas of one colour."""
    rows = np.rint(style.ground(np.arange(float(size[1])), size[1])).astype(int)
    changes = np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1)) + 1
    edges = [0, *changes.tolist(), size[1]]
    return [(rows[a].tolist(), (0, a, size[0], b - a)) for a, b in pairwise(edges)]


def _widths(lines: Any, widths: Any) -> Any:
    """What pygame is to be told so that `lines` `(m, 2, 2)` px get these `widths`.

    It measures the width of a slanted line along an axis, not across the line.
    """
    along = np.abs(lines[:, 1] - lines[:, 0])
    longest = np.maximum(along.max(axis=1), 1)
    slant = np.hypot(along[:, 0], along[:, 1]) / longest
    return np.rint(widths * np.maximum(slant, 1.0)).astype(np.int64)
