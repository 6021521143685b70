"""The journal of a search, from which it can be continued without flying a candidate again."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, final

import numpy as np

import formation_env
from baselines.system.reading import read_bytes
from baselines.system.writing import write_text
from formation_env import FormationConfig
from train.margin import changes
from train.seeds import TUNING_SEEDS
from train.tune_expert.options import FREE_ON_RESUME, SCRIPT, Options
from train.tune_expert.search import Candidate

_WRITING_INTERVAL = 5.0  # s, at least, between two writings of the file


@final
class Journal:
    """The scores of all candidates flown so far, in one file that is written whole or not at all."""

    def __init__(
        self, path: Path, options: Options, config: FormationConfig, flown: FormationConfig
    ) -> None:
        self._path, self._tunable = path, options.tunable
        self._space = self._tunable.space(config)
        fixed = {k: v for k, v in asdict(options).items() if k not in FREE_ON_RESUME}
        self._head: dict[str, Any] = {
            "command": options.command(),
            "package": formation_env.__version__,
            "options": {**fixed, "action": config.action},
            "training": [TUNING_SEEDS, TUNING_SEEDS + options.episodes - 1],
            "margin": changes(config, flown) or None,  # what the search changes of the task
        }
        self._written = time.monotonic()
        self.candidates: dict[str, list[Candidate]] = {}

    def recorded(self) -> dict[str, list[float]]:
        """The mean scores in the file, by choice. Raises `ValueError` if it is of another search."""
        try:
            before = json.loads(read_bytes(self._path).decode("utf-8"))
            options, package, values = before["options"], before["package"], before["values"]
            recorded = {k: [float(x) for x in v] for k, v in values.items()}
        except OSError as problem:
            raise ValueError(
                f"--resume: {self._path}: {problem.strerror}; expected a journal"
            ) from None
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            raise ValueError(f"--resume: {self._path} is not a journal of {SCRIPT}") from None
        now = json.loads(json.dumps({**self._head["options"], "package": self._head["package"]}))
        for name, value in {**options, "package": package}.items():
            if now.get(name) != value:
                raise ValueError(
                    f"--resume: {self._path} was begun with {name} = {value!r}, not {now.get(name)!r}"
                )
        return recorded

    def add(self, choice: str, generation: Sequence[Candidate]) -> None:
        """Add a generation; the file is written if the last time is seconds ago."""
        self.candidates.setdefault(choice, []).extend(generation)
        if time.monotonic() - self._written > _WRITING_INTERVAL:
            self.write(None)

    def best(self, choice: str, count: int) -> list[Candidate]:
        """The `count` candidates with the largest scores, no two equal; of equal scores the first."""
        ordered = sorted(self.candidates[choice], key=lambda c: -c.value)
        return list(dict.fromkeys(ordered))[:count]

    def write(self, result: dict[str, Any] | None) -> None:
        """Write the file: scores in the order flown, the best gains so far, and the result."""
        flown = [c for each in self.candidates.values() for c in each]
        best = max(flown, key=lambda c: c.value)
        document = {
            **self._head,
            "evaluations": len(flown),
            "best_by_training": {
                "score": best.value,
                **self._tunable.document(self._space.gains(np.array(best.x), best.choice)),
            },
            "result": result,
            "values": {name: [c.value for c in each] for name, each in self.candidates.items()},
        }
        write_text(self._path, json.dumps(document, indent=1, allow_nan=False) + "\n")
        self._written = time.monotonic()
