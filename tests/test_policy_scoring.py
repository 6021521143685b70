"""Policy files that are scored: by their path, and those that ship by the name of their method."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from networks import NOMINAL, card, looks, network

from baselines import evaluate as command
from baselines import make_policy, registry
from baselines.files import load, save
from baselines.policies.base import Policy
from baselines.policies.learned import Learned, Misfit
from baselines.reporting.board import BEGIN, END
from baselines.scoring.evaluation import evaluate, find_flyable
from baselines.scoring.results import Source
from baselines.scoring.runs import USUAL_TEACHER, find_runs, teacher_of
from formation_env import configure


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
def test_a_file_is_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the command line, also where it has no place on a scenario; threads change nothing."""
    path = tmp_path / "my policy.safetensors"
    own = card(history=2, residual=0.05)
    save(path, own, network(own))
    arguments = ["--policies", f"expert,{path}", "--scenarios", "nominal,swarm,experiment"]
    arguments += ["--episodes", "6", "--duration", "0.5"]
    texts = []
    for threads in (1, 2, 3):
        out = tmp_path / str(threads)
        assert command.main([*arguments, "--output", str(out), "--threads", str(threads)]) == 0
        texts.append((out / "results.json").read_text(encoding="utf-8"))
    assert texts[0] == texts[1] == texts[2]
    document = json.loads(texts[0])["scenarios"]
    assert document["nominal"]["policies"][str(path)]["metrics"]["score"][0] is not None
    assert document["nominal"]["files"] == {
        str(path): {
            "file": "my policy.safetensors",
            "method": "ppo",
            "scenario": "nominal",
            "action": "wrench",
            "differs": False,
            "teacher": "",
            "history": 2,
            "hidden": [37, 51],
        }
    }
    assert document["swarm"]["files"][str(path)]["differs"]
    assert list(document["experiment"]["policies"]) == ["expert"]
    assert "has 'rates'" in document["experiment"]["absent"][str(path)]
    text = (tmp_path / "1" / "results.md").read_text(encoding="utf-8")
    grid = next(line for line in text.splitlines() if line.startswith(f"| `{path}`"))
    assert grid.endswith("| - |") and grid.count("-") >= 1
    where = "| `my policy.safetensors` | `ppo` | `nominal` | `wrench` | - | 2 | 37 51 | `nominal`, `swarm` |"
    assert f"| `{path}` {where}" in text
    assert f"Not flown on `experiment`: `{path}` (" in text
    assert "* trained for another task" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["broken", "misfit", "missing"])
