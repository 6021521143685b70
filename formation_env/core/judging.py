"""The loops that say where followers should be, who is near, what is shown and what is paid.

As in `flight`, one statement for each loop, from the law of one follower in one world.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from formation_env._jit import device
from formation_env.core.arrays import Candidate, Counters, Squares, Tally, Touch, Verdict
from formation_env.core.flight import Hardest, Position, Velocity
from formation_env.laws.levels import Estimate, Follower
from formation_env.laws.slots import advance_heading
from formation_env.laws.slots import slot as slot_of
from formation_env.laws.world import Action
from formation_env.maths.so3 import ZERO, Vector, dot, pick, pick_vector, sub
from formation_env.memory.records import bounds, chooser, total
from formation_env.memory.tiles import over_lanes
from formation_env.physics.sensors import Measured
from formation_env.task import (
    LEADER,
    NO_FAILURE,
    Limits,
    Neighbour,
    Observation,
    Outcome,
    Passing,
    Rewards,
    Terms,
    failure,
    observe,
    observe_neighbour,
    reward,
)

choose_terms, total_of_terms = chooser(Terms), total(Terms)
_choose_action = chooser(Action)

# -- slots ---------------------------------------------------------------------------------------------------


class Headings(NamedTuple):
    """A part of a follower's rows."""

    heading: complex
    estimate: complex


@device
def next_headings(
    before: complex,
    leader: Velocity,
    measured_before: complex,
    measured: Velocity,
    x: Headings,
    moving: bool,
    d_x: float,
    h: float,
) -> Headings:
    """The slot's heading follows the leader's true motion, the estimate the measured one (23)."""
    v, w = complex(leader.v[0], leader.v[1]), complex(measured.v[0], measured.v[1])
    return Headings(
        advance_heading(x.heading, before, v, d_x, h),
        advance_heading(x.estimate, measured_before, w, d_x, h),
    )


@device
def next_headings_exactly(
    before: complex, leader: Velocity, x: Headings, moving: bool, d_x: float, h: float
) -> Headings:
    """The same where the true motion is what is measured."""
    v = complex(leader.v[0], leader.v[1])
    R = advance_heading(x.heading, before, v, d_x, h)
    return Headings(R, R)


turn_headings = over_lanes(
    next_headings,
    into=("x",),
    uniform=("d_x", "h"),
    keep="moving",
    x=Follower,
    leader=Measured,
    measured=Measured,
)
turn_headings_exactly = over_lanes(
    next_headings_exactly,
    into=("x",),
    uniform=("d_x", "h"),
    keep="moving",
    x=Follower,
    leader=Measured,
)


class Heading(NamedTuple):
    """A part of a follower's rows."""

    heading: complex


class Target(NamedTuple):
    """A part of `Outcome`."""

    slot: Vector
    slot_error: Vector


@device
def place(
    started: bool, x: Heading, leader: Position, begin: Vector, own: Position, d: Vector
) -> tuple[Target, Squares]:
    """Slot and slot error; of the other vehicles the leader is the nearest yet.

    Before the start the slot is that of the leader's first reference point `begin`.
    """
    p_L = pick_vector(started, leader.p, begin)
    target = slot_of(x.heading, p_L, ZERO, d)
    error, apart = sub(target.p, own.p), sub(own.p, leader.p)
    return Target(target.p, error), Squares(dot(error, error), dot(apart, apart))


locate = over_lanes(
    place,
    into=("outcome", "squares"),
    uniform=("d",),
    x=Follower,
    leader=Measured,
    own=Measured,
    outcome=Outcome,
)

# -- separations and neighbours --------------------------------------------------------------------------


class Separation(NamedTuple):
    """A part of `Squares` and of `Outcome`."""

    separation: float


@device
def nearer(one: Position, other: Position, squares: Separation) -> Separation:
    """The least squared distance yet between vehicle `one` and the others."""
    e = sub(one.p, other.p)
    return Separation(min(squares.separation, dot(e, e)))


approach = over_lanes(nearer, into=("squares",), one=Measured, other=Measured, squares=Squares)


@device
def distance_of(squares: Separation) -> Separation:
    """The distance to the nearest other vehicle, from its square."""
    return Separation(sqrt(squares.separation))


separate = over_lanes(distance_of, into=("outcome",), squares=Squares, outcome=Outcome)


@device
def no_candidate() -> Candidate:
    """None has been found yet, infinitely far."""
    return Candidate(np.inf, -1.0)


clear_candidate = over_lanes(no_candidate, into=("candidate",))


@device
def exchanged(candidate: Candidate, held: Candidate) -> tuple[Candidate, Candidate]:
    """The farther and the nearer of two; of two equally far the one with the smaller number is nearer."""
    r, number = candidate
    on = (r < held.square) | ((r == held.square) & (number < held.number))
    near = Candidate(pick(on, r, held.square), pick(on, number, held.number))
    return Candidate(pick(on, held.square, r), pick(on, held.number, number)), near


insert = over_lanes(exchanged, into=("candidate", "held"))


@device
def candidate_at(other: Position, own: Position, number: float) -> Candidate:
    """Squared distance to another follower, and its number."""
    e = sub(other.p, own.p)
    return Candidate(dot(e, e), number)


measure = over_lanes(
    candidate_at, into=("candidate",), uniform=("number",), own=Measured, other=Measured
)


