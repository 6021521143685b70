"""The live page in a real browser: Chromium without a display, driven by Playwright."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import browsers
import pytest
from browsers import DESKTOP, PATIENCE, PHONE, Opened, changed

pytest.importorskip("aiohttp", reason="needs aiohttp, of the extra `web`")

ROOT = Path(__file__).resolve().parent.parent
pytestmark = browsers.NEEDED


class Server:
    """The command in a process of its own."""

    def __init__(self, *words: str) -> None:
        command = [sys.executable, "-m", "baselines.play", "--no-browser", "--port", "0", *words]
        self.process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "COLUMNS": "90"},
        )
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().split()[1]

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL if os.name != "nt" else signal.SIGTERM)
        self.process.wait(60)

    def close(self) -> None:
        self.kill()
        assert self.process.stdout is not None
        self.process.stdout.close()


@pytest.fixture(scope="module")
def chromium() -> Iterator[dict[bool, Any]]:
    with browsers.launched() as found:
        yield found


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    found = Server()
    yield found
    found.close()


@pytest.fixture
def opened(chromium: dict[bool, Any]) -> Iterator[Any]:
    """Opens the page of a server; afterwards nothing may have gone wrong in it, nor come from elsewhere."""
    pages, contexts = [], []

    def open_page(
        server: Server, check: bool = True, fresh: bool = True, webgl: bool = True, **options: Any
    ) -> Any:
        context = chromium[webgl].new_context(**{"viewport": DESKTOP, **options})
        context.set_default_timeout(PATIENCE)
        contexts.append(context)
        found = Opened(context.new_page())
        found.page.goto(server.address)
        found.page.wait_for_selector("html[data-ready=true]", state="attached")
        found.wait_until("play.panel !== null && play.flights[0].instants > 0")
        if check:
            pages.append((found, server))
        if fresh:
            assert done(found, do="policies", value=["expert"])["ok"]
            assert done(found, do="scenario", value="nominal")["ok"]
            done(found, do="pause", value=False)
            done(found, do="reset", seed=0)
        return found

    yield open_page
    for found, of in pages:
        assert [text for text in found.problems if "WebGL" not in text] == []
        assert [url for url in found.requests if not url.startswith((of.address, "data:"))] == []
    for context in contexts:
        context.close()


def done(page: Any, **command: Any) -> dict[str, Any]:
    """What came of a command, once the page knows of it."""
    answer: dict[str, Any] = page.page.evaluate("(command) => play.send(command)", command)
    return answer


def time_of(page: Any) -> float:
    return float(page.value("play.flights[0].last"))


def changes(page: Any) -> Any:
    return page.value("play.state.changes")


def control(name: str) -> str:
    return f'.control[data-name="{name}"]'


def move(page: Any, name: str, value: float) -> None:
    """Move a slider as a hand does: the value, and the event."""
    script = """([selector, value]) => {
        const slider = document.querySelector(`${selector} input[type="range"]`);
        slider.value = value;
        slider.dispatchEvent(new Event("input", { bubbles: true }));
    }"""
    page.page.evaluate(script, [control(name), value])


def test_the_page_opens_and_the_scene_changes(server: Server, opened: Any) -> None:
    page = opened(server)
    before, picture = time_of(page), page.picture("#stage")
    page.wait_until(f"play.flights[0].last > {before + 0.5}")
    assert changed(picture, page.picture("#stage")) > 0.02
    assert page.page.locator("#about").inner_text().startswith("nominal · actions: wrench")
    assert page.page.locator(".plot:visible").count() == 5
    assert page.page.locator(".plot-values").first.inner_text() != ""


def test_every_field_has_a_control(server: Server, opened: Any) -> None:
    page = opened(server)
    from baselines.play.settings import values
    from formation_env import configure

    shown = set(page.value("[...document.querySelectorAll('.control')].map((x) => x.dataset.name)"))
    assert set(values(configure())) - {"scenario"} <= shown
    page.page.locator("#search").fill("k1 planner")
    assert page.page.locator(".control:visible").count() == 1
    assert page.page.locator(control("planner.k1")).is_visible()


def test_a_slider_changes_the_flight_while_it_goes_on(server: Server, opened: Any) -> None:
    page = opened(server)
    page.wait_until("play.flights[0].last > 0.3")
    epoch = page.value("play.state.epoch")
    move(page, "gust", 0.5)
    page.wait_until("play.state.changes.gust === 0.5")
    assert page.value("play.state.epoch") == epoch
    assert page.page.locator(f"{control('gust')}.changed").count() == 1
    assert page.page.locator("#changed").inner_text() == "1 changed"
    page.page.locator(f"{control('gust')} .undo").click()
    page.wait_until("!('gust' in play.state.changes)")
    assert page.page.locator(".control.changed").count() == 0


def test_the_slider_itself_is_moved_by_keys(server: Server, opened: Any) -> None:
    page = opened(server)
    slider = page.page.locator(f"{control('noise.position')} input[type=range]")
    slider.focus()
    slider.press("ArrowRight")
    page.wait_until("play.state.changes['noise.position'] > 0")
    assert not page.value("play.state.paused"), "keys within a control are the control's"


def test_an_impossible_value_is_said_where_it_was_set_and_changes_nothing(
    server: Server, opened: Any
) -> None:
    page = opened(server)
    move(page, "planner.k2", 0.5)
    problem = page.page.locator(f"{control('planner.k2')} .error")
    problem.wait_for(state="visible")
    assert "planner.k2 = 0.5" in problem.inner_text()
    assert changes(page) == {} and page.value("play.state.values['planner.k2']") == 2
    before = time_of(page)
    page.wait_until(f"play.flights[0].last > {before}")
    move(page, "gust", 0.1)
    problem.wait_for(state="hidden")
    box = page.page.locator(f"{control('planner.k2')} input[type=number]")
    assert box.input_value() == "2", "what is flown"
    move(page, "planner.k2", 3)
    page.wait_until("play.state.changes['planner.k2'] === 3")


def test_a_push_is_seen_and_goes_where_the_arrow_points(server: Server, opened: Any) -> None:
    page = opened(server)
    done(page, do="pause", value=True)
    done(page, do="reset", seed=0)
    page.wait_until("play.flights[0].instants === 1 && play.flights[0].last === 0")
    page.value(
        "play.stage.orbit.azimuth = Math.PI / 2"
    )  # seen from the east, north is to the right
    page.page.locator("#strength").fill("3")
    page.page.locator("#push-right").click()
    done(page, do="pause", value=False)
    ahead = """(() => {
        const { positions } = play.flights[0];
        const moved = (vehicle) => positions[9 + 3 * vehicle] - positions[3 * vehicle];
        return moved(1) - moved(0);
    })()"""
    # m, north of where it would be beside the leader: how soon a slow page shows it is not fixed.
    page.wait_until(f"{ahead} > 0.1")


def test_a_lost_follower_is_gone_and_the_flight_goes_on(server: Server, opened: Any) -> None:
    page = opened(server)
    page.wait_until("play.flights[0].last > 0.3")
    page.page.locator("#vehicle").select_option("1")
    page.page.locator("#lose").click()
    page.wait_until("play.flights[0].followers === 1 && play.flights[0].instants > 0")
    assert time_of(page) > 0.3
    assert page.page.locator("#lose").is_disabled()
    page.wait_until("document.querySelectorAll('.vehicle-label').length === 2")
    page.page.locator("#clear").click()
    page.wait_until("play.flights[0].followers === 2")


def test_two_policies_side_by_side(server: Server, opened: Any) -> None:
    page = opened(server)
    page.page.locator("#beside").select_option("hover")
    page.wait_until("play.flights.length === 2 && play.flights[1].instants > 1")
    assert page.page.locator("section.view").count() == 2
    starts = page.value("play.flights.map((f) => [...f.positions.slice(0, 9)])")
    assert starts[0] == starts[1], "the same seed"
    page.wait_until("play.panel?.flights.length === 2")
    assert page.page.locator(".choices button").all_inner_texts() == [
        "Compare",
        "A expert",
        "B hover",
    ]
    page.page.locator("#beside").select_option("")
    page.wait_until("play.flights.length === 1")


def test_number_and_shape_of_followers_and_the_path(server: Server, opened: Any) -> None:
    page = opened(server)
    move(page, "followers", 5)
    page.wait_until("play.flights[0].followers === 5")
    page.page.locator(f"{control('formation')} select").first.select_option("column")
    page.wait_until("play.state.changes.formation?.maker === 'column'")
    page.page.locator(f"{control('trajectory')} select").first.select_option("line")
    page.wait_until("play.state.changes.trajectory?.maker === 'line'")
    page.page.locator("#show-python").click()
    text = page.page.locator("#python-text").inner_text()
    assert "offsets=formations.column(5)" in text and 'trajectory={"path": "line"}' in text
    page.page.locator("#python .close").click()
    page.page.locator(f"{control('trajectory')} select").first.select_option("")
    page.wait_until("!('trajectory' in play.state.changes)")


def test_keys_pause_and_reset(server: Server, opened: Any) -> None:
    page = opened(server)
    page.page.locator("#stage").focus()
    page.page.keyboard.press("Space")
    page.wait_until("play.state.paused")
    assert page.page.locator("#play").get_attribute("aria-label") == "Go on"
    page.page.keyboard.press("n")
    page.wait_until("play.state.seed === 1")
    page.page.keyboard.press("Space")
    page.wait_until("!play.state.paused")
    page.page.keyboard.press("2")
    assert page.page.locator("#vehicle").input_value() == "2"


def test_tabs_show_the_same_flight_and_one_may_be_closed(server: Server, opened: Any) -> None:
    one = opened(server, webgl=False)
    other = opened(server, webgl=False, fresh=False)
    assert other.page.locator("#no-webgl").is_visible()
    done(one, do="set", name="duration", value=100.0)
    done(one, do="speed", value=2.0)
    other.wait_until("play.state.speed === 2 && play.state.changes.duration === 100")
    before = time_of(other)
    one.page.context.close()
    other.wait_until(f"play.flights[0].last > {before}")
    again = opened(server, webgl=False, fresh=False)
    other.wait_until(f"play.state.epoch === {again.value('play.state.epoch')}")
    assert again.value("play.flights[0].instants") > 1, "what has been flown is there"
    done(again, do="speed", value=1.0)


@pytest.mark.parametrize("tab", ["settings", "plots"])
def test_a_phone_shows_scene_and_bar_and_one_panel(server: Server, opened: Any, tab: str) -> None:
    page = opened(server, viewport=PHONE, color_scheme="dark", has_touch=True)
    page.page.locator(f"#tabs [data-tab={tab}]").click()
    other = {"settings": "plots", "plots": "settings"}[tab]
    assert page.page.locator(f"#{tab}").is_visible() and page.page.locator(f"#{other}").is_hidden()
    width = page.value("document.documentElement.scrollWidth")
    assert width <= PHONE["width"], "nothing sticks out"
    for button in page.page.locator("footer button:visible").all():
        box = button.bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= PHONE["width"]
        assert box["y"] + box["height"] <= PHONE["height"]
    assert page.value("document.documentElement.dataset.theme") == "dark"


def test_a_server_that_is_killed_is_missed_and_another_one_found(opened: Any) -> None:
    first = Server("--seed", "4")
    port = first.address.rsplit(":", 1)[1].strip("/")
    page = opened(first, webgl=False, check=False, viewport=PHONE)
    page.value("window.scrollTo(0, 1000)")
    first.close()
    page.page.locator("#lost").wait_for(state="visible")
    assert page.page.locator("#lost").bounding_box()["y"] >= 0, "also far down the page"
    assert "tries again" in page.page.locator("#lost").inner_text()
    answer = done(page, do="pause", value=True)
    assert "does not answer" in answer["error"]
    words = [sys.executable, "-m", "baselines.play", "--no-browser", "--port", port]
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL) as second:
        try:
            page.page.locator("#lost").wait_for(state="hidden")
            page.wait_until("!play.fresh && play.flights[0].instants > 2")
        finally:
            second.kill()
    assert [text for text in page.problems if "WebSocket" not in text and "WebGL" not in text] == []


def test_nothing_is_left_running() -> None:
    assert [t for t in threading.enumerate() if t.name == "flights"] == []
