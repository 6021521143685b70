"""A policy of a planner part and a tracker part.

With `PaperPlanner` and `PaperTracker` it is the expert; either can be exchanged for another, or for one of
your own: see `baselines.policies.parts`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.policies.actions import clipped
from baselines.policies.base import Policy, Rows
from baselines.policies.parts import (
    Estimator,
    Measured,
    Part,
    Planner,
    Points,
    Tracker,
    measured,
    part_of,
)
from baselines.policies.vectors import Floats, components, in_frame, out_of_frame
from formation_env import FormationConfig
from formation_env._jit import plain
from formation_env.laws.levels import acceleration_action, wrench_action
from formation_env.physics.quadrotor import Wrench


class Composed(Policy):
    """Flies each vehicle by `tracker` along the trajectory that `planner` gives, at every action level.

    `estimator`, if any, replaces what is measured before both. Raises `ValueError` for what is no part for
    the configuration; in flight it does, naming the part, where one returns numbers of another shape, or
    that are not finite.
    """

    name = "composed"

    def __init__(
        self,
        config: FormationConfig,
        planner: Planner,
        tracker: Tracker,
        estimator: Estimator | None = None,
    ) -> None:
        super().__init__(config)
        part_of("planner", planner, Planner, config)
        part_of("tracker", tracker, Tracker, config)
        self._parts: list[Part] = [planner, tracker]
        if estimator is not None:
            part_of("estimator", estimator, Estimator, config)
            self._parts.append(estimator)
        self.planner, self.tracker, self.estimator = planner, tracker, estimator

    @property
    def remembers(self) -> bool:
        return any(part.remembers for part in self._parts)

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        for part in self._parts:
            part.begin(len(seeds))

    def begin_again(self, mask: NDArray[np.bool_]) -> None:
        for part in self._parts:
            part.begin_again(mask)

    def decide(self, rows: Rows) -> Rows:
        m = measured(rows, self.config)
        known = m if self.estimator is None else self.estimator.estimate(m)
        point, shape = self.planner.plan(known), m.motion.p.shape
        for name, value in zip(Points._fields, point, strict=True):
            self._check(f"{name} of {type(self.planner).__name__}.plan", value, shape)
        reach, tracker = self.config.world.reach, type(self.tracker).__name__
        if self.config.action == "reference":
            a = self._acceleration(m, point)
            self._check(f"what {tracker}.acceleration returned", a, shape)
            wanted = components(in_frame(m.heading, a))
            return clipped(np.stack(plain(acceleration_action)(wanted, reach), axis=-1))
        command: Any = self.tracker.command(known.motion, point)
        thrust, turn = command
        self._check(f"the thrust of {tracker}.command", thrust, shape[:2])
        self._check(f"the turn of {tracker}.command", turn, shape)
        action = plain(wrench_action)(Wrench(thrust, components(turn)), reach)
        return clipped(np.stack(action, axis=-1))

    def _acceleration(self, m: Measured, point: Points) -> Floats:
        """Of the environment's virtual followers, which are known as exactly as the action moves them."""
        p = m.motion.p + out_of_frame(m.heading, m.entries["guide_position"])
        v = m.motion.v + out_of_frame(m.heading, m.entries["guide_velocity"])
        return self.tracker.acceleration(p, v, point, self.planner.velocity_after(point))

    def _check(self, what: str, value: object, shape: tuple[int, ...]) -> None:
        if not isinstance(value, np.ndarray) or value.shape != shape:
            found = (
                f"shape {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
            )
            raise ValueError(f"{what}: {found}: expected numbers of shape {shape}")
        if not np.isfinite(value).all():
            raise ValueError(
                f"{what}: expected finite numbers, not {value[~np.isfinite(value)][0]}"
            )
