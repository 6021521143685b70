"""What one call of a simulation returns."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from formation_env.core.arrays import Verdict
from formation_env.memory.records import size, slices
from formation_env.memory.store import Floats
from formation_env.task import Outcome

if TYPE_CHECKING:
    from formation_env.config import FormationConfig


_ENDS = {name: where.start for name, where in slices(Verdict).items()}


class Results(NamedTuple):
    """What one call returns, fresh arrays."""

    observations: NDArray[np.float32]  # (W, n, entries)
    outputs: Floats  # (W, n, numbers of an `Outcome`)
    ends: Floats  # (3, W): `Verdict`
    final_observations: NDArray[np.float32]  # as observations, empty unless asked for
    final_outputs: Floats

    @property
    def rewards(self) -> Floats:
        """The followers' mean reward, `(W,)`."""
        rewards: Floats = self.ends[_ENDS["reward"]]
        return rewards

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """`(W,)`."""
        flags: NDArray[np.bool_] = np.not_equal(self.ends[_ENDS["terminated"]], 0.0)
        return flags

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """`(W,)`."""
        flags: NDArray[np.bool_] = np.not_equal(self.ends[_ENDS["truncated"]], 0.0)
        return flags


@final
class Shapes:
    """Of what one call returns, for the fewest operations in a step of a lone world."""

    def __init__(self, config: FormationConfig, worlds: int) -> None:
        self.observations = (worlds, config.followers, config.layout.size)
        self.outputs = (worlds, config.followers, size(Outcome))
        self.ends = (size(Verdict), worlds)

    def results(self, final: bool) -> Results:
        """Fresh arrays; the kernel fills them all but those of episodes that did not end."""
        observations, outputs = np.empty(self.observations, _SINGLE), np.empty(self.outputs)
        if not final:
            return Results(observations, outputs, np.empty(self.ends), _NOTHING, _NO_OUTPUTS)
        last = np.zeros(self.observations, _SINGLE), np.zeros(self.outputs)
        return Results(observations, outputs, np.empty(self.ends), *last)


_SINGLE = np.dtype(np.float32)
_NOTHING = np.zeros((0, 0, 0), _SINGLE)
_NO_OUTPUTS = np.zeros((0, 0, size(Outcome)))
