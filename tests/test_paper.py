"""The paper's figures redone: theorems along the continuous solutions, and what the command writes."""

from __future__ import annotations

import json
import os
from math import hypot, log
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from closed_loop import agree

from baselines import paper
from baselines.reproduction import continuous, costs, sampled
from baselines.reproduction.claims import Cost, cost_table
from baselines.reproduction.claims_continuous import (
    flight_claims,
    heading_on_a_circle,
    planar_claims,
    settling_time,
)
from baselines.reproduction.claims_formation import predicted_correlation
from baselines.reproduction.continuous import Flight, Planar
from baselines.system.writing import claim
from formation_env.config import NO_NOISE
from formation_env.scenarios import configure

pytestmark = pytest.mark.filterwarnings("ignore::formation_env.laws.feasibility.FeasibilityWarning")

# What does not hold, and why, is said in the claims' notes.
REFUTED = {"speed-independent-of-dy", "heights-carry-over-under-noise"}

XYZ = ("x", "y", "z")
PLANNER = ("e1_x", "e1_y", "e2_x", "e2_y")
DISTANCES = ["dist_leader_f1", "dist_leader_f2", "dist_f1_f2"]


def formation_header() -> list[str]:
    names = ["t", "started"] + [f"{who}_{a}" for who in ("reference", "leader") for a in XYZ]
    for k in "12":
        names += [f"{who}_{a}" for who in (f"v{k}", f"f{k}", f"f{k}_v") for a in XYZ]
    for k in "12":
        names += [f"f{k}_e{e}_{a}" for e in "1234" for a in XYZ]
        names += [f"f{k}_e{e}_{a}_true" for e in "12" for a in XYZ]
    for k in "12":
        names += [f"v{k}_{e}" for e in (*PLANNER, "ez")] + [f"v{k}_{e}_true" for e in PLANNER]
    return names + DISTANCES


PLANE = ["t", *(f"{who}_{a}" for who in ("leader", "f1", "f2") for a in "xy"), *DISTANCES]
STATES = ["t", *(f"f{k}_{x}" for k in "12" for x in ("u", "omega", "theta", *PLANNER))]
FLIGHT = [
    "t",
    "p_x",
    "p_y",
    "p_z",
    "thrust",
    *(f"e{k}_{a}" for k in "1234" for a in XYZ),
    "lyapunov",
]
HEADERS = {
    2: PLANE,
    3: STATES,
    **dict.fromkeys((4, 5), FLIGHT),
    **dict.fromkeys((6, 7, 8, 9, 11, 12, 13, 14), formation_header()),
}


@pytest.fixture(scope="module")
def planar() -> Planar:
    return continuous.planar()


@pytest.fixture(scope="module")
def flight() -> Flight:
    return continuous.flight()


# -- figures 2 to 5 -----------------------------------------------------------------------------------


def test_planner_error_decays_as_theorem_1_says(planar: Planar) -> None:
    # k3 = 0: e2_dot = -k1 k2 e2, so e2 is known in closed form at every time.
    decay = np.exp(-0.2 * 2.0 * planar.t)[:, None, None]
    agree(planar.e2, decay * planar.e2[0], 1e-8)


def test_planar_start_is_the_papers(planar: Planar) -> None:
    agree(planar.p[0], [[3.0, 3.0], [3.0, 1.0]])
    agree(planar.theta[0], [1.5 * np.pi, 0.0])
    agree(planar.u[0], [0.5, 0.0])
    agree(planar.omega[0], [-0.5, 0.5])
    agree(planar.leader, np.stack([2 * np.cos(planar.t / 4), np.sin(planar.t / 2)], -1), 1e-12)


def test_virtual_followers_move_along_their_heading(planar: Planar) -> None:
    """(2)-(3) along the stored solution, by central differences."""
    h = planar.t[1] - planar.t[0]
    v = (planar.p[2:] - planar.p[:-2]) / (2 * h)
    heading = np.stack([np.cos(planar.theta), np.sin(planar.theta)], -1)
    agree(v, (planar.u[..., None] * heading)[1:-1], 2e-3)
    agree((planar.theta[2:] - planar.theta[:-2]) / (2 * h), planar.omega[1:-1], 2e-3)


