"""The Lyapunov functions of the paper's laws in flight, from what the expert records of its decisions."""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from baselines.policies.tuned import ExpertTuned, lawful
from baselines.replay.episode import Floats
from formation_env._jit import kernel
from formation_env.laws.tracker import Motion, TrackerLaw, certificate
from formation_env.maths.so3 import ZERO
from formation_env.paths.references import TrajectoryPoint
from formation_env.physics.quadrotor import MOMENT

NAMES = ("V1", "V2", "V3", "V4")
_LEAST = 1e-9  # of a function whose logarithm is drawn


def with_record(policy: Policy) -> Policy:
    """The expert, plain or tuned, as one that records its errors and decides the same; any other as it is."""
    if type(policy) is Expert:
        return Expert(policy.config, keep_record=True)
    if type(policy) is ExpertTuned:
        law = lawful(policy.config, policy.gains)
        return Expert(law, policy.gains.feedforward, keep_record=True)
    return policy


def is_recorded(expert: Expert) -> bool:
    """Whether it keeps a record and has decided something."""
    return len(expert.record["heading"]) > 0


def values(expert: Expert) -> Floats:
    """V1 (8) and V2 (12) of the planner, V3 (63) and V4 (66) of the tracker, at the last decision, `(n, 4)`.

    Of the errors as the expert measures them; m^2 and, of the tracker, as the paper weighs them. V_sigma (55)
    is a function of the position loop's errors alone, so it is `certificate`'s for a vehicle that has
    those errors and is level.
    """
    e = {name: rows[0] for name, rows in expert.record.items()}
    V1 = 0.5 * _squared(e["planner_e1"])
    world = expert.config.world
    law = world.tracker if expert.config.follower_actuation == MOMENT else world.rates_tracker
    V_sigma = _position_loop(e["tracker_e1"], e["tracker_e2"], law)
    V3 = V_sigma + 0.5 * _squared(e["tracker_e3"])
    return np.stack(
        [V1, V1 + 0.5 * _squared(e["planner_e2"]), V3, V3 + 0.5 * _squared(e["tracker_e4"])], -1
    )


def logarithms(functions: Floats) -> Floats:
    """Base 10, of at least `_LEAST`: what the pages draw."""
    found: Floats = np.log10(np.maximum(functions, _LEAST))
    return found


def _squared(e: Floats) -> Floats:
    square: Floats = (e * e).sum(axis=-1)
    return square


_LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@kernel
def _position_loop(e1: Any, e2: Any, law: TrackerLaw) -> Floats:
    """V_sigma (55) of errors `(n, 3)`, `(n,)`."""
    still = TrajectoryPoint(ZERO, ZERO, ZERO, ZERO, ZERO)
    out = np.empty(len(e1))
    for i in range(len(e1)):
        p, v = (e1[i, 0], e1[i, 1], e1[i, 2]), (e2[i, 0], e2[i, 1], e2[i, 2])
        out[i] = certificate(Motion(p, v, _LEVEL, ZERO), still, law).V_sigma
    return out
