"""The page in a real browser, opened from the disk: Chromium without a display, driven by Playwright."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import browsers
import numpy as np
import pytest
from browsers import DESKTOP, PATIENCE, PHONE, Opened, changed
from replays import flown

from baselines.replay import Replay

pytestmark = browsers.NEEDED


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Pages of one flight, of two, and of names that are markup."""
    folder = tmp_path_factory.mktemp("pages")
    crash = flown("random", 0, scenario="paper", duration=40.0)
    e = flown("expert", 3, duration=6.0)
    odd = e._replace(policy="<img src=x onerror=alert(1)></script><script>alert(2)</script>")
    each = {"one": [e], "two": [e, crash], "odd": [odd, odd]}
    return {name: Replay(list(x)).write(folder / f"{name}.html") for name, x in each.items()}


@pytest.fixture(scope="module")
def chromium() -> Iterator[dict[bool, Any]]:
    with browsers.launched() as found:
        yield found


@pytest.fixture
def opened(chromium: dict[bool, Any], files: dict[str, Path]) -> Iterator[Any]:
    """Opens a page by its name, in a window of its own; afterwards nothing may have gone wrong."""
    contexts, pages = [], []

    def open_page(
        name: str, at: str = "#t=2", webgl: bool = True, check: bool = True, **options: Any
    ) -> Opened:
        context = chromium[webgl].new_context(**{"viewport": DESKTOP, **options})
        context.set_default_timeout(PATIENCE)
        contexts.append(context)
        found = Opened(context.new_page())
        found.page.goto(files[name].as_uri() + at)
        found.page.wait_for_selector("html[data-ready=true]", state="attached")
        if check:
            pages.append(found)
        return found

    yield open_page
    for found in pages:
        assert found.problems == []
        assert [url for url in found.requests if not url.startswith(("file:", "data:"))] == []
        assert len([url for url in found.requests if url.startswith("file:")]) == 1
    for context in contexts:
        context.close()


SCENE = "section.view >> nth=0"


def test_the_scene_is_drawn_and_follows_the_time(opened: Any) -> None:
    found = opened("one")
    assert found.value("!!replay.stage")
    first = found.picture(SCENE)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 500, "vehicles, floor and shadows"
    assert changed(first, found.picture(SCENE)) == 0.0, "it stands still"
    found.page.locator("#scrub").fill("5")
    assert found.time == 5.0
    assert found.page.locator("#time").text_content() == "5.00 s"
    assert found.page.locator("#scrub").get_attribute("aria-valuetext") == "5.00 s of 6.0 s"
    later = found.picture(SCENE)
    assert changed(first, later) > 0.005
    found.page.locator("#scrub").fill("2")
    assert changed(first, found.picture(SCENE)) < 0.001, "and back again"


def test_vehicles_are_where_the_episode_has_them(opened: Any) -> None:
    """Each label stands above its vehicle: the projection of what the environment gave."""
    found = opened("one")
    e = flown("expert", 3, duration=6.0)
    for name, camera in (("formation", 1.0), ("path", 1.0), ("2", 2.0)):
        found.value(f"replay.setFollow('{name}'), replay.stage.orbit.magnify({camera})")
        found.picture(SCENE)
        P = (
            np.array(found.value("replay.views[0].camera.projectionMatrix.elements"))
            .reshape(4, 4)
            .T
        )
        V = np.array(found.value("replay.views[0].camera.matrixWorldInverse.elements"))
        box = found.page.locator(SCENE).bounding_box()
        size = found.value("replay.views[0].size")
        for i, (north, east, down) in enumerate(e.positions[100]):
            above = (0.2 if i == 0 else 0.11) * size
            clip = P @ V.reshape(4, 4).T @ np.array([east, above - down, -north, 1.0])
            x, y = (0.5 + 0.5 * clip[:2] / clip[3] * [1, -1]) * [box["width"], box["height"]]
            label = found.page.locator(".vehicle-label").nth(i)
            if not label.is_visible():
                continue
            at = label.bounding_box()
            assert at["x"] - box["x"] + at["width"] / 2 == pytest.approx(x, abs=1.5)
            assert at["y"] - box["y"] + at["height"] + 3 == pytest.approx(y, abs=1.5)


def test_it_plays_by_itself_and_pauses(opened: Any) -> None:
    found = opened("one", at="")
    found.wait_until("replay.clock.time > 0.1")
    found.page.keyboard.press("Home")
    found.page.locator("#speed").select_option("0.1")  # a minute: it does not end meanwhile
    found.click("#play")
    found.wait_until("replay.clock.time > 0.01")
    assert found.page.locator("#play").get_attribute("aria-label") == "Pause"
    found.click("#play")
    before = found.time
    found.page.wait_for_timeout(200)
    assert found.time == before < 6.0
    assert found.page.locator("#play").get_attribute("aria-label") == "Play"
    found.page.locator("#speed").select_option("8")
    found.click("#play")
    found.page.locator("#play[aria-label=Play]").wait_for()
    assert found.time == pytest.approx(6.0), "the end, where it stops"


