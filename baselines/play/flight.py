"""A flight that goes on: one policy on one configuration from one seed, changed while it flies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from baselines.play.carrying import carry, carry_memory, pushed
from baselines.policies.expert import Expert
from baselines.registry import recipe
from baselines.replay.episode import ending
from baselines.replay.lyapunov import NAMES, is_recorded, logarithms, values, with_record
from baselines.replay.page import card
from formation_env import FormationConfig
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.interface.faces import path_times
from formation_env.task import COLUMNS

_DIGITS = 4  # behind the point: a tenth of a millimetre
_PATH_DIGITS = 3


@final
class Flight:
    """The policy `name` in one world. Without changes it flies what `baselines.replay` records, bit for bit.

    Raises `ValueError` naming a policy that is unknown or cannot fly the configuration.
    """

    def __init__(self, name: str, config: FormationConfig, seed: int) -> None:
        self.name, self.config = name, config
        self._policy = with_record(recipe(name, config).make(config))
        self._simulation = Simulation(config)
        self.begin(seed)

    def begin(self, seed: int) -> None:
        """A new episode."""
        self.seed = seed
        self._simulation.seed(0, seeded_key(seed))
        self._policy.reset(seed=seed)
        self._results = self._simulation.reset()
        self._failure: NDArray[np.int64] = np.zeros(self.config.followers, dtype=np.int64)
        self._problem: str | None = None

    def warm(self) -> None:
        """Compile what a tick runs: one is flown, and the episode begins again."""
        self.tick()
        self.begin(self.seed)

    # -- flying -----------------------------------------------------------------------------------

    @property
    def ended(self) -> bool:
        """Whether the episode is over."""
        return self._problem is not None or self._simulation.ended(0)

    @property
    def time(self) -> float:
        """Time since reset, s."""
        return float(self._simulation.time[0])

    def tick(self) -> None:
        """Fly one tick, if the episode is not over. What a policy raises ends it, and is shown."""
        if self.ended:
            return
        try:
            self._results = self._simulation.step(self._policy.act(self._results.observations))
        except Exception as problem:
            text = " ".join(f"{type(problem).__name__}: {problem}".split())
            self._problem = f"policy {self.name}: {text}"[:400]
            return
        self._failure = self._results.outputs[0, :, COLUMNS["failed"].start].astype(np.int64)

    def push(self, vehicle: int, change: Sequence[float]) -> None:
        """Change the velocity of a vehicle, 0 for the leader, by so much, m/s, inertial."""
        if self.ended:
            return
        pushed(self._simulation, vehicle, change)
        self._look()

    def go_on_from(self, other: Flight, kept: Sequence[int] | None = None) -> bool:
        """Be where another flight is, of whose followers `kept` are left; whether that is possible."""
        if other._problem is not None or not carry(other._simulation, self._simulation, kept):
            return False
        carry_memory(other._policy, self._policy)
        self._look()
        return True

    def _look(self) -> None:
        """The state is another than the last tick left."""
        self._results = self._simulation.look()
        self._policy.look_away()

    # -- what is shown ----------------------------------------------------------------------------

    def card(self) -> dict[str, Any]:
        """What is said of it before it is flown, for `web/live.js`."""
        lawful = isinstance(self._policy, Expert)
        return {**card(self.name, self.config, self.seed), "laws": NAMES if lawful else None}

    def path(self) -> list[list[float]]:
        """The leader's reference path, m, inertial."""
        s = self._simulation
        points = s.reference(path_times(float(s.clock[0]), self.config.duration))
        rows: list[list[float]] = np.round(points, _PATH_DIGITS).tolist()
        return rows

    def frame(self) -> dict[str, Any]:
        """What is true now: numbers row by row in one list each, for `web/live.js`."""
        s, outputs = self._simulation, self._results.outputs[0]
        observed = s.layout.unpack(self._results.observations[0])
        actions = observed["previous_action"][:, : self.config.action_size]
        laws = None
        if isinstance(self._policy, Expert) and is_recorded(self._policy):
            laws = _listed(logarithms(values(self._policy)))
        return {
            "time": round(self.time, 6),
            "started": int(s.started[0]),
            "positions": _listed(s.positions[0]),
            "attitudes": _listed(s.attitudes[0]),
            "slots": _listed(outputs[:, COLUMNS["slot"]]),
            "actions": _listed(actions),
            "lyapunov": laws,
            "failure": self._failure.tolist(),
            "end": self.end(),
        }

    def end(self) -> str | None:
        """How the episode ended, in words; None while it goes on."""
        if self._problem is not None:
            return self._problem
        if not self.ended:
            return None
        return ending(self._failure, self.time) if self._failure.any() else "time is up"


def _listed(array: Any) -> list[float]:
    """The numbers for JSON, which has neither infinity nor NaN."""
    numbers = np.nan_to_num(np.asarray(array, dtype=np.float64), posinf=1e9, neginf=-1e9)
    flat: list[float] = np.round(numbers, _DIGITS).ravel().tolist()
    return flat
