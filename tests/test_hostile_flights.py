"""That a flight which cuts its thrust, stays beside its slot or waits gains nothing in its score."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from baselines.registry import make_policy
from baselines.scoring.rollout import fly as fly_policy
from formation_env import FormationConfig, configure


class Hostile:
    """A policy, but from some time after the trigger without thrust, beside its slot, or late to start.

    Late means that the first follower holds 0.3 m off where it should wait, `late` s long.
    """

    def __init__(
        self,
        config: FormationConfig,
        cut: float = np.inf,
        aside: tuple[float, ...] = (0, 0, 0),
        late: float = 0.0,
        policy: str = "ff",
    ) -> None:
        self.config, self._policy = config, make_policy(policy, config)
        self._cut, self._aside, self._late = cut, np.array(aside), late
        self._slices = config.layout.slices

    def reset(self, seed: int | None = None, worlds: int = 1) -> None:
        self._policy.reset(seed=seed, worlds=worlds)
        self._since, self._time = np.zeros(worlds), 0.0

    def act(self, rows: Any) -> Any:
        moved = rows.copy()
        moved[..., self._slices["slot_error"]] += self._aside
        waiting = rows[:, 0, self._slices["started"].start] == 0.0
        if self._time < self._late:
            moved[waiting, 0, self._slices["slot_error"].start] -= 0.3
        self._time += self.config.control_period
        actions = self._policy.act(moved)
        self._since += self.config.control_period * rows[:, 0, self._slices["started"].start]
        actions[self._since > self._cut] = (-1.0, 0.0, 0.0, 0.0)
        return actions


@pytest.mark.parametrize("scenario", ["nominal", "paper"])
def test_hostile_flights_score_less_than_flying_on(scenario: str) -> None:
    """On every seed, and all figures beside the score say so too."""
    config = configure(scenario)
    honest = fly_policy(Hostile(config), range(6))  # type: ignore[arg-type]
    for hostile in (
        Hostile(config, cut=10.0),
        Hostile(config, cut=24.0),
        Hostile(config, aside=(0.1, 0.0, 0.0)),
        Hostile(config, aside=(0.0, 0.0, 0.35)),
    ):
        columns = fly_policy(hostile, range(6))  # type: ignore[arg-type]
        assert (columns["score"] < honest["score"]).all()
        assert (columns["slot_error"] > honest["slot_error"]).all()
        assert (columns["slot_error_late"] > honest["slot_error_late"]).all()
        if hostile._cut < np.inf:
            assert (columns["failed"] == 1.0).all()


@pytest.mark.parametrize("cut", [np.inf, 17.0])
def test_waiting_does_not_pay(cut: float) -> None:
    """Neither for the leader to calm down, nor for one that will crash 17 s after its start.

    Where the window began with the start, this raised the score of `ff-filter` by 0.012; where it was the
    end of an episode of fixed length, it put off the crash. Other noise is scored, of 0.003 over 60 seeds.
    """
    config = configure("paper")
    soon, late = (
        fly_policy(Hostile(config, cut, late=wait, policy="ff-filter"), range(60))  # type: ignore[arg-type]
        for wait in (0.0, 13.5)
    )
    assert late["trigger_time"].mean() > soon["trigger_time"].mean() + 4.0
    assert late["score"].mean() < soon["score"].mean() + 0.005