def test_distances_reach_the_formations(planar: Planar) -> None:
    to_leader = np.linalg.norm(planar.leader[-1] - planar.p[-1], axis=-1)
    agree(to_leader, np.full(2, hypot(0.35, 0.35)), 1e-5)
    agree(np.linalg.norm(planar.p[-1, 0] - planar.p[-1, 1]), 0.7, 1e-5)


def test_lyapunov_rate_is_the_slope_of_the_lyapunov_function(flight: Flight) -> None:
    """(69) along the closed loop: the integrated flight, the law and V4 belong together."""
    h = flight.t[1] - flight.t[0]
    V = flight.lyapunov
    slope = (8 * (V[3:-1] - V[1:-3]) - (V[4:] - V[:-4])) / (12 * h)
    np.testing.assert_allclose(slope, flight.lyapunov_rate[2:-2], rtol=2e-5, atol=1e-7)
    assert (np.diff(V) < 0.0).all()


def test_flight_starts_upside_down_and_ends_on_the_path(flight: Flight) -> None:
    agree(flight.p[0], [-5.0, 10.0, -10.0])
    agree(flight.e3[0, 2] + np.sqrt(1 - (flight.e3[0, :2] ** 2).sum()), -1.0, 1e-6)
    assert -1.0 < flight.alignment[0] < -0.8  # near the unstable equilibrium, not at it
    assert flight.thrust.min() < 0.0
    assert np.linalg.norm(flight.p[-1] - flight.reference[-1]) < 1e-3


def test_continuous_claims(planar: Planar, flight: Flight) -> None:
    claims = planar_claims(planar) + flight_claims(flight)
    assert {c.id for c in claims if not c.holds} == {"speed-independent-of-dy"}


def test_claims_fail_where_they_are_false(planar: Planar, flight: Flight) -> None:
    apart = planar._replace(p=planar.p + np.array([[0.0, 0.01], [0.0, 0.0]]))
    rising = flight._replace(lyapunov=flight.lyapunov[::-1], e1=flight.e1[::-1])
    turned = planar._replace(theta=planar.theta + np.array([0.0, 4 * np.pi]))
    refuted = {c.id for c in planar_claims(apart) + flight_claims(rising) if not c.holds}
    assert {"distance-to-leader", "distance-between-followers", "lyapunov-falls"} <= refuted
    assert {"tracker-converges", "remaining-error"} <= refuted
    agreed = {c.id: c.holds for c in planar_claims(turned)}
    assert agreed["headings-and-rates-agree"]  # headings are compared modulo 2 pi


def test_heading_behind_a_circle_depends_on_its_radius() -> None:
    claim = heading_on_a_circle(60.0, radius=1.0)
    assert claim.holds
    agree(claim.values["f1"], -np.arcsin(0.35), 1e-4)


def test_settling_time_of_an_exponential() -> None:
    t = np.linspace(0.0, 10.0, 10001)
    assert settling_time(t, np.exp(-t)) == pytest.approx(log(20.0), abs=2e-3)
    assert settling_time(t, np.exp(-t) + 0.2 * (abs(t - 6) < 0.1)) == pytest.approx(6.1, abs=2e-3)


def test_exact_derivatives_track_exactly_and_zero_ones_do_not() -> None:
    world, d = configure("paper").world, (0.35, 0.35, -0.3)
    error = [costs.tracking_error(way, d, world, 30.0) for way in range(3)]
    assert error[costs.EXACT] < 1e-9
    assert 0.005 < error[costs.ZERO_FED] < 0.03
    assert 0.005 < error[costs.DERIVED] < 0.03


