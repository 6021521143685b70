"""The vector face is `SyncVectorEnv` to the last bit, in every autoreset mode, and faster only."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from episodes import arrays, same, wild
from gymnasium.error import ResetNeeded
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics
from numba import config

from formation_env import Limits, configure
from formation_env.core import kernels, simulation
from formation_env.task import Terms
from formation_env.vector import FormationVectorEnv

ID = "formation_env:Formation-v0"
MODES = list(AutoresetMode)

# Random actions end these episodes by impacts, collisions and lost followers; some by the time limit.
TASKS: dict[str, dict[str, Any]] = {
    "nominal": {},
    "paper-rates": {"scenario": "paper", "action": "rates"},
    "experiment-reference": {"scenario": "experiment", "action": "reference"},
    "agile": {
        "scenario": "agile",
        "followers": 3,
        "limits": Limits(collision=0.1, impact=1.0, tilt=0.5, lost=0.6),
    },
    "batches": {"followers": 9, "neighbours": 3},
    "swarm-delayed": {"scenario": "swarm", "followers": 5, "measurement_delay": 2},
}


def pair(task: str, num_envs: int, mode: AutoresetMode, steps: int) -> tuple[VectorEnv, VectorEnv]:
    """The native environment and Gymnasium's own, of one task."""
    make = partial(gym.make, ID, max_episode_steps=steps, **TASKS[task])
    native = FormationVectorEnv(
        num_envs, max_episode_steps=steps, autoreset_mode=mode, **TASKS[task]
    )
    return native, SyncVectorEnv([make] * num_envs, autoreset_mode=mode)


def agree(found: Any, expected: Any) -> None:
    """Equal to the last bit, with the parts that differ named."""
    for part, a, b in zip(
        ("obs", "reward", "ended", "late", "info"), found, expected, strict=False
    ):
        assert same(a, b), f"{part}: {a} is not {b}"
    assert len(found) == len(expected)


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)
@pytest.mark.parametrize(
    ("task", "num_envs"),
    [(task, 3) for task in TASKS] + [("nominal", 1), ("paper-rates", 17)],
)
def test_it_is_the_sync_vector_env(task: str, num_envs: int, mode: AutoresetMode) -> None:
    native, sync = pair(task, num_envs, mode, steps=45)
    agree(native.reset(seed=11), sync.reset(seed=11))
    failed = timed_out = 0
    for actions in wild(220, *sync.action_space.shape, seed=1):
        found, expected = native.step(actions), sync.step(actions)
        agree(found, expected)
        failed, timed_out = failed + found[2].sum(), timed_out + found[3].sum()
        done = found[2] | found[3]
        if mode == AutoresetMode.DISABLED and done.any():
            agree(
                native.reset(options={"reset_mask": done.copy()}),
                sync.reset(options={"reset_mask": done.copy()}),
            )
    assert failed + timed_out >= 4 * num_envs
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    sync.close()


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name)
def test_info_holds_only_arrays(mode: AutoresetMode) -> None:
    """`final_info` is by Gymnasium's convention a dictionary, and it too holds only arrays."""
    envs = FormationVectorEnv(2, max_episode_steps=3, autoreset_mode=mode)
    info = envs.reset(seed=0)[1]
    names = {name for name in info if not name.startswith("_")}
    assert {f"reward_{term}" for term in Terms._fields} < names
    finals = 0
    for _ in range(3):
        info = envs.step(np.zeros((2, 8), np.float32))[4]
        final = info.pop("final_info", {})
        finals += len(final) > 0
        for entry in (info, final) if final else (info,):
            assert all(type(value) is np.ndarray for value in entry.values())
            assert names <= set(entry)
            assert {f"_{name}" for name in names} <= set(entry)
    assert finals == (mode == AutoresetMode.SAME_STEP)


def test_seeds_may_be_given_one_by_one() -> None:
    native, sync = pair("agile", 3, AutoresetMode.NEXT_STEP, steps=20)
    agree(native.reset(seed=[5, 90, 5]), sync.reset(seed=[5, 90, 5]))
    obs, _ = native.reset(seed=[1, None, 2])
    agree((obs,), (sync.reset(seed=[1, None, 2])[0],))
    agree(native.reset(), sync.reset())


