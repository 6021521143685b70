"""The metrics on made-up trajectories whose figures are known, and the intervals against theory."""

from __future__ import annotations

import warnings
from math import sqrt
from typing import Any

import numpy as np
import pytest

from baselines.registry import make_policy
from baselines.scoring.intervals import Estimate, estimate, mean, normalised, summarise
from baselines.scoring.metrics import EPISODE, KINDS, SETTLED, add_tick, begin, episodes
from baselines.scoring.rollout import fly as fly_policy
from formation_env import FormationConfig, configure, splines
from formation_env.memory.records import size
from formation_env.task import COLLISION, COLUMNS, FAILED, SEPARATION, Outcome

TICKS = 200  # of 0.02 s
OFFSETS = np.array(configure("nominal").offsets)


@pytest.fixture(scope="module")
def config() -> FormationConfig:
    return configure("nominal", duration=TICKS * 0.02)


def fly(
    config: FormationConfig,
    errors: Any,
    *,
    rewards: Any = 1.0,
    actions: Any = 0.0,
    trigger: int = 0,
    ticks: int = TICKS,
    failed: int = 0,
    leader_only: bool = False,
) -> dict[str, float]:
    """The figures of one world in which follower i is displaced from its slot by `errors[tick, i]`.

    The leader moves along x; a second, dead world flies beside it and must not be counted.
    """
    errors = np.broadcast_to(errors, (TICKS, 2, 3)).astype(float)
    rewards = np.broadcast_to(rewards, TICKS)
    actions = np.broadcast_to(np.asarray(actions, dtype=np.float32), (TICKS, 2, 4))
    tally = begin(config, np.array([trigger == 0, True]))
    before = np.zeros((2, 2, 4), dtype=np.float32)
    live = np.array([True, False])
    for k in range(ticks):
        leader = np.array((0.1 * k, 0.0, -2.0))
        leaders = np.full((2 if k >= TICKS // 2 else 0, 3), np.nan)
        leaders[:1] = leader
        slots = leader - OFFSETS
        outputs = np.full((2, 2, size(Outcome)), np.nan)
        outputs[0, :, COLUMNS["slot"]], outputs[0, :, COLUMNS["slot_error"]] = slots, errors[k]
        outputs[0, :, SEPARATION] = 0.7 - 0.001 * k
        last = k == ticks - 1
        outputs[0, :, FAILED] = failed if last else 0
        terminated = np.array([last and (failed > 0 or leader_only), True])
        now = np.stack([actions[k], np.full((2, 4), np.nan, dtype=np.float32)])
        living = add_tick(
            tally,
            k + 1,
            live,
            np.array([k + 1 >= trigger, True]),
            leaders,
            outputs,
            np.array([rewards[k], np.nan]),
            terminated,
            np.array([k == TICKS - 1, True]),
            now,
            before,
            OFFSETS,
        )
        assert living == live.sum() == (not last)
        before = now
    tally.ticks[1] = 1  # only to divide by
    return {name: float(column[0]) for name, column in episodes(tally, config).items()}


def test_perfect_flight(config: FormationConfig) -> None:
    figures = fly(config, 0.0)
    assert figures["return"] == figures["reward_since_trigger"] == 1.0
    assert figures["settled"] == 1.0
    for name in ("slot_error_rms", "slot_error_steady", "slot_error_max", "settling_time"):
        assert figures[name] == 0.0
    for name in ("effort", "smoothness", "failed", "trigger_time"):
        assert figures[name] == 0.0
    assert figures["leader_deviation"] == pytest.approx(0.0, abs=1e-12)
    assert figures["follower_deviation"] == pytest.approx(0.0, abs=1e-12)
    assert figures["min_separation"] == pytest.approx(0.7 - 0.001 * (TICKS - 1))


def test_slot_errors(config: FormationConfig) -> None:
    """One follower 0.3 m off in the first half, 0.4 m in the second, the other exact."""
    errors = np.zeros((TICKS, 2, 3))
    errors[: TICKS // 2, 0, 1], errors[TICKS // 2 :, 0, 2] = 0.3, 0.4
    figures = fly(config, errors)
    assert figures["slot_error_rms"] == pytest.approx(sqrt((0.09 + 0.16) / 2 / 2))
    assert figures["slot_error_steady"] == pytest.approx(sqrt(0.16 / 2))
    assert figures["slot_error_max"] == pytest.approx(0.4)
    assert figures["settled"] == 0.0
    assert np.isnan(figures["settling_time"])


def test_settling_counts_from_the_trigger_to_the_last_time_outside(config: FormationConfig) -> None:
    """Trigger at tick 50; outside until tick 80, and once more, by one follower, at tick 120."""
    errors = np.zeros((TICKS, 2, 3))
    errors[:80, :, 0], errors[119, 1, 0] = 1.0, SETTLED + 1e-6
    figures = fly(config, errors, trigger=50)
    assert figures["trigger_time"] == pytest.approx(50 * 0.02)
    assert figures["settled"] == 1.0
    assert figures["settling_time"] == pytest.approx((120 - 50) * 0.02)


@pytest.mark.parametrize(("last", "settled"), [(TICKS - 50, 1.0), (TICKS - 49, 0.0)])
def test_settled_needs_a_second_inside(config: FormationConfig, last: int, settled: float) -> None:
    errors = np.zeros((TICKS, 2, 3))
    errors[:last, 0, 0] = 2 * SETTLED
    assert fly(config, errors)["settled"] == settled


def test_what_was_before_the_trigger_does_not_count(config: FormationConfig) -> None:
    errors, rewards = np.zeros((TICKS, 2, 3)), np.full(TICKS, 0.5)
    errors[:99, :, 0], rewards[:99] = 3.0, 0.1
    figures = fly(config, errors, rewards=rewards, trigger=100)
    assert figures["slot_error_max"] == figures["slot_error_rms"] == 0.0
    assert figures["reward_since_trigger"] == pytest.approx(0.5)
    assert figures["return"] == pytest.approx((99 * 0.1 + 101 * 0.5) / TICKS)


def test_never_triggered_counts_the_whole_episode(config: FormationConfig) -> None:
    figures = fly(config, (2.0, 0.0, 0.0), trigger=TICKS + 1)
    assert figures["slot_error_rms"] == figures["slot_error_max"] == pytest.approx(2.0)
    assert figures["settled"] == 0.0
    assert np.isnan(figures["trigger_time"])
    assert np.isnan(figures["reward_since_trigger"])


def test_distances(config: FormationConfig) -> None:
    """Followers 0.1 m towards each other (they stand side by side): 0.2 m between them; to the leader
    by Pythagoras. Only the second half counts."""
    errors = np.zeros((TICKS, 2, 3))
    errors[TICKS // 2 :, 0, 1], errors[TICKS // 2 :, 1, 1] = -0.1, 0.1
    errors[: TICKS // 2] = 7.0
    figures = fly(config, errors)
    x, y, z = OFFSETS[0]
    assert figures["follower_deviation"] == pytest.approx(0.2)
    expected = sqrt(x * x + y * y + z * z) - sqrt(x * x + (y - 0.1) ** 2 + z * z)
    assert figures["leader_deviation"] == pytest.approx(expected)


def test_effort_is_of_the_action_as_executed(config: FormationConfig) -> None:
    """Entries 3 (clipped to 1), 0, 0, 0 for both followers: mean square 1/4; one change, at the start."""
    figures = fly(config, 0.0, actions=(3.0, 0.0, 0.0, 0.0))
    assert figures["effort"] == pytest.approx(0.25)
    assert figures["smoothness"] == pytest.approx(0.25 / TICKS)


def test_smoothness_is_of_the_change(config: FormationConfig) -> None:
    """One entry of four alternates between 0.5 and -0.5: a change of 1 each tick, 0.5 in the first."""
    actions = np.zeros((TICKS, 2, 4))
    actions[0::2, :, 2], actions[1::2, :, 2] = 0.5, -0.5
    figures = fly(config, 0.0, actions=actions)
    assert figures["effort"] == pytest.approx(0.25 / 4)
    assert figures["smoothness"] == pytest.approx((0.25 + TICKS - 1) / 4 / TICKS)


def test_failure_stops_the_clock_and_misses_the_rest(config: FormationConfig) -> None:
    figures = fly(config, 0.0, ticks=50, failed=COLLISION)
    assert KINDS[int(figures["failure"])] == "collision"
    assert figures["failed"] == 1.0 and figures["settled"] == 0.0
    assert figures["return"] == pytest.approx(50 / TICKS)
    assert np.isnan(figures["slot_error_steady"])
    assert np.isnan(figures["leader_deviation"])


def test_a_crash_of_the_leader_is_nobody_elses(config: FormationConfig) -> None:
    figures = fly(config, 0.0, ticks=50, leader_only=True)
    assert KINDS[int(figures["failure"])] == "leader"


# -- intervals ------------------------------------------------------------------------------------


def test_interval_of_a_mean_is_the_normal_one() -> None:
    """For many samples the bootstrap interval of a mean is mean -+ 1.96 s / sqrt(n)."""
    x = np.random.default_rng(1).normal(3.0, 2.0, 400)
    e = estimate(mean, x)
    half = 1.96 * x.std() / sqrt(len(x))
    assert e.value == pytest.approx(x.mean())
    assert e.low == pytest.approx(x.mean() - half, abs=0.1 * half)
    assert e.high == pytest.approx(x.mean() + half, abs=0.1 * half)


def test_samples_are_resampled_together() -> None:
    """Returns that differ by a constant, seed by seed, have a score without uncertainty.

    With the expert one above hover and the policy half way between, every paired resample gives 1/2;
    were the three resampled apart, the interval would be wider than one.
    """
    hover = np.random.default_rng(2).normal(0.0, 10.0, 50)
    e = estimate(normalised, hover + 0.5, hover, hover + 1.0)
    assert (e.low, e.value, e.high) == pytest.approx((0.5, 0.5, 0.5))


@pytest.mark.filterwarnings("error")
def test_samples_without_spread_and_without_values() -> None:
    assert estimate(mean, np.full(5, 2.0)) == Estimate(2.0, 2.0, 2.0, 5)
    assert estimate(mean, np.array([4.0])) == Estimate(4.0, 4.0, 4.0, 1)
    empty = estimate(mean, np.full(5, np.nan))
    assert empty.episodes == 0 and np.isnan(empty.value)


def test_episodes_without_a_value_are_left_out() -> None:
    e = estimate(mean, np.array([np.nan, 1.0, 3.0, np.nan]))
    assert (e.value, e.episodes) == (2.0, 2)
    assert 1.0 <= e.low < e.high <= 3.0


def test_settling_time_is_a_median() -> None:
    columns = {name: np.array([1.0, 2.0, 30.0]) for name in EPISODE}
    summary = summarise(columns)
    assert summary["settling_time"].value == 2.0
    assert summary["slot_error_rms"].value == 11.0


def test_a_crash_of_the_leader_is_a_failure_of_its_own_kind() -> None:
    """A path that nobody can fly: the leader hits the floor, and no follower is to blame for it."""
    path = splines.waypoints([0, 1, 2], [[0, 0, -1.5], [8, 0, -1.5], [0, 0, -1.5]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        config = configure("nominal", trajectory=path, duration=2.0)
    columns = fly_policy(make_policy("expert", config), range(3))
    assert [KINDS[int(k)] for k in columns["failure"]] == ["leader"] * 3
    assert (columns["failed"] == 1.0).all()
    assert len(set(KINDS)) == len(KINDS)
