"""Reports of evaluations that have not been flown, with the scores that a test wants."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from baselines.scoring.metrics import EPISODE
from baselines.scoring.results import REFERENCES, Report, Scenario, Source, judge
from baselines.scoring.rollout import Episodes
from formation_env import FormationConfig, configure

Floats = NDArray[np.float64]

QUICK = ["--scenarios", "nominal", "--policies", "hover", "--episodes", "2", "--duration", "0.1"]
SCORES = {
    "ff": [np.array([0.9, 0.8, 1.0, 0.7])],
    "expert": [np.array([0.2, 0.4, 0.3, 0.1])],
    "ppo": [np.array([0.5, 0.5, 0.9, 0.6])],
    "dagger": [np.array([0.6, 0.5, 0.9, 0.7])],
}


def columns(score: Floats, failed: float = 0.0) -> Episodes:
    """The episodes of one run, `(episodes,)`; the first ones have failed."""
    flags = (np.arange(len(score)) < failed * len(score)).astype(np.float64)
    own = {"score": score, "slot_error": 1.0 - score, "failed": flags, "failure": flags}
    return {**{name: score + i for i, name in enumerate(EPISODE)}, **own}


def scenario(
    runs: Mapping[str, list[Floats]],
    trained: Mapping[str, str] | None = None,
    config: FormationConfig | None = None,
    absent: Mapping[str, str] | None = None,
    failed: float = 0.0,
) -> Scenario:
    """Rows of one run, or of several, called `name#0`, ...; `trained` says which of them are files, trained
    on what. Those that were trained elsewhere have failed in a part of the episodes."""
    config, trained = config or configure("nominal"), trained or {}
    sources = {
        name: Source(f"{name}.safetensors", name, task, config.action, task != config.scenario)
        for name, task in trained.items()
    }
    rows = {
        row: {
            row if len(each) == 1 else f"{row}#{i}": columns(
                x, failed if row in sources and sources[row].differs else 0.0
            )
            for i, x in enumerate(each)
        }
        for row, each in runs.items()
    }
    references = {name: next(iter(rows[name].values())) for name in REFERENCES if name in rows}
    results = {row: judge(each, references) for row, each in rows.items()}
    return Scenario(config, results, sources, dict(absent or {}))


LAWS = (
    *(
        "expert",
        "expert-tuned",
        "ff",
        "ff-filter",
        "ff-tuned",
        "lee",
        "lee-tuned",
        "lqr",
        "lqr-tuned",
    ),
    *("hover", "random"),
)
LEARNED = ("ppo", "bc", "dagger", "bc-ppo", "dagger-ppo", "residual", "residual-dagger", "rppo")


def large(scenarios: int, episodes: int = 40) -> Report:
    """As large as the board may become: all laws and eight methods of five runs, which have learned a half of
    the scenarios, fail elsewhere, and differ by their training seeds."""
    rng = np.random.default_rng(0)
    config = configure("nominal")
    found = {}
    for k in range(scenarios):
        runs = {
            law: [np.clip(rng.normal(0.9 - 0.02 * i, 0.02, episodes), 0.0, 1.0)]
            for i, law in enumerate(LAWS)
        }
        own = k % 2 == 0
        for i, method in enumerate(LEARNED):
            level = (0.91 if own else 0.4) - 0.01 * i
            runs[method] = [
                np.clip(rng.normal(level, 0.03, episodes) + rng.normal(0.0, 0.01), 0.0, 1.0)
                for _ in range(5)
            ]
        task = "nominal" if own else "experiment"
        name = f"experiment{k}:reference"
        trained = dict.fromkeys(LEARNED, task)
        found[name] = scenario(runs, trained, config, failed=0.456)
    return Report(0, episodes, found)


def near(level: float, seed: int = 0, count: int = 30) -> Floats:
    """Scores around a level."""
    return level + 0.01 * np.random.default_rng(seed).standard_normal(count)


def cells(text: str, row: str) -> list[str]:
    """The cells of a row of the first table that has it, without its name."""
    (line, *_) = (line for line in text.splitlines() if line.startswith(f"| `{row}` |"))
    return [cell.strip() for cell in line.strip("| ").split(" | ")[1:]]
