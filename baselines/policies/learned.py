"""A policy that was learned, run from its file by NumPy.

Its network takes one follower's row at a time, so one file serves any number of followers and worlds,
and a row's action depends on no other row, to the last bit (see `forward`).
"""

from __future__ import annotations

import os
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from baselines.files import Card, Network, check, load
from baselines.policies.actions import clipped, corrected
from baselines.policies.base import Policy, Rows
from baselines.policies.expert import Expert
from baselines.policies.forward import LANES, gathered, layer, padded, spread
from baselines.policies.transfer import warn_of_transfer
from formation_env import FormationConfig

_ROWS = 1024  # at a time, so that what lies between the layers stays in the cache

Source = tuple[Card, Network]


class Misfit(ValueError):
    """A policy that is not for this configuration."""


@final
class Learned(Policy):
    """The policy of a file, or of a card and its network, in its deterministic mode.

    Raises `ValueError` for a bad file, `Misfit` where observation or action are not the
    configuration's; warns with `TransferWarning` where it was trained for another task.
    """

    name = "learned"

    def __init__(self, config: FormationConfig, source: str | os.PathLike[str] | Source) -> None:
        super().__init__(config)
        if isinstance(source, tuple):
            check(*source)
            self.card, network = source
        else:
            self.card, network = load(source)
        require_fit(self.card, config)
        warn_of_transfer(self.card, config)
        self._layers = [
            (padded(W), padded(b)) for W, b in zip(network.weights, network.biases, strict=True)
        ]
        self._mean, self._scale = network.mean, network.scale
        self._expert = Expert(config) if self.card.residual > 0.0 else None
        # The last normalised observations of each row, newest last: (rows, history, entries).
        self._history = np.zeros((0, self.card.history, self.card.entries), dtype=np.float32)
        self._fresh = np.zeros(0, dtype=np.bool_)  # (rows,), those whose episode begins

    @property
    def remembers(self) -> bool:
        return self.card.history > 1 or self._expert is not None

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        rows = len(seeds) * self.config.followers
        self._history = np.zeros((rows, self.card.history, self.card.entries), dtype=np.float32)
        self._fresh = np.ones(rows, dtype=np.bool_)
        if self._expert is not None:
            self._expert.begin(seeds)

    def begin_again(self, mask: NDArray[np.bool_]) -> None:
        self._fresh |= np.repeat(mask, self.config.followers)
        if self._expert is not None:
            self._expert.begin_again(mask)

    def decide(self, rows: Rows) -> Rows:
        worlds, n, size = rows.shape
        flat = rows.reshape(worlds * n, size)
        output = np.empty((worlds * n, self.config.action_size), dtype=np.float32)
        for start in range(0, len(flat), _ROWS):
            part = slice(start, start + _ROWS)
            output[part] = self._forward(self._inputs(flat[part], part))
        self._fresh[:] = False
        actions = output.reshape(worlds, n, -1)
        if self._expert is None:
            return clipped(actions)
        return corrected(self._expert.decide(rows), actions, self.card.residual)

    def _inputs(self, rows: Rows, part: slice) -> Rows:
        """Inputs of the network, `(rows, history * entries)`, once these observations are the newest."""
        bound = np.float32(self.card.clip)
        with np.errstate(over="ignore"):  # of a tiny scale: infinity is clipped
            now: Rows = np.clip((rows - self._mean) / self._scale, -bound, bound)
        if self.card.history == 1:
            return now
        history, fresh = self._history[part], self._fresh[part]
        history[:, :-1] = history[:, 1:]
        history[:, -1] = now
        history[fresh] = now[fresh, None]
        return history.reshape(len(rows), -1)

    def _forward(self, inputs: Rows) -> Rows:
        """The network's output for any number of rows."""
        x = spread(inputs)
        for i, (weight, bias) in enumerate(self._layers):
            y = np.empty((len(x), len(bias), LANES), dtype=np.float32)
            layer(weight, bias, x, y)
            if i + 1 < len(self._layers):
                y = np.tanh(y) if self.card.activation == "tanh" else np.maximum(y, np.float32(0.0))
            x = y
        return gathered(x, len(inputs), self.card.action_size)


def require_fit(card: Card, config: FormationConfig) -> None:
    """Raise `Misfit` unless observations and actions of the configuration are those of the policy.

    `load` has checked the layout's version.
    """
    found: dict[str, tuple[Any, Any]] = {
        "action level": (card.action, config.action),
        "observation entries": (card.entries, config.layout.size),
    }
    for what, (own, wanted) in found.items():
        if own != wanted:
            raise Misfit(f"policy for {what} {own!r}: the configuration has {wanted!r}")
