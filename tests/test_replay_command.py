"""The command `formation-replay`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from replays import flown
from tables_in_docs import ROOT
from test_replay_page import content_of

from baselines.replay import main, read, write

SHORT = ["--duration", "0.5"]


def names_in(page: Path) -> list[str]:
    content, _ = content_of(page.read_text(encoding="utf-8"))
    return [episode["policy"] for episode in content["episodes"]]


def test_policies_fly_side_by_side(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status = main(
        [
            "--policies",
            "hover,ff",
            "--scenario",
            "agile",
            "--action",
            "rates",
            "--seed",
            "5",
            *SHORT,
        ]
    )
    assert status == 0
    assert [path.name for path in tmp_path.iterdir()] == ["replay.html"]
    content, _ = content_of((tmp_path / "replay.html").read_text(encoding="utf-8"))
    for episode, name in zip(content["episodes"], ("hover", "ff"), strict=True):
        facts = [episode[k] for k in ("policy", "scenario", "action", "seed", "duration")]
        assert facts == [name, "agile", "rates", 5, 0.5]
    out = capsys.readouterr().out
    assert "hover: score 0." in out
    assert out.endswith("written: replay.html\n")


def test_the_expert_on_nominal_is_what_flies_by_default(tmp_path: Path) -> None:
    out = tmp_path / "new" / "folder" / "a.html"
    assert main(["--output", str(out), *SHORT]) == 0
    content, _ = content_of(out.read_text(encoding="utf-8"))
    (episode,) = content["episodes"]
    assert (episode["policy"], episode["scenario"], episode["seed"]) == ("expert", "nominal", 0)


MINE = """
import numpy as np

class Mine:
    def __init__(self, config):
        self.shape = (config.followers, config.action_size)

    def reset(self, seed):
        pass

    def act(self, observation):
        return np.zeros(self.shape)

class Wrong(Mine):
    def act(self, observation):
        raise RuntimeError("no more")
"""


def test_a_policy_of_ones_own_flies_is_saved_and_is_shown_again(tmp_path: Path) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(MINE)
    saved, table, page = (tmp_path / name for name in ("a.npz", "a.csv", "a.html"))
    files = ["--output", str(page), "--save", str(saved), "--csv", str(table)]
    assert main(["--policies", f"{mine}:Mine", "--set", "followers=4", *SHORT, *files]) == 0
    episode = read(saved)
    assert episode.policy == f"{mine}:Mine"
    assert episode.config.followers == 4
    assert not episode.actions.any()
    assert len(table.read_text().splitlines()) == 1 + 26 * 5
    again = tmp_path / "b.html"
    assert main(["--record", str(saved), "--output", str(again)]) == 0
    assert again.read_text(encoding="utf-8") == page.read_text(encoding="utf-8")
    assert (
        main(["--record", str(saved), "--policies", "hover", "--output", str(again), *SHORT]) == 0
    )
    assert names_in(again) == [f"{mine}:Mine", "hover"]


def test_files_of_several_episodes_have_their_policies_names(tmp_path: Path) -> None:
    recorded = write(flown()._replace(policy="../../a b:<c>"), tmp_path / "odd.npz")
    files = ["--output", str(tmp_path / "x.html"), "--save", str(tmp_path / "x.npz")]
    files += ["--csv", str(tmp_path / "x.csv")]
    record = ["--record", str(recorded)] * 2
    assert main([*record, "--policies", "hover", *files, *SHORT]) == 0
    names = ("-..-a-b--c-", "-..-a-b--c--2", "hover")  # nothing in them leads out of the folder
    expected = {f"x-{name}{suffix}" for name in names for suffix in (".npz", ".csv")}
    assert {path.name for path in tmp_path.iterdir()} == {*expected, "odd.npz", "x.html"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--policies", "nobody"], "argument --policies: 'nobody': expected one of"),
        (["--scenario", "nowhere"], "argument --scenario: 'nowhere': expected some of nominal"),
        (["--seed", "-1"], "argument --seed: '-1': expected a whole number from 0"),
        (["--action", "wish"], "argument --action: invalid choice: 'wish'"),
        (["--set", "gust=-1"], "gust = -1"),
        (["--set", "followers=0"], "followers = 0"),
        (["--save", "replay.html"], "--output and --save: expected files of different names"),
        (
            ["--save", "a.x", "--csv", "./a.x"],
            "--save and --csv: expected files of different names",
        ),
        (
            ["--policies", "ppo", "--scenario", "nominal:reference"],
            "no file for action level 'reference'",
        ),
        (["--record", "nothing.npz"], "nothing.npz: cannot be read: No such file or directory"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("formation-replay: error: ")
    assert message in said
    assert list(tmp_path.iterdir()) == []


def test_a_policy_that_fails_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    out = tmp_path / "a.html"
    assert main(["--policies", f"{tmp_path / 'mine.py'}:Wrong", "--output", str(out), *SHORT]) == 1
    err = capsys.readouterr().err
    assert "RuntimeError: no more; nothing was written" in err
    assert not out.exists()


def test_a_place_that_cannot_be_written_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert main(["--output", str(tmp_path / "file" / "a.html"), *SHORT]) == 1
    assert "formation-replay: error: " in capsys.readouterr().err
    (tmp_path / "folder.html").mkdir()
    assert main(["--output", str(tmp_path / "folder.html"), *SHORT]) == 1
    assert "folder.html" in capsys.readouterr().err


def test_it_runs_as_a_module(tmp_path: Path) -> None:
    out = tmp_path / "a.html"
    command = [sys.executable, "-m", "baselines.replay", "--policies", "hover", *SHORT]
    run = subprocess.run(
        [*command, "--output", str(out)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert names_in(out) == ["hover"]
    assert np.isclose(content_of(out.read_text(encoding="utf-8"))[0]["episodes"][0]["period"], 0.02)
