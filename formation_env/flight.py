"""The loops of a tick: one statement for each, from the law of one vehicle in one world.

The laws here are those that only join others or keep the books; the mathematics is in `quadrotor`, `world`,
`task`, `slots`, `turning` and `sensors`. The order of a law's arguments is that in which they are loaded: in
another the compiler fuses other operations, and last bits change.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from formation_env import quadrotor
from formation_env._jit import device, loop
from formation_env.arrays import (
    Candidate,
    Counters,
    Squares,
    Tally,
    Touch,
    Verdict,
)
from formation_env.levels import Follower
from formation_env.quadrotor import (
    MOMENT,
    RATES,
    Airframe,
    Body,
    Wrench,
    touch_floor,
)
from formation_env.records import LANES, bounds, chooser, total
from formation_env.rng import MEASUREMENT, as_single, normal_pair, words
from formation_env.sensors import Measured, Noise, Sensed, accelerating, perturb, sensed, truth
from formation_env.slots import advance_heading
from formation_env.slots import slot as slot_of
from formation_env.so3 import ZERO, Vector, dot, pick, pick_vector, sub
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
from formation_env.tiles import FLAGS, over_lanes
from formation_env.turning import Turning, slow_by_moment, slow_by_rates, stays_up
from formation_env.world import Action, Clock, follow

_ACTUATION = {"actuation": (MOMENT, RATES)}
choose_terms, total_of_terms = chooser(Terms), total(Terms)
_choose_action = chooser(Action)


class Position(NamedTuple):
    """A part of `Measured`."""

    p: Vector  # m, inertial


class Velocity(NamedTuple):
    """A part of `Measured`."""

    v: Vector  # m/s, inertial


# -- which worlds step ------------------------------------------------------------------------------------


class Choice(NamedTuple):
    """How many worlds of a tile ..."""

    flying: bool  # step
    waiting: bool  # are to be reset
    standing: bool  # wait for their start, lanes without a world included


@device
def choose_world(named: bool, counters: Counters, reset: int) -> tuple[bool, bool, Choice]:
    """Whether a world steps, and whether it steps after its start; `Choice`.

    `reset` is 2 where all that are named are reset instead, 1 where those whose episode is over, or 0.
    """
    fresh = named & ((reset == 2) | ((reset == 1) & (counters.over != 0)))
    on = named & (not fresh)
    begun = counters.started != 0
    return on, on & begun, Choice(on, fresh, not begun)


choose = over_lanes(
    choose_world,
    into=("active", "moving"),
    uniform=("reset",),
    named=FLAGS,
)


@device
def note_start(counters: Counters) -> tuple[bool, bool]:
    """Whether an episode has started, and whether it has not, to be summed."""
    return counters.started != 0, counters.started == 0


note_started = over_lanes(note_start, into=("started",))


@device
def line_of_reference(counters: Counters, lines: int, length: int) -> tuple[int, bool]:
    """Where the line of a world's clock begins in a table of `lines`; whether it lies beyond them."""
    return counters.clock * length, counters.clock >= lines


find_lines = over_lanes(line_of_reference, into=("line_starts",), uniform=("lines", "length"))


class Clocks(NamedTuple):
    """A part of `Counters`."""

    tick: int
    clock: int


@device
def next_clocks(counters: Counters, active: bool, moving: bool) -> Clocks:
    """A tick later in the worlds that step, on the reference's clock in those that have started."""
    return Clocks(counters.tick + active, counters.clock + moving)


move_on = over_lanes(next_clocks, into=("counters",), counters=Counters)


@device
def number_of_sample(counters: Counters) -> int:
    """The number of the measurement at the end of the tick."""
    return counters.tick + 1


number_samples = over_lanes(number_of_sample, into=("counts",))

# -- commands and flight -------------------------------------------------------------------------------------

lead = over_lanes(follow, into=("command",), uniform=("world",), static=_ACTUATION)


