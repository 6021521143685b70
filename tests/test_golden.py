"""Stored episodes of v0: if one of these fails, `Formation-v0` has become another environment.

Such a change needs a line under "environment versions" of the CHANGELOG, a new version if the task
has changed, and then, consciously, new files (of all tasks, or of those that are named):

    python tests/test_golden.py [TASK ...]

Compared with tolerance, because fused operations round differently on different processors; on one
machine the numbers repeat to the last bit, which `test_determinism` checks, and `fingerprint.py`
compares them to the last bit before and after a change.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from episodes import gentle, wild
from numba import config

from formation_env import Limits, Noise, configure
from formation_env.env import FormationEnv
from formation_env.vector import FormationVectorEnv

FOLDER = Path(__file__).resolve().parent / "golden"
APART = Limits(collision=0.01, impact=1.0, tilt=0.5, lost=100.0)  # nothing ends an episode early
NOISE = Noise(0.02, 0.03, 0.04, 0.01, 0.02)
CAMERA = Noise(2e-4, 0.0, 0.0, 1e-3, 0.0)  # what is differenced 200 times a second must be exact

Episode = dict[str, npt.NDArray[Any]]


class Task(NamedTuple):
    """An environment's arguments, how many steps are flown, and every which of them is stored in full."""

    options: dict[str, Any]
    steps: int = 200
    every: int = 20


# On the floor below the slots and below the leader's first point, each 1.2 to 1.6 m from where it starts: the
# trigger (40) fires when those that climb, the leader among them, are within 1.3 m.
BELOW = {
    "paper": {
        "leader_start": (2.0, 0.0, 0.0),
        "follower_starts": ((2.35, -0.35, 0.0), (1.65, -0.35, 0.0)),
        "trigger": 1.3,
    },
    "experiment": {
        "leader_start": (1.06, 1.06, 0.0),
        "follower_starts": ((1.555, 1.06, 0.0), (1.06, 0.565, 0.0)),
        "trigger": 1.3,
    },
}

TASKS = {
    "nominal": Task({"scenario": "nominal"}),
    "paper": Task({"scenario": "paper"}),
    "experiment": Task({"scenario": "experiment"}),
    "agile-reference": Task({"scenario": "agile", "action": "reference"}),
    "agile": Task({"scenario": "agile"}),
    "nominal-rates": Task({"action": "rates"}),
    "reference-by-rates": Task({"action": "reference", "reference_actuation": "rates"}),
    "experiment-reference": Task({"scenario": "experiment", "action": "reference"}),
    # From the floor, and after the trigger; the three without a `-started` wait for it to the end.
    "paper-started": Task({"scenario": "paper", **BELOW["paper"]}),
    "experiment-started": Task({"scenario": "experiment", **BELOW["experiment"]}),
    "experiment-reference-started": Task(
        {"scenario": "experiment", "action": "reference", **BELOW["experiment"]}
    ),
    "gusts": Task({"gust": 0.5, "gust_time": 0.4}),
    "differenced": Task({"estimator": "differenced", "window": 10, "noise": NOISE}),
    # Measurements that come late: of every tick, of less than every tick, of more.
    "late": Task({"measurement_delay": 2, "noise": NOISE}),
    "late-seldom": Task({"measurement_delay": 1, "measurement_period": 0.025, "noise": NOISE}),
    "late-often": Task(
        {
            "measurement_delay": 5,
            "measurement_period": 0.005,
            "estimator": "differenced",
            "window": 16,
            "noise": CAMERA,
            "action": "reference",
            "reference_actuation": "rates",
        }
    ),
    # More than 30 vehicles: the sweep of `nearest` finds neighbours, by its own loop where two are wanted.
    "crowd": Task({"scenario": "swarm", "followers": 40, "neighbours": 3}, steps=60),
    "crowd-by-two": Task({"scenario": "swarm", "followers": 40}, steps=60, every=30),
}
# The same for many worlds, more than a tile of them, which end and begin anew.
WORLDS = 17
SEVERAL = {
    "worlds": Task({"scenario": "nominal"}, steps=100, every=25),
    "worlds-agile": Task({"scenario": "agile", "action": "reference"}, steps=100, every=25),
}