# -- figures 6 to 14 ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run() -> sampled.Run:
    return sampled.fly("paper", seed=3, worlds=2, after=20.0)


def test_planner_waits_for_the_trigger(run: sampled.Run) -> None:
    for w in range(2):
        waiting = run.clock[:, w] == 0.0
        assert np.ptp(run.virtual_p[waiting, w], axis=0).max() == 0.0
        assert np.ptp(run.virtual_p[~waiting, w], axis=0).max() > 1.0
        ready = np.argmax(run.clock[:, w] > 0.0) - 1
        assert np.linalg.norm(run.tracking[ready, w], axis=-1).max() < 0.25  # e_max
    assert run.trigger(0) != run.trigger(1)


def test_true_planner_errors_are_the_papers(run: sampled.Run) -> None:
    """(7) by matrices: `|R^T (p_L - p_F) - d|` does not depend on how `R` is written."""
    d = np.array(run.config.offsets)[:, :2]
    gap = run.p[:, :, :1, :2] - run.virtual_p[..., :2]
    leader = run.planner_true["e1"] + d
    np.testing.assert_allclose(
        np.linalg.norm(leader, axis=-1), np.linalg.norm(gap, axis=-1), atol=1e-12
    )
    noise = run.planner["e1"] - run.planner_true["e1"]
    flying = run.clock[:, 0] > 0.0
    assert 0.19 < noise[flying].std() < 0.21  # the position's 0.2 m


def test_worlds_differ_and_repeat(run: sampled.Run) -> None:
    again = sampled.fly("paper", seed=4, after=20.0)
    count = len(again.t)
    np.testing.assert_array_equal(again.p[:, 0], run.p[:count, 1])
    assert not np.array_equal(run.p[:, 0], run.p[:, 1])


def test_without_noise_the_formation_is_tight() -> None:
    run = sampled.fly("paper", after=30.0, noise=NO_NOISE)
    d = run.distances[run.steady(0), 0]
    agree(d, np.broadcast_to([hypot(0.35, 0.35, 0.3)] * 2 + [0.7], d.shape), 0.03)


def test_noise_correlation_of_heights_is_understood() -> None:
    """The prediction of the linear loops against the whole simulation, over many noises.

    One run's correlation varies by 0.22: the mean of 200 is known to 0.016.
    """
    run = sampled.fly("paper", seed=0, worlds=200)
    heights = [
        (run.p[m, w, 0, 2], run.virtual_p[m, w, 0, 2])
        for w, m in enumerate(map(run.steady, range(200)))
    ]
    measured = float(np.mean([np.corrcoef(a, b)[0, 1] for a, b in heights]))
    assert measured == pytest.approx(predicted_correlation(run.config, shared=True), abs=0.1)
    assert predicted_correlation(run.config, shared=False) > 0.5


# -- the command --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("paper")
    paper.main(["--out", str(out)])
    return out


def rows(path: Path) -> tuple[list[str], Any]:
    with path.open(encoding="utf-8") as file:
        header = file.readline().strip().split(",")
        return header, np.loadtxt(file, delimiter=",")


@pytest.mark.slow
def test_every_figure_has_its_columns_and_its_length(written: Path) -> None:
    last = {2: 60.0, 3: 60.0, 4: 30.0, 5: 30.0}
    for number, header in HEADERS.items():
        found, values = rows(written / f"fig{number:02d}.csv")
        assert found == header
        assert np.isfinite(values).all()
        t = values[:, 0]
        assert t[0] == 0.0
        assert (np.diff(t) > 0.0).all()
        if number in last:
            assert t[-1] == last[number]
        else:
            begin = t[np.argmax(values[:, 1])]
            assert t[-1] - begin >= 80.0 - 0.05
            leader, f1 = values[:, 5:8], values[:, 11:14]
            distance = values[:, header.index("dist_leader_f1")]
            np.testing.assert_allclose(np.linalg.norm(leader - f1, axis=1), distance, atol=1e-4)


