"""The textbook's controllers as policies: they fly the slot itself, from what is measured."""

from __future__ import annotations

from typing import Any, final

from baselines.policies.cascade import Feedforward
from baselines.policies.composed import Composed
from baselines.policies.kalman import Kalman
from baselines.policies.lee import Lee
from baselines.policies.lqr import Lqr
from baselines.policies.slot_motion import SlotPlanner
from formation_env import FormationConfig


@final
class Ff(Composed):
    """Position and velocity feedback on the slot, its acceleration fed forward. Without memory."""

    name = "ff"

    def __init__(self, config: FormationConfig, gains: Any = None) -> None:
        super().__init__(config, SlotPlanner(config), Feedforward(config, gains))


@final
class FfFilter(Composed):
    """`ff` on Kalman filters of what is measured; it remembers them, for each world."""

    name = "ff-filter"

    def __init__(self, config: FormationConfig, gains: Any = None) -> None:
        planner, tracker = SlotPlanner(config), Feedforward(config, gains)
        super().__init__(config, planner, tracker, Kalman(config))


@final
class LeeSlot(Composed):
    """Geometric tracking on SE(3) of the slot. Without memory."""

    name = "lee"

    def __init__(self, config: FormationConfig, gains: Any = None) -> None:
        super().__init__(config, SlotPlanner(config), Lee(config, gains))


@final
class LqrSlot(Composed):
    """The linear-quadratic regulator about hover, on the slot. Without memory."""

    name = "lqr"

    def __init__(self, config: FormationConfig, weights: Any = None) -> None:
        super().__init__(config, SlotPlanner(config), Lqr(config, weights))