def record(task: str) -> Episode:
    """Steps from seed 0: every reward, and some steps in full."""
    options, steps, every = TASKS[task]
    env = FormationEnv(**options, limits=APART)
    obs, info = env.reset(seed=0)
    observations, slots, positions, rewards = [obs], [info["slots"]], [], []
    actions = gentle(steps, *env.action_space.shape)
    actions[:, 0] += 0.02  # one follower climbs: the formation term changes, and takes off in time
    for k, action in enumerate(actions, 1):
        obs, reward, ended, _, info = env.step(action)
        assert not ended, f"{task} ended at step {k}"
        rewards.append(reward)
        if k % every == 0:
            observations.append(obs)
            slots.append(info["slots"])
            positions.append(env.simulation.positions[0])
    return {
        "observations": np.array(observations, dtype=np.float64),
        "slots": np.array(slots),
        "positions": np.array(positions),
        "rewards": np.array(rewards),
    }


def record_several(task: str) -> Episode:
    """Steps of many worlds that begin anew in the step in which they end: every reward and end."""
    options, steps, every = SEVERAL[task]
    env = FormationVectorEnv(
        WORLDS, **options, autoreset_mode="same_step", max_episode_steps=70, threads=1
    )
    observations = [env.reset(seed=0)[0]]
    rewards, ends, failures, last = [], [], [], []
    actions = 0.02 * wild(steps, *env.action_space.shape)
    actions[:, ::3] = wild(1, *env.action_space.shape)[:, ::3]  # these soon fall, each in its way
    for k, action in enumerate(actions, 1):
        obs, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        ends.append(terminated + 2 * truncated)
        if "final_obs" in info:
            last.extend(info["final_obs"][info["_final_obs"]])
            failures.append(info["final_info"]["failure"])
        if k % every == 0:
            observations.append(obs)
    env.close()
    return {
        "observations": np.array(observations, dtype=np.float64),
        "rewards": np.array(rewards),
        "ends": np.array(ends),
        "failures": np.array(failures),
        "last": np.array(last, dtype=np.float64),
    }


def compare(task: str, found: Episode) -> None:
    with np.load(FOLDER / f"{task}.npz") as stored:
        assert set(stored) == set(found)
        for name in stored:
            expected = stored[name]
            # Observations are stored as the float32 that they are.
            slack = 1e-5 if expected.dtype == np.float32 else 1e-6
            np.testing.assert_allclose(found[name], expected, slack, slack, err_msg=name)


@pytest.mark.parametrize("task", TASKS)
def test_v0_flies_as_it_always_did(task: str) -> None:
    if config.DISABLE_JIT and task.startswith("crowd"):
        pytest.skip("plain Python warns of infinity minus infinity among many vehicles")
    compare(task, record(task))


def test_all_fly_after_the_trigger_but_for_those_that_wait_for_it() -> None:
    """In the stored observations; of those that wait and start, more than half is flight after it."""
    for task, (options, steps, every) in TASKS.items():
        config = configure(**options)
        with np.load(FOLDER / f"{task}.npz") as stored:
            rows = stored["observations"].reshape(-1, config.followers, config.layout.size)
        begun = config.layout.unpack(rows)["started"][:, 0, 0] == 1.0
        assert len(begun) == 1 + steps // every
        if f"{task}-started" in TASKS:
            assert not begun.any()
        elif task.endswith("-started"):
            assert not begun[:2].any() and begun[5:].all()
        else:
            assert begun.all()


@pytest.mark.parametrize("task", SEVERAL)
def test_worlds_end_and_begin_as_they_always_did(task: str) -> None:
    found = record_several(task)
    assert set(np.unique(found["ends"])) == {0, 1, 2}
    compare(task, found)


def write(tasks: list[str]) -> None:
    """Replace the stored episodes of some tasks, or of all, by today's."""
    FOLDER.mkdir(exist_ok=True)
    for task in tasks or [*TASKS, *SEVERAL]:
        episode = record(task) if task in TASKS else record_several(task)
        for name in episode.keys() & {"observations", "last"}:
            episode[name] = episode[name].astype(np.float32)
        np.savez_compressed(FOLDER / f"{task}.npz", **episode)


if __name__ == "__main__":
    write(sys.argv[1:])