def test_who_wants_little_motion_starts_it(opened: Any) -> None:
    found = opened("one", at="", reduced_motion="reduce")
    found.page.wait_for_timeout(300)
    assert found.time == 0.0


def test_everything_is_done_by_keys(opened: Any) -> None:
    found = opened("one")
    press = found.page.keyboard.press
    for key, wanted in (
        ("ArrowRight", 2.1), ("Shift+ArrowRight", 3.1), ("ArrowLeft", 3.0), ("Shift+ArrowLeft", 2.0),
        ("PageDown", 6.0), ("PageUp", 1.0), ("End", 6.0), ("Home", 0.0),
    ):  # fmt: skip
        press(key)
        assert found.time == pytest.approx(wanted), key
    press("Space")
    assert found.value("replay.clock.playing")
    press("Space")
    assert not found.value("replay.clock.playing")
    press("ArrowUp")
    assert found.page.locator("#speed").input_value() == "2"
    press("ArrowDown")
    for key, name, factor in (("+", "zoom", 1.2), ("-", "zoom", 1.0)):
        press(key)
        assert found.value(f"replay.stage.orbit.{name}") == pytest.approx(factor)
    here = found.picture(SCENE)
    for key in ("d", "w"):
        press(key)
        assert changed(here, here := found.picture(SCENE)) > 0.01
    for key, name in (
        ("l", "0"),
        ("2", "2"),
        ("p", "path"),
        ("f", "formation"),
        ("9", "formation"),
    ):
        press(key)
        assert found.page.locator("#follow").input_value() == name
    press("r")
    assert found.value("replay.stage.orbit.azimuth") == pytest.approx(-0.62)
    press("h")
    assert found.page.locator("#help-text").is_visible()
    press("Escape")
    assert not found.page.locator("#help-text").is_visible()
    seen = set()
    for _ in range(40):
        press("Tab")
        if found.value("document.activeElement === document.body"):
            break
        seen.add(found.value("document.activeElement.id || document.activeElement.className"))
        assert found.value("getComputedStyle(document.activeElement).outlineStyle") != "none"
    assert {"follow", "home", "theme", "help", "stage", "chip", "play", "scrub", "speed"} <= seen
    unnamed = found.value(
        "[...document.querySelectorAll('button, select, input')].filter((x) => "
        "!(x.getAttribute('aria-label') || x.textContent.trim())).length"
    )
    assert unnamed == 0


def test_the_mouse_turns_zooms_and_moves(opened: Any) -> None:
    found = opened("one")
    mouse = found.page.mouse
    orbit = lambda name: found.value(f"replay.stage.orbit.{name}")  # noqa: E731
    mouse.move(400, 400)
    mouse.down()
    mouse.move(500, 420, steps=4)
    mouse.up()
    assert orbit("azimuth") == pytest.approx(-0.62 - 0.65)
    assert orbit("elevation") == pytest.approx(0.4 + 0.13)
    mouse.wheel(0, -300)
    found.picture(SCENE)
    assert orbit("zoom") > 1.3
    found.page.keyboard.down("Shift")
    mouse.down()
    mouse.move(400, 420, steps=4)
    mouse.up()
    found.page.keyboard.up("Shift")
    assert np.linalg.norm(orbit("pan")) > 0.05
    assert orbit("azimuth") == pytest.approx(-0.62 - 0.65)


def test_a_click_into_a_plot_goes_to_its_time(opened: Any) -> None:
    found = opened("one")
    plots = found.page.locator(".plot-area:visible")
    assert plots.count() == 5, "of the expert with its Lyapunov functions"
    for number in range(5):
        plots.nth(number).scroll_into_view_if_needed()
        box = plots.nth(number).bounding_box()
        left, right = 44, box["width"] - 22
        found.page.mouse.click(box["x"] + 0.5 * (left + right), box["y"] + 40)
        assert found.time == pytest.approx(3.0, abs=0.02)
        found.page.keyboard.press("Home")

    def values(number: int) -> list[float]:
        """What stands above a plot: marks and numbers in turn, with a proper minus sign."""
        text = found.page.locator(".plot-values").nth(number).text_content()
        return [float(x) for x in text.replace("\N{MINUS SIGN}", "-").split()[1::2]]

    e = flown("expert", 3, duration=6.0)
    assert values(0) == pytest.approx(e.errors[0], rel=6e-3)
    found.page.locator(".plot select").select_option(label="moment about y")
    assert values(3) == pytest.approx(e.actions[0, :, 2], abs=2.1e-3)
    found.page.locator(".legend .chip").nth(1).click()
    assert found.value("replay.stage.highlight") == 2
    assert values(4)[2:] == pytest.approx(e.lyapunov[0, 1, 2:], rel=6e-2)


