"""The gains as points of a space in which every point satisfies the paper's conditions.

    k = own k exp(x)                                 positive
    k2 = 1 + (own k2 - 1) exp(x)                     theorem 1: k2 > 1 (planner)
    k3 = (k1 k2)^2 (own + x)^2                       theorem 1: k3 >= 0; 0 is a point inside
    z_max = room share, sigma_max = room share       (53): what the other one leaves below g
    p11 = k2^2 / k1 share                            P (56) and Q (57) positive definite (tracker)

A share is `1 / (1 + exp(-own - x))`. So `x = 0` is the configuration's own gains, and a unit of `x` changes a
gain by a factor of about e.
"""

from __future__ import annotations

from dataclasses import fields
from math import exp, log, sqrt
from typing import final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.tuned import Gains, own, tracker_field
from formation_env import FormationConfig
from formation_env.laws.gains import PlannerGains, TrackerGains
from formation_env.physics.quadrotor import GRAVITY

REACH = 4.0  # how far a point may be from the own gains, either way: factors of about 55

PLANNER = tuple(f.name for f in fields(PlannerGains))
# Vehicles driven by rates have no loop for `k4` and `kz` (54), (65).
# By the field of the configuration, none where the environment's tracker flies the follower.
TRACKERS: dict[str | None, tuple[str, ...]] = {
    "tracker": ("k1", "k2", "k3", "k4", "kz", "sigma_max", "c", "p11"),
    "rates_tracker": ("k1", "k2", "k3", "sigma_max", "c", "p11"),
    None: (),
}


def _logit(share: float) -> float:
    return log(share / (1.0 - share))


def share(own_share: float, x: float) -> float:
    """A share in (0, 1) that grows with `x` and is the own one at zero."""
    return 1.0 / (1.0 + exp(-_logit(own_share) - x))


@final
class GainSpace:
    """The gains that a follower of a configuration may have, around the configuration's own."""

    def __init__(self, config: FormationConfig) -> None:
        self._config = config
        self._own = own(config)
        self._tracker = TRACKERS[tracker_field(config)]
        self.names = (*PLANNER, *(f"tracker.{name}" for name in self._tracker))

    def gains(self, x: NDArray[np.float64], feedforward: str) -> Gains:
        """The gains at a point `(len(names),)`."""
        at = dict(zip(self.names, map(float, x), strict=True))
        planner = self._planner(at)
        tracker = self._tracker_gains(at, planner.z_max) if self._tracker else None
        return Gains(planner, tracker, feedforward)

    def _planner(self, at: dict[str, float]) -> PlannerGains:
        base = self._config.planner
        k1 = base.k1 * exp(at["k1"])
        k2 = 1.0 + (base.k2 - 1.0) * exp(at["k2"])
        # With k3 = (k1 k2)^2 r^2 the poles of e2 depend on k1 k2 in size and on r in kind only.
        root = sqrt(base.k3) / (base.k1 * base.k2) + at["k3"]
        room = GRAVITY - self._kept_sigma()
        return PlannerGains(
            k1,
            k2,
            (k1 * k2 * root) ** 2,
            base.kz1 * exp(at["kz1"]),
            base.kz2 * exp(at["kz2"]),
            base.p_max * exp(at["p_max"]),
            room * share(base.z_max / room, at["z_max"]),
        )

    def _kept_sigma(self) -> float:
        """The largest `sigma_max` among the trackers that are not searched, m/s^2."""
        kept = {"tracker", "rates_tracker"} - {tracker_field(self._config)}
        return max(float(getattr(self._config, name).sigma_max) for name in kept)

    def _tracker_gains(self, at: dict[str, float], z_max: float) -> TrackerGains:
        base = self._own.tracker
        assert base is not None
        near = {
            name: getattr(base, name) * exp(at.get(f"tracker.{name}", 0.0))
            for name in ("k1", "k2", "k3", "k4", "kz", "c")
        }
        room = GRAVITY - max(z_max, self._config.reference_max[2])
        before = GRAVITY - max(self._config.planner.z_max, self._config.reference_max[2])
        most = near["k2"] ** 2 / near["k1"]
        own_share = base.p11 * base.k1 / base.k2**2
        return TrackerGains(
            **near,
            sigma_max=room * share(base.sigma_max / before, at["tracker.sigma_max"]),
            p11=most * share(own_share, at["tracker.p11"]),
        )
