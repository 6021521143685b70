"""The leaderboard: short, says what was trained for what, and calls a policy best only if all runs agree."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from made_reports import LEARNED, QUICK, cells, large, near, scenario

from baselines import evaluate as command
from baselines.registry import POLICIES
from baselines.reporting import board, profile, report
from baselines.reporting.cells import rounded
from baselines.reporting.further import Further
from baselines.reporting.rows import agreed_best
from baselines.scoring.changes import CHANGES
from baselines.scoring.intervals import Estimate
from baselines.scoring.results import Report
from baselines.scoring.robustness import LEADER, Cell, Robustness
from baselines.scoring.suite import matrix, probability_of_improvement, suite_score
from formation_env import SCENARIOS, configure


@pytest.fixture(scope="module")
def board_of_nine() -> Report:
    return large(9)


def tried(result: Report) -> Robustness:
    """As much as robustness may become: every policy on five tasks under every change."""
    tasks = tuple(f"scenario{k}" for k in range(5))
    names = [name for name in result.policies if name not in ("hover", "random")]
    plain = {(name, task): Cell(0.912, 0.0) for name in names for task in tasks}
    cells = {(*key, change.name): Cell(0.123, 0.5) for key in plain for change in CHANGES}
    void = {
        (task, change): LEADER
        for task in tasks[:2]
        for change in (CHANGES[0].name, CHANGES[3].name)
    }
    return Robustness(range(20), tasks, CHANGES, plain, cells, void, {})


# -- the short page -------------------------------------------------------------------------------


@pytest.mark.parametrize("scenarios", [2, 9, 15])
def test_it_is_short(scenarios: int) -> None:
    """However many policies fly: 8 kB, with all of its parts."""
    result = large(scenarios)
    text = board.leaderboard(result, "command", matrix(result), Further(robustness=tried(result)))
    assert len(text.encode()) <= 8000
    for part in (
        board.LEGEND,
        board.ADD,
        "## What it says",
        "[statistics](docs/board/statistics.md)",
        "[robustness](docs/board/robustness.md)",
    ):
        assert part in text
    assert len(cells(text, "ppo")) == scenarios
    assert cells(text, "ppo")[1].endswith(", 48 % experiment*"), "failures are never left out"
    assert ("±" in text.split("\n## ")[0].split("| `ppo`")[1]) == (scenarios < 9)
    assert ("## Robustness" in text) == (scenarios < 10) == (text.count("## ") == 3)
    if scenarios < 10:
        assert len(cells(text.split("## Robustness")[1], "ppo")) == 1 + len(CHANGES)


def test_every_learned_cell_says_what_it_was_trained_for(board_of_nine: Report) -> None:
    text = board.leaderboard(board_of_nine, "command", matrix(board_of_nine))
    for method in LEARNED:
        for k, cell in enumerate(cells(text, method)):
            assert cell.endswith(" own") if k % 2 == 0 else re.fullmatch(r"\*.* experiment\*", cell)
    for cell in cells(text, "lee"):
        assert re.fullmatch(r"\**0\.\d{3}( ±\.\d{3}| \(\.\d{3} \.\. \.\d{3}\))?\**", cell)


def test_failures_are_shown_where_there_are_any() -> None:
    """Those of transfer are 45.6 % of 40 episodes, rounded up."""
    result = large(3)
    text = board.leaderboard(result, "command", matrix(result))
    own, other, *_ = cells(text, "ppo")
    assert "%" not in own and other.endswith(", 48 % experiment*")
    assert not any("%" in cell for cell in cells(text, "expert"))
    assert "N %: of the episodes" in board.LEGEND


@pytest.mark.parametrize(
    ("share", "text"), [(0.0, "0.500"), (1.0, "0.500, 100 %"), (0.002, "0.500, 0.2 %")]
)
def test_a_share_of_failures_stands_behind_the_score(share: float, text: str) -> None:
    made = scenario({"ff": [np.full(500, 0.5)], "hover": [np.full(500, 0.1)]})
    runs = {"ff": {**made.results["ff"].runs["ff"], "failed": np.arange(500) < 500 * share}}
    row = made.results["ff"]._replace(runs=runs)
    result = Report(0, 500, {"nominal": made._replace(results={**made.results, "ff": row})})
    shown = cells(board.leaderboard(result, "command", matrix(result)), "ff")[0]
    assert shown.replace("*", "") == text


def test_small_intervals_go_first_and_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Then all of them, then robustness."""
    small = {name: [near(0.9)] for name in ("expert", "expert-tuned", "ff", "lqr", "bc")}  # ±0.003
    runs = {**small, "lee": [np.linspace(0.3, 0.7, 30)]}  # ±0.04
    result = Report(0, 30, {"nominal": scenario(runs)})
    further = Further(robustness=tried(result))
    seen, room = [], 8000
    for _ in range(4):
        monkeypatch.setattr(board, "LARGEST", room)
        text = board.leaderboard(result, "command", matrix(result), further)
        table, room = text.split("\n## ")[0], len(text.encode()) - 1
        shown = tuple("±" in cells(table, name)[0] for name in ("ff", "lee"))
        seen.append((shown, "## Robustness" in text))
        assert ("where 0.005 or more" in table) == (shown == (False, True))
        assert ("intervals are on the pages" in table) == (not any(shown))
    assert seen == [((True, True), True), ((False, True), True)] + [
        ((False, False), robust) for robust in (True, False)
    ]


