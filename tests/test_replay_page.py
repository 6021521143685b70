"""The page: what is packed into it, how its script is put together, that nothing of it leaves it."""

from __future__ import annotations

import base64
import html
import json
import re
import shutil
import subprocess
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replays import flown
from test_imports import modules_after

import baselines
from baselines.replay import Replay, replay
from baselines.replay.linking import linked, text_of
from baselines.replay.packing import Packed, deflated, pack
from baselines.replay.page import render

WEB = Path(baselines.__file__).parent / "replay" / "web"


def unpack(packed: Packed) -> dict[str, np.ndarray]:
    """The inverse of `pack`, by NumPy alone."""
    data = np.frombuffer(zlib.decompress(base64.b64decode(packed.text)), dtype=np.uint8)
    arrays, at = {}, 0
    for block in packed.blocks:
        count = block["rows"] * block["columns"]
        planes = data[at : at + 4 * count].reshape(4, count).astype(np.int64)
        folded = planes[0] + 256 * (planes[1] + 256 * (planes[2] + 256 * planes[3]))
        steps = np.where(folded % 2 == 0, folded // 2, -(folded + 1) // 2)
        table = steps.reshape(block["columns"], block["rows"]).T
        arrays[block["name"]] = np.cumsum(table, axis=0) * block["step"]
        at += 4 * count
    assert at == len(data)
    return arrays


def test_packed_numbers_are_off_by_half_a_step_at_most() -> None:
    rng = np.random.default_rng(0)
    smooth = np.cumsum(rng.normal(size=(500, 7, 3)), axis=0)
    wild = rng.choice([-1.0, 1.0], size=(50, 2)) * 1e5
    found = unpack(pack({"smooth": (smooth, 1e-3), "wild": (wild, 1e-3), "one": (smooth[:1], 0.5)}))
    assert np.abs(found["smooth"].reshape(smooth.shape) - smooth).max() <= 0.5e-3 + 1e-12
    assert np.abs(found["wild"] - wild).max() <= 0.5e-3 + 1e-9
    assert np.abs(found["one"].reshape(1, 7, 3) - smooth[:1]).max() <= 0.25


def test_packed_numbers_that_are_not_finite_stay_as_the_ones_before() -> None:
    nan, inf = np.nan, np.inf
    table = np.array([[nan, 1.0], [2.0, inf], [nan, 3.0]])
    (found,) = unpack(pack({"x": (table, 1.0)})).values()
    assert found.tolist() == [[0.0, 1.0], [2.0, 1.0], [2.0, 3.0]]


class Page(HTMLParser):
    """The elements of a page: those with an address, and the text of its scripts by their id."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.scripts: dict[str, str] = {}
        self.inside: str | None = None
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.addresses += [
            v or "" for k, v in attrs if k in ("src", "href", "action", "data", "poster")
        ]
        self.inside = (named.get("id") or "main") if tag == "script" else None
        assert not any(name.startswith("on") for name in named), attrs

    def handle_data(self, data: str) -> None:
        if self.inside is None:
            self.text += data
        else:
            self.scripts[self.inside] = self.scripts.get(self.inside, "") + data

    def handle_endtag(self, tag: str) -> None:
        self.inside = None


def content_of(text: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a page holds: the JSON object and the arrays."""
    scripts = Page(text).scripts
    content = json.loads(scripts["content"])
    return content, unpack(Packed(content["blocks"], scripts["data"]))


@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
def test_the_page_holds_the_flight(action: str) -> None:
    e = flown("expert", 3, action=action)
    content, arrays = content_of(render([e, e]))
    for number in (0, 1):
        x = {
            name: arrays[f"{number}.{name}"] for name in ("positions", "slots", "actions", "ticks")
        }
        assert np.abs(x["positions"].reshape(e.positions.shape) - e.positions).max() < 1.001e-4
        assert np.abs(x["slots"].reshape(e.slots.shape) - e.slots).max() < 1.001e-4
        assert np.abs(x["ticks"][:, 0] * 0.02 - e.time).max() < 1e-9
        actions = x["actions"].reshape(len(e.time), 2, -1)
        assert np.abs(actions[:-1] - e.actions).max() < 1.001e-3
        q = arrays[f"{number}.attitudes"].reshape(e.attitudes.shape)
        cosine = np.abs((q * e.attitudes).sum(-1)) / np.linalg.norm(q, axis=-1)
        assert cosine.min() > 1.0 - 1e-7
        assert (q[1:] * q[:-1]).sum(-1).min() > 0.0
        V = 10.0 ** arrays[f"{number}.lyapunov"].reshape(len(e.time), 2, 4)
        np.testing.assert_allclose(V[:-1], np.maximum(e.lyapunov, 1e-9), rtol=3e-3)
        card = content["episodes"][number]
        assert card["policy"] == "expert"
        assert card["metrics"]["score"] == e.metrics["score"]
        assert len(card["entries"]) == e.config.action_size


def test_a_long_flight_is_thinned_and_keeps_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.replay.page._INSTANTS", 30)
    e = flown()
    _, arrays = content_of(render([e]))
    ticks = arrays["0.ticks"][:, 0]
    assert ticks.tolist() == [*range(0, 101, 4)]
    assert len(arrays["0.positions"]) == len(ticks)
    _, arrays = content_of(render([e._replace(time=e.time[:100])]))
    assert arrays["0.ticks"][-1, 0] == 99


def test_the_page_refers_to_nothing_outside() -> None:
    text = render([flown()])
    page = Page(text)
    assert page.addresses == ["data:,"]
    script = zlib.decompress(base64.b64decode(page.scripts["three"])).decode()
    assert script == text_of("three/three.js")
    allowed = {"http://www.w3.org/1999/xhtml", "http://www.w3.org/2000/svg"}  # names of formats
    found = set(re.findall(r"https?://[^\s\"'`<>)]+", text + script))
    assert found <= allowed, found - allowed
    assert "url(" not in text
    assert "@import" not in text
    assert "default-src 'none'" in text
    assert text_of("three/LICENSE").strip() in html.unescape(text)
    assert "MIT" in text_of("three/LICENSE")


def test_twenty_seconds_with_seven_vehicles_are_small() -> None:
    e = flown("expert-tuned", 3, followers=6, duration=20.0)
    assert len(e.time) == 1001
    assert len(e.lyapunov) == 1000
    assert len(render([e]).encode()) < 500_000  # a third of what may be
    assert len(render([e] * 3).encode()) < 1_500_000


HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(1)> & \"'`$x ${y} \u2028 é"


def test_names_cannot_break_out_of_the_page() -> None:
    e = flown()
    text = Replay(e._replace(policy=HOSTILE), title=HOSTILE).html()
    assert "<img" not in text
    assert "alert(1)</script>" not in text
    page = Page(text)
    assert set(page.scripts) == {"content", "data", "three", "main"}
    content = json.loads(page.scripts["content"])
    assert content["episodes"][0]["policy"] == HOSTILE
    assert content["title"] == HOSTILE
    assert HOSTILE in page.text
    framed = Replay(e._replace(policy=HOSTILE), title=HOSTILE)._repr_html_()
    (frame,) = re.findall(r'<iframe srcdoc="([^"]*)" title="([^"]*)"', framed)
    assert html.unescape(frame[0]) == text
    assert html.unescape(frame[1]) == HOSTILE
    assert framed.count("<") == 2


def test_deflated_text_comes_back() -> None:
    assert zlib.decompress(base64.b64decode(deflated("né" * 99))).decode() == "né" * 99


# -- the script -------------------------------------------------------------------------------------


def test_modules_are_linked_in_order_each_once() -> None:
    script = linked("replay.js")
    order = re.findall(r'^modules\["([\w.-]+)"\] = ', script, re.MULTILINE)
    assert sorted(order) == sorted(path.name for path in WEB.glob("*.js"))
    assert order[-1] == "replay.js"
    for name in order:
        for _, other in re.findall(r'import (\{.*\}) from "\./([\w-]+\.js)"', text_of(name)):
            assert order.index(other) < order.index(name)
    assert not re.findall(r"^\s*(import|export)\b", script, re.MULTILINE)


@pytest.mark.parametrize(
    "odd",
    [
        'import x from "./y.js";',
        'import { a as b } from "./colours.js";',
        'import "./colours.js";',
        "export default 3;",
        "export { a };",
        "  export const a = 1;",
    ],
)
def test_other_forms_of_modules_are_refused(monkeypatch: pytest.MonkeyPatch, odd: str) -> None:
    monkeypatch.setattr(
        "baselines.replay.linking.text_of", lambda name, places: f"const a = 1;\n{odd}\n"
    )
    with pytest.raises(ValueError, match=r"odd\.js: .*expected the forms of"):
        linked("odd.js")


def test_modules_that_need_each_other_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = {"a.js": 'import { b } from "./b.js";', "b.js": 'import { a } from "./a.js";'}
    monkeypatch.setattr("baselines.replay.linking.text_of", lambda name, places: texts[name])
    with pytest.raises(ValueError, match=r"a\.js: imports itself by way of a\.js, b\.js"):
        linked("a.js")


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js to read the modules")
@pytest.mark.parametrize("path", sorted(WEB.glob("*.js")), ids=lambda path: path.name)
def test_the_modules_are_modules(path: Path, tmp_path: Path) -> None:
    """As they stand, not only when they are linked; and no file is long."""
    copy = tmp_path / path.with_suffix(".mjs").name
    copy.write_bytes(path.read_bytes())
    run = subprocess.run(["node", "--check", copy], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert len(path.read_text(encoding="utf-8").splitlines()) < 400


def test_three_is_the_release_that_its_package_names() -> None:
    package = json.loads(text_of("three/package.json"))
    release = package["devDependencies"]["three"].split(".")[1]
    assert f'"{release}"' in text_of("three/three.js")
    assert set(package["devDependencies"]) == {"three", "esbuild"}
    exported = re.findall(r"^  (\w+),$", text_of("three/entry.js"), re.MULTILINE)
    used = {
        name for path in WEB.glob("*.js") for name in re.findall(r"THREE\.(\w+)", path.read_text())
    }
    assert used == set(exported)


# -- what shows itself ------------------------------------------------------------------------------


def test_policies_are_flown_from_one_seed() -> None:
    both = replay(["hover", "ff"], "nominal", seed=4, duration=1.0, quiet=True)
    assert [e.policy for e in both.episodes] == ["hover", "ff"]
    assert [e.seed for e in both.episodes] == [4, 4]
    hover, ff = both.episodes
    assert np.array_equal(hover.positions[0], ff.positions[0])
    assert not np.array_equal(hover.positions[-1], ff.positions[-1])
    assert np.array_equal(hover.positions[:, 0], ff.positions[:, 0])
    named = baselines.replay({"mine": "hover"}, "paper", duration=1.0, quiet=True)
    assert named.episodes[0].policy == "mine"
    assert "Replay of 1: <Episode: mine on paper" in repr(named)


def test_what_cannot_be_shown_is_refused() -> None:
    for wrong in ([], None, [1], "expert"):
        with pytest.raises((ValueError, TypeError)):
            Replay(wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="title = 3: expected a text"):
        Replay(flown(), title=3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="policy = 'nobody': expected one of"):
        replay("nobody", quiet=True)
    with pytest.raises(ValueError, match="scenario = 'nowhere'"):
        replay("hover", "nowhere", quiet=True)
    with pytest.raises(ValueError, match="seed = -1"):
        replay("hover", seed=-1, quiet=True)
    with pytest.raises(ValueError, match="at least one"):
        render([])


def test_replays_load_nothing_that_draws() -> None:
    loaded = modules_after("import baselines.replay.command")
    assert not loaded & {"pygame", "matplotlib", "viser", "torch", "playwright"}
    assert not any(
        name.startswith("baselines.replay") for name in modules_after("import formation_env")
    )
    assert not any(
        name.startswith("baselines.replay") for name in modules_after("import baselines")
    )
