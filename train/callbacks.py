"""What happens between an update and the next rollout: scoring, writing files, stopping."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple, final

from stable_baselines3.common.callbacks import BaseCallback

from baselines.files import Card, Network
from train.checkpoint import write
from train.evaluation import Judge, Row, line, to_csv

BEST, LAST, LOG = "best.safetensors", "last.safetensors", "log.csv"


class Diary(NamedTuple):
    """What a run remembers of itself."""

    rows: list[Row]
    minutes: float  # of earlier sittings
    next_evaluation: int  # agent steps


@final
class Keeper(BaseCallback):
    """Scores, keeps and stops a run between updates, where nothing is half done.

    `policy` gives the policy as it is now, `save_policy` and `save_run` write it and everything; `stop`
    says whether the run is to end, `told` takes how far it is. What they raise ends it.
    """

    def __init__(
        self,
        folder: Path,
        diary: Diary,
        judge: Judge,
        policy: Callable[[], tuple[Card, Network]],
        save_policy: Callable[[Path, tuple[Card, Network]], None],
        save_run: Callable[[Diary], None],
        limits: tuple[float, float, int],
        stop: Callable[[], bool],
        told: Callable[[int, float, list[Row]], None],
    ) -> None:
        super().__init__()
        self.rows, self._next = list(diary.rows), diary.next_evaluation
        self._earlier, self._begun = diary.minutes, perf_counter()
        self._folder, self._judge, self._policy = folder, judge, policy
        self._save_policy, self._save_run, self._stop = save_policy, save_run, stop
        self._told = told
        self._most_minutes, self._save_every, self._evaluate_every = limits
        self._saved = self._begun
        self._stopped = False
        self.seconds = {"evaluation": 0.0, "files": 0.0}

    @property
    def minutes(self) -> float:
        """Of wall time, all sittings together."""
        return self._earlier + (perf_counter() - self._begun) / 60.0

    def _on_rollout_start(self) -> None:
        late, asked = self.minutes >= self._most_minutes, self._stop()
        self._stopped = late or asked
        self._boundary(last=late, save=asked)
        self._told(self.num_timesteps, self.minutes, self.rows)

    def _on_step(self) -> bool:
        return not self._stopped

    def _on_training_end(self) -> None:
        if not self._stopped:
            self._boundary(last=True, save=True)
        self._told(self.num_timesteps, self.minutes, self.rows)

    def _boundary(self, last: bool, save: bool) -> None:
        """Evaluate if it is time to, and write if that or enough time has passed."""
        evaluated = bool(self.rows) and self.rows[-1].steps == self.num_timesteps
        if not evaluated and (last or self.num_timesteps >= self._next):
            self._evaluate()
            save = True
        due = perf_counter() - self._saved >= 60.0 * self._save_every
        if save or last or due:
            self._write()

    def _write(self) -> None:
        begun = perf_counter()
        self._save_policy(self._folder / LAST, self._policy())
        self._save_run(Diary(self.rows, self.minutes, self._next))
        self._saved = perf_counter()
        self.seconds["files"] += self._saved - begun

    def _evaluate(self) -> None:
        """One line of the log, and the best policy if it is."""
        begun = perf_counter()
        made = self._policy()
        score, columns = self._judge.judge(*made)
        row = line(self.num_timesteps, self.minutes, score, columns, made[0].seed)
        best = all(row.score > other.score for other in self.rows)
        self.rows.append(row)
        self._next = (self.num_timesteps // self._evaluate_every + 1) * self._evaluate_every
        for name in ("score", "slot_error_rms", "failed"):
            self.logger.record(f"evaluation/{name}", getattr(row, name))
        self.seconds["evaluation"] += perf_counter() - begun
        if best:
            self._save_policy(self._folder / BEST, self._policy())  # now with its score
        write(self._folder / LOG, to_csv(self.rows).encode())


def shares(seconds: dict[str, float], total: float) -> str:
    """A table of where the time went; what is left over is the library's own."""
    named: dict[str, Any] = {
        **seconds,
        "the rest of Stable-Baselines3": total - sum(seconds.values()),
    }
    lines = [f"{name:32s} {s:9.2f} s {100.0 * s / total:6.1f} %" for name, s in named.items()]
    return "\n".join([*lines, f"{'together':32s} {total:9.2f} s"])
