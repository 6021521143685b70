"""Measurements in single worlds: taken when they are due, held until the next, late where they are."""

from __future__ import annotations

from typing import Any

from formation_env._jit import device
from formation_env.blocks import LANES
from formation_env.memory import (
    TICK,
    Scratch,
    State,
    load,
    load_body,
    load_gust,
    load_sample,
    oldest,
    put,
    put_sample,
    ring,
    vehicle,
)
from formation_env.quadrotor import Wrench
from formation_env.sensors import (
    Measured,
    angular_difference,
    averaged_acceleration,
    corrupt,
    difference,
    silent,
)
from formation_env.world import (
    Clock,
    World,
    truth,
)


@device
def _take_sample(
    samples: Any, speeds: Any, raw: Measured, count: int, leader: bool, s: World
) -> None:
    """Store sample number `count`, its velocities differenced where they are not measured."""
    if s.clock.window > 0:
        period = s.clock.sample_every * (s.clock.period / s.clock.substeps)
        before = load_sample(samples[(count - 1) % len(samples)])
        v = difference(raw.p, before.p, period)
        a = (0.0, 0.0, 0.0)
        if leader:
            then = speeds[count % s.clock.window]
            a = averaged_acceleration(v, load(then, 0), s.clock.window, period)
            put(then, 0, v)
        raw = Measured(raw.p, v, a, raw.q, angular_difference(raw.q, before.q, period))
    put_sample(samples[count % len(samples)], raw)


@device
def sense_when_due(state: State, t: int, i: int, room: Scratch, k: int, s: World) -> None:
    """Sample vehicle `i` in the flying worlds of tile `t` where a measurement is due."""
    for lane in range(LANES):
        if room.active[lane] == 0.0:
            continue
        w = t * LANES + lane
        elapsed = state.counters[TICK, w] * s.clock.substeps + k + 1
        if elapsed % s.clock.sample_every != 0:
            continue
        count = elapsed // s.clock.sample_every
        x = vehicle(state, w, i)
        applied = Wrench(room.commands[i, lane], (0.0, 0.0, 0.0))
        touching = room.touches[i, 2 * LANES + lane] != 0.0
        exact = truth(load_body(x), applied, load_gust(x), touching, s.airframe)
        raw = exact
        if not silent(s.noise):
            raw = corrupt(exact, s.noise, state.episode_keys[w], i, count)
        _take_sample(ring(state, w, i), state.speeds[w], raw, count, i == 0, s)


@device
def receive(state: State, t: int, here: int, room: Scratch, clock: Clock) -> None:
    """Fetch the measurements that have arrived in the `here` worlds of tile `t`, if they are late."""
    samples, seen = state.samples, room.seen
    if samples.shape[2] <= 1:
        return
    for i in range(samples.shape[1]):
        for lane in range(here):
            at = oldest(state, t * LANES + lane, clock)
            for k in range(16):
                seen[0, i, k * LANES + lane] = samples[t, i, at, k * LANES + lane]
