"""The loops of slots, separations, rewards and observations, against NumPy and one follower alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from states import filled, lane_of, line, measured_in, tile

from formation_env import Limits, Rewards, task
from formation_env.core import judging
from formation_env.core.arrays import Candidate, Counters, Squares, Tally, Touch, Verdict, rows
from formation_env.core.flight import Position
from formation_env.laws.levels import (
    Follower,
)
from formation_env.laws.slots import advance_heading
from formation_env.laws.world import Action
from formation_env.memory.records import LANES, bounds, flatten, size
from formation_env.physics.sensors import Measured
from formation_env.task import LEADER, NO_FAILURE, Neighbour, Observation, Outcome, Terms

Floats = npt.NDArray[np.float64]
Vector3 = Position  # a record of one vector


def drawn(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def flags(draw: np.random.Generator) -> Floats:
    """Zeros and ones, a lane each."""
    return draw.integers(0, 2, LANES).astype(np.float64)


def counted(tick: Any, over: Any) -> Any:
    """`Counters` in all lanes."""
    x = tile(Counters, np.int64)
    rows(x, Counters)["tick"][:], rows(x, Counters)["over"][:] = tick, over
    return x


# -- slots, separations and neighbours ------------------------------------------------------------------


def test_where_the_truth_is_measured_both_headings_are_that_of_the_truth() -> None:
    draw = drawn(3)
    x, leader, before = filled(Follower, draw), filled(Measured, draw), draw.normal(size=2 * LANES)
    rows(x, Follower)["estimate"][:] = rows(x, Follower)["heading"]
    moving, both = flags(draw), x.copy()
    judging.turn_headings(before, leader, before, leader, both, moving, -0.4, 0.02)
    once = x.copy()
    judging.turn_headings_exactly(before, leader, once, moving, -0.4, 0.02)
    np.testing.assert_array_equal(once, both)
    turned = rows((once != x).astype(float), Follower)
    for name in ("heading", "estimate"):
        np.testing.assert_array_equal(turned[name].any(axis=0), moving > 0.0)
    assert not turned["previous"].any()


def test_the_slot_turns_by_the_true_motion_and_the_estimate_by_the_measured() -> None:
    draw, d_x, h = drawn(13), -0.4, 0.02
    x, leader, told = filled(Follower, draw), filled(Measured, draw), filled(Measured, draw)
    before, told_before = draw.normal(size=(2, 2 * LANES))
    moving, was = flags(draw), x.copy()
    judging.turn_headings(before, leader, told_before, told, x, moving, d_x, h)
    for lane in range(LANES):
        old, new = lane_of(was, Follower, lane), lane_of(x, Follower, lane)
        for name, then, now in (("heading", before, leader), ("estimate", told_before, told)):
            v0 = complex(*then.reshape(2, LANES)[:, lane])
            v1 = complex(*measured_in(now, lane).v[:2])
            R = advance_heading(complex(*old[name]), v0, v1, d_x, h)
            expected = R if moving[lane] else complex(*old[name])
            np.testing.assert_allclose(complex(*new[name]), expected, rtol=1e-13)
        assert new["previous"] == old["previous"]


def test_the_leader_is_the_first_that_a_follower_may_be_near() -> None:
    draw = drawn(4)
    x, leader, own = filled(Follower, draw), filled(Measured, draw), filled(Measured, draw)
    begin, started = draw.normal(size=(3, LANES)), flags(draw)
    outcome, squares = tile(Outcome), tile(Squares)
    d = np.array([0.3, -0.2, 0.1])
    judging.locate(started, x, leader, begin.ravel(), own, d, outcome, squares)
    place, mine = rows(leader, Measured)["p"], rows(own, Measured)["p"]
    found = rows(squares, Squares)
    apart = ((mine - place) ** 2).sum(axis=0)
    np.testing.assert_allclose(found["separation"][0], apart, rtol=1e-14)
    # The slot is at the leader, or where it will start from: the offset's length away.
    slots = rows(outcome, Outcome)["slot"]
    anchor = np.where(started, place, begin)
    np.testing.assert_allclose(((slots - anchor) ** 2).sum(axis=0), 0.09 + 0.04 + 0.01)
    R = rows(x, Follower)["heading"]
    np.testing.assert_allclose(
        anchor - slots, [R[0] * 0.3 + R[1] * 0.2, R[1] * 0.3 - R[0] * 0.2, np.full(LANES, 0.1)],
        rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose(rows(outcome, Outcome)["slot_error"], slots - mine, atol=1e-14)
    error = ((slots - mine) ** 2).sum(axis=0)
    np.testing.assert_allclose(found["error"][0], error, rtol=1e-14)


def test_the_nearest_other_vehicle_is_kept() -> None:
    draw = drawn(8)
    one, otfastest = filled(Measured, draw), [filled(Measured, draw) for _ in range(4)]
    squares, outcome = tile(Squares), np.full(size(Outcome) * LANES, 7.0)
    rows(squares, Squares)["separation"][:], rows(squares, Squares)["error"][:] = 4.0, 9.0
    for other in otfastest:
        judging.approach(one, other, squares)
    p = [rows(x, Measured)["p"] for x in (one, *otfastest)]
    least = np.min([((p[0] - q) ** 2).sum(axis=0) for q in p[1:]] + [np.full(LANES, 4.0)], axis=0)
    np.testing.assert_allclose(rows(squares, Squares)["separation"][0], least, rtol=1e-14)
    assert (rows(squares, Squares)["error"] == 9.0).all()
    judging.separate(squares, outcome)
    np.testing.assert_allclose(rows(outcome, Outcome)["separation"][0], np.sqrt(least))
    assert (outcome == 7.0).sum() == (size(Outcome) - 1) * LANES


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_the_nearest_are_kept_in_order_and_the_smaller_number_first(ranks: int) -> None:
    draw = drawn(2)
    places = draw.integers(0, 3, (8, 3, LANES)).astype(np.float64)  # many are equally far
    own, *otfastest = (tile(Measured) for _ in range(8))
    for x, place in zip((own, *otfastest), places, strict=True):
        rows(x, Measured)["p"][:] = place
    nearest, candidate = [tile(Candidate) for _ in range(3)], tile(Candidate)
    for held in nearest:
        judging.clear_candidate(held)
    for j, other in enumerate(otfastest):
        if ranks > 1:
            judging.insert_two(other, own, float(j), nearest[0], nearest[1], candidate)
        else:
            judging.measure(other, own, float(j), candidate)
            judging.insert(candidate, nearest[0])
        for held in nearest[2:ranks]:
            judging.insert(candidate, held)
    squares = ((places[1:] - places[0]) ** 2).sum(axis=1)
    order = np.argsort(squares, axis=0, kind="stable")[:ranks]
    found = [rows(held, Candidate) for held in nearest[:ranks]]
    np.testing.assert_array_equal([one["number"][0] for one in found], order)
    expected = np.take_along_axis(squares, order, axis=0)
    np.testing.assert_array_equal([one["square"][0] for one in found], expected)


@pytest.mark.parametrize("kept", [1, 2, 4])
def test_few_are_ordered_by_distance_and_number_too(kept: int) -> None:
    """Small whole distances: nearly always some are equal, and one held is moved down the list."""
    distances = drawn(6).integers(0, 4, (9, LANES)).astype(np.float64)
    nearest, candidate = [tile(Candidate) for _ in range(kept)], tile(Candidate)
    for held in nearest:
        judging.clear_candidate(held)
        assert np.isinf(rows(held, Candidate)["square"]).all()
        assert (rows(held, Candidate)["number"] == -1.0).all()
    for number, row in enumerate(distances):
        rows(candidate, Candidate)["square"][:] = row
        rows(candidate, Candidate)["number"][:] = number
        for held in nearest:
            judging.insert(candidate, held)
    for lane in range(LANES):
        expected = sorted(range(9), key=lambda j: (distances[j, lane], j))[:kept]
        assert [rows(one, Candidate)["number"][0, lane] for one in nearest] == expected


# -- what the followers are shown and paid ------------------------------------------------------------------

LIMITS = Limits(collision=0.2, impact=1.0, tilt=0.5, lost=10.0)
REWARDS = Rewards(0.3, 0.05, waiting=0.02, effort=0.05, smoothness=0.07, failure=10.0)


def true_error(squares: Any, own: Any, leader: Any) -> float:
    """m; not a number where the state of one of the two is unsound."""
    unsound = np.isinf(own["speed"]) or np.isinf(leader["speed"])
    return float(np.nan if unsound else np.sqrt(squares["error"]))


def touches(draw: np.random.Generator) -> Floats:
    """Touch-downs of all sizes, some of vehicles whose state is unsound."""
    touch = tile(Touch)
    rows(touch, Touch)["speed"][:] = draw.choice([0.0, 0.5, 2.0], LANES)
    rows(touch, Touch)["uprightness"][:] = draw.choice([0.2, 1.0], LANES)
    return touch


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
def test_followers_fail_as_one_alone() -> None:
    """Separation and failure where the world steps; of the world the largest, and whether one failed."""
    seen = set()
    for seed in range(24):
        draw = drawn(seed)
        active, started, left = flags(draw), flags(draw), draw.choice([0.0, 1.0, 20.0], LANES)
        squares = draw.choice([0.01, 0.03, 1.0, 400.0], size(Squares) * LANES)
        touch, leader = touches(draw), touches(draw)
        rows(leader, Touch)["speed"][:, ::7] = np.inf
        tally, outcome = tile(Tally), np.full(size(Outcome) * LANES, 7.0)
        rows(tally, Tally)["failed"][:] = draw.choice([0.0, 0.5], LANES)
        rows(tally, Tally)["paid"][:] = flags(draw)
        before, untouched = tally.copy(), outcome.copy()
        judging.fail(active, started, left, squares, touch, leader, tally, line(LIMITS), outcome)
        for lane in range(LANES):
            apart, own = lane_of(squares, Squares, lane), lane_of(touch, Touch, lane)
            fastest = lane_of(leader, Touch, lane)
            error, separation = true_error(apart, own, fastest), np.sqrt(apart["separation"])
            late = bool(started[lane] == 0.0 and left[lane] == 0.0)
            why = task.failure(separation, own["speed"], own["uprightness"], error, late, LIMITS)
            on = bool(active[lane])
            failed = on and why != NO_FAILURE
            if why == NO_FAILURE and fastest["speed"] > LIMITS.impact:
                why = LEADER
            found = lane_of(outcome, Outcome, lane)
            np.testing.assert_allclose(found["separation"], separation)
            assert found["failed"] == (why if on else 0.0)
            old, new = lane_of(before, Tally, lane), lane_of(tally, Tally, lane)
            assert new["failed"] == max(old["failed"], found["failed"])
            assert new["paid"] == float(old["paid"] or failed)
            assert new["reward"] == old["reward"] == 0.0
            seen |= {(why, on)}
        for name in set(Outcome._fields) - {"separation", "failed"}:
            np.testing.assert_array_equal(
                rows(outcome, Outcome)[name], rows(untouched, Outcome)[name]
            )
    assert len(seen) == 12  # each way to fail and none, in worlds that step and in others


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
def test_followers_are_paid_as_one_alone() -> None:
    """Reward and the next previous action where the world steps; sums in the order of followers.

    What one of the world has failed in costs each of them.
    """
    seen = set()
    for seed in range(12):
        draw = drawn(seed)
        active, started, left = flags(draw), flags(draw), draw.choice([0.0, 30.0], LANES)
        squares = draw.choice([0.01, 0.03, 1.0, 400.0], size(Squares) * LANES)
        touch, leader = touches(draw), touches(draw)
        rows(leader, Touch)["speed"][:, ::7] = np.inf
        action, x = draw.uniform(-1.0, 1.0, size(Action) * LANES), filled(Follower, draw)
        tally, outcome = (
            np.abs(draw.normal(size=size(Tally) * LANES)),
            np.full(size(Outcome) * LANES, 7.0),
        )
        rows(tally, Tally)["paid"][:] = flags(draw)
        was, sums = x.copy(), tally.copy()
        weights = 3, line(REWARDS)
        judging.pay(
            active, started, left, squares, touch, leader, action, x, tally, *weights, outcome
        )
        for lane in range(LANES):
            apart, own = lane_of(squares, Squares, lane), lane_of(touch, Touch, lane)
            error, a = (
                true_error(apart, own, lane_of(leader, Touch, lane)),
                action.reshape(-1, LANES),
            )
            old, new = lane_of(sums, Tally, lane), lane_of(tally, Tally, lane)
            before = lane_of(was, Follower, lane)
            previous, a = before["previous"], action.reshape(-1, LANES)[:, lane]
            on, going, failed = bool(active[lane]), bool(started[lane]), bool(old["paid"])
            terms = task.reward(going, left[lane], error, tuple(a), previous, 3, failed, REWARDS)
            found, after = lane_of(outcome, Outcome, lane), lane_of(x, Follower, lane)
            np.testing.assert_allclose(
                found["terms"], terms if on else np.zeros(len(terms)), atol=1e-14
            )
            np.testing.assert_allclose(found["reward"], sum(terms) if on else 0.0, atol=1e-14)
            assert found["separation"] == found["failed"] == 7.0
            assert found["slot"] == found["slot_error"] == (7.0, 7.0, 7.0)
            assert after["previous"] == (tuple(a) if on else previous)
            assert (after["heading"], after["estimate"]) == (before["heading"], before["estimate"])
            np.testing.assert_allclose(new["reward"], old["reward"] + found["reward"])
            assert (new["failed"], new["paid"]) == (old["failed"], old["paid"])
            seen |= {(on, going, failed, bool(np.isnan(error)))}
    assert len(seen) == 16


def test_a_reward_is_the_sum_of_its_terms() -> None:
    terms = Terms(*(2.0**k for k in range(len(Terms._fields))))
    assert judging.total_of_terms(terms) == sum(terms)
    other = Terms(*[-1.0] * len(terms))
    assert judging.choose_terms(True, terms, other) == terms
    assert judging.choose_terms(False, terms, other) == other


def test_observations_are_those_of_one_follower_within_bounds() -> None:
    draw = drawn(9)
    x, leader, own = filled(Follower, draw), 60.0 * filled(Measured, draw), filled(Measured, draw)
    started, begin = flags(draw), filled(Vector3, draw)
    d, seen = np.array([0.3, -0.2, 0.1]), tile(Observation, np.float32)
    judging.show(started, x, leader, begin, own, d, seen)
    limits, clipped = np.array(bounds(Observation)), 0
    for lane in range(LANES):
        known, m = lane_of(x, Follower, lane), measured_in(leader, lane)
        anchor = m.p if started[lane] else lane_of(begin, Vector3, lane)["p"]
        expected = flatten(
            task.observe(
                measured_in(own, lane), m, anchor, complex(*known["estimate"]), tuple(d),
                known["previous"], bool(started[lane]),
            )
        )  # fmt: skip
        clipped += int((np.abs(expected) > limits).sum())
        found = seen.reshape(-1, LANES)[:, lane]
        np.testing.assert_allclose(found, np.clip(expected, -limits, limits), 2e-6, 1e-6)
    assert clipped > 0


def test_neighbours_are_shown_as_one_sees_them_and_zero_where_there_is_none() -> None:
    draw = drawn(10)
    x, own, other = filled(Follower, draw), filled(Measured, draw), filled(task.Passing, draw)
    number, seen = draw.integers(-1, 2, LANES).astype(float), tile(Neighbour, np.float32)
    rows(other, task.Passing)["v"][0, :4] = 1e6
    judging.show_neighbour(number, x, own, other, seen)
    for lane in range(LANES):
        R = complex(*lane_of(x, Follower, lane)["estimate"])
        m = measured_in(own, lane)
        there = task.Passing(**lane_of(other, task.Passing, lane))
        on = bool(number[lane] >= 0.0)
        expected = np.array(flatten(task.observe_neighbour(task.Passing(m.p, m.v), there, R, on)))
        limits = np.array(bounds(Neighbour))
        found = seen.reshape(-1, LANES)[:, lane]
        np.testing.assert_allclose(found, np.clip(expected, -limits, limits), 2e-6, 1e-6)
        assert on or not np.any(found)


# -- the end of an episode ---------------------------------------------------------------------------------


def test_an_episode_ends_by_a_failure_an_impact_of_the_leader_or_in_time() -> None:
    for seed in range(20):
        draw = drawn(seed)
        active, failed, total = flags(draw), flags(draw), draw.normal(size=LANES)
        impacts, tick = draw.uniform(0.0, 2.0, LANES), draw.integers(8, 13, LANES)
        before = draw.integers(0, 2, LANES)
        counters, verdict = counted(tick, before), tile(Verdict)
        tally, leader = tile(Tally), tile(Touch)
        rows(tally, Tally)["reward"][:], rows(tally, Tally)["failed"][:] = total, failed
        rows(leader, Touch)["speed"][:] = impacts
        judging.conclude(counters, tally, leader, active, 4.0, line(LIMITS), 10, verdict)
        on = active > 0.0
        ended = on & ((failed > 0.0) | (impacts > 1.0))
        late = on & (tick >= 10)
        over = np.where(on, ended | late, before)
        np.testing.assert_array_equal(counters, counted(tick, over))
        found = rows(verdict, Verdict)
        np.testing.assert_array_equal(found["reward"], [total / 4.0])
        np.testing.assert_array_equal(found["terminated"], [ended])
        np.testing.assert_array_equal(found["truncated"], [late])
