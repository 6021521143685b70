"""What it costs that the third and fourth derivatives of the planner's reference are not measured.

The tracker wants four derivatives (67), the planner gives two (35). The others are set to zero, as in
the paper's experiment, or derived from the law with the leader's jerk and snap taken as zero, or
derived exactly, which only the trajectory itself allows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.reproduction import sampled
from baselines.reproduction.claims import Cost
from baselines.reproduction.continuous import (
    AIRFRAME,
    BODY,
    EIGHT,
    PLANNER,
    TRACKER,
    body_of,
    fields_of,
    flown,
    grid,
    integrate,
    put_body,
    vector,
)
from formation_env._jit import device, kernel
from formation_env.config import NO_NOISE
from formation_env.laws.feedforward import full_trajectory_point
from formation_env.laws.planner import PlannerLaw, Virtual, place, plane
from formation_env.laws.planner import derivative as planner_derivative
from formation_env.laws.planner import trajectory_point as planner_trajectory_point
from formation_env.laws.tracker import TrackerLaw
from formation_env.laws.world import World, trimmed
from formation_env.maths.so3 import ZERO, Vector
from formation_env.memory.records import line_loader, line_storer, size
from formation_env.paths.references import Floats, TrajectoryPoint, evaluate
from formation_env.physics.quadrotor import Airframe, Body
from formation_env.scenarios import configure

ZERO_FED, DERIVED, EXACT = 0, 1, 2
_NAMES = ("zero", "derived", "derived, leader's exact")


@device
def _fed(
    f: Virtual, leader: TrajectoryPoint, d: Vector, law: PlannerLaw, mode: int
) -> TrajectoryPoint:
    """The reference of a virtual follower with its higher derivatives made in one of three ways."""
    if mode == ZERO_FED:
        return planner_trajectory_point(f, leader, d, law)
    if mode == DERIVED:  # the leader's jerk and snap are not measured
        leader = TrajectoryPoint(leader.p, leader.v, leader.a, ZERO, ZERO)
    return full_trajectory_point(f, leader, d, law)


_read_follower, _write_follower = line_loader(Virtual), line_storer(Virtual)
_FOLLOWER = size(Virtual)


@kernel
def _pair_rate(
    t: float,
    y: Floats,
    kind: int,
    table: Floats,
    d: Floats,
    planner: PlannerLaw,
    airframe: Airframe,
    law: TrackerLaw,
    mode: int,
) -> Floats:
    """A virtual follower and the quadrotor that flies along it."""
    leader = evaluate(kind, table, t)
    f = _read_follower(y)
    rate = np.empty_like(y)
    _write_follower(rate, planner_derivative(f, leader, vector(d), planner))
    ref = _fed(f, leader, vector(d), planner, mode)
    put_body(rate[_FOLLOWER:], flown(body_of(y[_FOLLOWER:]), ref, airframe, law))
    return rate


@kernel
def _pair_start(kind: int, table: Floats, d: Floats, planner: PlannerLaw, world: Any) -> Floats:
    """Both with null errors at `t = 0`."""
    leader = evaluate(kind, table, 0.0)
    v = plane(leader.v)
    f = place(leader.p, leader.v, vector(d), v / abs(v), True)
    y = np.empty(_FOLLOWER + BODY)
    _write_follower(y, f)
    put_body(
        y[_FOLLOWER:], trimmed(full_trajectory_point(f, leader, vector(d), planner), 0.0, world)
    )
    return y


def tracking_error(mode: int, d: Vector, world: World, duration: float = 60.0) -> float:
    """RMS of a quadrotor's `|e1|` behind its virtual follower from 20 s on, m, without noise.

    The leader is the trajectory (31) itself; `mode` is `ZERO_FED`, `DERIVED` (the leader's jerk and
    snap taken as zero) or `EXACT`. `world` is a configuration's `World`.
    """
    t = grid(duration, 0.02)
    planner = PLANNER.law()
    start = _pair_start(EIGHT.kind, EIGHT.table, np.array(d), planner, world)
    y = integrate(
        _pair_rate,
        start,
        t,
        EIGHT.kind,
        EIGHT.table,
        np.array(d),
        planner,
        AIRFRAME,
        TRACKER.law(),
        mode,
    )
    late = y[t >= min(20.0, 0.5 * duration)]
    virtual, vehicle = fields_of(Virtual, late), fields_of(Body, late[:, _FOLLOWER:])
    gap = vehicle["p"] - np.column_stack([virtual["p"], virtual["z"]])
    return float(np.sqrt((gap**2).sum(axis=1).mean()))


def _cost(run: sampled.Run, setting: str, feedforward: str) -> Cost:
    worlds = range(run.p.shape[1])
    error = np.concatenate([run.tracking[run.steady(w), w] for w in worlds])
    return Cost(setting, feedforward, float(np.sqrt((error**2).sum(axis=-1).mean())))


def feedforward_costs(seed: int, worlds: int) -> list[Cost]:
    """Tracking errors of a vehicle behind its virtual follower, in three settings.

    The noisy one is measured over `worlds` seeds from `seed` on.
    """
    config = configure("paper")
    costs = [
        Cost(
            "continuous, leader on (31)",
            name,
            tracking_error(way, config.offsets[0], config.world),
        )
        for way, name in enumerate(_NAMES)
    ]
    for name in _NAMES[:2]:
        clean = sampled.fly("paper", noise=NO_NOISE, feedforward=name)
        costs.append(_cost(clean, "figures 6-9 at 50 Hz, no noise", name))
    for name in _NAMES[:2]:
        noisy = sampled.fly("paper", seed, worlds, feedforward=name)
        costs.append(_cost(noisy, "figures 6-9 at 50 Hz, noise", name))
    return costs
