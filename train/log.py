"""The log of a training run: a row for each evaluation, and the file `log.csv` that they make."""

from __future__ import annotations

from typing import NamedTuple

from baselines.scoring.intervals import Estimate
from baselines.scoring.rollout import Episodes


class LogRow(NamedTuple):
    """One evaluation."""

    steps: int  # agent steps until then
    minutes: float  # of wall time until then, evaluations included
    score: float  # mean reward in the scored window, 0 to 1
    low: float  # lower end of the score's 95 % interval
    high: float  # upper end
    mean_return: float
    slot_error: float  # m, in that window
    failed: float  # part of the episodes, 0 to 1
    seed: int  # of the run


class RunRecord(NamedTuple):
    """Steps, time and log of a run so far, which a run that is resumed goes on from."""

    steps: int = 0  # agent steps
    minutes: float = 0.0  # of wall time
    next_evaluation: int = 0  # agent steps at which it is due
    rows: tuple[LogRow, ...] = ()


def log_row(steps: int, minutes: float, score: Estimate, columns: Episodes, seed: int) -> LogRow:
    """The row of an evaluation, from its score and the metrics of its episodes."""
    value, low, high = (float(x) for x in (score.value, score.low, score.high))
    names = ("return", "slot_error", "failed")
    mean_return, error, failed = (float(columns[name].mean()) for name in names)
    return LogRow(steps, minutes, value, low, high, mean_return, error, failed, seed)


HEADER = "steps,minutes,score,low,high,return,slot_error,failed,seed\n"


def to_csv(rows: tuple[LogRow, ...] | list[LogRow]) -> str:
    """The text of `log.csv`."""
    return HEADER + "".join(
        f"{r.steps},{r.minutes:.3f},{r.score:.5f},{r.low:.5f},{r.high:.5f},"
        f"{r.mean_return:.5f},{r.slot_error:.5f},{r.failed:.4f},{r.seed}\n"
        for r in rows
    )


def is_best(row: LogRow, earlier: tuple[LogRow, ...] | list[LogRow]) -> bool:
    """Whether an evaluation's score is above those of all earlier ones."""
    return all(row.score > other.score for other in earlier)


def summary(rows: tuple[LogRow, ...] | list[LogRow], path: object) -> str:
    """The last and the best evaluation in words, and where the best policy is."""
    if not rows:
        return "nothing was evaluated"
    row, best = rows[-1], max(rows, key=lambda r: r.score)
    return (
        f"score {row.score:.3f} ({row.low:.3f} .. {row.high:.3f}) after {row.steps:,} agent steps "
        f"and {row.minutes:.1f} minutes; best {best.score:.3f} at {best.steps:,}: {path}"
    )
