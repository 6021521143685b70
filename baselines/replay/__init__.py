"""Flights to look at: recorded, saved, exported and written as one HTML page.

import baselines

baselines.replay(["expert", "dagger"], "paper", seed=3).write("replay.html")   # or the last line of a cell

from baselines.replay import Recorder, Replay, read, write, write_table

recorder = Recorder(env, "mine")       # after env.reset(); recorder.add(info) after each env.step(...)
write(recorder.episode(), "mine.npz")  # one NumPy archive
Replay(read("mine.npz"))               # the page, in a notebook
"""

import sys
from types import ModuleType
from typing import Any, final

from baselines.replay.archive import read, write
from baselines.replay.command import main, parser
from baselines.replay.episode import Episode
from baselines.replay.flights import Replay, replay
from baselines.replay.recording import Recorder
from baselines.replay.table import write as write_table

__all__ = [
    "Episode",
    "Recorder",
    "Replay",
    "main",
    "parser",
    "read",
    "replay",
    "write",
    "write_table",
]


@final
class _Callable(ModuleType):
    """This package as a function, as `baselines.evaluate` is one."""

    def __call__(self, *args: Any, **options: Any) -> Replay:
        return replay(*args, **options)


sys.modules[__name__].__class__ = _Callable
