"""The metrics on made-up flights whose figures are known."""

from __future__ import annotations

import warnings
from math import sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baselines.registry import make_policy
from baselines.scoring.metrics import (
    CAP,
    KINDS,
    SETTLED,
    WINDOW,
    add_tick,
    begin,
    deadline,
    episodes,
    flight_ticks,
    window_ticks,
)
from baselines.scoring.rollout import fly as fly_policy
from formation_env import SCENARIOS, FormationConfig, configure, splines
from formation_env.memory.records import size
from formation_env.task import COLLISION, COLUMNS, FAILED, SEPARATION, Outcome

TICKS, SKIPPED = 240, 40  # of 0.02 s; the 200 after those that are skipped are scored
SCORED = TICKS - SKIPPED
OFFSETS = np.array(configure("nominal").offsets)
GROUND = configure("paper")  # 15 s to start, then 30 s of which 25 are scored


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
    ticks: int | None = None,
    failed: int = 0,
    leader_only: bool = False,
) -> dict[str, float]:
    """The figures of one world in which follower i is displaced from its slot by `errors[tick, i]`.

    The leader moves along x; a second, dead world flies beside it and must not be counted. The episode ends
    after `ticks`, in a failure if one is given.
    """
    most = config.max_steps
    ticks = min(most, trigger + flight_ticks(config)) if ticks is None else ticks
    errors = np.broadcast_to(errors, (most, 2, 3)).astype(float)
    rewards = np.broadcast_to(rewards, most)
    actions = np.broadcast_to(np.asarray(actions, dtype=np.float32), (most, 2, 4))
    tally = begin(np.array([trigger == 0, True]))
    before = np.zeros((2, 2, 4), dtype=np.float32)
    live = np.array([True, False])
    for k in range(ticks):
        leader = np.array((0.1 * k, 0.0, -2.0))
        leaders = np.full((2, 3), np.nan)
        leaders[:1] = leader
        slots = leader - OFFSETS
        outputs = np.full((2, 2, size(Outcome)), np.nan)
        outputs[0, :, COLUMNS["slot"]], outputs[0, :, COLUMNS["slot_error"]] = slots, errors[k]
        outputs[0, :, SEPARATION] = 0.7 - 0.0001 * k
        last = k == ticks - 1
        outputs[0, :, FAILED] = failed if last else 0
        terminated = np.array([last and (failed > 0 or leader_only), True])
        now = np.stack([actions[k], np.full((2, 4), np.nan, dtype=np.float32)])
        living = add_tick(
            tally,
            k + 1,
            flight_ticks(config) - window_ticks(config),
            window_ticks(config),
            live,
            np.array([k + 1 >= trigger, True]),
            leaders,
            outputs,
            np.array([rewards[k], np.nan]),
            terminated,
            np.array([last, True]),
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
    assert figures["score"] == figures["settled"] == 1.0 and figures["return"] == TICKS
    for name in ("slot_error", "slot_error_late", "settling_time"):
        assert figures[name] == 0.0
    for name in ("effort", "smoothness", "failed", "trigger_time"):
        assert figures[name] == 0.0
    assert figures["leader_deviation"] == pytest.approx(0.0, abs=1e-12)
    assert figures["follower_deviation"] == pytest.approx(0.0, abs=1e-12)
    assert figures["min_separation"] == pytest.approx(0.7 - 0.0001 * (TICKS - 1))


def test_slot_errors(config: FormationConfig) -> None:
    """One follower 0.3 m off in the window's first half, 0.4 m in the second, the other exact."""
    errors = np.zeros((TICKS, 2, 3))
    half = SKIPPED + SCORED // 2
    errors[:half, 0, 1], errors[half:, 0, 2] = 0.3, 0.4
    figures = fly(config, errors)
    assert figures["slot_error"] == pytest.approx(sqrt((0.09 + 0.16) / 2 / 2))
    assert figures["slot_error_late"] == pytest.approx(sqrt(0.16 / 2))
    assert figures["settled"] == 0.0
    assert np.isnan(figures["settling_time"])


def test_a_slot_error_counts_at_most_the_cap(config: FormationConfig) -> None:
    """One follower lost at 7 m, the other exact: as if 1 m off; not a number counts as lost."""
    errors = np.zeros((TICKS, 2, 3))
    for far in (7.0, np.nan):
        errors[:, 0, 0] = far
        assert fly(config, errors)["slot_error"] == pytest.approx(CAP / sqrt(2.0))


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


def test_distances(config: FormationConfig) -> None:
    """Followers 0.1 m towards each other (they stand side by side): 0.2 m between them; to the leader
    by Pythagoras. Only the window's second half counts."""
    errors = np.zeros((TICKS, 2, 3))
    half = SKIPPED + SCORED // 2
    errors[half:, 0, 1], errors[half:, 1, 1] = -0.1, 0.1
    errors[:half] = 7.0
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
    """Exact for 89 ticks, a collision on the 90th, which counts as those that are missing."""
    figures = fly(config, 0.0, ticks=90, failed=COLLISION)
    assert KINDS[int(figures["failure"])] == "collision"
    assert figures["failed"] == 1.0 and figures["settled"] == 0.0
    assert figures["return"] == pytest.approx(90)
    assert figures["score"] == pytest.approx(49 / SCORED)
    assert figures["slot_error"] == pytest.approx(sqrt(CAP**2 * (SCORED - 49) / SCORED))
    assert figures["slot_error_late"] == CAP
    assert np.isnan(figures["leader_deviation"])


def test_a_crash_of_the_leader_is_nobody_elses(config: FormationConfig) -> None:
    figures = fly(config, 0.0, ticks=90, leader_only=True)
    assert KINDS[int(figures["failure"])] == "leader"
    assert figures["score"] == pytest.approx(49 / SCORED)


# -- the window -----------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_window_is_the_end_of_every_flight(scenario: str) -> None:
    """Of every scenario 25 s, 5 s or more after the start; a flight that starts at the deadline fits."""
    config = configure(scenario)
    scored, flight = (
        ticks(config) * config.control_period for ticks in (window_ticks, flight_ticks)
    )
    assert scored == pytest.approx(WINDOW)
    assert flight - scored >= 5.0 - 1e-9
    assert deadline(config) + flight == pytest.approx(config.duration)


@pytest.mark.parametrize(
    ("duration", "flight"), [(45.0, 30.0), (60.0, 45.0), (30.0, 20.0), (12.0, 8.0)]
)
def test_of_a_short_episode_a_third_is_for_the_wait(duration: float, flight: float) -> None:
    config = configure("paper", duration=duration)
    assert flight_ticks(config) * 0.02 == pytest.approx(flight)
    assert window_ticks(config) * 0.02 == pytest.approx(min(WINDOW, flight * 5.0 / 6.0), abs=0.01)
    assert deadline(config) == min(15.0, duration)


@pytest.mark.parametrize(("duration", "scored"), [(30.0, 25.0), (12.0, 10.0), (0.02, 0.02)])
def test_of_short_episodes_five_sixths_are_scored(duration: float, scored: float) -> None:
    config = configure("nominal", duration=duration)
    assert window_ticks(config) * config.control_period == pytest.approx(scored)


def test_nothing_before_the_window_is_scored_and_nothing_is_flown_after_it() -> None:
    window, flight = window_ticks(GROUND), flight_ticks(GROUND)
    for trigger in (400, 700, GROUND.max_steps - flight):
        errors = np.full((GROUND.max_steps, 2, 3), 3.0)
        rewards = np.full(GROUND.max_steps, 0.125)
        end = trigger + flight
        errors[end - window : end], rewards[end - window : end] = 0.0, 0.75
        figures = fly(GROUND, errors, rewards=rewards, trigger=trigger)  # up to `end`
        assert figures["score"] == 0.75
        assert figures["slot_error"] == figures["slot_error_late"] == 0.0
        assert figures["trigger_time"] == pytest.approx(trigger * GROUND.control_period)


def test_a_flight_that_is_over_is_flown_no_further() -> None:
    """Each world ends with its own flight, before the time limit."""
    config, live_ticks = configure("paper", duration=30.0), np.zeros(3)

    def count(_: Any, live: Any, __: Any) -> None:
        live_ticks[:] += live

    columns = fly_policy(make_policy("ff", config), range(3), watch=count)
    ends = columns["trigger_time"] / config.control_period + flight_ticks(config)
    assert live_ticks == pytest.approx(ends)
    assert (live_ticks < config.max_steps).all() and not columns["failed"].any()


def test_ticks_of_the_window_that_a_limit_cuts_off_count_as_missing(
    config: FormationConfig,
) -> None:
    """The tick of the start, on which the slots change, is none of the flight's."""
    figures = fly(config, 0.0, trigger=80)
    assert figures["score"] == pytest.approx((SCORED - 80) / SCORED)
    assert figures["slot_error"] == pytest.approx(CAP * sqrt(80 / SCORED))
    assert figures["slot_error_late"] == pytest.approx(CAP * sqrt(80 / (SCORED / 2)))


def test_rewards_count_between_0_and_1(config: FormationConfig) -> None:
    rewards = np.where(np.arange(TICKS) % 2 == 0, -3.0, 5.0)
    assert fly(config, 0.0, rewards=rewards)["score"] == pytest.approx(0.5)


def test_never_started_is_the_worst_and_has_figures() -> None:
    figures = fly(GROUND, 0.0, trigger=GROUND.max_steps + 1)
    assert figures["score"] == 0.0
    assert figures["slot_error"] == figures["slot_error_late"] == CAP
    assert figures["trigger_time"] == deadline(GROUND)
    assert figures["settled"] == 0.0
    assert np.isfinite([figures[name] for name in ("score", "slot_error", "trigger_time")]).all()


def test_a_crash_scores_the_share_of_the_window_that_was_flown() -> None:
    """It scored 0.916 where the mean was over the ticks flown, and all where the window was over."""
    for flown in (10.0, 24.9):
        ticks = 300 + flight_ticks(GROUND) - round((WINDOW - flown) / GROUND.control_period)
        figures = fly(GROUND, 0.0, trigger=300, ticks=ticks, failed=COLLISION)
        assert figures["score"] == pytest.approx((flown - GROUND.control_period) / WINDOW, abs=1e-9)
        assert figures["slot_error_late"] > 0.0


@given(st.integers(1, TICKS - 1), st.floats(0.0, 1.0), st.integers(0, 2**32))
def test_ending_early_never_scores_more(cut: int, level: float, seed: int) -> None:
    """Whatever is earned until then, and whatever would have been later."""
    config = configure("nominal", duration=TICKS * 0.02)
    rewards = np.random.default_rng(seed).normal(level, 0.3, TICKS)
    on, off = (
        fly(config, 0.01, rewards=rewards, ticks=ticks, failed=failed)
        for ticks, failed in ((TICKS, 0), (cut, COLLISION))
    )
    assert off["score"] <= on["score"]
    assert off["slot_error"] >= on["slot_error"]


@pytest.mark.parametrize("flown", [None, 200, 600, 1400])
@pytest.mark.parametrize("delay", [1, 300, 749])
def test_the_same_flight_scores_the_same_whenever_it_starts(delay: int, flown: int | None) -> None:
    """To its end, or to a crash, which a wait would put off where the window were not of the flight."""
    flight = 0.5 + 0.5 * np.random.default_rng(0).random(GROUND.max_steps)
    ticks = np.arange(GROUND.max_steps)
    soon, late = (
        fly(
            GROUND,
            0.0,
            rewards=np.where(ticks < k, 0.0, np.roll(flight, k)),
            trigger=k,
            ticks=None if flown is None else k + flown,
            failed=0 if flown is None else COLLISION,
        )
        for k in (1, delay + 1)
    )
    assert late["score"] == pytest.approx(soon["score"], rel=1e-12)
    assert late["return"] == pytest.approx(soon["return"], rel=1e-12)
    assert late["trigger_time"] > soon["trigger_time"]
    assert late["slot_error"] == soon["slot_error"]


def test_a_crash_of_the_leader_is_a_failure_of_its_own_kind() -> None:
    """A path that cannot be flown: the leader hits the floor, and no follower has failed by itself."""
    path = splines.waypoints([0, 1, 2], [[0, 0, -1.5], [8, 0, -1.5], [0, 0, -1.5]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        config = configure("nominal", trajectory=path, duration=2.0)
    columns = fly_policy(make_policy("expert", config), range(3))
    assert [KINDS[int(k)] for k in columns["failure"]] == ["leader"] * 3
    assert (columns["failed"] == 1.0).all()
    assert len(set(KINDS)) == len(KINDS)
