"""Windows, displays, and machines without pygame."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from scenes import SIZE, picture, scene

from formation_env.rendering import Renderer

pygame = pytest.importorskip("pygame")
Painter = pytest.importorskip("formation_env.rendering.painter").Painter


def run_python(code: str, **environment: str) -> str:
    dropped = ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY")
    kept = {k: v for k, v in os.environ.items() if k not in dropped}
    root = str(Path(__file__).resolve().parent.parent)
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=root,
        env={**kept, "PYTHONPATH": root, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


DRAW = """
import sys, numpy as np
from formation_env.rendering import Renderer, Scene
assert "pygame" not in sys.modules
p = np.array([[0.0, 0.0, -1.5], [-0.5, 0.3, -1.2]])
scene = Scene(0.0, True, p, np.tile([1.0, 0, 0, 0], (2, 1)), p[1:], p)
frame = Renderer("rgb_array", 50.0, (320, 180)).draw(scene)
import pygame
assert not pygame.display.get_init()
print(frame.std() > 5.0)
"""


def test_pictures_need_no_display_and_import_pygame_late() -> None:
    assert run_python(DRAW).splitlines()[-1] == "True"


def test_a_window_shows_the_picture_and_can_be_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer = Renderer("human", 1000.0, SIZE)
    assert renderer.draw(scene()) is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    assert np.array_equal(shown, picture(scene()))
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_SPACE))
    assert renderer.draw(scene(time=0.02)) is None
    assert pygame.display.get_init()
    renderer.close()
    renderer.close()
    assert not pygame.display.get_init()


@pytest.mark.parametrize("how", ["escape", "button"])
def test_dismissing_the_window_does_not_stop_the_program(
    how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer = Renderer("human", 1000.0, SIZE)
    renderer.draw(scene())
    key = pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE)
    pygame.event.post(key if how == "escape" else pygame.event.Event(pygame.QUIT))
    for time in (0.02, 0.04):
        assert renderer.draw(scene(time=time)) is None
        assert not pygame.display.get_init()
    renderer.close()


def test_a_window_keeps_to_the_frame_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer = Renderer("human", 20.0, SIZE)
    renderer.draw(scene())
    start = pygame.time.get_ticks()
    for k in range(1, 7):
        renderer.draw(scene(time=0.02 * k))
    renderer.close()
    assert pygame.time.get_ticks() - start > 0.9 * 6 * 50.0


def test_without_pygame_the_command_that_installs_it_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r'pip install "formation-env\[render\]"'):
        Renderer("rgb_array", 50.0)


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="render_mode = 'ascii'"):
        Renderer("ascii", 50.0)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"fps": 0.0}, "fps"),
        ({"fps": "50"}, "fps"),
        ({"fps": np.nan}, "fps"),
        ({"size": 300}, "size"),
        ({"size": (300.0, 200)}, "width"),
        ({"size": (300, 10**9)}, "height"),
    ],
)
def test_impossible_numbers_are_refused(options: dict[str, Any], name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name} = "):
        Renderer(**{"render_mode": "rgb_array", "fps": 50.0, **options})


NO_DISPLAY = """
import gymnasium as gym, numpy as np
from formation_env import formation_v0
def single(**options):
    return gym.make("formation_env:Formation-v0", **options)
for make in (single, formation_v0.parallel_env, formation_v0.env):
    env = make(render_mode="human")
    for _ in range(2):
        try:
            env.reset(seed=0)
        except RuntimeError as error:
            print(type(error).__name__, error)
    env.close()
"""


@pytest.mark.parametrize("driver", [None, "x11", "nonsense"])
def test_without_a_display_the_mode_that_needs_none_is_named(driver: str | None) -> None:
    """On every face; also where SDL would draw into a window that is not shown."""
    said = run_python(NO_DISPLAY, **({} if driver is None else {"SDL_VIDEODRIVER": driver}))
    errors = [line for line in said.splitlines() if line.startswith("RuntimeError")]
    assert len(errors) == 6
    for line in errors:
        assert "render_mode = 'human' cannot open a window" in line
        assert "use render_mode='rgb_array'" in line
