"""The loops of a tick: one statement for each, from the law of one vehicle in one world.

The laws here are those that only join others or keep the books; the mathematics is in `quadrotor`, `world`,
`task`, `slots`, `turning` and `sensors`. The order of a law's arguments is that in which they are loaded: in
another the compiler fuses other operations, and last bits change.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from formation_env._jit import device, loop
from formation_env.core.arrays import Counters, Touch
from formation_env.laws.world import Clock, follow
from formation_env.maths.rng import Four, as_single, normal_pair, words
from formation_env.maths.so3 import Vector, dot, pick
from formation_env.memory.records import LANES
from formation_env.memory.tiles import FLAGS, over_lanes
from formation_env.paths.course import lay_point
from formation_env.physics import quadrotor
from formation_env.physics.quadrotor import MOMENT, RATES, Airframe, Body, Wrench, touch_floor
from formation_env.physics.sensors import (
    Measured,
    Noise,
    Sensed,
    accelerating,
    perturb,
    sensed,
    truth,
)
from formation_env.physics.turning import Turning, slow_by_moment, slow_by_rates, stays_up

_ACTUATION = {"actuation": (MOMENT, RATES)}
_LANES = np.uint64(LANES)


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


choose = over_lanes(choose_world, into=("active", "moving"), uniform=("reset",), named=FLAGS)


@device
def note_start(counters: Counters, deadline: int) -> tuple[bool, float, bool]:
    """Whether an episode has started, ticks until it has to, and whether it waits, to be summed."""
    waits = counters.started == 0
    return not waits, float(deadline - counters.tick) if waits else 0.0, waits


note_started = over_lanes(note_start, into=("started", "left"), uniform=("deadline",))


@device
def line_of_reference(counters: Counters, lines: int, length: int) -> tuple[int, bool]:
    """Where the line of a world's clock begins in a table of `lines`; whether it lies beyond them."""
    line = counters.clock + counters.first
    return line * length, line >= lines


find_lines = over_lanes(line_of_reference, into=("line_starts",), uniform=("lines", "length"))


lay_reference = over_lanes(lay_point, into=("reference",))


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

# -- random numbers ------------------------------------------------------------------------------------------

Pair = tuple[float, float]


@device
def random_words(key: int, count: int, purpose: int, who: int, block: int) -> tuple[Pair, Pair]:
    """One block of random words: its first pair, and what makes them normal with them."""
    a, b, c, d = words(key, purpose, who, count, block)
    return (as_single(a), as_single(b)), (as_single(c), as_single(d))


draw_words = over_lanes(random_words, into=("first", "second"), uniform=("purpose", "who", "block"))


@loop
def make_normal(first: Any, second: Any, rows: int) -> None:
    """Normal numbers in place of words, in pairs of a number of each array."""
    for row in range(np.uint64(rows)):
        for lane in range(_LANES):
            k = row * _LANES + lane
            first[k], second[k] = normal_pair(first[k], second[k])


@device
def in_order(first: Pair, second: Pair) -> Four:
    """The normal numbers of a block as `rng.normals` has them."""
    return first[0], second[0], first[1], second[1]


# -- measurements --------------------------------------------------------------------------------------------


@device
def sensed_exactly(
    applied: Wrench, touch: Touch, body: Body, push: Vector, airframe: Airframe
) -> Sensed:
    """What a measurement without noise adds to the state itself."""
    return sensed(body, accelerating(body, applied, push, touch.touching, airframe))


sense_exactly = over_lanes(sensed_exactly, into=("body",), uniform=("airframe",), body=Measured)

Eight = tuple[float, float, float, float, float, float, float, float]


@device
def noisy(
    applied: Wrench,
    touch: Touch,
    body: Body,
    push: Vector,
    second: Eight,
    first: Eight,
    airframe: Airframe,
    noise: Noise,
) -> Measured:
    """A measurement with noise made of normal numbers, in the order of `rng.normals` for each block."""
    exact = truth(body, applied, push, touch.touching, airframe)
    return perturb(
        exact,
        noise,
        in_order(first[0:2], second[0:2]),
        in_order(first[2:4], second[2:4]),
        in_order(first[4:6], second[4:6]),
        in_order(first[6:8], second[6:8]),
    )


add_noise = over_lanes(noisy, into=("sample",), uniform=("airframe", "noise"), body=Measured)