@device
def move(
    applied: Wrench, body: Body, push: Vector, h: float, actuation: int, airframe: Airframe
) -> Body:
    """A substep in the air."""
    return quadrotor.fly(body, applied, push, h, actuation, airframe)


fly = over_lanes(move, into=("body",), uniform=("h", "airframe"), static=_ACTUATION, body=Measured)


@device
def move_low(
    applied: Wrench,
    body: Body,
    push: Vector,
    touch: Touch,
    h: float,
    actuation: int,
    airframe: Airframe,
) -> tuple[Body, Touch]:
    """The same close to the floor, on which the vehicle is kept; in the air bit for bit the same."""
    kept, contact = touch_floor(move(applied, body, push, h, actuation, airframe), body)
    harder = contact.touching & (contact.speed > touch.speed)
    return kept, Touch(
        max(touch.speed, pick(contact.speed < np.inf, contact.speed, np.inf)),
        pick(harder, contact.uprightness, touch.uprightness),
        contact.touching,
    )


fly_low = over_lanes(
    move_low, into=("body", "touch"), uniform=("h", "airframe"), static=_ACTUATION, body=Measured
)


@device
def can_land(
    body: Body,
    applied: Wrench,
    push: Vector,
    active: bool,
    clock: Clock,
    airframe: Airframe,
    turning: Turning,
    actuation: int,
) -> bool:
    """Whether a vehicle may meet the floor in this tick; that it does not is certain, as `turning` proves."""
    period = clock.period
    up = stays_up(body.p[2], body.v[2], applied.thrust, push[2], period, airframe.mass)
    if actuation == MOMENT:
        slow = slow_by_moment(body.w, applied.turn, turning)
    else:
        slow = slow_by_rates(body.w, applied.turn, period / clock.substeps, airframe.rate_lag)
    return active & (not (up & slow))


count_landing = over_lanes(
    can_land, uniform=("clock", "airframe", "turning"), static=_ACTUATION, body=Measured
)


@device
def in_the_air() -> Touch:
    """Nothing has touched the floor yet."""
    return Touch(0.0, 1.0, False)


clear_touch = over_lanes(in_the_air, into=("touch",))


class Hardest(NamedTuple):
    """A part of `Touch`."""

    speed: float


@device
def soundness(body: Body, touch: Touch) -> Hardest:
    """An infinite speed where a vehicle's state has left what can be computed; `move_low` does the same."""
    q = body.q
    unit = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    p, v, w = body.p, body.v, body.w
    sound = (dot(p, p) + dot(v, v) + dot(w, w) < np.inf) & (unit > 0.5)
    return Hardest(pick(sound, touch.speed, np.inf))


note_unsound = over_lanes(soundness, into=("touch",), body=Measured, touch=Touch)

# -- measurements --------------------------------------------------------------------------------------------


@device
def sensed_exactly(
    applied: Wrench, touch: Touch, body: Body, push: Vector, airframe: Airframe
) -> Sensed:
    """What a measurement without noise adds to the state itself."""
    return sensed(body, accelerating(body, applied, push, touch.touching, airframe))


sense_exactly = over_lanes(sensed_exactly, into=("body",), uniform=("airframe",), body=Measured)

Pair = tuple[float, float]
Eight = tuple[float, float, float, float, float, float, float, float]


@device
def noise_words(key: int, count: int, who: int, block: int) -> tuple[Pair, Pair]:
    """One block of random words for a measurement: its first pair, and what makes them normal with them."""
    a, b, c, d = words(key, MEASUREMENT, who, count, block)
    return (as_single(a), as_single(b)), (as_single(c), as_single(d))


draw_words = over_lanes(noise_words, into=("first", "second"), uniform=("who", "block"))

_PAIRS = np.uint64(8 * LANES)


