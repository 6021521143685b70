"""The metrics on made-up flights whose figures are known, and that a hostile flight gains nothing."""

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
    window_ticks,
)
from baselines.scoring.rollout import fly as fly_policy
from formation_env import SCENARIOS, FormationConfig, configure, splines
from formation_env.memory.records import size
from formation_env.task import COLLISION, COLUMNS, FAILED, SEPARATION, Outcome

TICKS, SKIPPED = 240, 40  # of 0.02 s; the 200 after those that are skipped are scored
SCORED = TICKS - SKIPPED
OFFSETS = np.array(configure("nominal").offsets)
GROUND = configure("paper")  # 15 s to start, then 25 s scored


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
    ticks = most if ticks is None else ticks
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
            most - window_ticks(config),
            window_ticks(config),
            live,
            np.array([k + 1 >= trigger, True]),
            leaders,
            outputs,
            np.array([rewards[k], np.nan]),
            terminated,
            np.array([k == most - 1, True]),
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
def test_the_window_is_the_end_of_the_episode(scenario: str) -> None:
    """Of every scenario 25 s, after the deadline of the start or after 5 s."""
    config = configure(scenario)
    scored = window_ticks(config) * config.control_period
    assert scored == pytest.approx(WINDOW)
    assert config.duration - scored >= (deadline(config) or 5.0)


@pytest.mark.parametrize(("duration", "scored"), [(30.0, 25.0), (12.0, 10.0), (0.02, 0.02)])
def test_of_short_episodes_five_sixths_are_scored(duration: float, scored: float) -> None:
    config = configure("nominal", duration=duration)
    assert window_ticks(config) * config.control_period == pytest.approx(scored)


def test_nothing_before_the_window_is_scored() -> None:
    """Neither when the formation starts nor what is flown until then."""
    window = window_ticks(GROUND)
    errors, rewards = np.full((GROUND.max_steps, 2, 3), 3.0), np.full(GROUND.max_steps, 0.125)
    errors[-window:], rewards[-window:] = 0.0, 0.75
    for trigger in (400, 700, GROUND.max_steps - window):
        figures = fly(GROUND, errors, rewards=rewards, trigger=trigger)
        assert figures["score"] == 0.75
        assert figures["slot_error"] == figures["slot_error_late"] == 0.0
        assert figures["trigger_time"] == pytest.approx(trigger * GROUND.control_period)


def test_ticks_of_the_window_before_the_start_count_as_missing(config: FormationConfig) -> None:
    """And the tick of the start, on which the slots change, is one of them."""
    figures = fly(config, 0.0, trigger=SKIPPED + 80)
    assert figures["score"] == pytest.approx((SCORED - 80) / SCORED)
    assert figures["slot_error"] == pytest.approx(CAP * sqrt(80 / SCORED))
    assert figures["slot_error_late"] == 0.0


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
        ticks = GROUND.max_steps - round((WINDOW - flown) / GROUND.control_period)
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


@pytest.mark.parametrize("delay", [1, 300, 749, 1200])
def test_starting_later_never_scores_more(delay: int) -> None:
    """Of a flight that goes as well at every moment, whenever it has started."""
    flight = 0.5 + 0.5 * np.random.default_rng(0).random(GROUND.max_steps)
    ticks = np.arange(GROUND.max_steps)
    soon, late = (
        fly(GROUND, 0.0, rewards=np.where(ticks < k, 0.0, flight), trigger=k)
        for k in (1, delay + 1)
    )
    assert late["score"] <= soon["score"]
    assert (late["score"] < soon["score"]) == (delay + 1 > GROUND.max_steps - window_ticks(GROUND))
    assert late["return"] < soon["return"]
    assert late["trigger_time"] > soon["trigger_time"]


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


# -- hostile flights ------------------------------------------------------------------------------


class Hostile:
    """A policy, but from some time after the trigger without thrust, beside its slot, or late to start.

    Late means that the first follower holds 0.3 m off where it should wait, `late` s long.
    """

    def __init__(
        self,
        config: FormationConfig,
        cut: float = np.inf,
        aside: tuple[float, ...] = (0, 0, 0),
        late: float = 0.0,
        policy: str = "ff",
    ) -> None:
        self.config, self._policy = config, make_policy(policy, config)
        self._cut, self._aside, self._late = cut, np.array(aside), late
        self._slices = config.layout.slices

    def reset(self, seed: int | None = None, worlds: int = 1) -> None:
        self._policy.reset(seed=seed, worlds=worlds)
        self._since, self._time = np.zeros(worlds), 0.0

    def act(self, rows: Any) -> Any:
        moved = rows.copy()
        moved[..., self._slices["slot_error"]] += self._aside
        waiting = rows[:, 0, self._slices["started"].start] == 0.0
        if self._time < self._late:
            moved[waiting, 0, self._slices["slot_error"].start] -= 0.3
        self._time += self.config.control_period
        actions = self._policy.act(moved)
        self._since += self.config.control_period * rows[:, 0, self._slices["started"].start]
        actions[self._since > self._cut] = (-1.0, 0.0, 0.0, 0.0)
        return actions


@pytest.mark.parametrize("scenario", ["nominal", "paper"])
def test_hostile_flights_score_less_than_flying_on(scenario: str) -> None:
    """On every seed, and all figures beside the score say so too."""
    config = configure(scenario)
    honest = fly_policy(Hostile(config), range(6))  # type: ignore[arg-type]
    for hostile in (
        Hostile(config, cut=10.0),
        Hostile(config, cut=24.0),
        Hostile(config, aside=(0.1, 0.0, 0.0)),
        Hostile(config, aside=(0.0, 0.0, 0.35)),
    ):
        columns = fly_policy(hostile, range(6))  # type: ignore[arg-type]
        assert (columns["score"] < honest["score"]).all()
        assert (columns["slot_error"] > honest["slot_error"]).all()
        assert (columns["slot_error_late"] > honest["slot_error_late"]).all()
        if hostile._cut < np.inf:
            assert (columns["failed"] == 1.0).all()


def test_waiting_for_the_leader_to_calm_down_does_not_pay() -> None:
    """Where the window began with the start, this raised the score of `ff-filter` by 0.012.

    Another part of the path and other noise are scored, which over 60 seeds makes 0.003 either way.
    """
    config = configure("paper")
    soon, late = (
        fly_policy(Hostile(config, late=wait, policy="ff-filter"), range(60))  # type: ignore[arg-type]
        for wait in (0.0, 13.5)
    )
    assert late["trigger_time"].mean() > soon["trigger_time"].mean() + 4.0
    assert late["score"].mean() < soon["score"].mean() + 0.005
    assert late["return"].mean() < soon["return"].mean()
