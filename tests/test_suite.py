"""Intervals over episodes and training runs, and the statistics over scenarios, against what is known."""

from __future__ import annotations

import zipfile
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, norm, trim_mean

from baselines.scoring import suite
from baselines.scoring.intervals import (
    Estimate,
    Floats,
    estimate,
    estimates,
    median_run,
    summarise,
)
from baselines.scoring.metrics import EPISODE
from baselines.scoring.suite import (
    FIGURES,
    Matrix,
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
    suite_score,
)

# -- one figure -----------------------------------------------------------------------------------


def test_interval_of_a_mean_is_the_normal_one() -> None:
    """For many samples the bootstrap interval of a mean is mean -+ 1.96 s / sqrt(n)."""
    x = np.random.default_rng(1).normal(3.0, 2.0, 400)
    e = estimate(x)
    half = 1.96 * x.std() / sqrt(len(x))
    assert e.value == pytest.approx(x.mean())
    assert e.low == pytest.approx(x.mean() - half, abs=0.1 * half)
    assert e.high == pytest.approx(x.mean() + half, abs=0.1 * half)


@pytest.mark.filterwarnings("error")
def test_samples_without_spread_and_without_values() -> None:
    assert estimate(np.full(5, 2.0)) == Estimate(2.0, 2.0, 2.0, 5)
    assert estimate(np.array([4.0])) == Estimate(4.0, 4.0, 4.0, 1)
    empty = estimate(np.full(5, np.nan))
    assert empty.episodes == 0 and np.isnan(empty.value)


@pytest.mark.filterwarnings("error")
def test_episodes_without_a_value_are_left_out() -> None:
    e = estimate(np.array([np.nan, 1.0, 3.0, np.nan]))
    assert (e.value, e.episodes) == (2.0, 2)
    assert 1.0 <= e.low < e.high <= 3.0
    # Of two runs one has none.
    assert estimate(np.array([[1.0, 3.0], [np.nan, np.nan]])).value == 2.0


def test_settling_time_is_a_median() -> None:
    columns = {name: np.array([1.0, 2.0, 30.0]) for name in EPISODE}
    summary = summarise([columns])
    assert summary["settling_time"].value == 2.0
    assert summary["slot_error"].value == 11.0


def test_a_median_of_resamples_is_numpys() -> None:
    """The distribution of the median of three of (1, 2, 30), by counting: P(1) = P(30) = 7/27."""
    e = estimate(np.array([1.0, 2.0, 30.0]), middle=True)
    assert (e.low, e.value, e.high) == (1.0, 2.0, 30.0)
    x = np.random.default_rng(3).normal(size=(1, 9))
    whole = estimate(x, middle=True)
    assert whole.value == np.median(x)
    assert estimate(x[:, :4], middle=True).value == np.median(x[:, :4])
    # Against medians of resamples, of an even number too.
    for count in (40, 41):
        y = np.random.default_rng(4).normal(size=count)
        drawn = np.random.default_rng(5).choice(y, size=(20_000, count))
        low, high = np.percentile(np.median(drawn, axis=1), (2.5, 97.5))
        e = estimate(y, middle=True)
        assert (e.low, e.high) == pytest.approx((low, high), abs=0.05)


def test_several_runs_are_their_median_run() -> None:
    scores = np.array([[0.1, 0.3], [0.8, 1.0], [0.4, 0.6], [0.9, 0.9], [0.5, 0.7]])
    assert estimate(scores).value == pytest.approx(0.6)
    assert median_run(scores) == 4
    assert median_run(scores[:2]) == 0, "the worse of two"


def test_the_interval_covers_both_training_runs_and_episodes() -> None:
    """Where runs differ and episodes do not, it is the bootstrap of runs; and the other way round."""
    runs, episodes = np.arange(5.0)[:, None], np.random.default_rng(5).normal(size=(1, 400))
    only_runs = estimate(np.repeat(runs, 400, axis=1))
    # A median of five draws of five is the least with probability 0.058, which is more than 2.5 %.
    assert (only_runs.low, only_runs.value, only_runs.high) == (0.0, 2.0, 4.0)
    only_episodes = estimate(np.repeat(episodes, 5, axis=0))
    alone = estimate(episodes)
    assert only_episodes.high - only_episodes.low == pytest.approx(alone.high - alone.low, rel=0.1)
    both = estimate(runs + episodes)
    middle = episodes.mean()
    assert both.low - middle < only_runs.low and both.high - middle > only_runs.high


def test_a_paired_difference_without_noise_is_certain() -> None:
    x = np.random.default_rng(2).normal(0.0, 10.0, 50)
    e = estimate((x + 0.5) - x)
    assert (e.low, e.value, e.high) == pytest.approx((0.5, 0.5, 0.5))


