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
from formation_env.lanes import LANES
from formation_env.memory import (
    ERROR_SQUARED,
    ESTIMATE,
    GUIDE_P,
    GUIDE_V,
    HEADING,
    SEPARATION_SQUARED,
)

from formation_env import configure, lanes
from formation_env.quadrotor import saturate
from formation_env.sensors import Measured
from formation_env.turning import turning
from formation_env.world import Guide, guide_on, guided, motion, track

Floats = npt.NDArray[np.float64]


def drawn(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def flags(draw: np.random.Generator) -> Floats:
    """Zeros and ones, a lane each."""
    return draw.integers(0, 2, LANES).astype(np.float64)


def headings(draw: np.random.Generator, x: Floats, row: int) -> None:
    """Unit vectors into two rows of a tile."""
    angle = draw.uniform(-np.pi, np.pi, LANES)
    x.reshape(-1, LANES)[row : row + 2] = np.cos(angle), np.sin(angle)


@pytest.mark.parametrize("anew", [0, 1, 2])
def test_worlds_named_step_or_are_reset(anew: int) -> None:
    for seed in range(20):
        draw = drawn(seed)
        named = draw.integers(0, 2, LANES).astype(np.bool_)
        over, started = draw.integers(0, 2, (2, LANES))
        active, moving = np.full(LANES, 7.0), np.full(LANES, 7.0)
        flying, waiting, standing = lanes.sort_out(named, over, started, anew, active, moving)
        fresh = named & ((anew == 2) | ((anew == 1) & (over != 0)))
        on = named & ~fresh
        np.testing.assert_array_equal(active, on)
        np.testing.assert_array_equal(moving, on & (started != 0))
        assert (flying, waiting, standing) == (on.sum(), fresh.sum(), (started == 0).sum())


def test_clocks_move_on_in_the_worlds_that_step() -> None:
    draw = drawn(0)
    active = flags(draw)
    moving = active * flags(draw)
    tick, clock = draw.integers(0, 100, (2, LANES))
    expected = tick + active, clock + moving
    lanes.move_on(active, moving, tick, clock)
    np.testing.assert_array_equal((tick, clock), expected)
    counts = np.zeros(LANES, np.uint64)
    lanes.number_samples(tick, counts)
    np.testing.assert_array_equal(counts, tick + 1)
    starts = np.zeros(LANES, np.int64)
    for rows in (0, 40, int(clock.max()), int(clock.max()) + 1):
        assert lanes.find_rows(clock, rows, 16, starts) == (clock >= rows).sum()
        np.testing.assert_array_equal(starts, 16 * clock)


def test_who_waits_for_the_start_is_counted() -> None:
    started, noted = drawn(1).integers(0, 2, LANES), np.full(LANES, 7.0)
    assert lanes.note_started(started, noted) == (started == 0).sum()
    np.testing.assert_array_equal(noted, started)


def test_an_episode_ends_by_a_failure_an_impact_of_the_leader_or_in_time() -> None:
    for seed in range(20):
        draw = drawn(seed)
        active, failed, total = flags(draw), flags(draw), draw.normal(size=LANES)
        impacts, tick = draw.uniform(0.0, 2.0, LANES), draw.integers(8, 13, LANES)
        before = draw.integers(0, 2, LANES)
        over, verdicts = before.copy(), np.zeros(3 * LANES)
        tally = np.concatenate([total, failed])
        lanes.conclude(active, tally, impacts, tick, 4.0, 1.0, 10, over, verdicts)
        on = active > 0.0
        ended = on & ((failed > 0.0) | (impacts > 1.0))
        late = on & (tick >= 10)
        np.testing.assert_array_equal(over, np.where(on, ended | late, before))
        np.testing.assert_array_equal(verdicts.reshape(3, LANES), [total / 4.0, ended, late])


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_the_nearest_are_kept_in_order_and_the_smaller_number_first(ranks: int) -> None:
    draw = drawn(2)
    own = draw.integers(0, 3, 3 * LANES).astype(np.float64)
    others = draw.integers(0, 3, (7, 3 * LANES)).astype(np.float64)  # many are equally far
    nearest, candidate = np.zeros((3, 2 * LANES)), np.zeros(2 * LANES)
    for held in nearest:
        lanes.forget(held)
    for j, other in enumerate(others):
        if ranks > 1:
            lanes.meet(own, other, float(j), nearest[0], nearest[1], candidate)
        else:
            lanes.measure(own, other, float(j), candidate)
            lanes.insert(candidate, nearest[0])
        for held in nearest[2:ranks]:
            lanes.insert(candidate, held)
    squares = ((others - own).reshape(7, 3, LANES) ** 2).sum(axis=1)
    order = np.argsort(squares, axis=0, kind="stable")[:ranks]
    found = nearest[:ranks].reshape(ranks, 2, LANES)
    np.testing.assert_array_equal(found[:, 1], order)
    np.testing.assert_array_equal(found[:, 0], np.take_along_axis(squares, order, axis=0))


def test_where_the_truth_is_measured_both_headings_are_that_of_the_truth() -> None:
    draw = drawn(3)
    x, leader, before = (
        draw.normal(size=8 * LANES),
        draw.normal(size=16 * LANES),
        draw.normal(size=32),
    )
    headings(draw, x, HEADING)
    rows = x.reshape(-1, LANES)
    rows[ESTIMATE : ESTIMATE + 2] = rows[HEADING : HEADING + 2]
    moving, both = flags(draw), x.copy()
    lanes.turn_headings(both, leader, before, leader, before, moving, -0.4, 0.02)
    once = x.copy()
    lanes.turn_headings_exactly(once, leader, before, moving, -0.4, 0.02)
    np.testing.assert_array_equal(once, both)
    turned = (once != x).reshape(-1, LANES)
    np.testing.assert_array_equal(turned[HEADING : ESTIMATE + 2].any(axis=0), moving > 0.0)
    assert not turned[ESTIMATE + 2 :].any()


def test_the_leader_is_the_first_that_a_follower_may_be_near() -> None:
    draw = drawn(4)
    x, leader, own = (
        np.zeros(8 * LANES),
        draw.normal(size=(2, 16 * LANES))[0],
        draw.normal(size=256),
    )
    headings(draw, x, HEADING)
    begin, started = draw.normal(size=3 * LANES), flags(draw)
    out = np.zeros(15 * LANES)
    lanes.locate(x, leader, own, begin, started, (0.3, -0.2, 0.1), out)
    apart = ((own - leader).reshape(-1, LANES)[:3] ** 2).sum(axis=0)
    rows = out.reshape(-1, LANES)
    np.testing.assert_allclose(rows[SEPARATION_SQUARED], apart, rtol=1e-14)
    # The slot is at the leader, or where it will start from: the offset's length away.
    anchor = np.where(started, leader.reshape(-1, LANES)[:3], begin.reshape(3, LANES))
    slots = rows[5:8]
    np.testing.assert_allclose(((slots - anchor) ** 2).sum(axis=0), 0.09 + 0.04 + 0.01)
    error = ((slots - own.reshape(-1, LANES)[:3]) ** 2).sum(axis=0)
    np.testing.assert_allclose(rows[ERROR_SQUARED], error, rtol=1e-14)


@pytest.mark.parametrize("scenario", ["nominal", "experiment"])
def test_a_guided_follower_is_commanded_as_one_alone(scenario: str) -> None:
    """Along its virtual follower, which moves on where the world steps, and waits before its start."""
    world, draw = configure(scenario, action="reference").world, drawn(5)
    x, own = draw.normal(size=14 * LANES), draw.normal(size=16 * LANES)
    headings(draw, x, ESTIMATE)
    own.reshape(-1, LANES)[9:13] = [[1.0], [0.0], [0.0], [0.0]]
    action, active = draw.uniform(-1.0, 1.0, 4 * LANES), flags(draw)
    moving, before = active * flags(draw), x.copy()
    command = np.zeros(4 * LANES)
    loop: Any = lanes.guide_by_rates if world.follower_actuation else lanes.guide_by_moment
    loop(x, own, action, moving, active, command, world)
    rows, was, seen, a = (b.reshape(-1, LANES) for b in (x, before, own, action))
    for lane in range(LANES):
        guide = Guide(
            tuple(was[GUIDE_P : GUIDE_P + 3, lane]), tuple(was[GUIDE_V : GUIDE_V + 3, lane])
        )
        R = complex(was[ESTIMATE, lane], was[ESTIMATE + 1, lane])
        ref = guided((*(moving[lane] * a[:3, lane]), 0.0), guide, R, world)
        moved = guide_on(guide, ref.a, world.clock.period) if active[lane] else guide
        np.testing.assert_allclose(rows[GUIDE_P : GUIDE_P + 3, lane], moved.p, rtol=1e-13)
        np.testing.assert_allclose(rows[GUIDE_V : GUIDE_V + 3, lane], moved.v, rtol=1e-13)
        m = Measured(
            *(tuple(seen[i:j, lane]) for i, j in ((0, 3), (3, 6), (6, 9), (9, 13), (13, 16)))
        )
        wanted = track(motion(m), ref, world.follower_actuation, world)
        applied = saturate(wanted, world.follower_actuation, world.airframe)
        found = command.reshape(4, LANES)[:, lane]
        np.testing.assert_allclose(found, [applied.thrust, *applied.turn], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(rows[:GUIDE_P], was[:GUIDE_P])


def test_lanes_may_meet_the_floor_each_for_itself() -> None:
    """Counted where active: those low or falling, not those high up; of moments and of rates."""
    frame = configure().vehicle.airframe()
    for seed in range(10):
        draw = drawn(seed)
        x, active = np.zeros((16, LANES)), flags(draw)
        low = draw.integers(0, 2, LANES).astype(np.bool_)
        x[2], x[9] = np.where(low, -0.001, -1.0), 1.0
        x[5], command = 0.1, np.zeros(4 * LANES)
        rest = x.ravel(), command, np.zeros(3 * LANES), active, 0.02
        expected = (low & (active > 0.0)).sum()
        turn = turning(frame, 0.02, 4)
        assert lanes.doubtful_by_moment(*rest, frame.mass, turn) == expected
        assert lanes.doubtful_by_rates(*rest, 0.005, frame) == expected


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")  # without the compiler
@pytest.mark.parametrize("row", [0, 3, 9, 13])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_what_cannot_be_computed_is_noted_as_an_infinite_speed(row: int, value: float) -> None:
    draw = drawn(row)
    x, touch = draw.normal(size=(16, LANES)), draw.uniform(0.0, 2.0, 3 * LANES)
    x[9:13] /= np.linalg.norm(x[9:13], axis=0)
    expected, bad = touch.copy(), draw.integers(0, 2, LANES).astype(np.bool_)
    x[row, bad] = value
    if row == 9:  # normalised, one that is infinite has become NaN and one too large zero
        x[9:13, bad] = 0.0 if value == 1e200 else np.nan
    lanes.note_unsound(x.ravel(), touch)
    expected[:LANES][bad] = np.inf
    np.testing.assert_array_equal(touch, expected)


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
