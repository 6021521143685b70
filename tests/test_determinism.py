"""The same seed and actions give the same numbers: from every face, number of worlds and process."""

from __future__ import annotations

import copy
import hashlib
import json
import os
import pickle
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pytest
from episodes import LEVELS, SCENARIOS, Step, arrays, episode, fly, gentle, same, wild

from formation_env import formation_v0
from formation_env.env import FormationEnv
from formation_env.vector import FormationVectorEnv

# The same few steps in another process: hashed, or as numbers where a last digit may differ.
PROGRAM = """
import hashlib, json, sys
import numpy as np
from formation_env.env import FormationEnv

out = {}
for scenario, action, steps in json.loads(sys.argv[1]):
    env = FormationEnv(scenario, action=action)
    rows = [env.reset(seed=6)[0]]
    draw = np.random.default_rng(1)
    for _ in range(steps):
        act = draw.uniform(-0.3, 0.3, env.action_space.shape).astype(np.float32)
        seen, _, ended, _, _ = env.step(act)
        rows += [seen, env.reset()[0]] if ended else [seen]
    out[scenario + action] = np.array(rows)
if sys.argv[2] == "hash":
    print(hashlib.sha256(b"".join(a.tobytes() for a in out.values())).hexdigest())
else:
    print(json.dumps({k: a.tolist() for k, a in out.items()}))
"""


def in_another_process(tasks: Any, form: str, root: Path, **variables: str) -> str:
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", PROGRAM, json.dumps(tasks), form],
        cwd=root,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.strip()


def rows_of(tasks: Any) -> dict[str, Any]:
    """What `PROGRAM` computes, here."""
    out = {}
    for scenario, action, steps in tasks:
        env = FormationEnv(scenario, action=action)
        rows = [env.reset(seed=6)[0]]
        draw = np.random.default_rng(1)
        for _ in range(steps):
            act = draw.uniform(-0.3, 0.3, env.action_space.shape).astype(np.float32)
            seen, _, ended, _, _ = env.step(act)
            rows += [seen, env.reset()[0]] if ended else [seen]
        out[scenario + action] = np.array(rows)
    return out


# -- three faces --------------------------------------------------------------------------------------


@pytest.mark.parametrize("action", LEVELS)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_three_faces_are_one(scenario: str, action: str) -> None:
    """World 1 of a vector seeded with 20 is the environment seeded with 21."""
    single = FormationEnv(scenario, action=action)
    many = FormationVectorEnv(3, scenario, action=action)
    parallel = formation_v0.parallel_env(scenario=scenario, action=action)
    n, k = single.config.followers, single.config.action_size
    obs, info = single.reset(seed=21)
    rows, _ = parallel.reset(seed=21)
    assert np.concatenate(list(rows.values())).tobytes() == obs.tobytes()
    assert many.reset(seed=20)[0][1].tobytes() == obs.tobytes()
    for acts in wild(120, 3, n * k, seed=7) * np.float32(0.2):
        obs, reward, ended, late, info = single.step(acts[1])
        row = acts[1].reshape(n, k)
        found = parallel.step(dict(zip(parallel.agents, row, strict=True)))
        assert np.concatenate(list(found[0].values())).tobytes() == obs.tobytes()
        assert sum(found[1].values()) / n == reward  # summed in order, as documented
        assert set(found[2].values()) == {ended}
        assert set(found[3].values()) == {late}
        batch = many.step(acts)
        assert batch[0][1].tobytes() == obs.tobytes()
        assert (batch[1][1], batch[2][1], batch[3][1]) == (reward, ended, late)
        for name in ("slots", "slot_error", "separation", "failure"):
            assert batch[4][name][1].tobytes() == info[name].tobytes()
            own = [found[4][a][name.rstrip("s") if name == "slots" else name] for a in found[4]]
            assert same(np.array(own, info[name].dtype), info[name])
        if ended:
            break


@pytest.mark.parametrize("worlds", [1, 15, 16, 17, 33])
def test_a_world_does_not_depend_on_how_many_there_are(worlds: int) -> None:
    actions = wild(60, 33, 8, seed=3)
    rows, rewards = [], []
    for number in (worlds, 33):
        envs = FormationVectorEnv(number, "paper", threads=1)
        rows.append([envs.reset(seed=0)[0][:worlds]])
        for acts in actions:
            obs, reward, *_ = envs.step(acts[:number])
            rows[-1].append(obs[:worlds])
            rewards.append(reward[:worlds])
    assert same(rows[0], rows[1])
    assert same(rewards[: len(actions)], rewards[len(actions) :])


# -- seeds and streams ----------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_seed_gives_the_same_episode_whatever_came_before(scenario: str) -> None:
    fresh, used = FormationEnv(scenario), FormationEnv(scenario)
    actions = wild(80, *fresh.action_space.shape)
    episode(used, actions, seed=1)
    episode(used, actions)
    assert same(episode(used, actions, seed=9), episode(fresh, actions, seed=9))


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_episodes_of_one_stream_differ_and_repeat(scenario: str) -> None:
    one, two = FormationEnv(scenario), FormationEnv(scenario)
    actions = gentle(10, *one.action_space.shape)
    runs = [episode(one, actions, seed=3), episode(one, actions), episode(one, actions)]
    again = [episode(two, actions, seed=3), episode(two, actions), episode(two, actions)]
    assert same(runs, again)
    assert not same(runs[0], runs[1])
    assert not same(runs[1], runs[2])
    assert not same(runs[0], episode(two, actions, seed=4))