@pytest.mark.slow
def test_every_picture_shows_something(written: Path) -> None:
    from matplotlib.image import imread

    sizes = set()
    for number in paper.FIGURES:
        image = imread(written / f"fig{number:02d}.png")[..., :3]
        ink = (image < 0.9).any(axis=-1)
        assert 0.01 < ink.mean() < 0.6
        coloured = np.ptp(image, axis=-1) > 0.2  # curves: text and axes are grey
        assert coloured.mean() > 0.001
        sizes.add((written / f"fig{number:02d}.png").stat().st_size)
    assert len(sizes) == len(paper.FIGURES)


@pytest.mark.slow
def test_summary_measures_every_claim(written: Path) -> None:
    summary = json.loads((written / "summary.json").read_text(encoding="utf-8"))
    claims = {c["id"]: c for c in summary["claims"]}
    assert len(claims) == len(summary["claims"]) >= 25
    assert {f for c in claims.values() for f in c["figures"]} >= set(paper.FIGURES)
    for c in claims.values():
        assert all(np.isfinite(x) for x in c["values"].values())
        assert c["values"]
        assert c["text"]
        assert c["paper"]
        assert c["criterion"]
        assert c["holds"] or c["note"]  # what does not hold is explained
        assert c["holds"] or c["errata"] != "sound"
    assert {name for name, c in claims.items() if not c["holds"]} == REFUTED
    measured = {
        (c["setting"], c["feedforward"]): c["tracking_rms"] for c in summary["feedforward"]["costs"]
    }
    assert len(measured) == 7
    assert summary["feedforward"]["default"] == "zero"


def test_table_and_csv_of_a_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paper.main(["--out", str(tmp_path / "deep" / "er"), "--figures", "2", "--no-plots"])
    text = capsys.readouterr().out
    assert "0.495 m" in text
    assert "5 of 6 claims hold" in text
    assert sorted(p.name for p in (tmp_path / "deep" / "er").iterdir()) == [
        "fig02.csv",
        "summary.json",
    ]
    header, values = rows(tmp_path / "deep" / "er" / "fig02.csv")
    at = header.index("dist_f1_f2")
    agree(values[:, at], np.hypot(*(values[:, 3:5] - values[:, 5:7]).T), 1e-7)


@pytest.mark.parametrize("columns", [80, 100, 200])
def test_the_table_fits_the_terminal(
    columns: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    assert paper.main(["--out", str(tmp_path), "--figures", "2", "--no-plots"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines[:-1])) == min(columns, 100)
    costs = [Cost("figures 6-9 at 50 Hz, no noise", "derived, leader's exact", 0.1)]
    assert max(map(len, cost_table(costs).splitlines())) <= 80


def test_missing_matplotlib_is_said_before_anything_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name, package=None: None)
    with pytest.raises(SystemExit) as stop:
        paper.main(["--out", str(tmp_path / "out")])
    assert stop.value.code == 2
    assert 'pip install "formation-env[plot]"' in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--figures", "10"], "10"),
        (["--seeds", "0"], "'0': expected a whole number from 1 to"),
        (["--seeds", "many"], "'many': expected a whole number from 1 to"),
        (["--seed", "-1"], "'-1': expected a whole number from 0 to"),
        (["--sed", "1"], "unrecognized arguments: --sed 1"),
    ],
)
def test_impossible_options_are_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        paper.main(arguments)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_an_output_folder_that_is_a_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocked = tmp_path / "taken"
    blocked.write_text("mine")
    assert paper.main(["--out", str(blocked), "--figures", "2", "--no-plots"]) == 1
    assert "cannot write to" in capsys.readouterr().err
    assert blocked.read_text() == "mine"


def test_an_output_folder_of_another_run_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with claim(tmp_path):
        assert paper.main(["--out", str(tmp_path), "--figures", "2", "--no-plots"]) == 1
    error = capsys.readouterr().err
    assert f"process {os.getpid()} on" in error and str(tmp_path) in error
