"""The gains of a textbook law as points of a space in which every point is allowed.

    gain = own gain exp(x)                             positive, within its bounds
    upwards = bound share,  share = 1 / (1 + exp(-own - x))   stays below what keeps the thrust's direction

So `x = 0` is the plain gains, and a unit of `x` changes a gain by a factor of about e.
"""

from __future__ import annotations

from math import exp
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.textbook_tuned import LAWS
from formation_env import FormationConfig
from formation_env.memory.records import notes
from train.tune_expert.gain_space import share

# Of others than `lqr`, where the environment's tracker flies the follower.
_UNUSED = ("attitude", "rate", "own_push")


@final
class LoopSpace:
    """The gains that a law of `LAWS` may have, around its plain ones."""

    def __init__(self, law: str, config: FormationConfig) -> None:
        self._plain = LAWS[law].gains()
        fields = self._plain._fields
        if config.action == "reference" and law != "lqr":
            fields = tuple(name for name in fields if name not in _UNUSED)
        self.names: tuple[str, ...] = fields

    def gains(self, x: NDArray[np.float64], choice: str) -> Any:
        """The gains at a point `(len(names),)`; there is one `choice` alone."""
        kind: Any = type(self._plain)
        bounds = notes(kind)
        found = {}
        for name, at in zip(self.names, map(float, x), strict=True):
            plain, bound = getattr(self._plain, name), bounds[name]
            if name == "upwards":
                found[name] = bound.high * share(plain / bound.high, at)
            else:
                found[name] = min(max(plain * exp(at), bound.low), bound.high)
        return self._plain._replace(**found)
