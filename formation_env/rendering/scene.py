"""What a picture shows."""

from __future__ import annotations

from typing import NamedTuple

from formation_env.paths.references import Floats


class Scene(NamedTuple):
    """One world at one instant; inertial frame (north, east, down), `n` followers."""

    time: float  # s since reset
    started: bool  # whether the trigger (40) has fired
    positions: Floats  # (1+n, 3), m, the leader first
    attitudes: Floats  # (1+n, 4), unit quaternions (w, x, y, z), body to inertial
    slots: Floats  # (n, 3), m, where the followers should be
    path: Floats  # (M, 3), m, the leader's reference path; may be empty