@pytest.mark.parametrize(
    ("estimate", "text"),
    [
        ((0.9, 0.88, 0.92), "0.900 ±.020"),
        ((0.9, 0.88, 0.915), "0.900 ±.020"),
        ((0.9, 0.88, 0.91), "0.900 (.880 .. .910)"),
        ((0.932, 0.398, 0.970), "0.932 (.398 .. .970)"),
        ((0.5, 0.4999, 0.5004), "0.500"),
        ((0.99, 0.97, 1.0), "0.990 (.970 .. 1.000)"),
        ((0.99, 0.975, 1.0), "0.990 (.975 .. 1.000)"),
        ((0.01, 0.0, 0.025), "0.010 (.000 .. .025)"),
        ((0.983, 0.9822, 0.9834), "0.983 ±.001"),
        ((1.0, 1.0, 1.0), "1.000"),
    ],
)
def test_an_interval_is_one_half_only_where_it_has_two(
    estimate: tuple[float, float, float], text: str
) -> None:
    assert rounded(Estimate(*estimate, 100)) == text
    value, low, high = estimate
    assert (
        rounded(Estimate(*estimate, 100), max(value - low, high - value) + 1e-9) == f"{value:.3f}"
    )


def test_the_worst_run_stands_beside_the_median_where_it_is_another() -> None:
    def cell(worst: float) -> str:
        runs = [near(x, i) for i, x in enumerate((worst, 0.9, 0.9, 0.9, 0.9))]
        result = Report(0, 30, {"nominal": scenario({"ppo": runs}, {"ppo": "nominal"})})
        return cells(board.leaderboard(result, "command", matrix(result)), "ppo")[0]

    assert re.fullmatch(
        r"0\.9\d\d \(\.4\d\d \.\. \.9\d\d\), worst \.4\d\d own|0\.8.*, worst \.4\d\d own",
        cell(0.406),
    )
    assert "worst" not in cell(0.89)


def test_a_tuned_law_is_not_bold() -> None:
    runs = {"expert": [near(0.9, 9)], "expert-tuned": [near(0.95, 1)]}
    result = Report(0, 30, {"nominal": scenario(runs)})
    text = board.leaderboard(result, "command", matrix(result))
    assert "*" not in cells(text, "expert-tuned")[0] and "`-tuned` is one search" in text