def test_a_file_that_cannot_fly_is_one_error(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Status 2, one line that names it, before anything is flown or written."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.safetensors"
    if kind == "broken":
        path.write_bytes(b"broken")
    if kind == "misfit":
        config = configure("nominal", action="reference")
        save(path, card(config), network(card(config)))
    with pytest.raises(SystemExit) as stop:
        command.main(["--policies", str(path), "--scenarios", "nominal,experiment"])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert "mine.safetensors" in error and error.count("\n") == 1
    assert not (tmp_path / "results").exists()


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """`ppo` for `nominal` and for `paper`, and nothing else."""
    folder = tmp_path / "policies"
    folder.mkdir()
    for i, scenario in enumerate(("nominal", "paper")):
        own = card(scenario=scenario)
        save(folder / f"ppo-{scenario}-wrench.safetensors", own, network(own, seed=i))
    monkeypatch.setattr(registry, "SHIPPED", folder)
    return folder


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
def test_methods_fly_their_scenarios_file_or_that_of_nominal(shipped: Path) -> None:
    rows = looks(3)
    for scenario, used in (("nominal", "nominal"), ("paper", "paper"), ("agile", "nominal")):
        config = configure(scenario)
        made = registry.recipe("ppo", config)
        assert made.file == f"ppo-{used}-wrench.safetensors"
        file = make_policy(str(shipped / made.file), config)
        assert np.array_equal(make_policy("ppo", config).act(rows), file.act(rows))
    with pytest.raises(Misfit, match="'ppo': no file for action level 'rates' is shipped"):
        make_policy("ppo", configure("experiment"))
    with pytest.raises(Misfit, match="'bc': no file for action level 'wrench'"):
        make_policy("bc", NOMINAL)


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
@pytest.mark.usefixtures("shipped")
def test_shipped_methods_are_scored_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(f"{BEGIN}\n{END}\n", encoding="utf-8")
    arguments = ["--scenarios", "paper,agile,experiment", "--episodes", "2", "--duration", "0.1"]
    arguments += ["--output", str(tmp_path / "out"), "--leaderboard", str(tmp_path)]
    assert command.main(arguments) == 0
    board = (tmp_path / "LEADERBOARD.md").read_text(encoding="utf-8")
    assert "evaluate --policies" not in board.split("## How")[0]
    files = (tmp_path / "docs/board/files.md").read_text(encoding="utf-8")
    assert "| `ppo` | `ppo-nominal-wrench.safetensors` | `ppo` | `nominal` | `wrench` |" in files
    assert "| `ppo` | `ppo-paper-wrench.safetensors` | `ppo` | `paper` | `wrench` |" in files
    (row,) = (line for line in readme.read_text(encoding="utf-8").splitlines() if "ppo" in line)
    assert row.endswith(" - |")
    assert "`bc`" not in board + files
    capsys.readouterr()
    with pytest.raises(SystemExit):
        command.main([*arguments, "--policies", "bc"])
    assert "'bc': no file for action level" in capsys.readouterr().err


def test_a_run_that_ships_is_named_by_its_shipped_file(shipped: Path, tmp_path: Path) -> None:
    """Whichever of the runs it is, and whatever score was written into its card; else by its own file."""
    runs = []
    for seed in (0, 1):
        folder = tmp_path / f"run{seed}"
        folder.mkdir()
        own = replace(
            card(), seed=seed, command=f"formation-train-imitate --seed {seed} --teacher lqr"
        )
        save(folder / "best.safetensors", own, network(own, seed=seed))
        runs.append(folder)

    def source() -> Source:
        policies = find_runs(runs)
        report = evaluate({"nominal": configure("nominal", duration=0.1)}, policies, episodes=2)
        return report.scenarios["nominal"].sources["ppo"]

    assert source().file == "best.safetensors", "of other runs than that which ships"
    second, numbers = load(runs[1] / "best.safetensors")
    save(
        shipped / "ppo-nominal-wrench.safetensors",
        replace(second, score={"nominal": [0.5] * 3}),
        numbers,
    )
    found = source()
    assert found.file == "ppo-nominal-wrench.safetensors"
    hidden = tuple(len(bias) for bias in numbers.biases[:-1])
    assert (found.teacher, found.history, found.hidden) == ("lqr", second.history, hidden)
    assert hidden


@pytest.mark.parametrize(
    ("words", "teacher"),
    [
        ("formation-train-imitate --teacher lqr --rounds 3", "lqr"),
        ("formation-train-imitate --rounds 3 --teacher=ff", "ff"),
        ("formation-train-imitate --rounds 3", "expert"),
        ("formation-train-ppo --steps 3", ""),
        ("", ""),
    ],
)
def test_the_teacher_is_that_of_the_command(words: str, teacher: str) -> None:
    assert teacher_of(replace(card(), command=words)) == teacher


def test_the_teacher_of_a_command_without_one_is_the_options_default() -> None:
    pytest.importorskip("tyro")
    from train.command_line import SCRIPTS
    from train.imitate.options import Options

    defaults = {f.name: f.default for f in fields(Options)}
    assert defaults["teacher"] == USUAL_TEACHER
    assert teacher_of(replace(card(), command=SCRIPTS["train.imitate"])) == USUAL_TEACHER


@pytest.mark.usefixtures("shipped")
def test_reports_of_policies_that_fly_here_and_there() -> None:
    configs = {name: configure(name, duration=0.1) for name in ("experiment", "nominal")}
    flyable = find_flyable(configs, ["ppo", "hover"])
    assert list(flyable["experiment"].recipes) == ["hover"]
    assert list(flyable["experiment"].absent) == ["ppo"]
    report = evaluate(configs, ["ppo", "hover"], episodes=2)
    assert list(report.scenarios["experiment"].results) == ["hover"]
    assert list(report.scenarios["nominal"].results) == ["ppo", "hover"]
    score = f"{report.scenarios['nominal'].results['ppo'].score.value:.3f}"
    assert str(report).count(score) >= 2


def test_policy_is_the_interface() -> None:
    assert isinstance(Learned(NOMINAL, (card(), network(card()))), Policy)
