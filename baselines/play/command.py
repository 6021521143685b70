"""Open a live page on this machine and fly: `python -m baselines.play`, or `formation-play`."""

from __future__ import annotations

import argparse
import asyncio
import threading
import webbrowser
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from typing import Any

from baselines.files import SUFFIX
from baselines.play import ports
from baselines.registry import METHODS, POLICIES
from baselines.scoring import tasks
from baselines.scoring.options import add_task, read_policies
from baselines.system import console
from baselines.system.arguments import Parser, reader, whole
from baselines.system.progress import compiling
from baselines.system.text import wrapped

MISSING = 'the live page needs aiohttp: pip install "formation-env[web]"'

EXAMPLES = """\
  formation-play
  formation-play --policies expert,dagger --scenario swarm
  formation-play --policies mine.py:MyPolicy --set gust=0.3 --seed 7
  formation-play --no-browser --port 9000
"""


def parser() -> Parser:
    """The options of the command, none of them read yet."""
    own = Parser(
        "formation-play",
        "Fly policies live, on a page of this machine in your browser: sliders for every field of the "
        "configuration, pushes, a follower that is lost, two policies side by side.",
        EXAMPLES,
    )
    add = own.add_argument
    add("--policies", type=reader(read_policies), default=["expert"], metavar="NAMES",
        help="Policies to fly, one or two, separated by commas; of more the others can be chosen on the "
        f"page. Names: {', '.join(POLICIES)}; learned ones that are shipped, {', '.join(METHODS)}; paths of "
        f"*{SUFFIX} files; your own code as module:Name or file.py:Name. (default: expert)")  # fmt: skip
    add_task(own)
    add("--seed", type=whole(0, 2**32), default=0, metavar="N",
        help="Seed of the first episode. (default: %(default)s)")  # fmt: skip
    add("--port", type=whole(0, 65535), metavar="N",
        help="Port of this machine to serve the page on; 0 takes any that is free. "
        f"(default: {ports.PORT}, or the next that is free)")  # fmt: skip
    add("--no-browser", action="store_true",
        help="Print the address of the page and open no browser. (default: off)")  # fmt: skip
    return own


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    own = parser()
    given = own.parse_args(arguments)
    if find_spec("aiohttp") is None:
        console.complain(f"{own.prog}: error: {MISSING}")
        return 1
    try:
        at = ports.bound(given.port)
    except OSError as problem:
        console.complain(f"{own.prog}: error: {problem.strerror}")
        return 1
    try:
        from baselines.play import server

        with at:
            session = _session(own, given)
            try:
                session.start()
                asyncio.run(server.serve(session, at, lambda url: _tell(url, given.no_browser)))
            finally:
                session.close()
    except KeyboardInterrupt:
        console.complain("stopped")
    return 0


def _session(own: Parser, given: argparse.Namespace) -> Any:
    """What is flown, compiled. A wrong option ends the command."""
    from baselines.play.session import Session
    from baselines.play.settings import from_fields

    changes = {"action": given.action} if given.action else {}
    changes |= tasks.scenario_fields(given.scenario)
    scenario = changes.pop("scenario")
    changes |= {setting.field: setting.values[0] for setting in given.settings}
    try:
        with compiling():
            return Session(
                given.policies[:2], scenario, from_fields(changes), given.seed, given.policies
            )
    except (ValueError, TypeError) as problem:
        own.error(str(problem))


def _tell(address: str, quiet: bool) -> None:
    console.say(wrapped(f"open {address} in a browser; Ctrl-C ends it"))
    if not quiet:  # in a thread: a browser in the terminal returns when it is closed
        threading.Thread(target=_open, args=(address,), daemon=True).start()


def _open(address: str) -> None:
    with suppress(webbrowser.Error, OSError):
        webbrowser.open(address)
