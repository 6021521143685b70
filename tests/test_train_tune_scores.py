"""The scores of candidates: those that fly together have what each has alone; numbers that overflow."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

pytest.importorskip("tyro")
pytest.importorskip("cma")

from baselines import make_policy
from baselines.policies import textbook_tuned
from baselines.policies.cascade import Feedforward
from baselines.scoring import rollout
from formation_env import FormationConfig, configure
from train.tune_expert import scores
from train.tune_expert.scores import OVERFLOWED, mean_score, mean_scores
from train.tune_expert.tunables import TUNABLES


def test_gains_that_overflow_are_the_worst(monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulation refuses actions that are not numbers; other errors are not swallowed."""

    def refuse(text: str) -> None:
        def fly(*_: Any) -> Any:
            raise ValueError(text)

        monkeypatch.setattr(rollout, "fly", fly)

    policy = make_policy("expert", configure("nominal"))
    refuse("action of follower_1 of world 7 = [nan]: expected finite numbers")
    assert mean_score(policy, range(2)) == OVERFLOWED
    refuse("something else")
    with pytest.raises(ValueError, match="something else"):
        mean_score(policy, range(2))


# -- candidates together --------------------------------------------------------------------------


def candidates(law: str, config: FormationConfig, count: int) -> list[Any]:
    """The plain gains and others, some of which fly badly."""
    space, rng = TUNABLES[law].space(config), np.random.default_rng(4)
    points = [i * 0.4 * rng.standard_normal(len(space.names)) for i in range(count)]
    return [space.gains(x, TUNABLES[law].choices(config, "both")[0]) for x in points]


@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
@pytest.mark.parametrize("law", textbook_tuned.LAWS)
def test_candidates_together_score_as_each_alone(
    law: str, action: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit, whichever fly together and however many threads there are."""
    config = configure("paper", action=action, duration=4.0, start="formation")
    tunable, seeds, gains = TUNABLES[law], range(100_000, 100_003), candidates(law, config, 5)
    alone = [mean_score(tunable.policy(config, one), seeds) for one in gains]
    assert len(set(alone)) == 5
    for threads, vehicles in ((1, 1500), (2, 18)):  # all, and by twos
        monkeypatch.setattr(scores, "VEHICLES", vehicles)
        with ThreadPoolExecutor(threads) as pool:
            assert mean_scores(tunable, config, gains, seeds, pool) == alone


def test_filters_together_wait_for_the_trigger_as_each_alone() -> None:
    """Every metric of every episode, to the last bit; some of the filters are longer than others."""
    config, seeds = configure("paper", duration=4.0, trigger=2.3), range(3)
    gains = candidates("ff-filter", config, 3)
    gains.append(gains[0]._replace(own_push=500.0, lead_push=500.0, jerk=500.0))  # steady at once
    together = rollout.fly(textbook_tuned.Stacked("ff-filter", config, gains, 3), seeds, times=4)
    assert (together["trigger_time"] < 2.0).sum() >= 9 and len(set(together["smoothness"])) == 12
    for i, one in enumerate(gains):
        alone = rollout.fly(textbook_tuned.FfFilterTuned(config, one), seeds)
        for name, column in alone.items():
            assert np.array_equal(together[name][3 * i : 3 * i + 3], column, equal_nan=True), name


def test_one_that_overflows_does_not_spoil_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """The flight of all ends; then each flies alone."""
    config, seeds = configure("nominal", duration=1.0), range(2)
    gains = candidates("ff", config, 3)
    alone = [mean_score(textbook_tuned.FfTuned(config, one), seeds) for one in gains]
    plain: Any = Feedforward.wanted

    def wanted(self: Any, *given: Any) -> Any:
        a = plain(self, *given)
        a[np.broadcast_to(self.gains.position[..., 0], a.shape[:2]) == gains[1].position] = np.nan
        return a

    monkeypatch.setattr(Feedforward, "wanted", wanted)
    with ThreadPoolExecutor(1) as pool:
        found = mean_scores(TUNABLES["ff"], config, gains, seeds, pool)
    assert found == [alone[0], OVERFLOWED, alone[2]]


def test_a_stacked_law_flies_no_other_number_of_worlds() -> None:
    config = configure("nominal")
    policy = textbook_tuned.Stacked("ff", config, candidates("ff", config, 2), 3)
    with pytest.raises(ValueError, match="worlds = 5: expected 6"):
        policy.reset(worlds=5)
