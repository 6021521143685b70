"""The loops that keep the books of a tile, against NumPy; those that fly, against one vehicle at a time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from numba import config as numba_config
from states import filled, lane_of, line, measured_in, tile

from formation_env import configure
from formation_env.core import flight
from formation_env.core.arrays import Counters, Touch, rows
from formation_env.laws.levels import (
    LEVELS,
    Follower,
    Guide,
    command_follower,
    follower_layout,
    guide_on,
    guided,
    numbered,
)
from formation_env.laws.world import follow, motion, track
from formation_env.maths.rng import GUST, MEASUREMENT, normals
from formation_env.memory.records import LANES, flatten, size
from formation_env.paths.course import Course
from formation_env.physics import quadrotor
from formation_env.physics.quadrotor import MOMENT, RATES, Body, Wrench, saturate
from formation_env.physics.sensors import Measured, truth
from formation_env.physics.turning import slow_by_moment, slow_by_rates, stays_up, turning
from formation_env.trajectories import TrajectoryPoint

Floats = npt.NDArray[np.float64]

Vector3 = flight.Position  # a record of one vector


def drawn(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def flags(draw: np.random.Generator) -> Floats:
    """Zeros and ones, a lane each."""
    return draw.integers(0, 2, LANES).astype(np.float64)


def counted(**given: Any) -> Any:
    """`Counters` in all lanes."""
    x = tile(Counters, np.int64)
    for name, values in given.items():
        rows(x, Counters)[name][:] = values
    return x


# -- which worlds step ----------------------------------------------------------------------------


@pytest.mark.parametrize("reset", [0, 1, 2])
def test_worlds_named_step_or_are_reset(reset: int) -> None:
    for seed in range(20):
        draw = drawn(seed)
        named = draw.integers(0, 2, LANES).astype(np.bool_)
        over, started = draw.integers(0, 2, (2, LANES))
        active, moving = np.full(LANES, 7.0), np.full(LANES, 7.0)
        counters = counted(over=over, started=started)
        chosen = flight.choose(named, counters, reset, active, moving)
        fresh = named & ((reset == 2) | ((reset == 1) & (over != 0)))
        on = named & ~fresh
        np.testing.assert_array_equal(active, on)
        np.testing.assert_array_equal(moving, on & (started != 0))
        assert chosen.flying == on.sum()
        assert chosen.waiting == fresh.sum()
        assert chosen.standing == (started == 0).sum()


def test_clocks_move_on_in_the_worlds_that_step() -> None:
    draw = drawn(0)
    active = flags(draw)
    moving = active * flags(draw)
    tick, clock = draw.integers(0, 100, (2, LANES))
    counters = counted(tick=tick, clock=clock, episode=3, over=1)
    flight.move_on(counters, active, moving)
    expected = counted(tick=tick + active, clock=clock + moving, episode=3, over=1)
    np.testing.assert_array_equal(counters, expected)
    counts = np.zeros(LANES, np.int64)
    flight.number_samples(counted(tick=tick), counts)
    np.testing.assert_array_equal(counts, tick + 1)
    starts = np.zeros(LANES, np.int64)
    first = draw.integers(0, 60, LANES)  # of the path, where the episode began
    for lines in (0, 40, int((clock + first).max()), int((clock + first).max()) + 1):
        counters = counted(clock=clock, first=first, tick=tick)
        beyond = flight.find_lines(counters, lines, 16, starts)
        assert beyond == (clock + first >= lines).sum()
        np.testing.assert_array_equal(starts, 16 * (clock + first))


def test_references_lie_as_each_world_has_its_course() -> None:
    """Positions and all derivatives: mirrored, east for west, then turned; heights stay."""
    draw = drawn(2)
    courses, reference = filled(Course, draw), filled(TrajectoryPoint, draw)
    rows(courses, Course)["side"][:] = draw.choice([-1.0, 1.0], LANES)
    before = reference.copy()
    flight.lay_reference(courses, reference)
    for lane in range(LANES):
        course = lane_of(courses, Course, lane)
        c, s = course["turn"]
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        was, now = (lane_of(x, TrajectoryPoint, lane) for x in (before, reference))
        for name in TrajectoryPoint._fields:
            expected = turn @ np.diag([1.0, course["side"], 1.0]) @ was[name]
            np.testing.assert_allclose(now[name], expected, rtol=1e-13, atol=1e-14)


def test_worlds_that_wait_for_the_start_are_counted() -> None:
    """And noted in how many ticks they have to start."""
    draw = drawn(1)
    started, tick = draw.integers(0, 2, LANES), draw.integers(48, 53, LANES)
    noted, left = np.full((2, LANES), 7.0)
    counters = counted(started=started, tick=tick)
    assert flight.note_started(counters, 50, noted, left) == (started == 0).sum()
    np.testing.assert_array_equal(noted, started)
    np.testing.assert_array_equal(left, np.where(started == 0, 50 - tick, 0))


# -- flight -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("actuation", [MOMENT, RATES])
def test_the_leader_is_commanded_and_flown_as_one_vehicle_alone(actuation: int) -> None:
    world, draw = configure("nominal").world, drawn(5)
    own, ref = filled(Measured, draw), filled(TrajectoryPoint, draw)
    command, push = tile(Wrench), filled(Vector3, draw)
    flight.lead(ref, own, line(world), actuation, command)
    body, h = own.copy(), 0.005
    flight.fly(command, body, push, h, actuation, line(world.airframe))
    for lane in range(LANES):
        point = TrajectoryPoint(**lane_of(ref, TrajectoryPoint, lane))
        m = measured_in(own, lane)
        applied = follow(point, m, world, actuation)
        found = lane_of(command, Wrench, lane)
        np.testing.assert_allclose(found["thrust"], applied.thrust, rtol=1e-9)
        np.testing.assert_allclose(found["turn"], applied.turn, rtol=1e-9, atol=1e-12)
        state, a = Body(m.p, m.v, m.q, m.w), lane_of(push, Vector3, lane)["p"]
        after = quadrotor.fly(state, Wrench(**found), a, h, actuation, world.airframe)
        flown = measured_in(body, lane)
        np.testing.assert_allclose(flatten(Body(flown.p, flown.v, flown.q, flown.w)),
                                   flatten(after), rtol=1e-9, atol=1e-12)  # fmt: skip
        assert flown.a == m.a


@pytest.mark.parametrize("scenario", ["nominal", "experiment"])
def test_a_guided_follower_is_commanded_as_one_alone(scenario: str) -> None:
    """Along its virtual follower, which moves on where the world steps, and waits before its start."""
    world, draw = configure(scenario, action="reference").world, drawn(5)
    level = numbered("reference")
    layout = follower_layout(LEVELS[level].state)
    x, own = filled(layout, draw), filled(Measured, draw)
    rows(own, Measured)["q"][:] = [[1.0], [0.0], [0.0], [0.0]]
    action, active = draw.uniform(-1.0, 1.0, 4 * LANES), flags(draw)
    moving, before = active * flags(draw), x.copy()
    command, by = tile(Wrench), world.follower_actuation
    command_follower(level, x, own, action, moving, active, line(world), by, command)
    for lane in range(LANES):
        was, now = lane_of(before, layout, lane), lane_of(x, layout, lane)
        guide, a = Guide(was["p"], was["v"]), action.reshape(-1, LANES)[:, lane]
        ref = guided((*(moving[lane] * a[:3]), 0.0), guide, complex(*was["estimate"]), world)
        moved = guide_on(guide, ref.a, world.clock.period) if active[lane] else guide
        np.testing.assert_allclose(now["p"], moved.p, rtol=1e-13)
        np.testing.assert_allclose(now["v"], moved.v, rtol=1e-13)
        wanted = track(motion(measured_in(own, lane)), ref, by, world)
        applied = saturate(wanted, by, world.airframe)
        found = lane_of(command, Wrench, lane)
        np.testing.assert_allclose(found["thrust"], applied.thrust, rtol=1e-9)
        np.testing.assert_allclose(found["turn"], applied.turn, rtol=1e-9, atol=1e-12)
        assert all(now[name] == was[name] for name in Follower._fields)


@pytest.mark.parametrize("actuation", [MOMENT, RATES])
def test_in_the_air_a_vehicle_kept_above_the_floor_flies_the_same(actuation: int) -> None:
    """Bit for bit: whether a tile looks out for the floor depends on other worlds of it."""
    frame, draw = line(configure("nominal").vehicle.airframe()), drawn(5)
    for scale in 10.0 ** draw.uniform(-3.0, 1.0, 200):
        x, command = filled(Measured, draw), filled(Wrench, draw) * scale
        for name in ("p", "v", "w"):
            rows(x, Measured)[name][:] *= scale
        height = rows(x, Measured)["p"][2]
        height[:] = -1000.0 - abs(height)
        rows(command, Wrench)["turn"][:] *= 1e-4  # moments that a vehicle has
        push = draw.normal(size=3 * LANES) * scale
        high, low, touch = x, x.copy(), tile(Touch)
        flight.clear_touch(touch)
        for _ in range(4):
            flight.fly(command, high, push, 0.005, actuation, frame)
            flight.fly_low(command, low, push, touch, 0.005, actuation, frame)
        np.testing.assert_array_equal(high, low)
        assert not rows(touch, Touch)["speed"].any()
        assert not rows(touch, Touch)["touching"].any()


@pytest.mark.parametrize("actuation", [MOMENT, RATES])
def test_a_vehicle_that_lands_is_kept_and_its_hardest_touch_down_noted(actuation: int) -> None:
    """As `quadrotor.touch_floor` keeps one alone; a softer one later leaves the speed and the attitude."""
    draw, h = drawn(6), 0.005
    frame = configure("nominal").vehicle.airframe()
    body, command = filled(Measured, draw), np.abs(filled(Wrench, draw))
    rows(body, Measured)["p"][2] *= 0.01
    touch, push = tile(Touch), filled(Vector3, draw)
    noted = rows(touch, Touch)
    noted["speed"][:] = draw.choice([0.0, 0.5, 5.0, np.inf], LANES)
    noted["uprightness"][:] = draw.uniform(-1.0, 1.0, LANES)
    noted["touching"][:] = draw.integers(0, 2, LANES)
    was, x = touch.copy(), body.copy()
    flight.fly_low(command, x, push, touch, h, actuation, line(frame))
    landed = 0
    for lane in range(LANES):
        m = measured_in(body, lane)
        state, applied = Body(m.p, m.v, m.q, m.w), Wrench(**lane_of(command, Wrench, lane))
        a = lane_of(push, Vector3, lane)["p"]
        flown = quadrotor.fly(state, applied, a, h, actuation, frame)
        kept, contact = quadrotor.touch_floor(flown, state)
        after = measured_in(x, lane)
        old, new = lane_of(was, Touch, lane), lane_of(touch, Touch, lane)
        np.testing.assert_allclose(
            flatten(Body(after.p, after.v, after.q, after.w)), flatten(kept), 1e-9, 1e-12
        )
        assert after.a == m.a
        harder = contact.touching and contact.speed > old["speed"]
        np.testing.assert_allclose(new["speed"], max(old["speed"], contact.speed), rtol=1e-9)
        expected = contact.uprightness if harder else old["uprightness"]
        np.testing.assert_allclose(new["uprightness"], expected, rtol=1e-9)
        assert new["touching"] == contact.touching
        landed += contact.touching
    assert 2 < landed < LANES - 2


def test_before_it_flies_nothing_has_touched_the_floor() -> None:
    touch = np.full(size(Touch) * LANES, 7.0)
    flight.clear_touch(touch)
    noted = rows(touch, Touch)
    assert (noted["speed"] == 0.0).all()
    assert (noted["uprightness"] == 1.0).all()
    assert (noted["touching"] == 0.0).all()


def test_lanes_may_meet_the_floor_each_for_itself() -> None:
    """Counted where active: those low or falling, not those high up; of moments and of rates."""
    config = configure()
    frame, clock = config.vehicle.airframe(), config.world.clock
    for seed in range(10):
        draw = drawn(seed)
        x, active = tile(Measured), flags(draw)
        low = draw.integers(0, 2, LANES).astype(np.bool_)
        named = rows(x, Measured)
        named["p"][2], named["q"][0] = np.where(low, -0.001, -1.0), 1.0
        named["v"][2] = 0.1
        constants = line(clock), line(frame), line(turning(frame, clock.period, clock.substeps))
        for actuation in (MOMENT, RATES):
            rest = tile(Wrench), np.zeros(3 * LANES), active, *constants, actuation
            assert flight.count_landing(x, *rest) == (low & (active > 0.0)).sum()


@pytest.mark.parametrize("actuation", [MOMENT, RATES])
def test_the_floor_is_looked_out_for_where_the_bounds_do_not_exclude_it(actuation: int) -> None:
    """Lane by lane what `turning` says of height, fall, thrust, push and turn; none of them alone decides."""
    config = configure()
    frame, clock = config.vehicle.airframe(), config.world.clock._replace(substeps=3)
    turns = turning(frame, clock.period, clock.substeps)
    constants, excluded = (line(clock), line(frame), line(turns)), []
    for seed in range(20):
        draw = drawn(seed)
        x, command, push = filled(Measured, draw), filled(Wrench, draw), filled(Vector3, draw)
        rows(x, Measured)["p"][2] = -(10.0 ** draw.uniform(-3.0, 0.0, LANES))
        rows(x, Measured)["v"][:2] *= 30.0
        rows(x, Measured)["w"][:] *= 10.0 ** draw.uniform(-1.0, 2.5, LANES)
        rows(command, Wrench)["turn"][:] *= 0.1 if actuation == MOMENT else 100.0
        push *= 30.0
        for lane in range(LANES):
            m, applied = measured_in(x, lane), Wrench(**lane_of(command, Wrench, lane))
            fall = lane_of(push, Vector3, lane)["p"][2]
            up = stays_up(m.p[2], m.v[2], applied.thrust, fall, clock.period, frame.mass)
            if actuation == MOMENT:
                slow = slow_by_moment(m.w, applied.turn, turns)
            else:
                h = clock.period / clock.substeps
                slow = slow_by_rates(m.w, applied.turn, h, frame.rate_lag)
            active = np.zeros(LANES)
            active[lane] = 1.0
            found = flight.count_landing(x, command, push, active, *constants, actuation)
            assert found == (not (up and slow))
            excluded.append((bool(up), bool(slow)))
    assert min(excluded.count((up, slow)) for up in (True, False) for slow in (True, False)) > 10


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")  # without the compiler
@pytest.mark.parametrize("part", ["p", "v", "q", "w"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_what_cannot_be_computed_is_noted_as_an_infinite_speed(part: str, value: float) -> None:
    draw = drawn(0)
    x, touch = filled(Measured, draw), draw.uniform(0.0, 2.0, size(Touch) * LANES)
    expected, bad = touch.copy(), draw.integers(0, 2, LANES).astype(np.bool_)
    rows(x, Measured)[part][0, bad] = value
    if part == "q":  # normalised, one that is infinite has become NaN and one too large zero
        rows(x, Measured)[part][:, bad] = 0.0 if value == 1e200 else np.nan
    flight.note_unsound(x, touch)
    rows(expected, Touch)["speed"][:, bad] = np.inf
    np.testing.assert_array_equal(touch, expected)


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_a_speed_that_overflows_is_sound_in_no_part_of_three() -> None:
    """`|p|^2 + |v|^2 + |w|^2` each alone beyond the numbers, and a quaternion shorter than half."""
    for part, value in (("p", 1e160), ("v", -1e160), ("w", 1e160), ("q", 0.4)):
        x, touch = tile(Measured), tile(Touch)
        rows(x, Measured)["q"][0] = 1.0
        rows(x, Measured)[part][0, 3] = value
        flight.note_unsound(x, touch)
        assert np.flatnonzero(np.isinf(rows(touch, Touch)["speed"][0])).tolist() == [3], part


@pytest.mark.parametrize(("purpose", "who", "block"), [(MEASUREMENT, 0, 0), (GUST, 3, 2)])
def test_normal_numbers_in_all_lanes_are_those_of_one_draw(
    purpose: int, who: int, block: int
) -> None:
    """Bit for bit, each lane with a key and a count of its own; both beyond 32 bits."""
    draw = drawn(9)
    keys, counts = draw.integers(0, 2**63, LANES).astype(np.uint64), draw.integers(0, 2**40, LANES)
    first, second = np.zeros((2, 2 * LANES), np.float32)
    flight.draw_words(keys, counts, purpose, who, block, first, second)
    flight.make_normal(first, second, 2)
    for lane in range(LANES):
        pairs = (tuple(x[lane::LANES].tolist()) for x in (first, second))
        expected = normals(keys[lane], purpose, who, counts[lane], block)
        assert flight.in_order(*pairs) == expected


def test_the_acceleration_measured_is_that_of_the_truth() -> None:
    """And nothing else is written; on the floor it is zero."""
    frame, draw = configure("paper").vehicle.airframe(), drawn(7)
    x, command, push = filled(Measured, draw), filled(Wrench, draw), filled(Vector3, draw)
    touch, before = tile(Touch), x.copy()
    rows(touch, Touch)["touching"][:] = flags(draw)
    flight.sense_exactly(command, touch, x, push, line(frame))
    for lane in range(LANES):
        was, now = measured_in(before, lane), measured_in(x, lane)
        on = bool(lane_of(touch, Touch, lane)["touching"])
        applied, a = Wrench(**lane_of(command, Wrench, lane)), lane_of(push, Vector3, lane)["p"]
        exact = truth(Body(was.p, was.v, was.q, was.w), applied, a, on, frame)
        np.testing.assert_allclose(now.a, exact.a, rtol=1e-13, atol=1e-13)
        assert (now.p, now.v, now.q, now.w) == (was.p, was.v, was.q, was.w)


@pytest.mark.skipif(bool(numba_config.DISABLE_JIT), reason="all tests are in plain Python")
def test_many_vehicles_fly_in_plain_python(tmp_path: Path) -> None:
    """No loop reads what an array does not hold: compiled, such a read would go unnoticed."""
    program = (
        "import sys, numpy as np; from formation_env.env import FormationEnv\n"
        "env = FormationEnv(scenario='swarm', followers=32, neighbours=3); env.reset(seed=0)\n"
        "for _ in range(2): seen = env.step(np.zeros(128, np.float32))[0]\n"
        "np.save(sys.argv[1], seen)"
    )
    seen = []
    for plain in ("0", "1"):
        path = tmp_path / f"{plain}.npy"
        subprocess.run(
            [sys.executable, "-W", "ignore::RuntimeWarning", "-c", program, str(path)],
            env={**os.environ, "NUMBA_DISABLE_JIT": plain},
            check=True,
        )
        seen.append(np.load(path))
    np.testing.assert_allclose(seen[0], seen[1], 1e-5, 1e-6)