def test_a_mask_with_seeds_restarts_only_its_worlds() -> None:
    native, sync = pair("nominal", 3, AutoresetMode.DISABLED, steps=50)
    native.reset(seed=0), sync.reset(seed=0)
    for actions in wild(3, 3, 8):
        agree(native.step(actions), sync.step(actions))
    mask = np.array([True, False, True])
    agree(
        native.reset(seed=70, options={"reset_mask": mask.copy()}),
        sync.reset(seed=70, options={"reset_mask": mask.copy()}),
    )
    agree(native.step(np.zeros((3, 8), np.float32)), sync.step(np.zeros((3, 8), np.float32)))


def test_it_is_the_async_vector_env_under_spawn() -> None:
    make = partial(gym.make, ID, max_episode_steps=20, scenario="paper", action="rates")
    other = AsyncVectorEnv([make] * 2, context="spawn")
    try:
        native = FormationVectorEnv(2, "paper", action="rates", max_episode_steps=20)
        agree(native.reset(seed=8), other.reset(seed=8))
        for actions in wild(30, 2, 8, seed=2):
            agree(native.step(actions), other.step(actions))
    finally:
        other.close()


def test_make_vec_takes_the_native_one() -> None:
    """And its options, in the shape that Gymnasium passes them on."""
    envs = gym.make_vec(
        "Formation-v0", num_envs=2, max_episode_steps=3, autoreset_mode=AutoresetMode.SAME_STEP
    )
    assert isinstance(envs.unwrapped, FormationVectorEnv)
    assert envs.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    envs.reset(seed=0)
    late = [envs.step(np.zeros((2, 8), np.float32))[3].tolist() for _ in range(6)]
    assert late == [[False] * 2, [False] * 2, [True] * 2] * 2


@pytest.mark.parametrize("name", ["NEXT_STEP", "same_step", "Disabled", AutoresetMode.DISABLED])
def test_modes_go_by_name(name: str | AutoresetMode) -> None:
    expected = name if isinstance(name, AutoresetMode) else AutoresetMode[name.upper()]
    assert FormationVectorEnv(1, autoreset_mode=name).metadata["autoreset_mode"] is expected


def test_next_step_does_not_look_at_the_action_of_an_ended_world() -> None:
    """Gymnasium's rule: that step is a reset."""
    native, sync = pair("nominal", 2, AutoresetMode.NEXT_STEP, steps=2)
    for envs in (native, sync):
        envs.reset(seed=0)
        envs.step(np.zeros((2, 8), np.float32))
        envs.step(np.zeros((2, 8), np.float32))
    bad = np.full((2, 8), np.nan, np.float32)
    agree(native.step(bad), sync.step(bad))


@pytest.mark.parametrize("worlds", [17, 33, 50])
def test_threads_change_no_number(worlds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "_VEHICLES_PER_THREAD", 1)
    monkeypatch.setattr(simulation, "cores", lambda: 3)
    one = FormationVectorEnv(worlds, "paper", threads=1, max_episode_steps=25)
    more = FormationVectorEnv(worlds, "paper", threads=3, max_episode_steps=25)
    agree(more.reset(seed=0), one.reset(seed=0))
    for actions in wild(60, worlds, 8):
        actions[one.simulation.over] = np.nan  # which are not used
        agree(more.step(actions), one.step(actions))
    assert one.simulation._team is None
    assert more.simulation._team is not None or config.DISABLE_JIT, "the threads were not used"
    more.close()
    agree(more.step(actions), one.step(actions))
    more.close()


def test_results_belong_to_the_caller() -> None:
    """SB3 writes into the rewards it is given, and no other environment may notice."""
    spoiled = FormationVectorEnv(3, "paper", autoreset_mode="SAME_STEP", max_episode_steps=10)
    untouched = FormationVectorEnv(3, "paper", autoreset_mode="SAME_STEP", max_episode_steps=10)
    spoiled.reset(seed=0), untouched.reset(seed=0)
    for actions in wild(35, 3, 8):
        found, expected = spoiled.step(actions), untouched.step(actions)
        agree(found, expected)
        for array in arrays(found):
            if array.dtype != object:
                array[...] = 1


