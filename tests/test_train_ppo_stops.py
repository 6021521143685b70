"""PPO where a run is stopped or refused: files stay, one line tells, and it can be gone on with."""

from __future__ import annotations

import errno
import os
import signal
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # their own, at import
    for module in ("torch", "stable_baselines3", "tensorboard", "tyro"):
        pytest.importorskip(module)

    import train.ppo.run
    import train.ppo.start
    from train.ppo.start import prepare

from ppo_runs import files, shorten_evaluations, small, words

from baselines.files import load
from train import checkpoint, ppo


@pytest.fixture(autouse=True)
def _short_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten_evaluations(monkeypatch)


def test_a_full_disk_is_one_error_and_earlier_files_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    prepare(small(tmp_path)).train()
    before = files(tmp_path)
    assert set(before) == {"best.safetensors", "last.safetensors", "log.csv", checkpoint.NAME}

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    run = prepare(small(tmp_path, resume=True, steps=1024))
    monkeypatch.setattr(train.ppo.start, "prepare", lambda options: run)
    monkeypatch.setattr(os, "fsync", full)
    status = ppo.main([*words(small(tmp_path, steps=1024)), "--resume"])
    assert status == 1
    told = capsys.readouterr().err
    assert "No space left on device" in told and "earlier files are intact" in told
    assert told.count("\n") == 1 and "Traceback" not in told
    assert files(tmp_path) == before


def test_an_interruption_while_compiling_ends_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is lost then, so nothing is waited for: Ctrl-C is not put off until an update is over."""

    def interrupt(*args: Any) -> None:
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        raise KeyboardInterrupt

    monkeypatch.setattr(train.ppo.run, "Evaluator", interrupt)
    assert ppo.main(["--output", str(tmp_path / "run"), "--quiet"]) == 130
    assert "interrupted: nothing was written" in capsys.readouterr().err
    assert not (tmp_path / "run" / "checkpoint.safetensors").exists()


def test_an_interruption_saves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    score_network = train.ppo.run.Evaluator.score_network
    calls = []

    def interrupted(self: Any, *policy_file: Any) -> Any:
        calls.append(None)
        if len(calls) == 2:
            signal.raise_signal(signal.SIGINT)
        return score_network(self, *policy_file)

    monkeypatch.setattr(train.ppo.run.Evaluator, "score_network", interrupted)
    handler = signal.getsignal(signal.SIGINT)
    assert ppo.main(words(small(tmp_path, steps=10_000))) == 130
    assert "--resume" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is handler
    facts = checkpoint.load(tmp_path / checkpoint.NAME)[0]
    assert facts["steps"] == 384, "after the update in hand"
    assert ppo.main(["--output", str(tmp_path), "--resume", "--steps", "512", "--quiet"]) == 0
    assert load(tmp_path / "last.safetensors")[0].steps == 512


def test_a_time_limit_ends_a_run(tmp_path: Path) -> None:
    run = prepare(small(tmp_path, steps=10**9, minutes=0.02))
    run.train()
    assert run.model.num_timesteps < 10**7
    assert load(tmp_path / "last.safetensors")[0].minutes >= 0.02


def test_the_command_says_what_it_reached(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ppo.main([w for w in words(small(tmp_path)) if w != "--quiet"]) == 0
    said = capsys.readouterr()
    assert "after 512 agent steps" in said.out
    assert "Warning" not in said.err


def test_the_profile_adds_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ppo.main([*words(small(tmp_path)), "--profile"]) == 0
    lines = [line.rsplit(" s ", 1) for line in capsys.readouterr().out.splitlines()]
    parts = [float(head.split()[-1]) for head, _ in lines[:-1]]
    assert len(parts) == 7 and min(parts) >= 0.0
    assert sum(parts) == pytest.approx(float(lines[-1][0].split()[-2]), abs=0.05)


@pytest.mark.parametrize("missing", ["tyro", "stable_baselines3", "torch", "tensorboard"])
def test_a_missing_extra_is_named(
    missing: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in list(sys.modules):
        if name.startswith("train.") and name != "train.ppo":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    assert ppo.main(["--output", "nowhere"]) == 2
    told = capsys.readouterr().err
    assert 'pip install "formation-env[train]"' in told and missing in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    "wrong",
    [
        ["--scenario", "nowhere"],
        ["--action", "telepathy"],
        ["--worlds", "0"],
        ["--gamma", "1.5"],
        ["--residual", "-1"],
        ["--history", "two"],
        ["--start-offset", "-1"],
        ["--scenario-duration", "-1"],
        ["--init", "nothing.safetensors"],
        ["--resume"],
        ["--frobnicate"],
    ],
    ids=lambda wrong: wrong[0],
)
def test_an_impossible_option(
    wrong: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "new"
    try:
        status = ppo.main(["--output", str(folder), "--steps", "64", *wrong])
    except SystemExit as stopped:
        status = stopped.code if isinstance(stopped.code, int) else -1
    assert status == 2
    told = capsys.readouterr().err
    assert "Traceback" not in told and told.strip()
    assert not folder.exists()


def test_a_run_is_not_overwritten_and_keeps_its_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prepare(small(tmp_path)).train()
    before = files(tmp_path)
    assert ppo.main(words(small(tmp_path))) == 2
    assert "--resume" in capsys.readouterr().err
    assert ppo.main([*words(small(tmp_path, history=2)), "--resume"]) == 2
    assert "--history 2: the run was started with 1" in capsys.readouterr().err
    data = (tmp_path / checkpoint.NAME).read_bytes()
    for bad in (data[:1000], b"", before["last.safetensors"]):
        (tmp_path / checkpoint.NAME).write_bytes(bad)
        assert ppo.main([*words(small(tmp_path)), "--resume"]) == 2
        assert "not a checkpoint" in capsys.readouterr().err


def test_a_policy_of_another_action_level_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prepare(small(tmp_path / "one")).train()
    source = tmp_path / "one" / "last.safetensors"
    assert ppo.main([*words(small(tmp_path / "two", action="rates")), "--init", str(source)]) == 2
    assert "action level 'reference': the configuration has 'rates'" in capsys.readouterr().err
    assert not (tmp_path / "two").exists()
