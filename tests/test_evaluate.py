"""Scoring: the same numbers as `gym.make`, however the work is divided; files and errors."""

from __future__ import annotations

import json
import os
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from baselines import evaluate as command
from baselines import make_policy, registry
from baselines.files import Card, Network, save
from baselines.reporting.report import to_json
from baselines.scoring import rollout, suite
from baselines.scoring.evaluation import evaluate
from baselines.scoring.metrics import EPISODE
from baselines.scoring.results import Report
from baselines.system.writing import claim
from formation_env import SCENARIOS, configure

SHORT = 4.0  # s


@pytest.fixture(scope="module")
def short_report() -> Report:
    configs = {name: configure(name, duration=SHORT) for name in ("nominal", "swarm")}
    return evaluate(configs, ["expert", "random", "hover"], episodes=5, seed=7)


# -- the numbers ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["expert", "hover", "random"])
@pytest.mark.parametrize("scenario", ["nominal", "agile"])
def test_a_rollout_is_gym_make(name: str, scenario: str) -> None:
    """World 2 of a rollout from seed 5 is the episode of `reset(seed=7)`, to the last bit.

    Random flight ends in a failure, and hovering where another vehicle comes by, so the masked end of an
    episode is covered too.
    """
    env = gym.make("Formation-v0", scenario=scenario, duration=SHORT)
    config = env.unwrapped.config  # type: ignore[attr-defined]
    policy = make_policy(name, config)
    policy.reset(seed=7)
    observation, _ = env.reset(seed=7)
    total, over, ticks = 0.0, False, 0
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy.act(observation))
        total, over, ticks = total + float(reward), terminated or truncated, ticks + 1
    env.close()
    columns = rollout.fly(make_policy(name, config), range(5, 9))
    assert columns["return"][2] == total
    assert terminated == bool(columns["failed"][2])
    fails = {"nominal": ["hover", "random"], "agile": ["random"]}[scenario]
    assert terminated == (name in fails), f"these should have failed: {fails}"
    assert ticks == config.max_steps or terminated


@pytest.mark.parametrize("name", ["expert", "random"])
def test_groups_do_not_matter(name: str) -> None:
    config = configure("paper", duration=1.0)
    whole = rollout.fly(make_policy(name, config), range(20, 27))
    parts = [
        rollout.fly(make_policy(name, config), s) for s in rollout.chunks(20, 7, 2, vehicles=9)
    ]
    assert [len(p["return"]) for p in parts] == [2, 2, 3]
    for key in (*EPISODE, "failure"):
        together = np.concatenate([p[key] for p in parts])
        assert np.array_equal(together, whole[key], equal_nan=True), key


def test_groups_cover_every_seed_once() -> None:
    for count in (1, 499, 500, 501, 1001):
        groups = list(rollout.chunks(3, count, 2))
        assert [s for group in groups for s in group] == list(range(3, 3 + count))
        assert max(map(len, groups)) <= 500


def test_threads_do_not_matter(monkeypatch: pytest.MonkeyPatch, short_report: Report) -> None:
    monkeypatch.setattr(rollout.chunks, "__defaults__", (9,))
    configs = {name: s.config for name, s in short_report.scenarios.items()}
    other = evaluate(configs, ["expert", "random", "hover"], episodes=5, seed=7, threads=3)
    assert to_json(other) == to_json(short_report)


def test_every_policy_flies_the_same_worlds() -> None:
    """Before anybody acts the worlds agree: after one tick the slots, hence the errors, differ only by
    what one tick of action does, while another seed starts up to 0.4 m elsewhere."""
    config = configure("nominal", duration=0.02)
    errors = [
        rollout.fly(make_policy(name, config), range(4))["slot_error"]
        for name in ("expert", "hover", "random")
    ]
    assert errors[1] == pytest.approx(errors[0], abs=0.005)
    assert errors[2] == pytest.approx(errors[0], abs=0.005)
    assert np.ptp(errors[0]) > 0.01


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_expert_beats_hover_and_random(scenario: str) -> None:
    """On every seed, but on `experiment`, where most episodes end by a collision before they are scored."""
    config = configure(scenario)
    expert, hover, random = (
        rollout.fly(make_policy(name, config), range(4))["score"]
        for name in ("expert", "hover", "random")
    )
    for other in (hover, random):
        assert expert.mean() > other.mean()
        assert (expert > other).all() or scenario == "experiment"


def test_scores_need_no_other_policy(short_report: Report) -> None:
    """Neither hover nor the expert flies unasked, and the figures are those of an evaluation with them."""
    config = short_report.scenarios["nominal"].config
    alone = (
        evaluate({"nominal": config}, ["random"], episodes=5, seed=7).scenarios["nominal"].results
    )
    assert list(alone) == ["random"] and alone["random"].differences == {}
    together = short_report.scenarios["nominal"].results["random"]
    assert alone["random"].summary == together.summary
    assert (
        0.0 < together.score.value < short_report.scenarios["nominal"].results["expert"].score.value
    )
    assert list(together.differences) == ["expert"]


# -- training runs --------------------------------------------------------------------------------