def test_two_policies_stand_side_by_side(opened: Any) -> None:
    found = opened("two", at="#t=5")
    crash = flown("random", 0, scenario="paper", duration=40.0)
    assert [x.strip() for x in found.page.locator(".view h2").all_text_contents()] == [
        "A expert",
        "B random",
    ]
    assert "score 0.00" in found.page.locator(".figures").nth(1).text_content()
    assert found.page.locator(".end").nth(1).text_content() == crash.end()
    assert found.page.locator(".end:visible").count() == 1
    for number in range(2):
        picture = found.picture(f"section.view >> nth={number}")
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500
    found.page.keyboard.press("Home")
    assert found.page.locator(".end:visible").count() == 0
    assert found.page.locator(".choices button").count() == 3
    assert found.page.locator(".plot:visible").count() == 4
    found.page.locator(".choices button").nth(2).click()
    assert found.page.locator(".plot:visible").count() == 4, "no Lyapunov functions of random"
    found.page.locator(".choices button").nth(1).click()
    assert found.page.locator(".plot:visible").count() == 5


def test_names_that_are_markup_are_text(opened: Any) -> None:
    found = opened("odd")
    name = "<img src=x onerror=alert(1)></script><script>alert(2)</script>"
    assert found.page.locator(".view h2").nth(0).text_content() == f"A {name}"
    found.page.locator(".choices button").nth(1).click()
    assert found.value("document.querySelectorAll('img').length") == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_is_light_or_dark_as_the_reader_wants(opened: Any, scheme: str) -> None:
    found = opened("one", color_scheme=scheme)

    def brightness() -> float:
        return float(found.picture("body").mean())

    before = brightness()
    assert (before > 180.0) == (scheme == "light")
    assert (before < 60.0) == (scheme == "dark")
    found.page.keyboard.press("t")
    after = brightness()
    assert (after < 60.0) == (scheme == "light")
    found.click("#theme")
    assert brightness() == pytest.approx(before, abs=2.0)


@pytest.mark.parametrize("name", ["one", "two", "odd"])
def test_it_fits_a_phone(opened: Any, name: str) -> None:
    found = opened(name, viewport=PHONE, has_touch=True, is_mobile=True, device_scale_factor=2)
    assert found.value("document.documentElement.scrollWidth") == 390
    wide = found.value(
        "[...document.querySelectorAll('button, select, canvas, .plot, .view-card')].filter((x) => {"
        "const b = x.getBoundingClientRect(); return b.width && (b.right > 390.5 || b.left < -0.5);"
        "}).map((x) => x.id || x.className)"
    )
    assert wide == []
    for selector in ("#play", "#speed", "#theme"):
        box = found.page.locator(selector).bounding_box()
        assert box["y"] + box["height"] <= 844, "within reach without scrolling"
        assert min(box["width"], box["height"]) >= 34
    found.page.locator("#speed").select_option("0.1")  # so that it does not end meanwhile
    found.page.locator("#play").tap()
    assert found.value("replay.clock.playing")
    found.page.locator("#play").tap()
    assert not found.value("replay.clock.playing")
    found.click("#help")
    box = found.page.locator("#help-text").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= 390
    assert found.value("document.getElementById('help-text').scrollWidth") <= box["width"]


def test_without_webgl_it_says_so_and_shows_the_plots(opened: Any) -> None:
    found = opened("two", webgl=False, check=False)
    assert all("WebGL" in problem for problem in found.problems), "three.js says it, too"
    assert "offers no WebGL" in found.page.locator("#no-webgl").text_content()
    assert found.page.locator("#no-webgl").is_visible()
    assert found.page.locator(".view h2").nth(1).is_visible()
    plot = found.picture(".plot-area >> nth=0")
    assert len(np.unique(plot.reshape(-1, 3), axis=0)) > 20
    found.page.keyboard.press("End")
    assert changed(plot, found.picture(".plot-area >> nth=0")) > 0.001
    for key in ("+", "a", "p", "2", "r", "t"):
        found.page.keyboard.press(key)
    assert len(found.problems) <= 3


def test_in_a_notebook_it_shows_itself(opened: Any, files: dict[str, Path]) -> None:
    """As the output of a cell: in a frame, from an attribute."""
    notebook = files["one"].with_name("notebook.html")
    output = Replay(flown("expert", 3, duration=6.0))._repr_html_()
    notebook.write_text(
        f"<!doctype html><html data-ready=true><body>{output}</body></html>", "utf-8"
    )
    found = opened("one")
    found.page.goto(notebook.as_uri())
    frame = found.page.frame_locator("iframe")
    frame.locator("html[data-ready=true]").wait_for(state="attached")
    assert frame.locator(".vehicle-label").count() == 3
    assert frame.locator("#no-webgl").is_hidden()
    found.requests = found.requests[:1]
