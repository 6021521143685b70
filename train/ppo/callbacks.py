"""What happens between an update and the next rollout: evaluations, files, the end of the run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import NamedTuple, final

from stable_baselines3.common.callbacks import BaseCallback

from baselines.files import Card, Network
from train.checkpoint import write
from train.evaluation import Evaluator
from train.log import LogRow, RunRecord, is_best, log_row, to_csv

BEST, LAST, LOG = "best.safetensors", "last.safetensors", "log.csv"


class Limits(NamedTuple):
    """When a run ends, and how often it is evaluated and saved."""

    minutes: float  # of wall time, all sittings together
    save_every: float  # minutes
    evaluate_every: int  # agent steps


class Hooks(NamedTuple):
    """What a run gives to its callback; an error that they raise ends the run."""

    policy: Callable[[], tuple[Card, Network]]  # the policy as it is now
    save_policy: Callable[[Path, tuple[Card, Network]], None]
    save_run: Callable[[RunRecord], None]  # writes the checkpoint
    stop: Callable[[], bool]  # whether the run is to end
    show: Callable[[int, float, list[LogRow]], None]  # shows agent steps, minutes and the log


@final
class EvaluateAndSave(BaseCallback):
    """Evaluates, saves and ends a run between two updates, where no update is half done."""

    def __init__(
        self, folder: Path, record: RunRecord, evaluator: Evaluator, hooks: Hooks, limits: Limits
    ) -> None:
        super().__init__()
        self.rows, self._next_evaluation = list(record.rows), record.next_evaluation
        self._earlier_minutes, self._begun = record.minutes, perf_counter()
        self._folder, self._evaluator = folder, evaluator
        self._hooks, self._limits = hooks, limits
        self._saved_at = self._begun
        self._stopped = False
        self.seconds = {"evaluation": 0.0, "files": 0.0}

    @property
    def minutes(self) -> float:
        """Of wall time, all sittings together."""
        return self._earlier_minutes + (perf_counter() - self._begun) / 60.0

    def _on_rollout_start(self) -> None:
        late, asked = self.minutes >= self._limits.minutes, self._hooks.stop()
        self._stopped = late or asked
        self._between_updates(last=late, save=asked)
        self._hooks.show(self.num_timesteps, self.minutes, self.rows)

    def _on_step(self) -> bool:
        return not self._stopped

    def _on_training_end(self) -> None:
        if not self._stopped:
            self._between_updates(last=True, save=True)
        self._hooks.show(self.num_timesteps, self.minutes, self.rows)

    def _between_updates(self, last: bool, save: bool) -> None:
        """Evaluate if that is due, and write if it was or enough time has passed."""
        evaluated = bool(self.rows) and self.rows[-1].steps == self.num_timesteps
        if not evaluated and (last or self.num_timesteps >= self._next_evaluation):
            self._evaluate()
            save = True
        due = perf_counter() - self._saved_at >= 60.0 * self._limits.save_every
        if save or last or due:
            self._write()

    def _write(self) -> None:
        begun = perf_counter()
        self._hooks.save_policy(self._folder / LAST, self._hooks.policy())
        steps, rows = self.num_timesteps, tuple(self.rows)
        self._hooks.save_run(RunRecord(steps, self.minutes, self._next_evaluation, rows))
        self._saved_at = perf_counter()
        self.seconds["files"] += self._saved_at - begun

    def _evaluate(self) -> None:
        """Add a row to the log, and write the policy if it is the best one yet."""
        begun, every = perf_counter(), self._limits.evaluate_every
        card, network = self._hooks.policy()
        score, columns = self._evaluator.score_network(card, network)
        row = log_row(self.num_timesteps, self.minutes, score, columns, card.seed)
        best = is_best(row, self.rows)
        self.rows.append(row)
        self._next_evaluation = (self.num_timesteps // every + 1) * every
        for name in ("score", "slot_error", "failed"):
            self.logger.record(f"evaluation/{name}", getattr(row, name))
        self.seconds["evaluation"] += perf_counter() - begun
        if best:
            self._hooks.save_policy(self._folder / BEST, self._hooks.policy())  # now with its score
        write(self._folder / LOG, to_csv(self.rows).encode())


def time_table(seconds: dict[str, float], total: float) -> str:
    """A table of the seconds that each part took; what is left of `total` is the library's own."""
    named = {**seconds, "the rest of Stable-Baselines3": total - sum(seconds.values())}
    lines = [f"{name:32s} {s:9.2f} s {100.0 * s / total:6.1f} %" for name, s in named.items()]
    return "\n".join([*lines, f"{'together':32s} {total:9.2f} s"])
