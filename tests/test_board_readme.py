"""What the README shows of the leaderboard, refusals before it is made, and the board that is checked in."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from made_reports import QUICK, cells, near, scenario

from baselines import evaluate as command
from baselines.registry import POLICIES
from baselines.reporting import board
from baselines.scoring.results import Report


def test_readme_without_markers_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "README.md").write_text("no place", encoding="utf-8")
    with pytest.raises(SystemExit):
        command.main([*QUICK, "--output", str(tmp_path / "out"), "--leaderboard", str(tmp_path)])
    assert board.BEGIN in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_missing_extra_is_named_before_anything_flies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SystemExit):
        command.main([*QUICK, "--output", str(tmp_path / "out"), "--leaderboard", str(tmp_path)])
    error = capsys.readouterr().err
    assert 'pip install "formation-env[plot]"' in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def names(text: str) -> list[str]:
    """The rows of a table."""
    return re.findall(r"^\| `([\w-]+)` \|", text, re.M)


def test_the_readme_shows_the_best_and_the_paper() -> None:
    """By the mean over the scenarios as they are named, where what does not fly counts zero."""
    scores = {"a": 0.8, "b": 0.9, "c": 0.7, "d": 0.6, "e": 0.5, "expert": 0.1}
    one = {name: [near(x)] for name, x in scores.items()} | {"once": [near(0.95)]}
    two = {name: [near(x)] for name, x in scores.items()}
    other = {name: [near(1.0 - x)] for name, x in scores.items()}
    result = Report(
        0, 30, {"nominal": scenario(one), "agile": scenario(two), "nominal:rates": scenario(other)}
    )
    learned = {"d": "nominal", "e": "nominal"}
    some = result._replace(
        scenarios={"nominal": scenario(one, learned), "agile": scenario(two, learned)}
    )
    assert names(board.extract(some)) == ["b", "a", "c", "d", "expert"], (
        "the best learned one as well"
    )
    text = board.extract(result)
    assert names(text) == ["b", "a", "c", "expert"]
    assert text.splitlines()[0] == "| policy | `nominal` | `agile` |"
    assert "talics" not in text and "does not fly" not in text
    few = result._replace(scenarios={"nominal": scenario({"once": [near(0.9)], "a": [near(0.1)]}),
                                     "agile": scenario({"a": [near(0.2)]})})  # fmt: skip
    assert names(board.extract(few)) == ["once", "a"]
    assert cells(board.extract(few), "once")[1] == "-"
    assert "`-`: does not fly" in board.extract(few)


def test_what_was_trained_elsewhere_is_in_italics_in_the_readme() -> None:
    result = Report(
        0,
        30,
        {
            "nominal": scenario({"lee": [near(0.8)], "ppo": [near(0.9)]}, {"ppo": "nominal"}),
            "agile": scenario({"lee": [near(0.8)], "ppo": [near(0.9)]}, {"ppo": "paper"}),
        },
    )
    text = board.extract(result)
    assert [cell.startswith("*") for cell in cells(text, "ppo")] == [False, True]
    assert not any("*" in cell for cell in cells(text, "lee"))
    assert "*Italics*" in text


def test_the_checked_in_board_is_short_and_marked(root: Path) -> None:
    """What ships, on both pages: what was trained elsewhere is in italics."""
    text = (root / "LEADERBOARD.md").read_text(encoding="utf-8")
    assert len(text.encode()) <= 8000
    assert board.LEGEND in text
    readme = (
        (root / "README.md").read_text(encoding="utf-8").split(board.BEGIN)[1].split(board.END)[0]
    )
    assert board.TOP <= len(names(readme)) <= board.TOP + 2
    columns = len(cells(readme, "expert"))  # the first ones of the board
    for row in names(readme):
        if row not in POLICIES:
            transfer = [cell.startswith("*") for cell in cells(readme, row)]
            board_cells = cells(text, row)[:columns]
            marked = [cell.startswith("*") and not cell.startswith("**") for cell in board_cells]
            assert marked == transfer, row
