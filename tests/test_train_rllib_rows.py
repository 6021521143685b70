"""The rows that RLlib flies are the simulation's, with Gymnasium's ends."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from baselines import make_policy
from formation_env import configure
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.task import REWARD
from train.rllib.rows import FollowerRows
from train.seeds import TRAINING_SEEDS

WORLDS = 3


def flown(central: bool, ticks: int = 40, seed: int = 5) -> tuple[FollowerRows, list[Any]]:
    """An environment with short episodes, and what the expert saw and got in it, tick by tick."""
    config = configure("paper", duration=0.3)
    rows = FollowerRows(config, 2 * WORLDS, central=central, reward_scale=0.5)
    expert = make_policy("expert", config)
    seen, _ = rows.reset(seed=seed)
    expert.reset(worlds=WORLDS)
    log = [(seen, np.zeros(2 * WORLDS), *np.zeros((2, 2 * WORLDS), dtype=bool))]
    for _ in range(ticks):
        own = log[-1][0]["obs"] if central else log[-1][0]
        seen, *rest, infos = rows.step(expert.act(own.reshape(WORLDS, 2, -1)).reshape(6, -1))
        assert infos == {}
        over = (log[-1][2] | log[-1][3])[::2]
        if over.any():
            expert.restart(over)
        log.append((seen, *rest))
    return rows, log


def test_rows_are_the_simulation() -> None:
    """World by world, episode by episode, with the same bits: reset rows add nothing but themselves."""
    rows, log = flown(central=False)
    config = rows.config
    for world in range(WORLDS):
        alone, expert = Simulation(config), make_policy("expert", config)
        alone.seed(0, seeded_key(TRAINING_SEEDS + 5 * WORLDS + world))
        mine = slice(2 * world, 2 * world + 2)
        ended, episodes = True, 0
        for tick, (seen, rewards, terminated, truncated) in enumerate(log):
            if ended:
                results, reward, episodes = alone.reset(), np.zeros(2), episodes + 1
                expert.reset()
                over = False
            else:
                before = log[tick - 1][0][mine]
                results = alone.step(expert.act(before[None]).reshape(1, 2, -1))
                reward, over = 0.5 * results.outputs[0, :, REWARD], bool(results.truncated[0])
            assert np.array_equal(seen[mine], results.observations[0])
            if episodes > 1:  # the first ends at a random age
                assert truncated[mine].tolist() == [over] * 2
            assert not terminated.any()
            assert rewards[mine] == pytest.approx(reward, abs=0.0) or ended
            ended = bool(truncated[mine][0])
        assert episodes > 2


def test_worlds_do_not_end_together() -> None:
    _, log = flown(central=False, ticks=15)
    firsts = [next(t for t, row in enumerate(log) if row[3][2 * w]) for w in range(WORLDS)]
    assert len(set(firsts)) > 1


def test_the_state_is_pettingzoos() -> None:
    from formation_env.formation_v0 import parallel_env

    rows, log = flown(central=True, ticks=3)
    assert log[0][0] in rows.observation_space
    env = parallel_env(scenario=rows.config)
    env.reset(seed=TRAINING_SEEDS + 5 * WORLDS + 1)
    for row in (2, 3):
        assert np.array_equal(log[0][0]["state"][row], env.state())


def test_seeds_repeat_and_differ() -> None:
    (_, a), (_, b), (_, c) = (flown(central=False, ticks=5, seed=s) for s in (1, 1, 2))
    assert np.array_equal(a[-1][0], b[-1][0])
    assert not np.array_equal(a[0][0], c[0][0])


def test_rows_come_in_whole_worlds() -> None:
    with pytest.raises(ValueError, match="num_envs = 5: expected a multiple of the 2 followers"):
        FollowerRows(configure("nominal"), 5)
    assert FollowerRows.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


def test_gymnasium_makes_them_as_rllib_does() -> None:
    import gymnasium as gym

    gym.register(
        "rows-v0", vector_entry_point=lambda num_envs: FollowerRows(configure("nominal"), num_envs)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it has no single environment
        envs = gym.make_vec("rows-v0", num_envs=4, vectorization_mode="vector_entry_point")
    seen, _ = envs.reset(seed=0)
    assert seen.shape == (4, *envs.single_observation_space.shape)
    envs.close()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_what_a_central_critic_sees_is_finite(value: float) -> None:
    """Also in the step in which the vehicles have left the numbers."""
    rows = FollowerRows(configure("nominal"), 2 * WORLDS, central=True)
    rows.reset(seed=0)
    rows._simulation._state.vehicles[...] = value
    seen, _, terminated, *_ = rows.step(np.zeros((2 * WORLDS, 4), np.float32))
    assert terminated.all()
    assert seen in rows.observation_space
    assert np.isfinite(seen["state"]).all()
