"""The pictures of an evaluation, read back from what is drawn."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from made_reports import SCORES, scenario

import baselines
from baselines import evaluate as command
from baselines import make_policy
from baselines.reporting import plots, report
from baselines.scoring import curves
from baselines.scoring.metrics import CAP, flight_ticks, window_ticks
from baselines.scoring.results import Report
from baselines.scoring.rollout import fly
from baselines.system import pictures
from formation_env import configure
from formation_env.core.simulation import Simulation

FLIGHT = {"scenario": "paper", "duration": 13.0}  # the trigger (40) fires about 9 s after reset


@pytest.fixture(scope="module")
def flown() -> Report:
    """With errors against time: policies that keep the formation, and one that never starts."""
    mine = {"mine": configure(**FLIGHT)}
    return command.scoring.evaluate(mine, ["ff", "hover"], 3, curves=True)


def made() -> Report:
    return Report(0, 4, {"nominal": scenario(SCORES, {"ppo": "paper", "dagger": "nominal"})})


def texts(figure: Any) -> list[str]:
    return [text.get_text() for text in figure.findobj(matplotlib.text.Text)]


# -- scores ---------------------------------------------------------------------------------------


def test_scores_are_the_reports_in_the_order_of_the_table() -> None:
    result = made().scenarios["nominal"]
    (ax,) = plots.draw_scores("nominal", result, 4).axes
    policies = [label.get_text() for label in ax.get_yticklabels()]
    assert policies == list(result.results) and ax.yaxis_inverted()
    drawn = {}
    for bar in ax.containers:
        line, _, (ends,) = bar.lines
        for x, y, segment in zip(*line.get_data(), ends.get_segments(), strict=True):
            drawn[policies[round(y)]] = (x, *segment[:, 0])
    assert set(drawn) == set(SCORES)
    for policy, numbers in drawn.items():
        assert numbers == pytest.approx(result.results[policy].score[:3], abs=1e-12), policy


def test_learned_policies_say_what_they_were_trained_for() -> None:
    figure = plots.draw_scores("nominal", made().scenarios["nominal"], 4)
    beside = {text.split("  ")[1] for text in texts(figure) if "trained for" in text}
    assert beside == {"trained for paper, wrench*", "trained for nominal, wrench"}
    faces = {
        bar.get_label(): bar.lines[0].get_markerfacecolor() for bar in figure.axes[0].containers
    }
    hollow = [label for label, face in faces.items() if face == "white"]
    assert len(faces) == 3 and hollow == ["learned for another task*"]
    marks = {bar.lines[0].get_marker() for bar in figure.axes[0].containers}
    assert len(marks) == 2, "programmed and learned are told apart without colours"


# -- errors against time --------------------------------------------------------------------------


def test_errors_are_those_of_the_true_positions(flown: Report) -> None:
    """Against an own recording of the flight, through what the panel shows."""
    config = configure(**FLIGHT)
    seen = np.full((3, config.max_steps, config.followers), CAP)
    tick = 0

    def watch(simulation: Simulation, live: Any, _: Any) -> None:
        nonlocal tick
        off = np.linalg.norm(simulation.slots - simulation.positions[:, 1:], axis=-1)
        seen[live, tick] = np.minimum(off[live], CAP)
        tick += 1

    fly(make_policy("ff", config), range(3), watch=watch)
    figure = plots.draw_errors("mine", flown.scenarios["mine"], 3)
    ax = next(ax for ax in figure.axes if ax.get_title("left").startswith("ff"))
    line = next(line for line in ax.lines if line.get_label() == "median")
    time, median = line.get_data()
    kept = np.round(np.asarray(time) / config.control_period).astype(int) - 1
    assert len(time) == curves.INSTANTS and kept[-1] == config.max_steps - 1
    assert median == pytest.approx(np.median(seen[:, kept], axis=(0, 2)), rel=1e-5)
    shade = next(c for c in ax.collections if c.get_label() == "10 to 90 %")
    low, high = np.percentile(seen[:, kept], (10.0, 90.0), axis=(0, 2))
    (path,) = shade.get_paths()
    for k in (0, 100, 239):
        there = path.vertices[np.isclose(path.vertices[:, 0], time[k]), 1]
        assert (there.min(), there.max()) == pytest.approx((low[k], high[k]), rel=1e-5)


def test_the_cap_stands_from_the_tick_of_a_failure_on() -> None:
    """What an episode lacks is no gap and no zero."""
    config = configure("nominal", duration=3.0)
    ticks: list[Any] = []  # of each the worlds that have flown it and go on

    def watch(simulation: Simulation, live: Any, _: Any) -> None:
        ticks.append(live & ~simulation.over.astype(bool))

    columns = fly(make_policy("random", config), range(4), watch=watch, curves=True)
    assert columns["failed"].all()
    errors = columns[curves.COLUMN]
    assert errors.shape == (4, 150, config.followers) and np.isfinite(errors).all()
    alive = np.zeros((4, 150), dtype=bool)
    alive[:, : len(ticks)] = np.array(ticks).T
    assert (errors[~alive] == np.float32(CAP)).all()
    assert (errors[alive] < CAP).mean() > 0.5 and 10 < alive.sum() < 590


def test_the_trigger_and_the_scored_window_are_marked(flown: Report) -> None:
    figure = plots.draw_errors("mine", flown.scenarios["mine"], 3)
    marks = {
        ax.get_title("left").split(",")[0]: [
            float(line.get_xdata()[0]) for line in ax.lines if "trigger" in str(line.get_label())
        ]
        for ax in figure.axes
        if ax.get_visible()
    }
    fired = flown.scenarios["mine"].results["ff"].runs["ff"]["trigger_time"]
    assert 5.0 < np.median(fired) < 13.0
    assert marks == {"ff": [pytest.approx(np.median(fired))], "hover": []}
    (scored,) = (p for p in figure.axes[0].patches if p.get_label() == "scored")
    config = flown.scenarios["mine"].config
    flight, window = (0.02 * ticks(config) for ticks in (flight_ticks, window_ticks))
    assert scored.get_x() == pytest.approx(np.median(fired) + flight - window)
    assert scored.get_width() == pytest.approx(window)


def test_axes_have_units(flown: Report) -> None:
    figure = plots.draw_errors("mine", flown.scenarios["mine"], 3)
    assert {"time (s)", "slot error (m)"} <= set(texts(figure))
    assert figure.axes[0].get_yscale() == "log"


def test_no_number_changes_with_pictures(flown: Report, tmp_path: Path) -> None:
    config = configure(**FLIGHT)
    plain = baselines.evaluate(["ff", "hover"], {"mine": config}, episodes=3, quiet=True)
    drawn = baselines.evaluate(
        ["ff", "hover"], {"mine": config}, episodes=3, quiet=True, plot=tmp_path / "new" / "folder"
    )
    assert report.to_json(plain) == report.to_json(drawn) == report.to_json(flown)
    for policy in ("ff", "hover"):
        runs = [r.scenarios["mine"].results[policy].runs[policy] for r in (plain, drawn)]
        assert set(runs[1]) - set(runs[0]) == {curves.COLUMN}
        assert all(np.array_equal(runs[0][x], runs[1][x], equal_nan=True) for x in runs[0])
    names = sorted(path.name for path in (tmp_path / "new" / "folder").iterdir())
    pair = [f"mine-{what}.{kind}" for what in ("errors", "scores") for kind in ("png", "svg")]
    assert names == pair


# -- the command ----------------------------------------------------------------------------------

FAST = ["--policies", "hover", "--scenarios", "nominal", "--episodes", "2", "--duration", "0.2"]


def test_the_command_writes_pictures_and_the_sweep(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, folder = tmp_path / "out", tmp_path / "pictures"
    options = ["--output", str(out), "--plot", str(folder)]
    assert command.main([*FAST, "--sweep", "gust=0:1:3", *options]) == 0
    document = json.loads((out / "results.json").read_text(encoding="utf-8"))
    (sweep,) = document["sweeps"]
    assert (sweep["field"], sweep["unit"], sweep["values"]) == ("gust", "m/s^2", [0, 0.5, 1])
    assert list(document["scenarios"]) == sweep["scenarios"]
    assert document["command"].endswith("--sweep gust=0:1:3 --episodes 2 --duration 0.2")
    pair = ["nominal-gust.png", "nominal-gust.svg"]
    assert sorted(path.name for path in folder.iterdir()) == pair
    assert "scores by gust, m/s^2" in capsys.readouterr().out
    first = [(folder / name).read_bytes() for name in pair]
    assert command.main([*FAST, "--sweep", "gust=0:1:3", *options]) == 0
    assert [(folder / name).read_bytes() for name in pair] == first


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--sweep", "gusts=0:1:3"], "unexpected keyword argument 'gusts'"),
        (["--sweep", "estimator=0:1:3"], "estimator = 0: expected one of 'direct'"),
        (["--sweep", "gust=1:-1:3"], "scenario nominal gust=-1: gust = -1: expected"),
        (["--sweep", "measurement_delay=0:2:4"], "measurement_delay = 0.666666666667: expected"),
        (["--sweep", "gust=0,1", "--sweep", "gust=1,2"], "gust is swept twice"),
    ],
)
def test_a_sweep_that_cannot_be_is_one_line_before_anything_flies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], expected: str
) -> None:
    with pytest.raises(SystemExit):
        command.main([*FAST, *options, "--output", str(tmp_path / "out")])
    error = capsys.readouterr().err
    assert expected in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_without_matplotlib_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pictures, "installed", lambda: False)
    folder = tmp_path / "pictures"
    with pytest.raises(SystemExit):
        command.main([*FAST, "--output", str(tmp_path / "out"), "--plot", str(folder)])
    error = capsys.readouterr().err
    assert 'pip install "formation-env[plot]"' in error and error.count("\n") == 1
    with pytest.raises(ValueError, match="need Matplotlib"):
        baselines.evaluate("hover", plot=folder)
    assert not folder.exists() and not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_named_before_anything_flies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command.scoring, "fly_all", lambda *_: pytest.fail("flew"))
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(SystemExit):
        command.main([*FAST, "--output", str(tmp_path / "out"), "--plot", str(file)])
    error = capsys.readouterr().err
    assert f"cannot write into {file}" in error and error.count("\n") == 1
    with pytest.raises(OSError, match="file"):
        baselines.evaluate("hover", plot=file)


# -- files and style ------------------------------------------------------------------------------


def test_names_of_files_are_safe_and_differ() -> None:
    names = list(plots.names(["a/b", "a b", "A:b", "ä" * 300], ()).values())
    assert names[:6:2] == ["a-b-scores", "a-b-scores-2", "A-b-scores-3"]
    assert all(len(name) < 120 and name.isascii() for name in names)


def test_the_style_neither_takes_from_the_users_own_nor_leaks(tmp_path: Path) -> None:
    with matplotlib.rc_context({"font.size": 30.0, "axes.facecolor": "red"}):
        before = dict(matplotlib.rcParams)
        plots.plot(made(), tmp_path / "own")
        assert dict(matplotlib.rcParams) == before
    plots.plot(made(), tmp_path / "plain")
    for name in ("nominal-scores.png", "nominal-scores.svg"):
        own, plain = (tmp_path / folder / name for folder in ("own", "plain"))
        assert own.read_bytes() == plain.read_bytes()
