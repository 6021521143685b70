"""What an evaluation writes and prints: JSON, Markdown, the tables for a terminal."""

from __future__ import annotations

import json

import numpy as np
import pytest
from made_reports import scenario

from baselines import evaluate as command
from baselines import make_policy
from baselines.reporting import report
from baselines.scoring.evaluation import evaluate
from baselines.scoring.metrics import EPISODE
from baselines.scoring.results import Report, Scenario, Source, summary
from formation_env import configure

SHORT = 4.0  # s


@pytest.fixture(scope="module")
def short_report() -> Report:
    configs = {name: configure(name, duration=SHORT) for name in ("nominal", "swarm")}
    return evaluate(configs, ["expert", "random", "hover"], episodes=5, seed=7)


def test_json_keeps_its_layout(short_report: Report) -> None:
    document = json.loads(report.to_json(short_report), parse_constant=pytest.fail)
    assert document["schema"] == 2
    assert (document["seed"], document["episodes"]) == (7, 5)
    assert set(document["metrics"]["effort"]) == {"unit", "better", "meaning"}
    swarm = document["scenarios"]["swarm"]
    assert (swarm["action"], swarm["followers"], swarm["duration"]) == ("wrench", 16, SHORT)
    assert swarm["window"] == round(SHORT * 5 / 6 / 0.02) * 0.02
    random = swarm["policies"]["random"]
    assert set(random) == {"metrics", "differences", "failures", "runs", "median"}
    assert list(random["metrics"]) == list(EPISODE)
    value, low, high, episodes = random["metrics"]["score"]
    assert low <= value <= high and episodes == 5
    assert random["metrics"]["settling_time"] == [None, None, None, 0]
    assert random["runs"] == {"random": value} and random["median"] == "random"
    assert list(random["differences"]) == ["expert"]
    assert list(random["differences"]["expert"]) == ["score", "slot_error"]
    failed = round(5 * random["metrics"]["failed"][0])
    assert sum(random["failures"].values()) == failed


def test_json_has_six_digits(short_report: Report) -> None:
    document = json.loads(report.to_json(short_report))
    for name, each in short_report.scenarios.items():
        for policy, result in each.results.items():
            written = document["scenarios"][name]["policies"][policy]["metrics"]
            for metric, e in result.summary.items():
                for x, y in zip(written[metric][:3], e[:3], strict=True):
                    assert (x is None and np.isnan(y)) or x == pytest.approx(y, rel=1e-5)


def test_failures_are_counted_over_all_runs() -> None:
    """Of the run in the middle and of the others, as the column's head says."""
    made = scenario(
        {"ppo": [np.full(4, x) for x in (0.5, 0.9, 0.7)]},
        {"ppo": "paper"},
        failed=0.5,
    )
    row = made.results["ppo"]
    assert sum(row.failures.values()) == 6 and row.failed == 0.5
    assert "| failures, all runs |" in "\n".join(report.details(made))


def test_the_files_table_says_whose_clone_a_policy_is() -> None:
    made = scenario(
        {"dagger": [np.full(4, 0.5)], "ppo": [np.full(4, 0.5)]},
        {"dagger": "nominal", "ppo": "nominal"},
    )
    source = made.sources["dagger"]._replace(teacher="lqr", history=4, hidden=(64, 32))
    text = report.files_table(
        Report(0, 4, {"nominal": made._replace(sources={**made.sources, "dagger": source})})
    )
    assert "| `nominal` | `wrench` | `lqr` | 4 | 64 32 | `nominal` |" in text
    assert "| `nominal` | `wrench` | - | 1 | - | `nominal` |" in text


def test_the_score_names_the_window_of_what_was_flown() -> None:
    def said(**durations: float) -> str:
        made = {
            name: scenario({"ff": [np.zeros(3)]}, config=configure(name, duration=duration))
            for name, duration in durations.items()
        }
        return report.score(Report(0, 3, made))

    assert "over the last 25 s of a flight; what is missing" in said(nominal=30.0, agile=60.0)
    assert "over the last 8.34 s of a flight; what is missing" in said(nominal=10.0)
    text = said(nominal=30.0, agile=10.0, swarm=60.0)
    assert "over the last 25 s of a flight, 8.34 s on `agile`; what is missing" in text


def test_native_scenarios_are_those_at_their_own_level() -> None:
    one = scenario({"ff": [np.full(4, 0.5)]})
    rates = scenario({"ff": [np.full(4, 0.5)]}, config=configure("nominal", action="rates"))
    assert Report(0, 4, {"nominal": one, "nominal:rates": rates, "x": one}).native == ("nominal",)
    assert Report(0, 4, {"nominal": rates}).native == ("nominal",), "all, where there is none"
    assert Report(0, 4, {"x": one, "nominal": rates}).native == ("x", "nominal")


