"""Sweeps, from the option to the axis of the picture and the table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_reports import SCORES, scenario

import baselines
from baselines.reporting import plots
from baselines.scoring.results import Report, Sweep, summary
from baselines.scoring.tasks import read_sweep
from formation_env import configure


@pytest.mark.parametrize(
    ("sweep", "unit", "label", "values"),
    [
        ("gust=0:2:3", "m/s^2", "gust (m/s²)", [0.0, 1.0, 2.0]),
        ("noise.position=0.3:0:4", "m", "noise.position (m)", [0.3, 0.2, 0.1, 0.0]),
        ("planner.k1=0.1:0.3:3", "1/s", "planner.k1 (1/s)", [0.1, 0.2, 0.3]),
        ("measurement_delay=0:4:5", "samples", "measurement_delay (samples)", [0, 1, 2, 3, 4]),
        ("followers=2:4:3", "1", "followers", [2, 3, 4]),
    ],
)
def test_what_is_flown_stands_on_the_axis(
    sweep: str, unit: str, label: str, values: list[float]
) -> None:
    result = baselines.evaluate(
        ["ff", "hover"],
        {"mine": {"scenario": "nominal", "duration": 0.3}},
        episodes=2,
        quiet=True,
        sweep=sweep,
    )
    (found,) = result.sweeps
    assert (list(found.values), found.unit, found.scenario) == (values, unit, "mine")
    field = found.field.split(".")
    for value, name in zip(values, found.scenarios, strict=True):
        configured: Any = result.scenarios[name].config
        for part in field:
            configured = getattr(configured, part)
        assert configured == value
    (ax,) = plots.draw_sweep(found, result).axes
    assert ax.get_xlabel() == label
    for policy in ("ff", "hover"):
        line = next(line for line in ax.lines if line.get_label() == policy)
        each = [result.scenarios[name].results[policy].score for name in found.scenarios]
        order = np.argsort(values)
        assert list(line.get_xdata()) == sorted(values)
        assert list(line.get_ydata()) == [each[k].value for k in order]
        band = ax.collections[["ff", "hover"].index(policy)].get_paths()[0].vertices
        for k in order:
            there = band[band[:, 0] == values[k], 1]
            assert (there.min(), there.max()) == (each[k].low, each[k].high)


def test_every_value_has_the_same_episodes() -> None:
    """A limit that no vehicle reaches changes nothing, so the scores are equal episode by episode."""
    task = {"scenario": "nominal", "duration": 1.0}
    result = baselines.evaluate(
        "ff", {"a": task}, episodes=3, seed=5, quiet=True, sweep="limits.lost=9:10:2"
    )
    one, other = (s.results["ff"].runs["ff"] for s in result.scenarios.values())
    assert np.array_equal(one["score"], other["score"]) and np.ptp(one["score"]) > 0.0


def test_further_sweeps_make_a_picture_each() -> None:
    config = configure("nominal", duration=0.1)
    result = baselines.evaluate(
        "hover", config, episodes=1, quiet=True, sweep=["gust=0,1", "neighbours=1:2:2"]
    )
    assert [s.scenario for s in result.sweeps] == ["nominal neighbours=1", "nominal neighbours=2"]
    assert [name for name, _ in plots.figures(result)] == [
        "nominal-neighbours=1-gust",
        "nominal-neighbours=2-gust",
    ]
    for k, sweep in enumerate(result.sweeps):
        configs = [result.scenarios[name].config for name in sweep.scenarios]
        assert [(c.gust, c.neighbours) for c in configs] == [(0.0, k + 1), (1.0, k + 1)]


def swept_report(values: tuple[Any, ...] = (0, 0.5, 1)) -> Report:
    """Scores that fall with the value; a learned policy at home at the first one, absent at the last."""
    found = {}
    for k, value in enumerate(values):
        runs = {name: [x * 0.5**k] for name, [x] in SCORES.items() if k < 2 or name != "ppo"}
        trained = {"ppo": "nominal" if k == 0 else "paper", "dagger": "paper"}
        found[f"nominal gust={value}"] = scenario(runs, trained)
    sweep = Sweep("nominal", "gust", "m/s^2", values, tuple(map(str, values)), tuple(found))
    return Report(0, 4, found, (sweep,))


def test_hollow_marks_are_another_tasks_and_absent_policies_leave_gaps() -> None:
    result = swept_report()
    figure = plots.draw_sweep(result.sweeps[0], result)
    programmed, learned = figure.axes
    assert [ax.get_title("left") for ax in figure.axes] == ["programmed", "learned"]
    lines = {str(line.get_label()): line for line in (*programmed.lines, *learned.lines)}
    assert list(lines["ppo"].get_xdata()) == [0, 0.5]
    assert list(lines["ppo* (another task)"].get_xdata()) == [0.5]
    assert list(lines["dagger* (another task)"].get_xdata()) == [0, 0.5, 1]
    looks = [(x.get_marker(), str(x.get_linestyle()), x.get_color()) for x in lines.values()]
    assert len({mark for mark, _, _ in looks}) == 4, "told apart without colours"
    legend = {text.get_text() for text in figure.legends[0].get_texts()}
    assert legend == set(lines)


def test_values_that_are_no_numbers_stand_side_by_side() -> None:
    result = swept_report(("direct", "differenced"))
    ax = plots.draw_sweep(result.sweeps[0], result).axes[0]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["direct", "differenced"]
    (line, _, (ends,)) = ax.containers[0].lines
    assert line.get_linestyle() == "None" and len(ends.get_segments()) == 2


@pytest.mark.parametrize("columns", [80, 100])
def test_the_table_of_a_sweep_fits_the_terminal(columns: int) -> None:
    result = swept_report(tuple(range(14)))
    text = summary(result, columns)
    assert max(map(len, text.splitlines())) <= columns
    assert "nominal: scores by gust, m/s^2" in text and "same seeds" in text
    head, *rows = text.split("gust, m/s^2\n")[1].splitlines()[:5]
    assert head.split()[:4] == ["policy", "0", "1", "2"]
    assert [row.split()[:2] for row in rows] == [
        ["ff", "0.850"],
        ["expert", "0.250"],
        ["ppo", "0.625"],
        ["dagger", "0.675*"],
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("gust=0:2:1", "COUNT from 2 to 1000"),
        ("gust=0:2:2.5", "a whole number COUNT"),
        ("gust=low:2:3", "expected numbers LOW:HIGH"),
        ("gust=0:2", "expected FIELD=LOW:HIGH:COUNT"),
        ("gust=1:1:3", "LOW and HIGH that differ"),
        ("gust=0:nan:3", "finite LOW and HIGH"),
    ],
)
def test_what_is_wrong_of_a_sweep_is_named(text: str, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        read_sweep(text)


def test_values_closer_than_six_digits_stay_apart() -> None:
    assert len(set(read_sweep("duration=20:20.00001:3").texts)) == 3
