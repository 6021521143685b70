"""Finished training runs and a checkout to take them in, for the tests of `train.cards`."""

from __future__ import annotations

import math
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from baselines import files
from baselines.files import Card, Network
from formation_env import configure
from train import cards
from train.cards import guide
from train.log import LogRow, to_csv

CONFIG = configure("nominal")


def row(steps: int, score: float, seed: int = 3) -> LogRow:
    return LogRow(
        steps, steps / 1e6, score, score - 0.01, score + 0.01, 2.0 * score, 0.1, 0.0, seed
    )


def rows_of(count: int, best: int) -> tuple[LogRow, ...]:
    return tuple(row(1000 * i, 2.0 if i == best else 1.0 - math.exp(-i / 30)) for i in range(count))


def policy(scale: float = 0.1, entries: int = CONFIG.layout.size, hidden: int = 8) -> Network:
    rng = np.random.default_rng(5)
    sizes = [entries, hidden, CONFIG.action_size]
    weights = tuple(
        (scale * rng.standard_normal((b, a))).astype(np.float32) for a, b in pairwise(sizes)
    )
    zeros = np.zeros(entries, np.float32)
    return Network(weights, tuple(np.zeros(len(w), np.float32) for w in weights), zeros, zeros + 1)


def card(**given: object) -> Card:
    usual: dict[str, object] = {
        "action": "wrench",
        "entries": CONFIG.layout.size,
        "action_size": 4,
        "scenario": "nominal",
        "method": "ppo",
        "command": "python -m train.ppo --seed 3",
        "seed": 3,
        "steps": 5000,
        "score": {"nominal": [0.5, 0.4, 0.6]},
    }
    return Card(**{**usual, **given})  # type: ignore[arg-type]


def a_run(folder: Path, made: Card | None = None, network: Network | None = None) -> Path:
    folder.mkdir()
    files.save(folder / "best.safetensors", made or card(), network or policy())
    (folder / "log.csv").write_text(to_csv(list(rows_of(6, 3))))
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def bare_checkout(tmp_path: Path, root: Path) -> Path:
    """A checkout with the real template and nothing else."""
    folder = tmp_path / "checkout"
    (folder / "train").mkdir(parents=True)
    (folder / "baselines").mkdir()
    shutil.copy(root / guide.TEMPLATE, folder / guide.TEMPLATE)
    return folder


def main(checkout: Path, *words: object) -> int:
    return cards.main([*map(str, words), "--checkout", str(checkout), "--threads", "1"])


def refused(checkout: Path, capsys: pytest.CaptureFixture[str], names: str, *words: object) -> None:
    """One line on stderr, status 2, nothing changed."""
    before = contents(checkout)
    with pytest.raises(SystemExit) as end:
        main(checkout, *words)
    message = capsys.readouterr().err
    assert end.value.code == 2 and message.count("\n") == 1, message
    assert names in message
    assert contents(checkout) == before