def test_best_only_if_all_training_runs_agree() -> None:
    five = [near(0.95, i) for i in range(5)]
    others = {"expert": [near(0.9, 9)], "bc": [near(0.85, 10), near(0.92, 11)]}
    trained = {"ppo": "nominal", "bc": "nominal"}
    assert agreed_best(scenario({**others, "ppo": five}, trained)) == "ppo"
    # One run that is behind one of another policy's runs, four runs, a tie.
    assert agreed_best(scenario({**others, "ppo": [*five[1:], near(0.91, 0)]}, trained)) is None
    assert agreed_best(scenario({**others, "ppo": five[1:]}, trained)) is None
    assert agreed_best(scenario({**others, "ppo": five, "ff": [five[0]]}, trained)) is None
    # A law needs no training seeds, but has to beat every run.
    assert agreed_best(scenario({"expert": [near(0.99)], "ppo": five}, trained)) == "expert"
    lucky = [*five[1:], near(0.995, 3)]
    assert agreed_best(scenario({"expert": [near(0.99)], "ppo": lucky}, trained)) is None


def test_the_best_is_bold_and_nothing_else() -> None:
    runs = {"expert": [near(0.9, 9)], "ppo": [near(0.95, i) for i in range(5)]}
    result = Report(0, 30, {"nominal": scenario(runs, {"ppo": "nominal"})})
    text = board.leaderboard(result, "command", matrix(result))
    assert re.fullmatch(r"\*\*0\.9\d\d ±\.\d{3}\*\* own", cells(text, "ppo")[0])
    assert "*" not in cells(text, "expert")[0]


@pytest.fixture
def textbook(monkeypatch: pytest.MonkeyPatch) -> None:
    """All laws of `made_reports` are programmed ones."""
    for name in ("ff", "ff-filter", "ff-tuned", "lee", "lee-tuned", "lqr", "lqr-tuned"):
        monkeypatch.setitem(POLICIES, name, POLICIES["expert"])


# -- the pages ------------------------------------------------------------------------------------


def test_all_of_it_is_written_and_again_the_same(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    readme = tmp_path / "README.md"
    frame = f"# Title\n\n{board.BEGIN}\n{{}}\n{board.END}\n\nRest\n"
    readme.write_text(frame.format("old"), encoding="utf-8")
    stale = tmp_path / "docs/board/gone.md"
    stale.parent.mkdir(parents=True)
    stale.write_text("a scenario that is no more", encoding="utf-8")
    arguments = [*QUICK, "--output", str(tmp_path / "out"), "--leaderboard", str(tmp_path)]
    assert command.main(arguments) == 0
    text = (tmp_path / "LEADERBOARD.md").read_text(encoding="utf-8")
    repeat = "--policies hover --scenarios nominal --episodes 2 --duration 0.1 --leaderboard"
    assert f"`python -m baselines.evaluate {repeat}`" in text
    first = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file() and "out" not in p.parts}
    names = {
        "nominal.md",
        "scenarios.md",
        "robustness.md",
        "files.md",
        "figures.md",
        "statistics.md",
        "results.json",
        "profile.png",
    }
    assert {p.name for p in first if p.parent.name == "board"} == names
    shown = readme.read_text(encoding="utf-8")
    assert shown.startswith("# Title") and shown.endswith("Rest\n") and "old" not in shown
    assert re.search(r"\| `hover` \| 0\.\d\d \|", shown)
    assert command.main(arguments) == 0
    assert {p: p.read_bytes() for p in first} == first