@loop
def make_normal(draws: Any) -> None:
    """Normal numbers in place of the words: rows 0-7 and 8-15 are the pairs."""
    for k in range(_PAIRS):
        draws[k], draws[k + _PAIRS] = normal_pair(draws[k], draws[k + _PAIRS])


@device
def noisy(
    applied: Wrench,
    touch: Touch,
    body: Body,
    push: Vector,
    first: Eight,
    second: Eight,
    airframe: Airframe,
    noise: Noise,
) -> Measured:
    """A measurement with noise made of normal numbers, in the order of `rng.normals` for each block."""
    exact = truth(body, applied, push, touch.touching, airframe)
    return perturb(
        exact,
        noise,
        (first[0], second[0], first[1], second[1]),
        (first[2], second[2], first[3], second[3]),
        (first[4], second[4], first[5], second[5]),
        (first[6], second[6], first[7], second[7]),
    )


add_noise = over_lanes(noisy, into=("sample",), uniform=("airframe", "noise"), body=Measured)

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
    started: bool, x: Heading, leader: Passing, begin: Vector, own: Position, d: Vector
) -> tuple[Target, Squares]:
    """Slot and slot error; of the other vehicles the leader is the nearest yet.

    Before the start the slot is that of the leader's first reference point `begin`, at rest.
    """
    p_L = pick_vector(started, leader.p, begin)
    v_L = pick_vector(started, leader.v, ZERO)
    target = slot_of(x.heading, p_L, v_L, d)
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


class Judged(NamedTuple):
    """A part of `Outcome`."""

    reward: float
    terms: Terms
    separation: float
    failed: float


_NOTHING = Terms(*[0.0] * len(Terms._fields))


@device
def judgement(
    active: bool,
    squares: Squares,
    touch: Touch,
    leader: Hardest,
    action: Action,
    x: Previous,
    tally: Tally,
    entries: int,
    rewards: Rewards,
    limits: Limits,
) -> tuple[Judged, Previous, Tally]:
    """Separation, reward and failure of a follower, its next previous action, and the world's sums.

    A world that has not stepped earns nothing and its followers have not failed. `touch` is the follower's,
    `leader` the leader's: a crash of the leader fails a follower that has not failed itself, unpaid.
    """
    # Not a number where one of the two is unsound, else what it was.
    error = sqrt(squares.error) + 0.0 * (touch.speed + leader.speed)
    separation = sqrt(squares.separation)
    why = failure(separation, touch.speed, touch.uprightness, error, limits)
    terms = reward(error, action, x.previous, entries, why != NO_FAILURE, rewards)
    earned = pick(active, total_of_terms(terms), 0.0)
    crashed = (why == NO_FAILURE) & (leader.speed > limits.impact)
    failed = pick(active, pick(crashed, float(LEADER), float(why)), 0.0)
    return (
        Judged(earned, choose_terms(active, terms, _NOTHING), separation, failed),
        Previous(_choose_action(active, action, x.previous)),
        Tally(tally.reward + earned, max(tally.failed, failed)),
    )


judge = over_lanes(
    judgement,
    into=("outcome", "x", "tally"),
    uniform=("entries", "rewards", "limits"),
    x=Follower,
    leader=Touch,
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


class Known(NamedTuple):
    """A part of a follower's rows: what it knows of itself."""

    estimate: complex
    previous: Action


@device
def observed(
    started: bool, x: Known, leader: Measured, begin: Vector, own: Measured, d: Vector
) -> Observation:
    """A follower's observation without what its level adds and its neighbours."""
    anchor = pick_vector(started, leader.p, begin)
    return observe(own, leader, anchor, x.estimate, d, x.previous, started)


show = over_lanes(observed, into=("rows",), uniform=("d",), bounds=bounds(Observation), x=Follower)


class Frame(NamedTuple):
    """A part of a follower's rows."""

    estimate: complex


@device
def observed_neighbour(number: float, x: Frame, own: Passing, other: Passing) -> Neighbour:
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
