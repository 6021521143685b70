"""`benchmarks.against` times what it says and judges by it. No test looks at how long anything took."""

from __future__ import annotations

import json
import shutil
from math import isfinite
from pathlib import Path
from typing import Any

import pytest

from benchmarks import against

ROOT = Path(__file__).resolve().parent.parent
TINY = ["--turns", "1", "--rounds", "1", "--seconds", "0.0001", "--points"]
POINTS = ["gym.make", "pettingzoo", "vector-2", "expert-2", "frame-1"]


@pytest.fixture
def uncompiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """The processes take plain Python: otherwise each test would compile for minutes."""
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")


@pytest.mark.slow
@pytest.mark.usefixtures("uncompiled")
def test_against_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every point is timed once a turn in both; the ratios printed are those of the figures written."""
    output = tmp_path / "figures.json"
    assert against.main([str(ROOT), *TINY, ",".join(POINTS), "--output", str(output)]) == 0
    figures: dict[str, Any] = json.loads(output.read_text(encoding="utf-8"))
    this, other = figures["seconds"]["this"], figures["seconds"]["other"]
    assert list(this) == list(other) == [*POINTS, "first compile"]
    for times in (*this.values(), *other.values()):
        assert len(times) == 1 and isfinite(times[0]) and times[0] > 0.0
    printed = capsys.readouterr().out.splitlines()
    for line, point in zip(printed[1:], this, strict=False):
        assert line.startswith(point)
        assert f"{other[point][0] / this[point][0]:.3f}" in line
    assert printed[-1].startswith("worst point: ")


@pytest.mark.usefixtures("uncompiled")
def test_a_checkout_that_fails_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the other checkout's process said last, and whose it was."""
    for package in ("formation_env", "baselines"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    broken = tmp_path / "formation_env" / "__init__.py"
    broken.write_text("raise RuntimeError('half a merge')\n", encoding="utf-8")
    arguments = [str(tmp_path), *TINY, "vector-1"]
    assert against.main([*arguments, "--compile", "1"]) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert message == f"error: a process of {tmp_path} failed: RuntimeError: half a merge"


def test_only_the_measuring_code_is_this_checkouts(tmp_path: Path) -> None:
    """The package is the other's, and without it nothing falls back on the one installed here."""
    other, folder = tmp_path / "other", tmp_path / "measuring"
    shutil.copytree(ROOT / "benchmarks", folder / "benchmarks")
    for package, names in {
        "formation_env": "FormationConfig = configure = formation_v0 = None",
        "baselines": "make_policy = None",
    }.items():
        (other / package).mkdir(parents=True)
        (other / package / "__init__.py").write_text(names + "\n", encoding="utf-8")
    (other / "benchmarks").mkdir()
    (other / "benchmarks" / "__init__.py").write_text("raise RuntimeError\n", encoding="utf-8")
    told = {"points": [], "scenario": "nominal", "threads": 1, "rounds": 1, "seconds": 1e-4}
    assert against._turn(other, folder, tmp_path / "cache", json.dumps(told)) == {}
    with pytest.raises(against.Failed, match="instead"):
        against._turn(other / "elsewhere", folder, tmp_path / "cache", json.dumps(told))


def test_ratios_are_those_of_paired_turns() -> None:
    """Load that doubles both times of a turn changes no ratio."""
    [row] = against.rows({"vector-1": [1.0, 2.0, 1.0]}, {"vector-1": [0.9, 1.8, 3.0]})
    assert row == ("vector-1", 1.0, 1.8, 0.9, 0.9, 3.0)


def test_which_points_are_below() -> None:
    compared = [
        against.Row("a", 1.0, 0.94, 0.94, 0.9, 1.1),
        against.Row("b", 1.0, 0.95, 0.95, 0.5, 1.1),
        against.Row("c", 1.0, 2.0, 2.0, 0.1, 3.0),
    ]
    assert against.below(compared, 0.95) == ["a"]
    assert against.below(compared, 0.9) == []


@pytest.mark.parametrize(("least", "status"), [("0.8", 0), ("0.9", 1)])
def test_scripts_can_judge(
    least: str,
    status: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    times = {
        "this": {"vector-1": [1.0], "gym.make": [1.0]},
        "other": {"vector-1": [0.85], "gym.make": [2.0]},
    }
    monkeypatch.setattr(against, "measure", lambda options: times)
    assert against.main([str(ROOT), "--least", least]) == status
    printed = capsys.readouterr()
    assert printed.out.splitlines()[-1].startswith("worst point: vector-1, 0.850 times")
    assert printed.err.splitlines() == status * ["error: speed below 0.9: vector-1"]


def test_the_table_fits() -> None:
    """The longest point and times that a machine may show."""
    longest = against.Row("expert-1000000", 0.0999, 12345.678, 123.456, 0.001, 1234.567)
    lines = against.table([longest]).splitlines()
    assert max(map(len, lines)) <= 80
    assert all(len(column.split()) == 8 for column in lines[1:2])


def test_the_checkouts_take_turns() -> None:
    """Neither is always first, so that what drifts favours neither."""
    order = [side for turn in against._turns(4) for side in turn]
    assert order == ["this", "other", "other", "this"] * 2


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["{folder}"], "CHECKOUT"),
        (["{folder}/absent"], "CHECKOUT"),
        (["{root}", "--points", "vector-0"], "--points"),
        (["{root}", "--points", "frame-0"], "--points"),
        (["{root}", "--points", "gym.make,swarm"], "--points"),
        (["{root}", "--least", "nan"], "--least"),
        (["{root}", "--turns", "0"], "--turns"),
        (["{root}", "--output", "{folder}"], "--output"),
        (["{root}", "--output", "{folder}/absent/figures.json"], "--output"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else value,
)
def test_impossible_options_are_refused_in_one_line(
    options: list[str], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        against.main([option.format(folder=tmp_path, root=ROOT) for option in options])
    assert stopped.value.code == 2
    [line] = capsys.readouterr().err.splitlines()
    assert f"argument {named}" in line
