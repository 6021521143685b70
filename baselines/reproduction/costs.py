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
    flown,
    grid,
    integrate,
    leader_at,
    put_body,
    vector,
)
from formation_env._jit import device, kernel
from formation_env.config import NO_NOISE
from formation_env.feedforward import full_reference
from formation_env.planner import Leader, PlannerLaw, Virtual, place, plane
from formation_env.planner import derivative as planner_derivative
from formation_env.planner import reference as planner_reference
from formation_env.quadrotor import Airframe
from formation_env.references import Floats, Reference
from formation_env.scenarios import configure
from formation_env.so3 import ZERO, Vector
from formation_env.tracker import TrackerLaw
from formation_env.world import World, trimmed

ZERO_FED, DERIVED, EXACT = 0, 1, 2
_NAMES = ("zero", "derived", "derived, leader's exact")


@device
def _fed(f: Virtual, leader: Leader, d: Vector, law: PlannerLaw, mode: int) -> Reference:
    """The reference of a virtual follower with its higher derivatives made in one of three ways."""
    if mode == ZERO_FED:
        return planner_reference(f, leader, d, law)
    if mode == DERIVED:  # the leader's jerk and snap are not measured
        leader = Leader(leader.p, leader.v, leader.a, ZERO, ZERO)
    return full_reference(f, leader, d, law)


@device
def _follower(y: Any) -> Virtual:
    return Virtual(complex(y[0], y[1]), y[2], y[3], y[4], complex(y[5], y[6]), y[7], y[8])


_FOLLOWER = 9


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
    leader = leader_at(kind, table, t)
    f = _follower(y)
    r = planner_derivative(f, leader, vector(d), planner)
    rate = np.empty_like(y)
    rate[0], rate[1], rate[2], rate[3], rate[4] = r.p.real, r.p.imag, r.theta, r.u, r.omega
    rate[5], rate[6], rate[7], rate[8] = r.xi.real, r.xi.imag, r.z, r.w
    ref = _fed(f, leader, vector(d), planner, mode)
    put_body(rate[_FOLLOWER:], flown(body_of(y[_FOLLOWER:]), ref, airframe, law))
    return rate


@kernel
def _pair_start(kind: int, table: Floats, d: Floats, planner: PlannerLaw, world: Any) -> Floats:
    """Both with null errors at `t = 0`."""
    leader = leader_at(kind, table, 0.0)
    v = plane(leader.v)
    f = place(leader.p, leader.v, vector(d), v / abs(v), True)
    y = np.empty(_FOLLOWER + BODY)
    y[0], y[1], y[2], y[3], y[4] = f.p.real, f.p.imag, f.theta, f.u, f.omega
    y[5], y[6], y[7], y[8] = f.xi.real, f.xi.imag, f.z, f.w
    put_body(y[_FOLLOWER:], trimmed(full_reference(f, leader, vector(d), planner), world))
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
    gap = late[:, _FOLLOWER : _FOLLOWER + 3] - late[:, [0, 1, 7]]
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