def test_sources_of_one_row_are_its_runs() -> None:
    """By names that end in a number, or in a list; what is reported is the median run."""
    config = configure("nominal", duration=1.0)
    numbered = {"mine#0": "hover", "mine#4": "random", "mine#7": "expert"}
    for policies, names in (
        (numbered, list(numbered)),
        ({"mine": ["hover", "random", "expert"]}, ["mine#0", "mine#1", "mine#2"]),
    ):
        (row,) = (
            evaluate({"short": config}, policies, episodes=3).scenarios["short"].results.items()
        )
        name, result = row
        assert name == "mine" and list(result.runs) == names
        order = sorted(result.scores, key=lambda run: result.scores[run])
        assert result.median == order[1] and result.score.value == result.scores[order[1]]
        assert result.score.low < result.score.value < result.score.high


@pytest.mark.parametrize(
    ("policies", "message"),
    [
        ({"mine": "hover", "mine#0": "random"}, "'mine' and 'mine#0': expected one of them"),
        ({"mine#0": "hover", "mine": "random"}, "'mine' and 'mine': expected one of them"),
        ({"mine": []}, "policy 'mine': no training run: expected at least one"),
        ({"mine#0": "hover", "mine#1": "best"}, "'best': expected one of"),
    ],
)
def test_rows_that_cannot_be(policies: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        evaluate({"short": configure("nominal", duration=0.1)}, policies, episodes=1)


def trained(folder: Path, seed: int, scenario: str = "nominal", method: str = "ppo") -> Path:
    """A training run's folder with a policy whose network is drawn anew for every seed."""
    config = configure(scenario, action="wrench")
    entries, size = config.layout.size, config.action_size
    card = Card("wrench", entries, size, scenario=scenario, method=method, seed=seed)
    weights = np.random.default_rng(seed).normal(0.0, 0.01, (size, entries)).astype(np.float32)
    zeros = np.zeros(entries, np.float32)
    run = folder / f"{method}-{scenario}-{seed}"
    run.mkdir(parents=True)
    save(run / "best.safetensors", card, Network((weights,), (zeros[:size],), zeros, zeros + 1))
    (run / "last.safetensors").write_bytes(b"not read")
    return run


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
def test_training_runs_fly_what_they_were_trained_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And where there is neither a run nor a file that ships for a scenario, what `nominal` has."""
    shipped = tmp_path / "shipped"
    shipped.mkdir()
    monkeypatch.setattr(registry, "SHIPPED", shipped)
    for seed in (3, 5, 11):
        trained(tmp_path / "runs", seed)
    trained(tmp_path / "runs", 8, "paper")
    for scenario in ("agile", "nominal"):
        file = trained(tmp_path / "ships", 0, scenario) / "best.safetensors"
        file.rename(shipped / f"ppo-{scenario}-wrench.safetensors")
    arguments = ["--scenarios", "nominal,paper,swarm,agile", "--episodes", "2", "--duration", "0.2"]
    arguments += ["--runs", str(tmp_path / "runs"), "--policies", "ppo"]
    arguments += ["--output", str(tmp_path / "out"), "--matrix", str(tmp_path / "out/raw")]
    assert command.main(arguments) == 0
    document = json.loads((tmp_path / "out/results.json").read_text(encoding="utf-8"))
    found = {name: each["policies"]["ppo"] for name, each in document["scenarios"].items()}
    three = ["ppo#3", "ppo#5", "ppo#11"]
    assert {name: list(each["runs"]) for name, each in found.items()} == {
        "nominal": three, "paper": ["ppo#8"], "swarm": three, "agile": ["ppo"]
    }  # fmt: skip
    assert document["scenarios"]["swarm"]["files"]["ppo"]["differs"]
    assert not document["scenarios"]["nominal"]["files"]["ppo"]["differs"]
    assert f"--runs {tmp_path / 'runs'}" in document["command"]
    assert "of several training runs the median is shown: ppo#" in " ".join(
        capsys.readouterr().out.split()
    )
    raw = suite.read(tmp_path / "out/raw.npz")
    assert raw.training_seed.tolist() == [suite.ALONE, 3, 5, 8, 11]
    assert raw.scenario == ("nominal", "paper", "swarm", "agile")
    assert raw.runs("ppo", "nominal").shape == (3, 2) and raw.runs("ppo", "agile").shape == (1, 2)
    for name, each in found.items():
        assert raw.runs("ppo", name).mean(axis=1) == pytest.approx(
            list(each["runs"].values()), abs=1e-5
        )


def test_runs_that_cannot_be_told_apart_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trained(tmp_path / "a", 3)
    trained(tmp_path / "b", 3)
    (tmp_path / "empty").mkdir()
    for folder, message in (
        (tmp_path, "of the same method, scenario, level and seed as"),
        (tmp_path / "empty", "expected a policy file, or a folder with some best.safetensors"),
    ):
        with pytest.raises(SystemExit):
            command.main([*QUICK, "--runs", str(folder), "--output", str(tmp_path / "out")])
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


# -- the command ----------------------------------------------------------------------------------

QUICK = ["--scenarios", "nominal", "--policies", "hover", "--episodes", "2", "--duration", "0.1"]


def test_command_writes_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "results"
    assert command.main([*QUICK, "--output", str(out), "--action", "rates"]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["results.json", "results.md"]
    document = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert document["scenarios"]["nominal"]["action"] == "rates"
    assert "nominal" in capsys.readouterr().out


def test_scenarios_at_other_levels(tmp_path: Path) -> None:
    """A level after the name counts for that entry, `--action` for those without one."""
    arguments = ["--scenarios", "nominal,nominal:rates,nominal:reference", "--policies", "expert"]
    arguments += ["--episodes", "1", "--duration", "0.1", "--output", str(tmp_path)]
    for action, own in (([], "wrench"), (["--action", "rates"], "rates")):
        assert command.main([*arguments, *action]) == 0
        document = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
        levels = {name: each["action"] for name, each in document["scenarios"].items()}
        assert levels == {
            "nominal": own,
            "nominal:rates": "rates",
            "nominal:reference": "reference",
        }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--policies", "expert,best"],
            "'best': expected one of 'expert', 'expert-tuned', 'ff'",
        ),
        (["--policies", "mine.safetensors"], "mine.safetensors: cannot be read: No such file"),
        (["--policies", ""], "'': expected one of"),
        (["--scenarios", "windy"], "'windy': expected some of nominal, paper"),
        (["--scenarios", "nominal:fast"], "'nominal:fast': expected after the colon one of wrench"),
        (["--scenarios", "nominal:"], "'nominal:': expected after the colon"),
        (["--episodes", "0"], "'0': expected a whole number from 1 to"),
        (["--episodes", "1.5"], "'1.5': expected a whole number from 1 to"),
        (["--seed", "-1"], "'-1': expected a whole number from 0 to"),
        (["--threads", "0"], "'0': expected a whole number from 1 to"),
        (["--action", "speed"], "argument --action: invalid choice: 'speed'"),
        (["--duration", "nan"], "'nan': expected a time in seconds above 0"),
        (["--duration", "0.001"], "scenario nominal: duration = 0.001: expected"),
        (["--polices", "expert"], "unrecognized arguments: --polices expert"),
        (["--leaderboard", "nowhere"], "argument --leaderboard: nowhere"),
    ],
)
def test_wrong_option(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One line that names the offender, status 2, and nothing written."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        command.main(arguments)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_output_that_cannot_be_written_is_noticed_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    (tmp_path / "busy" / "results.json").mkdir(parents=True)
    (tmp_path / "raw.npz").mkdir()
    monkeypatch.setattr(command.scoring, "evaluate", pytest.fail)
    for folder, problem in (("file", "cannot write into"), ("busy", "is a folder")):
        with pytest.raises(SystemExit) as stop:
            command.main([*QUICK, "--output", str(tmp_path / folder)])
        assert stop.value.code == 2
        error = capsys.readouterr().err
        assert problem in error and folder in error
    with pytest.raises(SystemExit):
        command.main([*QUICK, "--output", str(tmp_path), "--matrix", str(tmp_path / "raw")])
    assert "raw.npz is a folder" in capsys.readouterr().err
    assert (tmp_path / "file").read_text(encoding="utf-8") == "mine"


@pytest.mark.skipif(
    sys.platform == "win32" or not hasattr(os, "geteuid") or os.geteuid() == 0,
    reason="folders cannot be made read-only for this user",
)
def test_read_only_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(SystemExit):
        command.main([*QUICK, "--output", str(tmp_path)])
    assert "cannot write into" in capsys.readouterr().err


def test_a_full_disk_is_an_error_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(command.os, "replace", full)
    assert command.main([*QUICK, "--output", str(tmp_path)]) == 1
    assert "No space left on device" in capsys.readouterr().err


def test_two_runs_do_not_share_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both ended well, and the results of one were gone."""
    with claim(tmp_path), pytest.raises(SystemExit) as stop:
        command.main([*QUICK, "--output", str(tmp_path)])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert f"{tmp_path}: a run that is not finished writes there (process {os.getpid()} " in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_warnings_come_once_and_last(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fly = rollout.fly

    def warned(*args: Any, **options: Any) -> Any:
        warnings.warn("gains of another scenario", UserWarning, stacklevel=1)
        return fly(*args, **options)

    monkeypatch.setattr("baselines.scoring.evaluation.fly", warned)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert command.main([*QUICK, "--output", str(tmp_path)]) == 0
    shown = capsys.readouterr()
    assert shown.out.count("warning: gains of another scenario") == 1
    assert "gains of another" not in shown.err
    last = shown.out.split("\n\n")[-1]
    assert last.startswith("all metrics and differences:") and "results.md" in last


@pytest.mark.parametrize("early", [True, False])
def test_interruption_stops_the_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], early: bool
) -> None:
    """Whatever stops one worker stops all of them, and no results appear; also while compiling."""

    def interrupted(*_: object, most: int | None = None, **__: object) -> None:
        if (most is not None) == early:
            raise KeyboardInterrupt

    monkeypatch.setattr("baselines.scoring.evaluation.fly", interrupted)
    assert command.main([*QUICK, "--output", str(tmp_path)]) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
