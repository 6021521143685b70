"""How good a policy is while it is being trained, and the log of it.

Judged as the leaderboard judges, on episodes of their own: the leaderboard's seeds are 0 to 99, those
of training worlds begin at `TRAINING`, and those between `VALIDATION` and there are for choosing the
best of a run.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from baselines import make_policy
from baselines.evaluate import write_text
from baselines.policy import Policy
from baselines.rollout import Episodes, chunks, fly
from baselines.scoring import ANCHORS, Result, judge
from formation_env import FormationConfig

VALIDATION = 200_000
TRAINING = 1_000_000
# Streams of a run: runs with different seeds share none while they have fewer worlds than this.
STREAMS = 1_000_000

COLUMNS = ("steps", "minutes", "score", "low", "high", "return", "slot_error_rms", "failed", "seed")


def flown(policy: Policy, seeds: range) -> Episodes:
    """One episode for each of the seeds; the columns are `metrics.EPISODE`."""
    groups = chunks(seeds.start, len(seeds), policy.config.followers)
    parts = [fly(policy, group) for group in groups]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@final
class Examination:
    """Validation episodes of a configuration, with hover and the expert, who are 0 and 1 there."""

    def __init__(self, config: FormationConfig, episodes: int, first: int = VALIDATION) -> None:
        self.seeds = range(first, first + episodes)
        self._anchors = {name: flown(make_policy(name, config), self.seeds) for name in ANCHORS}

    def of(self, policy: Policy) -> Result:
        """The result of a policy for the same configuration."""
        return judge(flown(policy, self.seeds), self._anchors["hover"], self._anchors["expert"])


class Row(NamedTuple):
    """A line of the log."""

    steps: int  # agent steps so far
    minutes: float  # since the training began
    result: Result
    seed: int  # of the training

    def cells(self) -> dict[str, str]:
        """Its entries by the names of `COLUMNS`."""
        score, summary = self.result.score, self.result.summary
        figures = {
            "score": score.value,
            "low": score.low,
            "high": score.high,
            **{name: summary[name].value for name in ("return", "slot_error_rms", "failed")},
        }
        texts = {name: f"{value:.6g}" for name, value in figures.items()}
        whole = {"steps": str(self.steps), "seed": str(self.seed)}
        return {**whole, **texts, "minutes": f"{self.minutes:.3f}"}


@final
class Log:
    """A CSV file of rows; whoever is interrupted leaves whole lines."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._text = io.StringIO(newline="")
        self._writer = csv.DictWriter(self._text, COLUMNS, lineterminator="\n")
        self._writer.writeheader()

    def add(self, row: Row) -> None:
        """Add a line and write the file. Raises `OSError` where it cannot be written."""
        self._writer.writerow(row.cells())
        write_text(self._path, self._text.getvalue())