def test_without_a_seed_two_environments_differ() -> None:
    assert not same(FormationEnv().reset(), FormationEnv().reset())


def test_faces_follow_one_stream_from_episode_to_episode() -> None:
    single, parallel = FormationEnv("agile"), formation_v0.parallel_env(scenario="agile")
    single.reset(seed=2), parallel.reset(seed=2)
    for _ in range(3):
        rows, _ = parallel.reset()
        assert same(np.concatenate(list(rows.values())), single.reset()[0])


def test_nothing_draws_from_global_generators() -> None:
    """Another environment and other libraries in between change nothing, and nothing changes them."""
    env, other = FormationEnv("paper"), FormationEnv("agile")
    actions = gentle(30, 8)
    expected = episode(env, actions, seed=0)
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    state = random.getstate(), np.random.get_state()[1].copy()  # noqa: NPY002
    found: list[Step] = [env.reset(seed=0)]
    other.reset(seed=5)
    for action in actions:
        other.step(action)
        found.append(env.step(action))
    assert same(found, expected)
    assert random.getstate() == state[0]
    assert same(np.random.get_state()[1], state[1])  # noqa: NPY002


# -- processes --------------------------------------------------------------------------------------------


def test_another_process_gives_the_same_numbers(root: Path) -> None:
    tasks = [(scenario, action, 40) for scenario in SCENARIOS for action in LEVELS]
    here = hashlib.sha256(b"".join(a.tobytes() for a in rows_of(tasks).values())).hexdigest()
    assert in_another_process(tasks, "hash", root, PYTHONHASHSEED="5") == here


def test_plain_python_gives_the_same_numbers(root: Path) -> None:
    """Without compilation: the same formulas, only no fused operations."""
    tasks = [
        ("nominal", "wrench", 8),
        ("paper", "reference", 8),
        ("experiment", "rates", 8),
        ("agile", "reference", 8),
    ]
    slow = json.loads(in_another_process(tasks, "json", root, NUMBA_DISABLE_JIT="1"))
    for task, rows in rows_of(tasks).items():
        # Observations are float32: 1e-6 is some last digits of the largest.
        np.testing.assert_allclose(np.array(slow[task]), rows, rtol=1e-6, atol=1e-6, err_msg=task)


# -- saving and restoring ---------------------------------------------------------------------------------


def restored(env: Any) -> dict[str, Any]:
    """The environment by every way of saving it."""
    again = type(env)(env.config)
    again.set_state(env.get_state())
    stored = pickle.loads(pickle.dumps(env.get_state()))
    from_disk = type(env)(env.config)
    from_disk.set_state(stored)
    used = type(env)(env.config)
    used.reset(seed=77)
    used.set_state(env.get_state())
    return {
        "pickle": pickle.loads(pickle.dumps(env)),
        "cloudpickle": cloudpickle.loads(cloudpickle.dumps(env)),
        "deepcopy": copy.deepcopy(env),
        "get_state": again,
        "pickled state": from_disk,
        "used": used,
    }


@pytest.mark.parametrize("action", ["wrench", "reference"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_saved_episode_continues_identically(scenario: str, action: str) -> None:
    """Across its end, into the next episodes of its stream."""
    delay = {"measurement_delay": 3} if scenario != "nominal" else {}
    env = FormationEnv(scenario, action=action, duration=0.8, **delay)
    size = env.action_space.shape[0]
    episode(env, gentle(25, size), seed=13)
    copies = restored(env)
    more = gentle(60, size, seed=1)
    expected = fly(env, more)
    for way, other in copies.items():
        assert same(fly(other, more), expected), way


def test_a_saved_parallel_episode_continues_identically() -> None:
    env = formation_v0.parallel_env(scenario="agile", max_cycles=30)
    env.reset(seed=1)
    for row in gentle(10, 8):
        env.step(dict(zip(env.agents, row.reshape(2, 4), strict=True)))
    copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    again = formation_v0.parallel_env(scenario="agile", max_cycles=30)
    again.set_state(env.get_state())
    for row in gentle(50, 8, seed=2):
        if not env.agents:
            expected = env.reset()
            assert all(same(other.reset(), expected) for other in (*copies, again))
        actions = dict(zip(env.agents, row.reshape(2, 4), strict=True))
        step = env.step(actions)
        for other in (*copies, again):
            assert same(other.step(actions), step)
            assert same(other.state(), env.state())


def test_a_saved_state_is_a_copy() -> None:
    env = FormationEnv("paper")
    episode(env, gentle(5, 8), seed=0)
    saved = env.get_state()
    before = copy.deepcopy(saved.state)
    expected = fly(env, gentle(5, 8))
    assert same(saved.state, before)
    for _ in range(2):
        env.set_state(saved)
        assert same(fly(env, gentle(5, 8)), expected)
    assert same(saved.state, before)


def test_a_state_saved_before_the_first_reset_needs_one_too() -> None:
    """It holds no stream yet: a reset draws one, it does not run on key zero."""
    env, vector = FormationEnv(), FormationVectorEnv(1)
    env.set_state(FormationEnv().get_state())
    vector.set_state(FormationVectorEnv(1).get_state())
    rows = [FormationEnv().reset(seed=0)[0], env.reset()[0], vector.reset()[0][0]]
    assert len({row.tobytes() for row in rows}) == 3
    assert all(np.isfinite(a).all() for a in arrays(rows))