def test_samples_are_resampled_together() -> None:
    x = np.random.default_rng(6).normal(size=(3, 40))
    both = estimates({"x": x, "2 x": 2.0 * x})
    assert np.allclose(2.0 * np.array(both["x"][:3]), both["2 x"][:3])
    assert both["x"] == estimate(x)


# -- over scenarios -------------------------------------------------------------------------------


def made(scores: dict[str, list[Floats]], episodes: int) -> Matrix:
    """A matrix from the scores of each method on each scenario, `(runs, episodes)`, or of no run."""
    runs = max(len(x) for each in scores.values() for x in each)
    scenarios = len(next(iter(scores.values())))
    score = np.full((len(scores), runs, scenarios, episodes), np.nan)
    for i, each in enumerate(scores.values()):
        for k, x in enumerate(each):
            score[i, : len(x), k] = x
    names = tuple(f"task {k}" for k in range(scenarios))
    figures = {name: score if name == "score" else score + 1.0 for name in FIGURES}
    return Matrix(tuple(scores), np.arange(runs), names, np.arange(episodes), figures)


def test_interquartile_mean_by_hand() -> None:
    """Of 1 ... 8 the mean of 3, 4, 5, 6; SciPy's trimmed mean where a quarter is a whole number."""
    x = np.array([8.0, 1.0, 5.0, 3.0, 7.0, 2.0, 4.0, 6.0])
    assert interquartile_mean(x, np.ones(8)) == pytest.approx(4.5)
    x = np.random.default_rng(0).normal(size=(4, 20))
    assert interquartile_mean(x, np.ones(20)) == pytest.approx(trim_mean(x, 0.25, axis=1))
    # Of 0, 1, 10 the middle half: 1/12 of the first, 1/3 of the second, 1/12 of the third.
    y = np.array([10.0, 0.0, 1.0])
    assert interquartile_mean(y, np.ones(3)) == pytest.approx((1 / 3 + 10 / 12) / 0.5)
    # A value of weight 3 is three values.
    z, w = np.array([0.0, 4.0, 9.0]), np.array([3.0, 1.0, 4.0])
    assert interquartile_mean(z, w) == pytest.approx(trim_mean([0, 0, 0, 4, 9, 9, 9, 9], 0.25))


def test_scenarios_count_alike_however_many_runs_they_have() -> None:
    one, five = np.full((1, 4), 0.2), np.full((5, 4), 0.8)
    m = made({"a": [one, five]}, 4)
    assert suite_score(m, "a").mean[:3] == pytest.approx((0.5, 0.5, 0.5))
    assert suite_score(m, "a", ["task 1"]).mean.value == pytest.approx(0.8)


def test_the_suites_interval_is_stratified() -> None:
    """That scenarios differ gives no width: of c means of n normal scores 2 times 1.96 s / sqrt(n c)."""
    rng = np.random.default_rng(1)
    levels = (0.0, 10.0, 50.0, 100.0)
    m = made({"a": [level + rng.normal(0.0, 1.0, (1, 400)) for level in levels]}, 400)
    mean = suite_score(m, "a").mean
    assert mean.value == pytest.approx(40.0, abs=0.2)
    assert mean.high - mean.low == pytest.approx(2 * 1.96 / sqrt(400 * 4), rel=0.1)


def test_the_suites_interval_counts_training_runs() -> None:
    """Mean of five runs with spread s: 1.96 s sqrt(1 / 5), over four scenarios half of that."""
    rng = np.random.default_rng(2)
    runs = [np.repeat(rng.normal(0.0, 1.0, (5, 1)), 50, axis=1) for _ in range(4)]
    m = made({"a": runs}, 50)
    spread = sqrt(np.mean([x[:, 0].var() for x in runs]))
    mean = suite_score(m, "a").mean
    assert mean.high - mean.low == pytest.approx(2 * 1.96 * spread / sqrt(20), rel=0.15)


def test_probability_of_improvement_is_mann_whitneys() -> None:
    rng = np.random.default_rng(3)
    x = [rng.normal(0.3, 1.0, (r, 30)).round(1) for r in (5, 1)]
    y = [rng.normal(0.0, 1.0, (r, 30)).round(1) for r in (1, 3)]
    m = made({"x": x, "y": y}, 30)
    u = [
        mannwhitneyu(a.ravel(), b.ravel()).statistic / (a.size * b.size)
        for a, b in zip(x, y, strict=True)
    ]
    p = probability_of_improvement(m, "x", "y")
    assert p.value == pytest.approx(np.mean(u))
    assert p.low < p.value < p.high
    q = probability_of_improvement(m, "y", "x")
    assert (q.value, q.low, q.high) == pytest.approx((1 - p.value, 1 - p.high, 1 - p.low), abs=0.02)


