"""What is said while kernels are compiled: one line on a terminal, few elsewhere, counted beforehand."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from formation_env import _compiling
from formation_env._compiling import _Compiling, linked_functions
from formation_env.core.kernels import advance
from formation_env.physics.quadrotor import derivative

ROOT = Path(__file__).resolve().parent.parent
FOLDER = "/the/folder"

needs_compiler = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="nothing is compiled"
)


class Screen(io.StringIO):
    """A stream that says of itself whether it is a terminal."""

    def __init__(self, terminal: bool) -> None:
        super().__init__()
        self.terminal = terminal

    def isatty(self) -> bool:
        return self.terminal


def compiled(function: Any) -> Any:
    """What a compiled function looks like from without."""
    return SimpleNamespace(py_func=function, stats=SimpleNamespace(cache_path=FOLDER))


def kernel_of(count: int) -> tuple[Any, list[Any]]:
    """A kernel that calls so many functions, and these."""
    space: dict[str, Any] = {}
    for k in range(count):
        exec(f"def part_{k}(): pass", space)
        space[f"part_{k}"] = compiled(space[f"part_{k}"])
    exec(f"def whole(): {'; '.join(f'part_{k}()' for k in range(count))}", space)
    return compiled(space["whole"]), [space[f"part_{k}"] for k in range(count)]


def tell(
    monkeypatch: pytest.MonkeyPatch,
    terminal: bool,
    count: int,
    seconds: float,
    story: _Compiling | None = None,
    title: str = "the whole",
) -> list[str]:
    """The parts of what is written, each up to a line's end or return, while a kernel of `count` functions is
    compiled in steps of so many seconds."""
    now = [0.0]
    screen = Screen(terminal)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(_compiling, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setenv("COLUMNS", "80")
    story = _Compiling() if story is None else story
    kernel, parts = kernel_of(count)
    story.titles[id(kernel)] = (kernel, title)
    events = {id(one): SimpleNamespace(data={"dispatcher": one}) for one in (kernel, *parts)}
    story.on_start(events[id(kernel)])
    for part in parts:
        story.on_start(events[id(part)])
        now[0] += seconds
        story.on_end(events[id(part)])
    story.on_end(events[id(kernel)])
    assert story.status() == ""
    return screen.getvalue().replace("\r", "\n").split("\n")


FIRST = f"formation_env: compiling, once, which can take a minute (kept in {FOLDER})"


def test_on_a_terminal_one_line_is_rewritten_and_erased(monkeypatch: pytest.MonkeyPatch) -> None:
    told = tell(monkeypatch, True, 120, 0.5)
    assert told[0] == FIRST
    line = [one.rstrip() for one in told[1:-2]]
    assert line[0] == ""
    # 0.8 of the time for 121 functions: 0.5 s each make 75 s.
    assert line[1] == "formation_env: the whole, 1 of 121 functions"
    assert line[4] == "formation_env: the whole, 4 of 121 functions"  # too early for an estimate
    assert line[5] == "formation_env: the whole, 5 of 121 functions, about 73 s left"
    assert line[60] == "formation_env: the whole, 60 of 121 functions, about 46 s left"
    assert line[120] == "formation_env: the whole, 120 of 121 functions, about 16 s left"
    assert max(map(len, told[1:])) < 80
    assert told[-2] == " " * len(line[-1]) and told[-1] == ""


def test_a_line_that_gets_shorter_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    told = tell(monkeypatch, True, 60, 3.0)
    shown = [len(one) for one in told[2:-2]]
    kept = [len(one.rstrip()) for one in told[2:-2]]
    assert any(later < before for before, later in pairwise(kept))
    assert all(room >= before for before, room in zip(kept, shown[1:], strict=False))


def test_a_narrow_terminal_cuts_it(monkeypatch: pytest.MonkeyPatch) -> None:
    story = _Compiling()
    story.told = True
    monkeypatch.setattr(
        _compiling.shutil, "get_terminal_size", lambda: SimpleNamespace(columns=40, lines=24)
    )
    assert max(map(len, tell(monkeypatch, True, 50, 1.0, story))) == 39


def test_the_line_is_seldom_redrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    told = tell(monkeypatch, True, 300, 0.03)
    assert 60 <= len(told) <= 90


@pytest.mark.parametrize(("seconds", "lines"), [(0.2, 3), (0.02, 0)])
def test_elsewhere_there_are_few_lines_and_none_of_what_is_fast(
    monkeypatch: pytest.MonkeyPatch, seconds: float, lines: int
) -> None:
    told = tell(monkeypatch, False, 99, seconds)
    assert told[0] == FIRST and told[-1] == "" and len(told) == lines + 2
    quarters = [f"formation_env: the whole, {k} of 100 functions, about " for k in (25, 50, 75)]
    assert all(one.startswith(start) for one, start in zip(told[1:-1], quarters, strict=False))


def test_kernels_in_turn_are_one_story(monkeypatch: pytest.MonkeyPatch) -> None:
    story = _Compiling()
    first = tell(monkeypatch, True, 40, 0.5, story, "the one")
    second = tell(monkeypatch, True, 40, 0.5, story, "the other")
    assert first[0] == FIRST
    assert "formation_env: compiling" not in " ".join(second)
    assert any("the other, 20 of 41 functions" in one for one in second)


def test_what_was_compiled_before_is_not_counted_again(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen(True)
    monkeypatch.setattr(sys, "stderr", screen)
    story, (kernel, parts) = _Compiling(), kernel_of(3)
    story.titles[id(kernel)] = (kernel, "the whole")
    other = SimpleNamespace(data={"dispatcher": compiled(lambda: None)})
    story.on_start(other)
    done = SimpleNamespace(data={"dispatcher": parts[0]})
    story.on_start(done)
    story.on_end(done)
    story.on_end(other)
    story.on_start(SimpleNamespace(data={"dispatcher": kernel}))
    assert story.status() == "the whole, 0 of 3 functions"
    story.on_end(SimpleNamespace(data={"dispatcher": kernel}))


def test_untold_says_nothing_and_status_still_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    story = _Compiling()
    monkeypatch.setattr(_compiling, "_compiling", story)
    with _compiling.untold():
        assert tell(monkeypatch, True, 40, 0.5, story) == [""]
    assert tell(monkeypatch, True, 40, 0.5, story)[0] == FIRST
    story._title, story._total, story._left, story._began = "the whole", 10, set(), -19.5
    assert _compiling.status() == "the whole, machine code of 10 functions, about 10 s left"


class Gone(Screen):
    def write(self, text: str) -> int:
        raise BrokenPipeError


@pytest.mark.parametrize("stream", [None, Gone(True), Gone(False)])
def test_a_stream_that_takes_nothing_stops_nothing(
    monkeypatch: pytest.MonkeyPatch, stream: Any
) -> None:
    story, (kernel, parts) = _Compiling(), kernel_of(4)
    story.titles[id(kernel)] = (kernel, "the whole")
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(_compiling, "_REDRAWN", 0.0)
    for one in (kernel, *parts):
        story.on_start(SimpleNamespace(data={"dispatcher": one}))
    for one in (*parts, kernel):
        story.on_end(SimpleNamespace(data={"dispatcher": one}))
    assert story.told


# -- the number of functions ----------------------------------------------------------------------

COUNT = """
import json
from numba.core import event
from formation_env._compiling import linked_functions
from formation_env._jit import KERNELS
within, seen, compiled = [], set(), set()
class Listener(event.Listener):
    def on_start(self, event):
        within.append(event.data["dispatcher"])
        if within[0] in KERNELS:
            seen.add(within[0].py_func)
            compiled.add(within[-1].py_func)
    def on_end(self, event):
        within.pop()
