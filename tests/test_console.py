"""Commands whose output nobody reads to the end, or that a full device does not take."""

from __future__ import annotations

import io
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest
from numba.core import event

from baselines.scoring import evaluation as scoring
from baselines.system import console, progress
from formation_env import configure
from formation_env._jit import kernel

QUICK = ["--scenarios", "nominal", "--policies", "hover", "--episodes", "1", "--duration", "0.1"]
unix = pytest.mark.skipif(sys.platform == "win32", reason="pipes and devices of Unix")


def closed_pipe(*words: str) -> tuple[int, str]:
    """Status and standard error of a command whose reader has gone before it prints."""
    with subprocess.Popen(
        [sys.executable, "-m", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout is not None and run.stderr is not None
        run.stdout.close()
        said = run.stderr.read()
        return run.wait(300), said


@unix
def test_an_evaluation_is_not_lost_in_a_closed_pipe(tmp_path: Path) -> None:
    status, said = closed_pipe("baselines.evaluate", *QUICK, "--output", str(tmp_path))
    assert status == 0
    assert "Traceback" not in said and "Broken" not in said
    assert sorted(p.name for p in tmp_path.iterdir()) == ["results.json", "results.md"]


@unix
def test_help_in_a_closed_pipe_is_quiet() -> None:
    assert closed_pipe("baselines.evaluate", "--help") == (0, "")


@unix
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device")
def test_an_evaluation_is_not_lost_on_a_full_device(tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "baselines.evaluate", *QUICK, "--output", str(tmp_path)],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=300,
        )
    assert run.returncode == 1
    assert run.stderr.splitlines()[-1] == "error: cannot print: No space left on device"
    assert "Traceback" not in run.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["results.json", "results.md"]


@unix
def test_a_bar_that_nobody_reads_does_not_end_the_run(tmp_path: Path) -> None:
    """`2>&1 | head`: the bar goes into the closed pipe as well."""
    words = [sys.executable, "-m", "baselines.evaluate", *QUICK, "--output", str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as run:
        assert run.stdout is not None
        run.stdout.close()
        assert run.wait(300) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["results.json", "results.md"]


# -- compiling first ------------------------------------------------------------------------------


@kernel
def a_kernel(x: float) -> float:
    return x


def compile_something() -> None:
    data = {"dispatcher": a_kernel}
    for _ in range(3):
        event.start_event("numba:compile", data)
        event.end_event("numba:compile", data)


@pytest.mark.skipif(not hasattr(a_kernel, "targetoptions"), reason="nothing is compiled")
def test_an_interruption_outside_of_the_work_is_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    @console.command
    def main(arguments: Sequence[str] | None = None) -> int:
        raise KeyboardInterrupt

    assert main([]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_compiling_that_is_interrupted_is_not_done(capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted() -> None:
        with progress.compiling():
            compile_something()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert capsys.readouterr().err == f"{progress.TEXT} stopped after 0 s\n"


@pytest.mark.skipif(not hasattr(a_kernel, "targetoptions"), reason="nothing is compiled")
def test_compiling_has_a_line_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.compiling():
        pass
    assert capsys.readouterr().err == ""
    with progress.compiling():
        compile_something()
        assert capsys.readouterr().err == progress.TEXT
    assert capsys.readouterr().err == " done in 0 s\n"
    compile_something()
    with progress.compiling(quiet=True):
        compile_something()
    assert capsys.readouterr().err == ""


def test_on_a_terminal_the_line_says_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    monkeypatch.setattr(sys, "stderr", screen)
    line, waits = progress._Line(quiet=False), iter([False, False, True])
    monkeypatch.setattr(line._over, "wait", lambda seconds: next(waits))
    said = iter(["the simulation, 9 of 331 functions, about 17 s left", ""])
    monkeypatch.setattr(progress, "status", lambda: next(said))
    line._began = time.monotonic()
    line._tick()
    _, first, second = screen.getvalue().split("\r")
    assert first.rstrip() == "compiling once: the simulation, 9 of 331 functions, about 17 s left"
    assert second.rstrip() == f"{progress.TEXT} 0 s"
    assert len(first) == len(second) == 79


def test_the_bar_begins_when_everything_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every kernel has been used when the bar is made: its rate counts flying only."""
    happened: list[str] = []
    fly, Bar = scoring.fly, scoring.Bar

    def flown(*args: object, **options: object) -> object:
        happened.append("warm" if "most" in options else "fly")
        return fly(*args, **options)  # type: ignore[arg-type]

    def bar(*args: object) -> object:
        happened.append("bar")
        return Bar(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(scoring, "fly", flown)
    monkeypatch.setattr(scoring, "Bar", bar)
    scoring.evaluate(
        {"nominal": configure("nominal", duration=0.1)}, ["hover", "expert"], episodes=1
    )
    assert happened == ["warm"] * 2 + ["bar"] + ["fly"] * 2
