"""What an evaluation writes and prints: JSON, Markdown, the table for a terminal, the leaderboard."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from baselines import evaluate as command
from baselines import make_policy
from baselines.reporting import board, report
from baselines.reporting.explanations import AHEAD, CLIMB, POLES, SLOWER, explanations
from baselines.scoring.evaluation import evaluate
from baselines.scoring.metrics import EPISODE
from baselines.scoring.results import Report, Scenario, Source, summary
from formation_env import configure

SHORT = 4.0  # s
QUICK = ["--scenarios", "nominal", "--policies", "hover", "--episodes", "2", "--duration", "0.1"]


@pytest.fixture(scope="module")
def short_report() -> Report:
    configs = {name: configure(name, duration=SHORT) for name in ("nominal", "swarm")}
    return evaluate(configs, ["expert", "random", "ff", "hover"], episodes=5, seed=7)


def test_json_keeps_its_layout(short_report: Report) -> None:
    document = json.loads(report.to_json(short_report), parse_constant=pytest.fail)
    assert document["schema"] == 1
    assert (document["seed"], document["episodes"]) == (7, 5)
    assert set(document["metrics"]["effort"]) == {"unit", "better", "meaning"}
    swarm = document["scenarios"]["swarm"]
    assert (swarm["action"], swarm["followers"], swarm["duration"]) == ("wrench", 16, SHORT)
    random = swarm["policies"]["random"]
    assert set(random) == {"score", "metrics", "difference_to_expert", "failures"}
    assert list(random["metrics"]) == list(EPISODE)
    assert set(random["metrics"]["effort"]) == {"value", "low", "high", "episodes"}
    assert random["metrics"]["settling_time"]["value"] is None
    failed = round(5 * random["metrics"]["failed"]["value"])
    assert sum(random["failures"].values()) == failed


def test_markdown_tables_are_whole(short_report: Report) -> None:
    """Every row of a table has as many cells as its head: a `|` in a text would break that."""
    text = report.markdown(short_report).replace("\\|", "")
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert len(tables) == 4
    for rows in tables:
        assert len({row.count("|") for row in rows}) == 1


def ahead(scenario: Scenario, *policies: str) -> Scenario:
    """The scenario with some policies above the expert, and faster to the trigger."""
    results = dict(scenario.results)
    for policy in policies:
        own = results[policy]
        more = {name: e._replace(value=0.1) for name, e in own.differences.items()}
        summary = {**own.summary}
        summary["trigger_time"] = own.summary["trigger_time"]._replace(value=-1.0)
        score = own.score._replace(value=1.25)
        results[policy] = own._replace(score=score, differences=more, summary=summary)
    return scenario._replace(results=results)


def test_policies_above_the_expert_are_explained(short_report: Report) -> None:
    nominal = short_report.scenarios["nominal"]
    others = {name: own for name, own in nominal.results.items() if name != "ff"}
    assert explanations(Report(7, 5, {"nominal": nominal._replace(results=others)})) == []
    remarks = explanations(Report(7, 5, {"nominal": ahead(nominal, "ff")}))
    assert remarks[0] == f"{AHEAD}: on `nominal` `ff`."
    # k1 = 0.2 in the plane; s^2 + 2 s + 0.2 in height; s^2 + s' (1.5 s + 0.5), s' = 5 / sqrt(50).
    assert "-0.20 1/s (planner, plane), -0.11 1/s (planner, height)" in remarks[-1]
    assert "-0.53 1/s (tracker" in remarks[-1]


def test_every_remark_stands_once(short_report: Report) -> None:
    """However many policies and scenarios it holds for: one sentence was printed eleven times."""
    one = ahead(short_report.scenarios["nominal"], "ff", "random")
    absent = {"bc-ppo": "reason", "residual": "reason"}
    scenarios = {name: one._replace(absent=absent) for name in ("nominal", "other", "third")}
    text = " ".join(explanations(Report(7, 5, scenarios)))
    for sentence in (AHEAD, CLIMB, SLOWER, POLES, "reason", "Not flown"):
        assert text.count(sentence) == 1, sentence
    assert "Not flown on `nominal`, `other`, `third`: `bc-ppo`, `residual` (reason)." in text
    assert f"{CLIMB}: on `nominal` `random`, `ff`; on `other` `random`" in text
    assert "since then" not in text


def test_scores_without_a_scale_are_called_meaningless() -> None:
    """In the first tick nobody can be better than hover."""
    config = configure("nominal", duration=0.02)
    result = evaluate({"nominal": config}, ["hover"], episodes=3)
    assert explanations(result) == [
        "On `nominal` the expert is no better than hover: scores there mean nothing."
    ]
    assert "scores on nominal mean nothing" in str(result)


def test_why_a_policy_is_absent_names_no_scenario_twice() -> None:
    """It said "neither for scenario 'nominal' nor for 'nominal'"."""
    with pytest.raises(ValueError, match=r"shipped for scenario 'nominal'$"):
        make_policy("bc-ppo", configure("nominal"))
    with pytest.raises(ValueError, match=r"shipped for scenario 'swarm' or 'nominal'$"):
        make_policy("bc-ppo", configure("swarm"))


# -- the terminal ---------------------------------------------------------------------------------


def elsewhere(scenario: Scenario) -> Scenario:
    """The scenario with `ff` for a policy from a file that was trained on another one."""
    return scenario._replace(
        sources={"ff": Source("ff.safetensors", "ppo", "paper", "wrench", True)}
    )


@pytest.mark.parametrize("columns", [60, 80, 100])
def test_the_table_fits_the_terminal(short_report: Report, columns: int) -> None:
    one = elsewhere(short_report.scenarios["nominal"])._replace(absent={"random": "no"})
    names = [*command.BOARD_SCENARIOS, *(f"nominal gust={k}" for k in range(9)), "a" * 30]
    result = Report(7, 5, dict.fromkeys(names, one))
    text = summary(result, columns)
    assert max(map(len, text.splitlines())) <= columns
    assert text.count("1.000") == len(names)
    assert len(text.splitlines()) < 100
    assert "* trained for another task" in text


def test_the_table_has_scores_and_failures(short_report: Report) -> None:
    lines = summary(short_report, 80).splitlines()
    assert lines[1].split() == ["policy", "nominal", "swarm"]
    assert lines[2].split() == ["expert", "1.000", "1.000"]
    assert [line.split()[0] for line in lines[2:6]] == ["expert", "random", "ff", "hover"]
    failures = lines[lines.index("") + 1 :]
    assert failures[0] == "failed episodes, of 5 (none where empty)"
    assert failures[2].split() == ["random", "5", "5"]
    assert str(short_report) == summary(short_report)


# -- the leaderboard ------------------------------------------------------------------------------


def test_leaderboard_and_extract(tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    frame = f"# Title\n\n{board.BEGIN}\n{{}}\n{board.END}\n\nRest\n"
    readme.write_text(frame.format("old"), encoding="utf-8")
    arguments = [*QUICK, "--output", str(tmp_path / "out"), "--leaderboard", str(tmp_path)]
    assert command.main(arguments) == 0
    text_of_board = (tmp_path / "LEADERBOARD.md").read_text(encoding="utf-8")
    repeat = "--policies hover --scenarios nominal --episodes 2 --duration 0.1 --leaderboard"
    assert f"python -m baselines.evaluate {repeat}\n" in text_of_board
    text = readme.read_text(encoding="utf-8")
    assert "| `hover` | 0.000 |" in text_of_board
    assert "| `hover` | 0.00 |" in text
    assert text.startswith("# Title") and text.endswith("Rest\n") and "old" not in text
    # Again: the same files to the letter.
    assert command.main(arguments) == 0
    assert (tmp_path / "LEADERBOARD.md").read_text(encoding="utf-8") == text_of_board
    assert readme.read_text(encoding="utf-8") == text


def test_readme_without_markers_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "README.md").write_text("no place", encoding="utf-8")
    with pytest.raises(SystemExit):
        command.main([*QUICK, "--output", str(tmp_path / "out"), "--leaderboard", str(tmp_path)])
    assert board.BEGIN in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_was_trained_elsewhere_is_in_italics(short_report: Report) -> None:
    scenarios = {name: elsewhere(s) for name, s in short_report.scenarios.items()}
    scenarios["swarm"] = short_report.scenarios["swarm"]
    result = Report(7, 5, scenarios)
    score = short_report.scenarios["nominal"].results["ff"].score.value
    for text in (board.extract(result), board.leaderboard(result, "command")):
        (row, *_) = (line for line in text.splitlines() if line.startswith("| `ff` |"))
        cells = row.split(" | ")
        assert cells[1].rstrip(" |").startswith("*") and cells[1].endswith("*")
        assert float(cells[1].strip("*").split()[0]) == pytest.approx(score, abs=0.01)
        assert "*" not in cells[2]
        assert board.LEGEND in text
        assert text.index(board.FLAWS) < text.index(row)
    assert board.FLAWS.count(". ") == 2, "three sentences"


def test_the_checked_in_board_is_marked(root: Path) -> None:
    """Both pages say the flaws, and what was trained elsewhere is in italics there."""
    for name in ("README.md", "LEADERBOARD.md"):
        text = (root / name).read_text(encoding="utf-8")
        assert board.FLAWS in text and board.LEGEND in text, name
        (row,) = (line for line in text.split("## Remarks")[0].splitlines() if "| `ppo` |" in line)
        italics = [cell.strip().startswith("*") for cell in row.strip("| ").split(" | ")[1:]]
        trained = [
            s in ("nominal", "paper") for s in (n.split(":")[0] for n in command.BOARD_SCENARIOS)
        ]
        assert italics == [not t for t in trained], name