def test_statistics_are_first_of_the_scenarios_at_their_own_level() -> None:
    """Which are not counted twice; of five the interquartile mean leaves out 1.25 at each end."""
    configs = {name: configure(name) for name in SCENARIOS}
    configs |= {f"{name}:rates": configure(name, action="rates") for name in ("nominal", "agile")}
    rng = np.random.default_rng(0)
    scores = {name: rng.random(2) for name in configs}
    made = {
        name: scenario({"expert": [near(x)], "ff": [near(y, 1)]}, config=configs[name])
        for name, (x, y) in scores.items()
    }
    result = Report(0, 30, made)
    m = matrix(result)
    first, rest = board.pages(result, m)[board.STATISTICS].split("## All scenarios")
    assert (
        "`swarm`. Of a method of one run the interquartile mean leaves out its 1.25 best" in first
    )
    assert (
        "`agile:rates`. Of a method of one run the interquartile mean leaves out its 1.75 best"
        in rest
    )
    assert "scenarios are held fixed" in first
    for text, names in ((first, tuple(SCENARIOS)), (rest, m.scenario)):
        score = suite_score(m, "ff", names)
        assert cells(text, "ff")[:2] == [str(len(names)), "-"]
        assert cells(text, "ff")[2].startswith(f"{score.mean.value:.3f} (")
        assert cells(text, "ff")[3].startswith(f"{score.interquartile_mean.value:.3f} (")
    p = probability_of_improvement(m, "ff", "expert", tuple(SCENARIOS))
    improvement = rest.split("## Probability")[1]
    assert "Over `nominal`, `paper`, `experiment`, `agile`, `swarm`." in improvement
    assert cells(improvement, "ff")[0].startswith(f"{p.value:.2f} (")


def test_links_lead_to_pages(board_of_nine: Report) -> None:
    m = matrix(board_of_nine)
    pages = board.pages(board_of_nine, m)
    known = {*pages, board.PICTURE, board.JSON}
    text = board.leaderboard(board_of_nine, "command", m)
    assert {Path(link).name for link in re.findall(r"\]\((docs/board/[^)]+)\)", text)} == known - {
        board.PICTURE
    }
    for name, page in pages.items():
        links = re.findall(r"\]\(([^)]+)\)", page)
        assert links and all(link in (*known, "../../LEADERBOARD.md") for link in links), name
        assert len(page.encode()) < 32_000, name


def test_pages_hold_differences_runs_and_their_median(board_of_nine: Report) -> None:
    name = next(iter(board_of_nine.scenarios))
    page = board.pages(board_of_nine, matrix(board_of_nine))[board.page_name(name)]
    for other in ("expert", "expert-tuned", "ff"):
        assert f"score minus `{other}`'s" in page
    result = board_of_nine.scenarios[name].results["ppo"]
    assert sorted(result.scores.values())[2] == result.scores[result.median]
    assert f"**{result.median} {result.scores[result.median]:.3f}**" in page
    assert page.count("**") == 2 * len(LEARNED)


def test_the_json_of_a_whole_board_is_small(board_of_nine: Report) -> None:
    text = report.to_json(board_of_nine, "command")
    json.loads(text, parse_constant=pytest.fail)
    assert len(text) < 300_000
    assert max(map(len, text.splitlines())) < 3000, "a line for each policy"


@pytest.mark.usefixtures("textbook")
def test_the_profile_is_small_and_says_what_it_shows(board_of_nine: Report, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    m = matrix(board_of_nine)
    assert {title: len(methods) for title, methods in profile.panels(m).items()} == {
        "programmed laws": 9,
        "learned policies": 9,
    }
    for name in ("one.png", "two.png"):
        profile.draw(m, tmp_path / name)
    data = (tmp_path / "one.png").read_bytes()
    assert data == (tmp_path / "two.png").read_bytes()
    assert len(data) < 100_000
    assert profile.digest(m).encode() in data
    other = m._replace(figures={**m.figures, "score": m.figures["score"] * 0.99})
    assert profile.digest(other) != profile.digest(m)


def test_methods_that_do_not_fly_everything_are_not_in_the_profile() -> None:
    two = scenario({"expert": [near(0.9)], "ppo": [near(0.8)]}, {"ppo": "nominal"})
    one = scenario({"expert": [near(0.9)]}, config=configure("agile"))
    result = Report(0, 30, {"nominal": two, "agile": one})
    assert profile.panels(matrix(result)) == {"programmed laws": ["expert"]}