event.register("numba:compile", Listener())
from formation_env import configure
configure("agile").trajectory.drawn(0)
counted = set().union(*(linked_functions(one) for one in KERNELS if one.py_func in seen))
ours = {one for one in compiled if one.__module__.startswith("formation_env.")}
names = [sorted(one.__qualname__ for one in some) for some in (seen, ours - counted, counted - ours)]
print(json.dumps([*names, len(counted)]))
"""


@needs_compiler
def test_the_functions_that_are_compiled_are_those_that_were_counted(tmp_path: Path) -> None:
    """Of the small kernels: what the simulation links is named in the same ways."""
    done = subprocess.run(
        [sys.executable, "-c", COUNT],
        env={**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    kernels, missed, vain, count = json.loads(done.stdout)
    assert {"_sample", "_draw_one", "_deviations"} <= set(kernels)
    assert missed == [] and vain == [] and count > 20


@needs_compiler
def test_the_simulation_is_hundreds_of_functions_that_are_counted_at_once() -> None:
    names = {one.__module__ for one in linked_functions(advance)}
    for module in ("core.tick", "laws.world", "paths.references", "physics.sensors"):
        assert f"formation_env.{module}" in names
    assert len(linked_functions(advance)) > 200
    # Runge-Kutta's step has the derivative it was made for as a variable of an outer function.
    assert derivative.py_func in linked_functions(advance)  # type: ignore[attr-defined]