def test_markdown_tables_are_whole(short_report: Report) -> None:
    """Every row of a table has as many cells as its head: a `|` in a text would break that."""
    text = report.markdown(short_report).replace("\\|", "")
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert len(tables) == 6, "scores, two for each scenario, and what the figures mean"
    for rows in tables:
        assert len({row.count("|") for row in rows}) == 1


def test_differences_are_seed_by_seed(short_report: Report) -> None:
    for each in short_report.scenarios.values():
        own, best = each.results["random"], each.results["expert"]
        e = own.differences["expert"]["score"]
        assert e.value == pytest.approx(own.score.value - best.score.value)
        assert best.differences["expert"]["score"][:3] == (0.0, 0.0, 0.0)


def test_every_absence_stands_once(short_report: Report) -> None:
    """However many policies and scenarios it holds for."""
    absent = {"bc-ppo": "reason", "residual": "reason"}
    one = short_report.scenarios["nominal"]._replace(absent=absent)
    scenarios = dict.fromkeys(("nominal", "other", "third"), one)
    (text,) = report.absences(Report(7, 5, scenarios))
    assert text == "Not flown on `nominal`, `other`, `third`: `bc-ppo`, `residual` (reason)."
    assert report.markdown(Report(7, 5, scenarios)).count("reason") == 1


def test_why_a_policy_is_absent_names_no_scenario_twice() -> None:
    """It said "neither for scenario 'nominal' nor for 'nominal'"."""
    with pytest.raises(ValueError, match=r"shipped for scenario 'nominal'$"):
        make_policy("residual-dagger-ppo", configure("nominal"))
    with pytest.raises(ValueError, match=r"shipped for scenario 'swarm' or 'nominal'$"):
        make_policy("residual-dagger-ppo", configure("swarm"))


# -- the terminal ---------------------------------------------------------------------------------


def elsewhere(each: Scenario) -> Scenario:
    """The scenario with `hover` for a policy from a file that was trained on another one."""
    return each._replace(
        sources={"hover": Source("hover.safetensors", "ppo", "paper", "wrench", True)}
    )


@pytest.mark.parametrize("columns", [60, 78, 100])
@pytest.mark.parametrize("many", [True, False])
def test_the_table_fits_the_terminal(short_report: Report, columns: int, many: bool) -> None:
    one = elsewhere(short_report.scenarios["nominal"])
    one = one._replace(absent={"bc": "no"}, results={**one.results, "x" * 60: one.results["hover"]})
    names = ["nominal", "nominal:rates"]
    if many:
        names = [*command.BOARD_SCENARIOS, *(f"nominal gust={k}" for k in range(9)), "a" * 30]
    text = summary(Report(7, 5, dict.fromkeys(names, one)), columns)
    assert max(map(len, text.splitlines())) <= columns
    score = f"{one.results['expert'].score.value:.3f}"
    assert text.count(score) >= len(names) * (1 if many else 2)
    assert len(text.splitlines()) < 100
    assert "* trained for another task" in text


def test_a_terminal_shows_at_most_78_columns(
    short_report: Report, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert max(map(len, str(short_report).splitlines())) <= 78


def test_the_tables_have_the_telling_figures(short_report: Report) -> None:
    text = summary(short_report, 78)
    block = text.split("\n\n")[1].splitlines()
    assert block[0] == "nominal"
    head = ["slot late", "error error failed start", "policy score m m % s"]
    assert [" ".join(line.split()) for line in block[1:4]] == head
    assert [line.split()[0] for line in block[4:]] == ["expert", "random", "hover"]
    s = short_report.scenarios["nominal"].results["random"].summary
    interval = f"{s['score'].value:.3f} ({s['score'].low:.3f} .. {s['score'].high:.3f})"
    assert interval in block[5]
    late = f"{s['slot_error'].value:.3f} {s['slot_error_late'].value:.3f}"
    assert block[5].split()[-4:] == [*late.split(), f"{100 * s['failed'].value:.0f}", "0.0"]
    last = text.split("\n\n")[3].splitlines()
    assert last[0] == "scores" and last[1].split() == ["policy", "nominal", "swarm"]


def test_the_median_of_training_runs_is_named() -> None:
    runs = [np.full(4, x) for x in (0.5, 0.9, 0.7)]
    result = Report(0, 4, {"nominal": scenario({"ppo": runs}, {"ppo": "nominal"})})
    assert "of several training runs the median is shown: ppo#2 of 3" in summary(result, 78)
    assert result.scenarios["nominal"].results["ppo"].score.value == 0.7
