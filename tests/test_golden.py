"""Stored episodes of v0: if one of these fails, `Formation-v0` has become another environment.

Such a change needs a line under "environment versions" of the CHANGELOG, a new version if the task
has changed, and then, consciously, new files:

    python tests/test_golden.py

Compared with tolerance, because fused operations round differently on different processors; on one
machine the numbers repeat to the last bit, which `test_determinism` checks.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from episodes import gentle

from formation_env import Limits
from formation_env.env import FormationEnv

FOLDER = Path(__file__).resolve().parent / "golden"
STEPS, EVERY = 200, 20
APART = Limits(collision=0.01, impact=1.0, tilt=0.5, lost=100.0)  # nothing ends an episode early
TASKS = {
    "nominal": {"scenario": "nominal"},
    "paper": {"scenario": "paper"},
    "experiment": {"scenario": "experiment"},
    "agile-reference": {"scenario": "agile", "action": "reference"},
}


def record(task: str) -> dict[str, npt.NDArray[np.float64]]:
    """200 steps from seed 0: every reward, and each twentieth step in full."""
    env = FormationEnv(**TASKS[task], limits=APART)  # type: ignore[arg-type]
    obs, info = env.reset(seed=0)
    observations, slots, positions, rewards = [obs], [info["slots"]], [], []
    actions = gentle(STEPS, *env.action_space.shape)
    actions[:, 0] += 0.02  # one follower climbs: the formation term changes, and takes off in time
    for k, action in enumerate(actions, 1):
        obs, reward, ended, _, info = env.step(action)
        assert not ended, f"{task} ended at step {k}"
        rewards.append(reward)
        if k % EVERY == 0:
            observations.append(obs)
            slots.append(info["slots"])
            positions.append(env.simulation.positions[0])
    return {
        "observations": np.array(observations, dtype=np.float64),
        "slots": np.array(slots),
        "positions": np.array(positions),
        "rewards": np.array(rewards),
    }


@pytest.mark.parametrize("task", TASKS)
def test_v0_flies_as_it_always_did(task: str) -> None:
    found = record(task)
    with np.load(FOLDER / f"{task}.npz") as stored:
        assert set(stored) == set(found)
        for name in stored:
            expected = stored[name]
            # Observations are stored as the float32 that they are.
            slack = 1e-5 if name == "observations" else 1e-6
            np.testing.assert_allclose(found[name], expected, slack, slack, err_msg=name)


def write() -> None:
    """Replace the stored episodes by today's."""
    FOLDER.mkdir(exist_ok=True)
    for task in TASKS:
        episode = record(task)
        observations = episode["observations"].astype(np.float32)
        np.savez_compressed(FOLDER / f"{task}.npz", **{**episode, "observations": observations})


if __name__ == "__main__":
    write()