def test_probability_of_improvement_of_known_distributions() -> None:
    """Of two normal distributions a unit apart Phi(1 / sqrt 2); of equal scores a half."""
    rng = np.random.default_rng(4)
    m = made({"x": [rng.normal(1.0, 1.0, (1, 2000))], "y": [rng.normal(0.0, 1.0, (1, 2000))]}, 2000)
    p = probability_of_improvement(m, "x", "y")
    assert p.low < norm.cdf(1.0 / sqrt(2.0)) < p.high
    assert p.high - p.low < 0.05
    same = probability_of_improvement(m, "x", "x")
    assert same[:3] == pytest.approx((0.5, 0.5, 0.5))


def test_profile_by_hand_and_of_a_known_distribution() -> None:
    m = made({"a": [np.array([[0.2, 0.4]]), np.array([[0.4, 0.8], [0.9, 0.1]])]}, 2)
    profile = performance_profile(m, "a", np.array([0.0, 0.3, 0.4, 0.85]))
    assert profile.share == pytest.approx([1.0, (0.5 + 0.75) / 2, 0.25, 0.125])
    uniform = made({"a": [np.random.default_rng(5).random((1, 1000)) for _ in range(2)]}, 1000)
    tau = np.linspace(0.1, 0.9, 9)
    profile = performance_profile(uniform, "a", tau)
    assert profile.share == pytest.approx(1.0 - tau, abs=0.03)
    width = 2 * 1.96 * np.sqrt(tau * (1.0 - tau) / 2000)
    assert profile.high - profile.low == pytest.approx(width, rel=0.2)


def test_only_scenarios_that_both_have_flown_are_compared() -> None:
    good, bad, none = np.full((1, 3), 0.9), np.full((1, 3), 0.1), np.zeros((0, 3))
    m = made({"x": [good, none, bad], "y": [bad, good, none]}, 3)
    assert m.flown("x") == ("task 0", "task 2") and m.flown("x", "y") == ("task 0",)
    assert probability_of_improvement(m, "x", "y").value == 1.0
    assert suite_score(m, "y").scenarios == ("task 0", "task 1")
    with pytest.raises(ValueError, match="not flown on task 1"):
        suite_score(m, "x", ["task 1"])
    with pytest.raises(ValueError, match="'z': expected one of x, y"):
        suite_score(m, "z")


def test_a_part_of_a_matrix_has_its_scenarios_and_who_has_flown_one() -> None:
    good, none = np.full((1, 3), 0.9), np.zeros((0, 3))
    m = made({"x": [good, good * 0.5, good], "y": [none, good, none]}, 3)
    part = suite.over(m, ["task 2", "task 0"])
    assert part.scenario == ("task 2", "task 0") and part.method == ("x",)
    assert suite.over(m, m.scenario).method == m.method
    assert suite_score(part, "x").mean.value == pytest.approx(0.9)
    whole = suite_score(m, "x", ["task 0", "task 2"])
    assert suite_score(suite.over(m, ["task 0", "task 2"]), "x") == whole


# -- the file -------------------------------------------------------------------------------------


def test_a_matrix_is_read_back_as_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    m = made({"a": [rng.random((2, 5))], "b": [rng.random((1, 5))]}, 5)
    path = suite.write(m, tmp_path / "raw")
    assert path.name == "raw.npz" and path == suite.write(m, path)
    with zipfile.ZipFile(path) as archive:
        assert {n.removesuffix(".npy") for n in archive.namelist()} == {
            "axes", *suite.AXES, *FIGURES
        }  # fmt: skip
    again = suite.read(path)
    assert again.method == ("a", "b") and again.scenario == ("task 0",)
    assert again.training_seed.tolist() == [0, 1] and again.episode.tolist() == [0, 1, 2, 3, 4]
    for name in FIGURES:
        np.testing.assert_allclose(again.figures[name], m.figures[name], rtol=1e-6)
    assert suite_score(again, "a").mean.value == pytest.approx(suite_score(m, "a").mean.value)


def test_what_is_no_matrix_is_refused(tmp_path: Path) -> None:
    """Pickled objects too, which reading would execute."""
    m = made({"a": [np.zeros((1, 5))]}, 5)
    whole = suite.write(m, tmp_path / "whole").read_bytes()
    arrays = {**dict(np.load(tmp_path / "whole.npz"))}
    np.savez(tmp_path / "pickled.npz", **{**arrays, "method": np.array([{}], dtype=object)})
    np.savez(tmp_path / "short.npz", **{**arrays, "score": np.zeros(3)})
    np.savez(tmp_path / "missing.npz", score=np.zeros(3))
    (tmp_path / "cut.npz").write_bytes(whole[:-50])
    (tmp_path / "text.npz").write_text("score")
    np.save(tmp_path / "one.npy", np.zeros(3))
    for name in ("pickled.npz", "short.npz", "missing.npz", "cut.npz", "text.npz", "one.npy"):
        with pytest.raises(ValueError, match=f"{name}: expected") as refusal:
            suite.read(tmp_path / name)
        assert str(refusal.value).count("\n") == 0
