"""Chromium without a display, driven by Playwright, for the tests of pages; without it they are skipped."""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

playwright = pytest.importorskip(
    "playwright.sync_api", reason="needs Playwright, of the extra `dev`", exc_type=ImportError
)
image = pytest.importorskip("PIL.Image", reason="needs Pillow, which comes with Matplotlib")

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
NEEDED = pytest.mark.skipif(CHROMIUM is None, reason=f"needs one of {', '.join(NAMES)}")

BASIC = ["--headless=new", "--no-sandbox", "--disable-background-networking"]
SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PATIENCE = 240_000  # ms: software draws slowly on a machine that does much else
DESKTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}


@contextmanager
def launched() -> Iterator[dict[bool, Any]]:
    """Chromium with WebGL, and without, where a page costs little to draw."""
    with playwright.sync_playwright() as engine:
        flags = {True: SOFTWARE_GL, False: ["--disable-3d-apis"]}
        each = {
            webgl: engine.chromium.launch(
                executable_path=CHROMIUM, args=[*BASIC, *own], timeout=PATIENCE
            )
            for webgl, own in flags.items()
        }
        yield each
        for browser in each.values():
            browser.close()


class Opened:
    """A page and what it did that it should not."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.problems: list[str] = []
        self.requests: list[str] = []
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.problems.append(str(error)))
        page.on("dialog", lambda dialog: self.problems.append(dialog.message))
        page.on("request", lambda request: self.requests.append(request.url))

    def _console(self, message: Any) -> None:
        # How many milliseconds software needs to read a picture back is no fault of the page.
        if message.type in ("error", "warning") and "GPU stall" not in message.text:
            self.problems.append(message.text)

    def value(self, script: str) -> Any:
        return self.page.evaluate(script)

    def wait_until(self, script: str) -> None:
        """Until an expression is true: the page's own policy keeps Playwright from waiting by itself."""
        end = time.monotonic() + PATIENCE / 1000
        while not self.value(script):
            assert time.monotonic() < end, script
            self.page.wait_for_timeout(50)

    @property
    def time(self) -> float:
        return float(self.value("replay.clock.time"))

    def picture(self, selector: str) -> np.ndarray:
        """The pixels of an element, once two frames have been drawn."""
        self.value("new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))")
        box = self.page.locator(selector).bounding_box()
        return pixels(self.page.screenshot(clip=box))

    def click(self, selector: str) -> None:
        self.page.locator(selector).click()


def pixels(png: bytes) -> np.ndarray:
    """The picture in a PNG, `(height, width, 3)`."""
    return np.asarray(image.open(io.BytesIO(png)).convert("RGB"))


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """Share of pixels that differ by more than noise."""
    return float((np.abs(one.astype(int) - other).max(axis=-1) > 12).mean())
