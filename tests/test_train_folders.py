"""An output folder has one run of a trainer at a time; what else lies in it stays; compiling comes first."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # their own, at import
    for module in ("torch", "stable_baselines3", "tensorboard", "tyro", "cma"):
        pytest.importorskip(module)
    import torch

    import train.ppo.run
    import train.ppo.start
    from train.ppo.start import prepare

from baselines.policies.tuned import read
from baselines.system.writing import LOCK, claim
from train import imitate, ppo, tune_expert
from train.ppo.options import Options

SMALL = ["--steps", "64", "--worlds", "2", "--rollout", "8", "--episodes", "2", "--quiet"]
PPO = [*SMALL, "--action", "reference", "--hidden", "8"]
IMITATE = ["--worlds", "8", "--rounds", "1", "--ticks", "5", "--updates", "1", "--episodes", "2",
           "--quiet"]  # fmt: skip
TUNE = ["--evaluations", "2", "--episodes", "1", "--validation", "1", "--finalists", "1", "--quiet",
        "--feedforward", "zero", "--threads", "1"]  # fmt: skip
# What each claims in its folder: all of it, or one file.
COMMANDS: dict[str, tuple[Callable[..., int], list[str], str]] = {
    "ppo": (ppo.main, PPO, ""),
    "imitate": (imitate.main, IMITATE, ""),
    "tune": (tune_expert.main, TUNE, "nominal-wrench.json"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_second_run_in_a_folder_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both ended well before, and one result was gone."""
    main, words, file = COMMANDS[name]
    folder = tmp_path / "out"
    with claim(folder, file):
        before = sorted(folder.iterdir())
        assert main(["--output", str(folder), *words]) != 0
        told = capsys.readouterr().err
        assert told.count("\n") == 1 and "Traceback" not in told
        assert str(folder) in told and "a run that is not finished" in told and "process" in told
        assert sorted(folder.iterdir()) == before


def test_searches_with_other_journals_share_a_folder(tmp_path: Path) -> None:
    """And a file of gains, in which both entries stand then."""
    words = ["--output", str(tmp_path), "--gains", str(tmp_path / "gains.json"), *TUNE]
    with claim(tmp_path, "nominal-wrench.json"):
        assert tune_expert.main([*words, "--action", "reference"]) == 0
    assert tune_expert.main(words) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("gains.json", "nominal-reference.json", "nominal-wrench.json")
    ]
    assert set(read(tmp_path / "gains.json")) == {("nominal", "wrench"), ("nominal", "reference")}


def test_a_folder_is_free_after_a_run_and_after_a_refusal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is there of somebody else's stays, `.writable` too; what a killed run was writing goes."""
    part = tmp_path / ".log.csv.0123456789abcdef.part"
    for path in (tmp_path / ".writable", part):
        path.write_text("mine")
    assert ppo.main(["--output", str(tmp_path), *PPO]) == 0
    assert (tmp_path / ".writable").read_text() == "mine" and not part.exists()
    assert not (tmp_path / LOCK).exists()
    assert ppo.main(["--output", str(tmp_path), *PPO]) == 2
    assert "--resume" in capsys.readouterr().err
    assert imitate.main(["--output", str(tmp_path), *IMITATE]) == 2
    assert "exists" in capsys.readouterr().err
    claim(tmp_path).release()


def test_what_is_compiled_is_compiled_before_the_bar(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The evaluator's flights compile; a bar that had begun would count that as time of the training."""
    order: list[str] = []
    evaluator, bar = train.ppo.run.Evaluator, train.ppo.run.Progress

    def compiled(*given: Any) -> Any:
        order.append("compile")
        return evaluator(*given)

    def shown(self: Any, *given: Any) -> None:
        order.append("bar")

    monkeypatch.setattr(train.ppo.run, "Evaluator", compiled)
    monkeypatch.setattr(bar, "show", shown)
    assert ppo.main(["--output", str(tmp_path), *PPO]) == 0
    assert order[0] == "compile" and order.count("compile") == 1 and len(order) > 2


def test_numbers_that_are_lost_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a learning rate that is far too large makes them."""
    run = prepare(Options(output=tmp_path, action="reference", worlds=2, episodes=2, quiet=True))
    with torch.no_grad():
        run.policy.action_net.weight.fill_(float("nan"))
    monkeypatch.setattr(train.ppo.start, "prepare", lambda options: run)
    assert ppo.main(["--output", str(tmp_path), *PPO]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "no longer finite" in told
