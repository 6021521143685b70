"""The benchmark measures what it says. No test looks at how long anything took."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit

from benchmarks import grid, peers, profile, report, single, throughput
from benchmarks.floor import LANES, Floor, _fly_tile
from benchmarks.steps import steps_only
from benchmarks.timing import in_turn, ratio, repeating
from formation_env import configure
from formation_env._jit import FASTMATH
from formation_env.core import kernels
from formation_env.physics.quadrotor import MOMENT, Body, Wrench, fly

TINY = ["--quick", "--worlds", "1,3", "--followers", "2", "--rounds", "1", "--seconds", "0.0001"]


@pytest.mark.parametrize("threads", [1, 2])
def test_the_floor_flies_every_vehicle(threads: int) -> None:
    """Each lane of each tile ends where the rigid body alone takes it; 2 threads want 2 parts."""
    config = configure("nominal")
    vehicles = 5 if threads == 1 else 40 * 128
    floor = Floor(config, vehicles, threads)
    draw = np.random.default_rng(1)
    floor.states[:] = draw.normal(size=floor.states.shape)
    before, inputs = floor.states.copy(), floor.inputs
    floor.step()
    floor.close()
    h = config.control_period / config.substeps
    tiles = {0, len(before) - 1}
    for tile in tiles:
        lane = 3
        x = before[tile].reshape(13, LANES)[:, lane].tolist()
        u = inputs[tile].reshape(4, LANES)[:, lane].tolist()
        body = Body(tuple(x[0:3]), tuple(x[3:6]), tuple(x[6:10]), tuple(x[10:13]))
        applied = Wrench(u[0], tuple(u[1:4]))
        for _ in range(config.substeps):
            body = fly(body, applied, (0.0, 0.0, 0.0), h, MOMENT, config.vehicle.airframe())
        expected = [*body.p, *body.v, *body.q, *body.w]
        after = floor.states[tile].reshape(13, LANES)[:, lane]
        np.testing.assert_allclose(after, expected, rtol=1e-12, atol=1e-12)
    assert (floor.states != before).reshape(len(before), 13, LANES)[:, :6].all()


def test_the_floor_is_vectorised() -> None:
    """Four vehicles to a division: otherwise the floor would be too high to compare with."""
    if not hasattr(_fly_tile, "py_func"):
        pytest.skip("compilation is switched off")
    # Anew, since there is no code to look at in what comes from the cache.
    fresh = njit(fastmath=FASTMATH, error_model="numpy", nogil=True)(_fly_tile.py_func)
    floor = Floor(configure("nominal"), 1)
    fresh(floor.states[0], floor.inputs[0], *floor._arguments)
    code = "".join(fresh.inspect_asm().values())
    if "xmm" not in code:
        pytest.skip("not an x86 processor")
    assert "divpd" in code


def test_samples_are_taken_in_turn() -> None:
    seen: list[str] = []
    in_turn(
        {"a": repeating(lambda: seen.append("a")), "b": repeating(lambda: seen.append("b"))},
        2,
        1e-9,
    )
    turns = [name for name, before in zip(seen, ["", *seen], strict=False) if name != before]
    assert turns[-4:] == ["a", "b", "a", "b"]
    assert ratio([2.0, 6.0, 40.0], [1.0, 2.0, 4.0]) == 3.0


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("benchmarks")
    assert throughput.main([*TINY, "--no-peers", "--output", str(folder)]) == 0
    written: dict[str, Any] = json.loads((folder / "throughput.json").read_text(encoding="utf-8"))
    text = (folder / "throughput.md").read_text(encoding="utf-8")
    assert report.bars_table(written) in text
    assert (folder / "throughput.png").stat().st_size > 1000
    return written


def test_every_combination_is_measured_once(figures: dict[str, Any]) -> None:
    found = [(r["scenario"], r["worlds"], r["followers"], r["threads"]) for r in figures["grid"]]
    expected = [(s, w, 2, t) for s in ("nominal", "paper") for w in (1, 3) for t in (1, 2)]
    assert sorted(found) == sorted(expected)


def test_rates_follow_from_the_time_of_a_step(figures: dict[str, Any]) -> None:
    for row in figures["grid"]:
        steps = 1e6 / row["step_us"]
        assert row["agent_steps_per_s"] == pytest.approx(2 * row["worlds"] * steps)
        # A leader and two followers, four substeps.
        assert row["vehicle_substeps_per_s"] == pytest.approx(12 * row["worlds"] * steps)


def test_memory_covers_what_the_state_must_hold(figures: dict[str, Any]) -> None:
    """At least the 13 numbers of a rigid body a vehicle, and the peak not below what is held."""
    for row in figures["memory"]:
        assert row["held"] > 13 * 8
        assert row["peak"] >= row["held"]


def test_a_picture_is_timed(figures: dict[str, Any]) -> None:
    if importlib.util.find_spec("pygame") is None:
        assert figures["frame_ms"] is None
    else:
        assert 0.1 < figures["frame_ms"] < 10_000.0


def test_what_does_not_fit_is_skipped_with_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for part in ("_singles", "_memory"):
        monkeypatch.setattr(throughput, part, lambda *_: None)
    options = ["--no-peers", "--memory", "1e-6", "--output", str(tmp_path)]
    assert throughput.main([*TINY, *options]) == 0
    written = json.loads((tmp_path / "throughput.json").read_text(encoding="utf-8"))
    assert written["grid"] == []
    assert len(written["notes"]) == 4 and "3 worlds x 2" in written["notes"][1]
    assert "see --memory" in capsys.readouterr().out


def test_an_absent_neighbour_is_skipped_with_a_line() -> None:
    def make(worlds: int) -> Any:
        raise AssertionError("made although it is not installed")

    ghost = peers.Peer("Ghost", "no-such-distribution-of-ours", (1,), make)
    lines: list[str] = []
    assert single._absent(ghost, lines.append)
    assert lines == ["skipped Ghost: no-such-distribution-of-ours is not installed"]


def test_a_failing_neighbour_is_skipped_with_a_line() -> None:
    def make(worlds: int) -> Any:
        raise RuntimeError("no display")

    lines: list[str] = []
    assert single._made(peers.Peer("Ghost", "numpy", (1,), make), 1, lines.append) is None
    assert lines == ["skipped Ghost at 1 worlds: RuntimeError: no display"]


def test_resets_are_not_counted_as_steps() -> None:
    """Five steps over episodes of two: three of them, and the clock only around steps."""

    class Short:
        resets = steps = 0

        def reset(self, seed: int | None = None) -> None:
            self.resets += 1
            self.age = 0

        def step(self, action: int) -> tuple[int, float, bool, bool]:
            assert self.age < 2
            self.age += 1
            self.steps += 1
            return 0, 0.0, self.age == 2, False

    env = Short()
    steps_only(env, lambda k: k)(5)
    assert env.steps == 5
    assert env.resets == 4  # one to begin with, one a sample, one after each of two ends


def _row(**changes: Any) -> dict[str, Any]:
    row = {"scenario": "nominal", "action": "wrench", "followers": 2, "worlds": 4096, "threads": 1}
    return {**row, "share_of_floor": 0.6, "speedup": 1.0, "ns_per_agent_step": 50.0, **changes}


def test_bars() -> None:
    figures = {
        "grid": [_row(), _row(threads=2, speedup=1.7), _row(worlds=256, ns_per_agent_step=125.0)],
        "one_world": {"over_cartpole": 1.9, "over_mpe2": None},
    }
    bars = {bar.what: (bar.value, bar.reached) for bar in report.bars(figures)}
    assert bars["gym.make step over CartPole-v1's"] == (1.9, True)
    assert bars["MPE2 step over PettingZoo step, 3 agents"] == (None, None)
    share = "share of the floor, nominal, 4096 worlds, 2 followers, threads 1"
    assert bars[share] == (0.6, True)
    assert bars["two threads over one, least from 4096 worlds up"] == (1.7, False)
    flat = "cost per agent step, dearest over cheapest, 256 to 65536 worlds"
    assert bars[flat] == (2.5, False)
    assert bars["import formation_env, s"] == (None, None)


@pytest.mark.parametrize(
    "options",
    [
        ["--worlds", "0"],
        ["--worlds", "1,x"],
        ["--followers", "5000"],
        ["--seconds", "nan"],
        ["--memory", "-1"],
        ["--actions", "levitate"],
        ["--scenarios", "swarm"],
    ],
    ids=" ".join,
)
def test_impossible_options_are_refused(
    options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        throughput.main(options)
    assert stopped.value.code == 2
    assert f"argument {options[0]}" in capsys.readouterr().err


def test_an_output_that_is_a_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine")
    assert throughput.main([*TINY, "--output", str(taken)]) == 2
    assert "argument --output" in capsys.readouterr().err
    assert taken.read_text() == "mine"


def test_returned_arrays_are_counted_once() -> None:
    base = np.zeros(10)
    assert grid.returned_bytes((base[2:], base[:4], {"a": {"b": np.zeros(3, np.float32)}})) == 92


@pytest.fixture
def untouched_kernels() -> Iterator[None]:
    before = dict(vars(kernels))
    yield
    assert dict(vars(kernels)) == before


@pytest.mark.usefixtures("untouched_kernels")
def test_the_profile_finds_the_kernels(capsys: pytest.CaptureFixture[str]) -> None:
    assert profile.main(["--rounds", "1"]) == 0
    printed = capsys.readouterr().out
    assert "FormationEnv.step" in printed and "FormationParallelEnv.step" in printed
    assert printed.count("| kernels |") == 2
