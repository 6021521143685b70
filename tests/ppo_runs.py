"""Runs of `train.ppo` that take seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from formation_env import configure
from train.ppo.options import Options


def small(folder: Path, **options: Any) -> Options:
    """A run of seconds: 4 updates of 128 agent steps."""
    usual: dict[str, Any] = {
        "action": "reference",
        "steps": 512,
        "worlds": 8,
        "rollout": 8,
        "batch": 64,
        "epochs": 2,
        "hidden": (8,),
        "evaluate_every": 256,
        "episodes": 2,
        "threads": 1,
        "quiet": True,
    }
    return Options(output=folder, **{**usual, **options})


def words(options: Options) -> list[str]:
    """As on a command line."""
    return [
        *options.command().split()[1:],
        "--output",
        str(options.output),
        "--quiet",
        "--threads",
        "1",
    ]


def files(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir()) if p.is_file()}


def shorten_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Episodes of a fraction of a second, for the task itself too."""

    def config(self: Options) -> Any:
        given: dict[str, Any] = {} if self.action is None else {"action": self.action}
        return configure(self.scenario, duration=0.4, **given)

    monkeypatch.setattr(Options, "config", config)
