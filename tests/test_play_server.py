"""The server: who is let in, what it serves, browsers that are slow or gone; and the command around it."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import queue
import re
import socket
import subprocess
import sys
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from test_imports import modules_after

from baselines.play import command, main, ports
from baselines.play.ports import HOST, bound

pytest.importorskip("aiohttp", reason="needs aiohttp, of the extra `web`")

from aiohttp import ClientSession, WSServerHandshakeError
from aiohttp.test_utils import TestServer

from baselines.play.server import application, serve
from baselines.play.session import Session


@pytest.fixture(scope="module")
def session() -> Session:
    return Session(("expert",))


@asynccontextmanager
async def running(session: Session) -> AsyncIterator[tuple[ClientSession, str]]:
    async with TestServer(application(session), host=HOST) as server, ClientSession() as client:
        yield client, f"http://{HOST}:{server.port}"


def run(session: Session, test: Callable[[ClientSession, str], Awaitable[None]]) -> None:
    async def whole() -> None:
        async with running(session) as (client, address):
            await asyncio.wait_for(test(client, address), 120)

    asyncio.run(whole())


async def until(socket_: Any, kind: str) -> dict[str, Any]:
    """The next message of a kind; frames are asked for."""
    while True:
        message = await socket_.receive_json()
        if message["type"] == "frames":
            await socket_.send_str("drawn")
        if message["type"] == kind:
            return dict(message)


def test_the_page_is_whole_and_may_load_nothing_else(session: Session) -> None:
    async def test(client: ClientSession, address: str) -> None:
        async with client.get(address + "/") as answer:
            text = await answer.text()
            policy = answer.headers["Content-Security-Policy"]
        addresses = re.findall(r'(?:src|href)="([^"]*)"', text)
        assert addresses and all(x.startswith(("/", "data:,")) for x in addresses)
        for path in filter(lambda x: x.startswith("/"), addresses):
            async with client.get(address + path) as answer:
                assert answer.status == 200 and await answer.text()
        assert "default-src 'none'" in policy and "script-src 'self';" in policy
        assert "http:" not in policy and "*" not in policy and "unsafe" not in policy
        ids = set(re.findall(r'id="([\w-]+)"', text))
        async with client.get(address + "/play.js") as answer:
            script = await answer.text()
        asked = set(
            re.findall(r'find\("([\w-]+)"\)', script[script.index('modules["pushing.js"]') :])
        )
        assert asked <= ids, "what the script looks for is there"
        async with client.get(address + "/nothing") as answer:
            assert answer.status == 404

    run(session, test)


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "[::1]:{port}", ""]
)
def test_other_hosts_are_refused(session: Session, host: str) -> None:
    async def test(client: ClientSession, address: str) -> None:
        port = address.rsplit(":", 1)[1]
        for path in ("/", "/play.js", "/socket"):
            named = {"Host": host.format(port=port), "Origin": address}
            async with client.get(address + path, headers=named) as answer:
                assert answer.status == 403
        async with client.get(address + "/", headers={"Host": f"localhost:{port}"}) as answer:
            assert answer.status == 200

    run(session, test)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1", None]
)
def test_the_socket_is_for_this_page_alone(session: Session, origin: str | None) -> None:
    async def test(client: ClientSession, address: str) -> None:
        port = address.rsplit(":", 1)[1]
        headers = {} if origin is None else {"Origin": origin.format(port=port)}
        with pytest.raises(WSServerHandshakeError) as refused:
            await client.ws_connect(address + "/socket", headers=headers)
        assert refused.value.status == 403

    run(session, test)


def test_commands_are_answered_and_told_to_all(session: Session) -> None:
    async def test(client: ClientSession, address: str) -> None:
        connect = [client.ws_connect(address + "/socket", origin=address) for _ in range(2)]
        one, other = [await each for each in connect]
        for each in (one, other):
            assert (await until(each, "hello"))["controls"]
            state = await until(each, "state")
            frames = (await until(each, "frames"))["frames"]
            assert {frame["epoch"] for frame in frames} == {state["epoch"]}
        await one.send_json({"do": "set", "name": "gust", "value": 0.25, "id": 7})
        assert await until(one, "answer") == {"type": "answer", "id": 7, "ok": True, "began": False}
        assert (await until(other, "state"))["changes"] == {"gust": 0.25}
        await one.send_json({"do": "set", "name": "planner.k2", "value": 0.5, "id": 8})
        answer = await until(one, "answer")
        assert answer["id"] == 8 and "planner.k2 = 0.5" in answer["error"]
        for text in ("no JSON", "[" * 5000, "3", "null", '{"id": 9}'):
            await one.send_str(text)
            assert "error" in await until(one, "answer")
        await one.send_json({"do": "clear", "id": 10})
        assert (await until(one, "answer"))["ok"]
        await one.send_str("x" * 2**17)
        while not (await one.receive()).type.name.startswith("CLOS"):
            pass
        await other.send_json({"do": "speed", "value": 1.0, "id": 11})
        assert (await until(other, "answer"))["ok"], "who sends too much is closed, others are not"

    run(session, test)


def test_a_slow_browser_gets_what_is_new_at_once_and_keeps_nobody_waiting(session: Session) -> None:
    async def test(client: ClientSession, address: str) -> None:
        slow = await client.ws_connect(address + "/socket", origin=address)
        quick = await client.ws_connect(address + "/socket", origin=address)
        for kind in ("hello", "state", "frames"):
            assert (await slow.receive_json())["type"] == kind
        await until(quick, "frames")
        last = 0.0
        for _ in range(400):
            session.tick()
            session._publish()
            last = (await until(quick, "frames"))["frames"][-1]["flights"][0]["time"]
        assert last == session._flights[0].time
        with pytest.raises(asyncio.TimeoutError):
            await slow.receive(timeout=0.05)
        await slow.send_str("drawn")
        message = await slow.receive_json()
        times = [frame["flights"][0]["time"] for frame in message["frames"]]
        assert times[-1] == last and 50 < len(times) <= 300 and times == sorted(times)
        await slow.close()
        session.tick()
        session._publish()
        await until(quick, "frames")
        await quick.close()
        for _ in range(100):
            if not session._listeners:
                break
            await asyncio.sleep(0.02)
        assert not session._listeners, "who has gone is forgotten"

    run(session, test)


# -- the command ----------------------------------------------------------------------------------


def test_a_port_in_use_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with bound(0) as taken:
        port = taken.getsockname()[1]
        assert main(["--port", str(port), "--no-browser"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"formation-play: error: port {port} is in use: try another --port"]


def test_without_a_port_the_next_free_one_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    with bound(0) as taken:
        monkeypatch.setattr(ports, "PORT", taken.getsockname()[1])
        with bound(None) as found:
            assert 0 < found.getsockname()[1] - ports.PORT < 20
            assert found.getsockname()[0] == HOST == "127.0.0.1"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scenario", "storm"], "'storm'"),
        (["--policies", "pilot"], "'pilot'"),
        (["--policies", "bc"], "policy = 'bc'"),
        (["--set", "planner.k2=0.5"], "planner.k2 = 0.5"),
        (["--set", "wings=2"], "wings"),
        (["--seed", "-1"], "'-1'"),
        (["--port", "70000"], "'70000'"),
    ],
)
def test_a_wrong_option_is_one_line(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    port = [] if "--port" in words else ["--port", "0"]
    with pytest.raises(SystemExit) as ended:
        main([*words, *port, "--no-browser"])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and message in said


def test_without_aiohttp_the_extra_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    assert main(["--no-browser"]) == 1
    assert capsys.readouterr().err == (
        'formation-play: error: the live page needs aiohttp: pip install "formation-env[web]"\n'
    )
    assert importlib.util.find_spec("aiohttp") is not None


@pytest.mark.parametrize("module", ["baselines", "baselines.play", "baselines.play.session"])
def test_no_import_needs_aiohttp(module: str) -> None:
    assert "aiohttp" not in modules_after(f"import {module}")


@pytest.mark.parametrize("quiet", [True, False])
def test_it_says_where_and_opens_the_browser(
    quiet: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: queue.Queue[str] = queue.Queue()
    monkeypatch.setattr(webbrowser, "open", opened.put)
    command._tell("http://127.0.0.1:8765/", quiet)
    assert "http://127.0.0.1:8765/" in capsys.readouterr().out
    if quiet:
        assert opened.empty()
    else:
        assert opened.get(timeout=60) == "http://127.0.0.1:8765/"


def test_serving_ends_when_it_is_cancelled(session: Session) -> None:
    async def test() -> None:
        told: asyncio.Queue[str] = asyncio.Queue()
        with bound(0) as at:
            task = asyncio.create_task(serve(session, at, told.put_nowait))
            address = (await told.get()).rstrip("/")
            async with ClientSession() as client:
                page = await client.ws_connect(address + "/socket", origin=address)
                await until(page, "frames")
                task.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await task
                while not (await page.receive()).type.name.startswith("CLOS"):
                    pass

    asyncio.run(asyncio.wait_for(test(), 60))


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
def test_ctrl_c_ends_it_without_a_traceback() -> None:
    words = [sys.executable, "-m", "baselines.play", "--no-browser", "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run_:
        assert run_.stdout is not None and run_.stderr is not None
        address = run_.stdout.readline().split()[1]
        with socket.create_connection((HOST, int(address.rsplit(":", 1)[1].strip("/"))), 30):
            run_.send_signal(2)
            assert run_.wait(60) == 0
        said = run_.stderr.read()
    assert said.splitlines()[-1] == "stopped" and "Traceback" not in said


def test_answers_are_json_without_nan(session: Session) -> None:
    for text in (session.frames(), json.dumps(session.state()[1])):
        json.loads(text, parse_constant=lambda name: pytest.fail(name))
