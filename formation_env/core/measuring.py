"""Measurements: taken when they are due, held until the next, late where they are.

How they come is decided when the memory is made (`arrays.measuring`): exactly, so that the state is what is
measured; with noise at the end of every tick; or when they are due, from a ring of samples if they are late.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formation_env._jit import cold, device, step
from formation_env.core import arrays, flight
from formation_env.core.arrays import Counters, Touch
from formation_env.laws.world import Clock
from formation_env.maths.rng import MEASUREMENT
from formation_env.maths.so3 import ZERO, Vector
from formation_env.memory.records import LANES, at, line_loader, line_storer, loader, size, storer
from formation_env.memory.shuffles import carve
from formation_env.physics.quadrotor import Body, Wrench
from formation_env.physics.sensors import (
    Measured,
    angular_difference,
    averaged_acceleration,
    corrupt,
    difference,
    silent,
    truth,
    with_rates,
)

_TICK = at(Counters, "tick") * LANES
_read_body, _read_sample, _store_sample = loader(Body, Measured), loader(Measured), storer(Measured)
_read_push, _read_touch, _read_command = loader(Vector), loader(Touch), loader(Wrench)
_read_velocity, _write_velocity = line_loader(Vector), line_storer(Vector)
_PAIR, _BLOCKS, _ROWS = size(flight.Pair), 4, size(Measured)


@step
def in_hand(memory: Any, room: Any, t: int, i: int) -> Any:
    """The rows of the measurement of vehicle `i` of tile `t` that has arrived."""
    if arrays.delays(memory) == 0:
        return arrays.vehicle(memory, t, i)
    if arrays.delays(memory) == 1:
        return arrays.sample(memory, t, i, 0)
    return arrays.received(room, i)


@cold
def receive(memory: Any, room: Any, t: int, here: int) -> None:
    """Fetch the measurements that have arrived in the `here` worlds of tile `t`, if they are late."""
    if arrays.delays(memory) <= 1:
        return
    clock, count = arrays.read_clock(arrays.world(memory)), arrays.counters(memory, t)
    for i in range(arrays.vehicles(memory)):
        received = arrays.received(room, i)
        for lane in range(here):
            taken = count[_TICK + lane] * clock.substeps // clock.sample_every
            oldest = arrays.sample(memory, t, i, (taken + 1) % arrays.delays(memory))
            for k in range(_ROWS):
                received[k * LANES + lane] = oldest[k * LANES + lane]


@step
def measure_exactly(memory: Any, room: Any, t: int, i: int) -> None:
    """The state is what is measured; here its acceleration."""
    x, applied = arrays.vehicle(memory, t, i), arrays.command(room, i)
    airframe = arrays.airframe_line(memory)
    flight.sense_exactly(applied, arrays.touch(room, i), x, arrays.push(room, i), airframe)


@step
def measure_with_noise(memory: Any, room: Any, t: int, i: int) -> None:
    """A noisy measurement of vehicle `i`, of the numbers in `counts`, in all lanes.

    It is `sensors.corrupt` in steps with room between them: in one loop the constants of Philox and of the
    polynomials exceed the registers, and the float64 of the measurement would halve the width of the
    float32, which together doubles the time.
    """
    keys, draws, counts = arrays.episode_key(memory, t), arrays.draws(room), arrays.counts(room)
    half = _BLOCKS * _PAIR * LANES
    for block in range(_BLOCKS):
        first = carve(draws, block * _PAIR * LANES, (_PAIR * LANES,))
        second = carve(draws, half + block * _PAIR * LANES, (_PAIR * LANES,))
        flight.draw_words(keys, counts, MEASUREMENT, i, block, first, second)
    flight.make_normal(carve(draws, 0, (half,)), carve(draws, half, (half,)), _BLOCKS * _PAIR)
    flight.add_noise(
        arrays.command(room, i),
        arrays.touch(room, i),
        arrays.vehicle(memory, t, i),
        arrays.push(room, i),
        carve(draws, half, (half,)),
        carve(draws, 0, (half,)),
        arrays.airframe_line(memory),
        arrays.noise_line(memory),
        arrays.sample(memory, t, i, 0),
    )


@cold
def measure_when_due(memory: Any, room: Any, t: int, i: int, k: int) -> None:
    """Sample vehicle `i` in the worlds that step, where a measurement is due after substep `k`."""
    world, active = arrays.world(memory), arrays.active(room)
    clock, count = arrays.read_clock(world), arrays.counters(memory, t)
    for lane in range(LANES):
        elapsed = count[_TICK + lane] * clock.substeps + k + 1
        if active[lane] != 0.0 and elapsed % clock.sample_every == 0:
            number, at_lane = elapsed // clock.sample_every, np.uint64(lane)
            applied = _read_command(arrays.command(room, i), at_lane)
            touching = _read_touch(arrays.touch(room, i), at_lane).touching
            body = _read_body(arrays.vehicle(memory, t, i), at_lane)
            push = _read_push(arrays.push(room, i), at_lane)
            raw = truth(body, applied, push, touching, arrays.read_airframe(world))
            noise = arrays.read_noise(world)
            if not silent(noise):
                raw = corrupt(raw, noise, arrays.episode_key(memory, t)[lane], i, number)
            take_sample(memory, t, i, lane, raw, number, clock)


@device
def take_sample(
    memory: Any, t: int, i: int, lane: int, raw: Measured, number: int, clock: Clock
) -> None:
    """Store sample `number`, its velocities differenced where they are not measured."""
    ring, at_lane = arrays.delays(memory), np.uint64(lane)
    if clock.window > 0:
        period = clock.sample_every * (clock.period / clock.substeps)
        before = _read_sample(arrays.sample(memory, t, i, (number - 1) % ring), at_lane)
        v, a = difference(raw.p, before.p, period), ZERO
        if i == 0:
            then = arrays.speed(memory, t * LANES + lane, number % clock.window)
            a = averaged_acceleration(v, _read_velocity(then), clock.window, period)
            _write_velocity(then, v)
        raw = with_rates(raw, v, a, angular_difference(raw.q, before.q, period))
    _store_sample(arrays.sample(memory, t, i, number % ring), at_lane, raw)
