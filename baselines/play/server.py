"""Serves the page and its WebSocket, on 127.0.0.1 alone.

A page of another site cannot drive the flights: every request has to name this server as its host, which
a name that was rebound to 127.0.0.1 does not, and the WebSocket, which browsers let any page open, has to
come from this page. The page may load nothing that is not this server's (Content-Security-Policy).

Each browser gets what is new when it has drawn what it got: a slow one gets more at once, of which some is
left out, and nothing waits for it. Commands of one browser are carried out one after the other, in a
thread, and answered.
"""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, final

from aiohttp import WSMsgType, web

from baselines.play.ports import HOST
from baselines.play.session import Session
from baselines.replay.linking import linked, text_of

PLACES = ("baselines.play", "baselines.replay")
_LONGEST = 2**16  # bytes of a command
DRAWN = "drawn"  # what a browser says when it has drawn the frames that it got

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def application(session: Session) -> web.Application:
    """The pages of a session."""
    app = web.Application(middlewares=[_guard])
    for path, name in (("/", "play.html"), ("/three.js", "three/three.js")):
        app.router.add_get(path, partial(_text, text_of(name, PLACES), _kind(name)))
    style = text_of("style.css", PLACES) + text_of("play.css", PLACES)
    app.router.add_get("/style.css", partial(_text, style, "text/css"))
    app.router.add_get("/play.js", partial(_text, linked("play.js", PLACES), "text/javascript"))
    sockets = Sockets(session)
    app.router.add_get("/socket", sockets.serve)
    app.on_shutdown.append(sockets.close)
    return app


def _kind(name: str) -> str:
    return "text/html" if name.endswith(".html") else "text/javascript"


# -- who may ask ----------------------------------------------------------------------------------


def _hosts(request: web.Request) -> tuple[str, ...]:
    """The names under which this server is known, with the port that the request came to."""
    transport = request.transport
    port = transport.get_extra_info("sockname")[1] if transport is not None else 0
    return (f"{HOST}:{port}", f"localhost:{port}")


@web.middleware
async def _guard(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Refuse other hosts; forbid the page all other addresses."""
    hosts = _hosts(request)
    if request.headers.get("Host") not in hosts:
        raise web.HTTPForbidden(text=f"this server is http://{hosts[0]} only\n")
    response = await handler(request)
    if not response.prepared:
        response.headers.update(_headers(hosts))
    return response


def _headers(hosts: tuple[str, ...]) -> dict[str, str]:
    sockets = " ".join(f"ws://{host}" for host in hosts)
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; "
        f"connect-src 'self' {sockets}; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return {
        "Content-Security-Policy": policy,
        "Cache-Control": "no-store",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
    }


# -- answers --------------------------------------------------------------------------------------


async def _text(text: str, kind: str, request: web.Request) -> web.StreamResponse:
    return web.Response(text=text, content_type=kind, charset="utf-8")


# -- the WebSocket --------------------------------------------------------------------------------


@dataclass
class _Turn:
    """Whose turn it is between the server and a browser."""

    news: asyncio.Event  # something may be sent
    ready: bool = False  # the browser has drawn what it was sent


@final
class Sockets:
    """The browsers that are connected to a session."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._open: set[web.WebSocketResponse] = set()

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """Commands in, states and frames out."""
        origins = [f"http://{host}" for host in _hosts(request)]
        if request.headers.get("Origin") not in origins:
            raise web.HTTPForbidden(text=f"only for the page {origins[0]}\n")
        to = web.WebSocketResponse(max_msg_size=_LONGEST, compress=False)
        await to.prepare(request)
        self._open.add(to)
        turn = _Turn(asyncio.Event())
        sender = asyncio.create_task(self._send(to, turn))
        try:
            async for message in to:
                if message.type is WSMsgType.TEXT and message.data == DRAWN:
                    turn.ready = True
                    turn.news.set()
                elif message.type is WSMsgType.TEXT:
                    await to.send_str(json.dumps(await self._answer(message.data)))
        except ConnectionError:  # the browser has gone
            pass
        finally:
            self._open.discard(to)
            sender.cancel()
        return to

    async def _answer(self, text: str) -> dict[str, Any]:
        """What a command did, with the number `id` that it came with."""
        try:
            command = json.loads(text)
        except (ValueError, RecursionError):
            return {"type": "answer", "error": "expected a command as JSON"}
        loop = asyncio.get_running_loop()
        answer = await loop.run_in_executor(None, self._session.do, command)
        number = command.get("id") if isinstance(command, dict) else None
        return {"type": "answer", "id": number, **answer}

    async def _send(self, to: web.WebSocketResponse, turn: _Turn) -> None:
        """What is new, to one browser: frames when it has drawn the last ones, all else at once."""
        loop, session = asyncio.get_running_loop(), self._session

        def wake() -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(turn.news.set)

        known, epoch, last = -1, -1, 0
        session.listen(wake)
        try:
            await to.send_str(json.dumps(session.hello()))
            turn.ready = True
            while True:
                version, _, count = session.latest()
                if version != known:
                    known, state = session.state()
                    await to.send_str(json.dumps(state))
                    if state["epoch"] != epoch:
                        epoch, last, turn.ready = state["epoch"], 0, True
                elif turn.ready and count > last:
                    text, last, turn.ready = session.frames(last), count, False
                    await to.send_str(text)
                else:
                    await turn.news.wait()
                    turn.news.clear()
        except ConnectionError:
            return
        finally:
            session.listen(wake, False)

    async def close(self, app: web.Application) -> None:
        """Say goodbye to all."""
        for to in tuple(self._open):
            await to.close(code=1001, message=b"the server was stopped")


# -- serving -------------------------------------------------------------------------------------


async def serve(session: Session, at: socket.socket, ready: Callable[[str], None]) -> None:
    """Serve until cancelled; `ready(address)` is called once it can be opened."""
    runner = web.AppRunner(application(session), access_log=None, shutdown_timeout=2.0)
    await runner.setup()
    await web.SockSite(runner, at).start()
    ready(f"http://{HOST}:{at.getsockname()[1]}/")
    try:
        await asyncio.Event().wait()
    finally:
        await runner.cleanup()