@device
def nearest_two(
    other: Position, own: Position, number: float, first: Candidate, second: Candidate
) -> tuple[Candidate, Candidate, Candidate]:
    """`measure`, and `insert` into the first two places, in one go: most look no further."""
    candidate, first = exchanged(candidate_at(other, own, number), first)
    candidate, second = exchanged(candidate, second)
    return first, second, candidate


insert_two = over_lanes(
    nearest_two,
    into=("first", "second", "candidate"),
    uniform=("number",),
    own=Measured,
    other=Measured,
)

# -- what the followers are shown and paid ---------------------------------------------------------------


class Previous(NamedTuple):
    """A part of a follower's rows."""

    previous: Action


class Failing(NamedTuple):
    """A part of `Outcome`."""

    separation: float
    failed: float


class Paid(NamedTuple):
    """A part of `Outcome`."""

    reward: float
    terms: Terms


_NOTHING = Terms(*[0.0] * len(Terms._fields))


@device
def true_error(square: float, own: Hardest, leader: Hardest) -> float:
    """The slot error, m, from its square; not a number where the state of one of the two is unsound."""
    return sqrt(square) + 0.0 * (own.speed + leader.speed)


@device
def failing(
    active: bool,
    started: bool,
    left: float,
    squares: Squares,
    touch: Touch,
    leader: Hardest,
    tally: Tally,
    limits: Limits,
) -> tuple[Failing, Tally]:
    """Separation and failure of a follower, and whether one of its world has failed.

    In a world that has not stepped none has. `touch` is the follower's, `leader` the leader's: a crash of the
    leader fails a follower that has not failed itself, unpaid.
    """
    error = true_error(squares.error, Hardest(touch.speed), leader)
    separation = sqrt(squares.separation)
    overdue = (not started) & (left <= 0.0)
    why = failure(separation, touch.speed, touch.uprightness, error, overdue, limits)
    own = active & (why != NO_FAILURE)
    crashed = (why == NO_FAILURE) & (leader.speed > limits.impact)
    failed = pick(active, pick(crashed, float(LEADER), float(why)), 0.0)
    return Failing(separation, failed), Tally(
        tally.reward, max(tally.failed, failed), tally.paid | own
    )


fail = over_lanes(
    failing,
    into=("outcome", "tally"),
    uniform=("limits",),
    leader=Touch,
    outcome=Outcome,
)


class Error(NamedTuple):
    """A part of `Squares`."""

    error: float


@device
def payment(
    active: bool,
    started: bool,
    left: float,
    squares: Error,
    touch: Hardest,
    leader: Hardest,
    action: Action,
    x: Previous,
    tally: Tally,
    entries: int,
    rewards: Rewards,
) -> tuple[Paid, Previous, Tally]:
    """The reward of a follower, its next previous action, and the world's sum.

    A world that has not stepped earns nothing. When one follower of a world has failed, each of them pays, so
    the joint reward loses the same whatever their number, and no follower gains by the failure of another.
    """
    error = true_error(squares.error, touch, leader)
    terms = reward(started, left, error, action, x.previous, entries, tally.paid, rewards)
    earned = pick(active, total_of_terms(terms), 0.0)
    return (
        Paid(earned, choose_terms(active, terms, _NOTHING)),
        Previous(_choose_action(active, action, x.previous)),
        Tally(tally.reward + earned, tally.failed, tally.paid),
    )


pay = over_lanes(
    payment,
    into=("outcome", "x", "tally"),
    uniform=("entries", "rewards"),
    squares=Squares,
    touch=Touch,
    leader=Touch,
    x=Follower,
    outcome=Outcome,
)


class Over(NamedTuple):
    """A part of `Counters`."""

    over: int


@device
def verdict_of(
    counters: Counters,
    tally: Tally,
    leader: Hardest,
    active: bool,
    followers: float,
    limits: Limits,
    last: int,
) -> tuple[Over, Verdict]:
    """Whether an episode goes on; mean reward, whether it has failed, whether it is over in time."""
    ended = active & ((tally.failed > 0.0) | (leader.speed > limits.impact))
    late = active & (counters.tick >= last)
    over = int(ended | late) if active else counters.over
    return Over(over), Verdict(tally.reward / followers, ended, late)


conclude = over_lanes(
    verdict_of,
    into=("counters", "verdict"),
    uniform=("followers", "limits", "last"),
    counters=Counters,
    leader=Touch,
)


class EstimateAndPrevious(NamedTuple):
    """A part of a follower's rows: the heading that it estimates, its last action."""

    estimate: complex
    previous: Action


@device
def observed(
    started: bool, x: EstimateAndPrevious, leader: Measured, begin: Vector, own: Measured, d: Vector
) -> Observation:
    """A follower's observation without what its level adds and its neighbours."""
    anchor = pick_vector(started, leader.p, begin)
    return observe(own, leader, anchor, x.estimate, d, x.previous, started)


show = over_lanes(observed, into=("rows",), uniform=("d",), bounds=bounds(Observation), x=Follower)


@device
def observed_neighbour(number: float, x: Estimate, own: Passing, other: Passing) -> Neighbour:
    """Another follower; there is none of number -1."""
    return observe_neighbour(own, other, x.estimate, number >= 0.0)


show_neighbour = over_lanes(
    observed_neighbour,
    into=("rows",),
    bounds=bounds(Neighbour),
    x=Follower,
    own=Measured,
    other=Passing,
)
