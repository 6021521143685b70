"""How measurements come: exactly, with noise after every tick, when they are due, late; in a tile's lanes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from states import begun, counters, filled, lane_of, measured_in

from formation_env._jit import plain
from formation_env.core import arrays, measuring
from formation_env.core.arrays import Touch, rows
from formation_env.core.flight import Position
from formation_env.core.simulation import Simulation
from formation_env.memory.records import LANES, flatten, size
from formation_env.physics.quadrotor import Body, Wrench
from formation_env.physics.sensors import (
    Measured,
    Noise,
    angular_difference,
    averaged_acceleration,
    corrupt,
    difference,
    truth,
)

NOISE = Noise(0.2, 0.1, 0.01, 0.3, 0.02)
WHO = 2
SCENES: dict[str, dict[str, Any]] = {
    "exact": {},
    "noisy": {"noise": NOISE},
    "late": {"noise": NOISE, "measurement_delay": 2},
    "seldom": {"noise": NOISE, "measurement_period": 0.03, "measurement_delay": 1},
    "differenced": {
        "estimator": "differenced",
        "window": 3,
        "measurement_delay": 1,
        "measurement_period": 0.01,
    },
    "quiet": {"measurement_delay": 1},
}


def scene(name: str) -> tuple[Simulation, dict[str, Any], dict[str, Any]]:
    """Nineteen worlds with random states, samples, commands, gusts and touches; each with its own clock."""
    flight, draw = begun(19, **SCENES[name]), np.random.default_rng(3)
    memory, room = arrays.MEMORY.views(flight._memory), arrays.ROOM.views(flight._rooms[0])
    for array in (memory["vehicles"], memory["samples"]):
        for x in array.reshape(-1, array.shape[-1]):
            x[: size(Measured) * LANES] = filled(Measured, draw)
    for x in room["commands"]:
        x[:] = filled(Wrench, draw)
    room["pushes"][:] = draw.normal(size=room["pushes"].shape)
    rows(room["touches"], Touch)["touching"][:] = draw.integers(0, 2, LANES)
    room["active"][:] = draw.integers(0, 2, LANES)
    counters(memory["counters"])["tick"][:] = draw.integers(1, 50, (2, LANES))
    memory["speeds"][:] = draw.normal(size=memory["speeds"].shape)
    return flight, memory, room


def exact(flight: Simulation, memory: Any, room: Any, t: int, i: int, lane: int) -> Measured:
    """What perfect sensors read of a vehicle in one lane."""
    m = measured_in(memory["vehicles"][t, i][: size(Measured) * LANES], lane)
    applied = Wrench(**lane_of(room["commands"][i], Wrench, lane))
    push = lane_of(room["pushes"][i], Position, lane)["p"]
    touching = bool(lane_of(room["touches"][i], Touch, lane)["touching"])
    frame = flight.config.world.airframe
    return truth(Body(m.p, m.v, m.q, m.w), applied, push, touching, frame)


def alike(found: Measured, expected: Measured) -> None:
    np.testing.assert_allclose(flatten(found), flatten(expected), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "how"),
    [("exact", "EXACT"), ("noisy", "EVERY_TICK"), ("late", "WHEN_DUE"), ("seldom", "WHEN_DUE"),
     ("differenced", "WHEN_DUE"), ("quiet", "WHEN_DUE")],
)  # fmt: skip
def test_how_measurements_come_is_said_by_the_configuration(name: str, how: str) -> None:
    flight, memory, _ = scene(name)
    sizes = arrays.MEMORY.sizes(flight._memory)
    assert sizes.measuring == getattr(arrays, how)
    delays = {"exact": 0, "noisy": 1, "late": 3}.get(name, 2)
    assert sizes.delays == memory["samples"].shape[2] == delays


def test_what_is_in_hand_is_the_state_the_sample_or_what_has_arrived() -> None:
    for name in ("exact", "noisy", "late"):
        flight, memory, room = scene(name)
        room["received"][...] = np.random.default_rng(1).normal(size=room["received"].shape)
        found = plain(measuring.in_hand)(flight._memory, flight._rooms[0], 1, WHO)
        expected = {
            "exact": lambda m=memory: m["vehicles"][1, WHO],
            "noisy": lambda m=memory: m["samples"][1, WHO, 0],
            "late": lambda r=room: r["received"][WHO],
        }[name]()
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", ["late", "seldom", "differenced"])
def test_what_arrives_is_the_sample_as_old_as_the_delay(name: str) -> None:
    """In each world by its own clock: of the samples taken so far the one `delay` before the last."""
    flight, memory, room = scene(name)
    clock, ring = flight.config.world.clock, memory["samples"].shape[2]
    room["received"][:] = 7.0
    measuring.receive(flight._memory, flight._rooms[0], 1, 3)
    tick = counters(memory["counters"])["tick"][1]
    for i in range(len(room["received"])):
        for lane in range(3):
            last = int(tick[lane]) * clock.substeps // clock.sample_every
            sample = memory["samples"][1, i, (last - clock.delay) % ring]
            assert measured_in(room["received"][i], lane) == measured_in(sample, lane)
    assert (room["received"].reshape(-1, LANES)[:, 3:] == 7.0).all(), "lanes without a world"


@pytest.mark.parametrize("name", ["exact", "noisy"])
def test_nothing_arrives_late_where_nothing_is(name: str) -> None:
    flight, _, room = scene(name)
    before = {key: array.copy() for key, array in room.items()}
    measuring.receive(flight._memory, flight._rooms[0], 1, 3)
    for key, array in room.items():
        np.testing.assert_array_equal(array, before[key])


def test_the_state_is_measured_exactly_but_for_its_acceleration() -> None:
    flight, memory, room = scene("exact")
    expected = [exact(flight, memory, room, 1, WHO, lane) for lane in range(LANES)]
    measuring.measure_exactly(flight._memory, flight._rooms[0], 1, WHO)
    for lane in range(LANES):
        alike(measured_in(memory["vehicles"][1, WHO], lane), expected[lane])


def test_noise_is_that_of_the_vehicle_and_of_the_sample() -> None:
    """In steps over all lanes: the same random numbers as `sensors.corrupt` draws for one vehicle."""
    flight, memory, room = scene("noisy")
    room["counts"][:] = np.random.default_rng(2).integers(0, 2**40, LANES)
    memory["episode_keys"][1] = np.random.default_rng(4).integers(0, 2**63, LANES)
    measuring.measure_with_noise(flight._memory, flight._rooms[0], 1, WHO)
    for lane in range(LANES):
        raw = exact(flight, memory, room, 1, WHO, lane)
        key, number = memory["episode_keys"][1, lane], room["counts"][lane]
        expected = corrupt(raw, NOISE, key, WHO, number)
        alike(measured_in(memory["samples"][1, WHO, 0], lane), expected)


@pytest.mark.parametrize("name", ["late", "seldom", "quiet"])
@pytest.mark.parametrize("k", range(4))
def test_a_sample_is_taken_where_it_is_due(name: str, k: int) -> None:
    """After substep `k`, in worlds that step, into its place in the ring; all else stays."""
    flight, memory, room = scene(name)
    clock, before = flight.config.world.clock, memory["samples"].copy()
    measuring.measure_when_due(flight._memory, flight._rooms[0], 1, WHO, k)
    expected, taken = before.copy(), 0
    for lane in range(LANES):
        elapsed = int(counters(memory["counters"])["tick"][1, lane]) * clock.substeps + k + 1
        if room["active"][lane] and elapsed % clock.sample_every == 0:
            number = elapsed // clock.sample_every
            told = exact(flight, memory, room, 1, WHO, lane)
            if name != "quiet":
                told = corrupt(told, NOISE, memory["episode_keys"][1, lane], WHO, number)
            place = expected[1, WHO, number % before.shape[2]].reshape(-1, LANES)
            place[:, lane] = flatten(told)
            taken += 1
    np.testing.assert_allclose(memory["samples"], expected, rtol=1e-12, atol=1e-12)
    due = k == 3 if name != "seldom" else k in (1, 3)
    assert (taken > 0) == due


@pytest.mark.parametrize("who", [0, WHO])
def test_velocities_that_are_not_measured_are_differences(who: int) -> None:
    """Of positions and attitudes from the sample before; the leader's acceleration from `window` ago."""
    flight, memory, room = scene("differenced")
    clock = flight.config.world.clock
    samples, speeds = memory["samples"].copy(), memory["speeds"].copy()
    period, ring = clock.sample_every * clock.period / clock.substeps, samples.shape[2]
    room["active"][:], lanes = 1.0, 3  # worlds in the last tile
    room["active"][lanes:] = 0.0
    measuring.measure_when_due(flight._memory, flight._rooms[0], 1, who, clock.substeps - 1)
    for lane in range(lanes):
        elapsed = (int(counters(memory["counters"])["tick"][1, lane]) + 1) * clock.substeps
        number, world = elapsed // clock.sample_every, LANES + lane
        raw = exact(flight, memory, room, 1, who, lane)
        before = measured_in(samples[1, who, (number - 1) % ring], lane)
        v, a = difference(raw.p, before.p, period), (0.0, 0.0, 0.0)
        if who == 0:
            then = tuple(speeds[world, number % clock.window].tolist())
            a = averaged_acceleration(v, then, clock.window, period)
            np.testing.assert_allclose(
                memory["speeds"][world, number % clock.window], v, rtol=1e-12
            )
            speeds[world, number % clock.window] = memory["speeds"][world, number % clock.window]
        w = angular_difference(raw.q, before.q, period)
        found = measured_in(memory["samples"][1, who, number % ring], lane)
        alike(found, Measured(raw.p, v, a, raw.q, w))
    np.testing.assert_array_equal(memory["speeds"], speeds)
