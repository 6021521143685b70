"""The textbook's controllers as policies: they fly the slot itself, from what is measured."""

from __future__ import annotations

from typing import Any, NamedTuple, final, get_type_hints

from baselines.policies.cascade import Feedforward, LoopGains
from baselines.policies.composed import Composed
from baselines.policies.kalman import Factors, Kalman
from baselines.policies.lee import Lee
from baselines.policies.lqr import Lqr
from baselines.policies.slot_motion import SlotPlanner
from formation_env import FormationConfig
from formation_env.configuration.parts import part

# The gains of `ff-filter` in one record.
_PARTS = (LoopGains, Factors)
_HINTS = [hint for kind in _PARTS for hint in get_type_hints(kind, include_extras=True).items()]
FilteredGains: Any = NamedTuple("FilteredGains", _HINTS)  # type: ignore[misc]
FilteredGains.__new__.__defaults__ = (*LoopGains(), *Factors())


@final
class Ff(Composed):
    """Position and velocity feedback on the slot, its acceleration fed forward. Without memory."""

    name = "ff"

    def __init__(self, config: FormationConfig, gains: Any = None) -> None:
        super().__init__(config, SlotPlanner(config), Feedforward(config, gains))


@final
class FfFilter(Composed):
    """`ff` on Kalman filters of what is measured; it remembers them, for each world.

    Its gains are those of `ff` and the factors on the filters' process noise, `FilteredGains`.
    """

    name = "ff-filter"

    def __init__(self, config: FormationConfig, gains: Any = None) -> None:
        planner = SlotPlanner(config)
        g = part("gains", FilteredGains() if gains is None else gains, FilteredGains())
        loops, factors = g[: len(LoopGains._fields)], g[len(LoopGains._fields) :]
        tracker = Feedforward(config, LoopGains(*loops))
        super().__init__(config, planner, tracker, Kalman(config, Factors(*factors)))


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
