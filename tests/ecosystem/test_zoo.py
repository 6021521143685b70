"""RL Baselines3 Zoo: the command of the manual, for a few steps."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pages
import pytest

pytest.importorskip("rl_zoo3")


SHORT = ["--n-timesteps", "256", "--hyperparams", "n_steps:16", "batch_size:64", "n_envs:2"]


def test_the_command_trains(tmp_path: Path) -> None:
    (block,) = pages.blocks(pages.DOCS / "libraries/rl-zoo3.md", "bash")
    command = shlex.split(block.splitlines()[-1])
    assert command[:2] == ["python", "-m"]
    command[command.index("logs")] = str(tmp_path)
    run = subprocess.run(
        [sys.executable, *command[1:], *SHORT],
        cwd=pages.ROOT,
        env={**os.environ, "PYTHONPATH": str(pages.ROOT)},
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert run.returncode == 0, run.stderr[-3000:]
    assert (tmp_path / "ppo/Formation-v0_1/Formation-v0.zip").exists()
