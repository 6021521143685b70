"""One recorded flight: the configuration, the true motion at every instant, what was commanded and earned."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env import FormationConfig
from formation_env.task import FAILURES

Floats = NDArray[np.float64]


class Episode(NamedTuple):
    """A flight of T ticks with n followers: T + 1 instants, the first at reset, the last after the last tick.

    Inertial frame north-east-down. Of a flight that ended because a state could no longer be computed the
    last instant may hold numbers that are not finite.
    """

    policy: str  # name of what flew
    seed: int | None  # of the reset; None: not known
    config: FormationConfig
    time: Floats  # (T+1,) s since reset
    started: NDArray[np.bool_]  # (T+1,) whether the trigger (40) has fired
    positions: Floats  # (T+1, 1+n, 3) m, leader first
    velocities: Floats  # (T+1, 1+n, 3) m/s
    attitudes: Floats  # (T+1, 1+n, 4) unit quaternions (w, x, y, z), body to inertial
    angular_velocities: Floats  # (T+1, 1+n, 3) rad/s, body
    slots: Floats  # (T+1, n, 3) m, where the followers should be
    actions: NDArray[np.float32]  # (T, n, k) in [-1, 1], as executed from instant j to j + 1
    rewards: Floats  # (T, n) of the tick
    failure: NDArray[np.int64]  # (n,) at the end, indices into `task.FAILURES`
    path: Floats  # (M, 3) m, the leader's reference path
    lyapunov: (
        Floats  # (T, n, 4) V1 to V4 at each decision, or (0, n, 4) where no law of the paper flew
    )
    metrics: dict[str, float]  # by the names of `baselines.scoring.metrics.EPISODE`; may be NaN

    def __repr__(self) -> str:
        seed = "" if self.seed is None else f", seed {self.seed}"
        return (
            f"<Episode: {self.policy} on {self.config.scenario}:{self.config.action}{seed}, "
            f"{self.config.followers} followers, {self.time[-1]:g} s, {self.end()}>"
        )

    @property
    def errors(self) -> Floats:
        """Distances of the followers from their slots, `(T+1, n)`, m."""
        e: Floats = np.linalg.norm(self.slots - self.positions[:, 1:], axis=-1)
        return e

    def end(self) -> str:
        """How the flight ended, in words."""
        return ending(self.failure, float(self.time[-1]))


def ending(failure: NDArray[np.int64], time: float) -> str:
    """How a flight ended at `time` (s since reset) with these kinds of failure, `(n,)`, in words."""
    failed = np.flatnonzero(failure)
    if not len(failed):
        return "no failure"
    kind = FAILURES[failure[failed[0]]]
    when = f"at {time:.2f} s"
    if kind == "leader":
        return f"leader crashed {when}"
    if kind == "unstarted":
        return f"not started by the deadline, {when}"
    who = ", ".join(str(i + 1) for i in failed if FAILURES[failure[i]] == kind)
    return f"{kind} of follower{'s' if ',' in who else ''} {who} {when}"