def test_memory_order_of_actions_does_not_matter() -> None:
    one, two = FormationVectorEnv(4), FormationVectorEnv(4)
    one.reset(seed=0), two.reset(seed=0)
    actions = wild(1, 4, 8)[0]
    agree(one.step(np.asfortranarray(actions)), two.step(actions))
    agree(one.step(np.repeat(actions, 2, axis=1)[:, ::2]), two.step(actions))


def test_statistics_of_episodes() -> None:
    envs = RecordEpisodeStatistics(FormationVectorEnv(2, max_episode_steps=6))
    envs.reset(seed=0)
    total = np.zeros(2)
    for _ in range(6):
        _, reward, _, late, info = envs.step(np.zeros((2, 8), np.float32))
        total += reward
    assert late.all()
    np.testing.assert_allclose(info["episode"]["r"], total, rtol=1e-6)
    assert info["episode"]["l"].tolist() == [6, 6]


def test_observations_can_be_normalised() -> None:
    envs = NormalizeObservation(FormationVectorEnv(8, "agile", max_episode_steps=20))
    envs.reset(seed=0)
    rows = np.concatenate([envs.step(actions)[0] for actions in wild(60, 8, 8)])
    varied = rows[240:].std(axis=0) > 1e-3
    assert varied.sum() > 20
    assert np.abs(rows[240:, varied].mean(axis=0)).max() < 1.0


def test_a_vector_of_worlds_continues_from_a_saved_state() -> None:
    envs = FormationVectorEnv(3, "agile", max_episode_steps=15)
    envs.reset(seed=0)
    for actions in wild(10, 3, 8):
        envs.step(actions)
    fresh = FormationVectorEnv(3, "agile", max_episode_steps=15)
    fresh.set_state(envs.get_state())
    for actions in wild(30, 3, 8, seed=3):
        agree(fresh.step(actions), envs.step(actions))
    agree(fresh.reset(), envs.reset())


def test_worlds_that_have_not_begun_may_be_restored() -> None:
    envs = FormationVectorEnv(3)
    blank = envs.get_state()
    envs.reset(seed=0)
    envs.step(np.zeros((3, 8), np.float32))
    envs.set_state(blank)
    with pytest.raises(ResetNeeded):
        envs.step(np.zeros((3, 8), np.float32))


def test_another_memory_layout_is_not_compiled_for() -> None:
    """A read-only or strided array of actions would be another type: it is copied instead."""
    envs = FormationVectorEnv(3)
    envs.reset(seed=0)
    actions = np.zeros((3, 8), np.float32)
    actions.setflags(write=False)
    envs.step(actions)
    envs.step(np.zeros((3, 16), np.float32)[:, ::2])
    envs.step(np.asfortranarray(np.zeros((3, 8), np.float32)))
    assert len(getattr(kernels.advance, "signatures", [0])) == 1


def test_results_too_many_for_the_cache_are_those_of_a_few_worlds() -> None:
    config = configure("nominal")
    many, few = (simulation.Simulation(config, worlds) for worlds in (11_000, 33))
    for world in range(11_000):
        many.seed(world, world)
    for world in range(33):
        few.seed(world, world)
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (11_000, config.followers, 4))
    some = actions.astype(np.float32)
    results = [(many.reset(), few.reset())]
    results += [(many.step(some), few.step(some[:33])) for _ in range(2)]
    for all_of_them, first in results:
        assert all_of_them.observations.nbytes + all_of_them.outputs.nbytes > 6_000_000
        np.testing.assert_array_equal(all_of_them.observations[:33], first.observations)
        np.testing.assert_array_equal(all_of_them.outputs[:33], first.outputs)
        np.testing.assert_array_equal(all_of_them.ends[:, :33], first.ends)
