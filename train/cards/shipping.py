"""Checks in the policy and the curve of a run, and scores policies on tasks they were not trained on."""

from __future__ import annotations

import csv
import hashlib
import io
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, get_type_hints

from baselines import files
from baselines.files import SUFFIX, Card, Network
from baselines.policies.learned import Learned
from baselines.registry import METHODS, USUAL
from baselines.scoring.evaluation import EPISODES, evaluate
from baselines.scoring.intervals import Estimate
from baselines.scoring.results import Result
from baselines.scoring.runs import BEST
from baselines.system.writing import write_text
from formation_env import SCENARIOS, FeasibilityWarning, FormationConfig, configure, formations
from formation_env.laws.levels import NAMES as LEVEL_NAMES
from train.cards.curves import Curve, Key, read_log, thinned, to_text

# Where things lie in a checkout.
POLICIES, CURVES = Path("baselines/policies"), Path("train/curves")
GENERALISATION = CURVES / "generalisation.csv"

LARGEST_FILE = 1_000_000  # bytes, of a policy
_SPARE = 1_000  # bytes of these for the score that is written into the card
LOG = "log.csv"
_ROW = "runs"


class FinishedRun(NamedTuple):
    """The contents of a finished run's folder."""

    policy: Path
    card: Card
    network: Network
    config: FormationConfig
    curve: Curve


# -- runs -----------------------------------------------------------------------------------------


def open_run(folder: Path, method: str | None = None) -> FinishedRun:
    """A run from its folder; `method` replaces the one in its policy's card.

    Raises `ValueError` naming what is missing or does not belong together.
    """
    for name in (BEST, LOG):
        if not (folder / name).is_file():
            raise ValueError(f"{folder}: no {name}: expected the folder of a finished run")
    policy = folder / BEST
    card, network = files.load(policy)
    if card.scenario not in SCENARIOS:
        raise ValueError(
            f"{policy}: trained on {card.scenario!r}: expected one of {', '.join(SCENARIOS)}"
        )
    config = configure(card.scenario, action=card.action)
    try:
        Learned(config, (card, network))
    except ValueError as problem:
        raise ValueError(f"{policy}: {problem}") from None
    try:
        _, rows = read_log((folder / LOG).read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        raise ValueError(f"{folder / LOG}: {problem}") from None
    seeds = {row.seed for row in rows}
    if seeds != {card.seed}:
        raise ValueError(
            f"{folder}: the log is of seed {', '.join(map(str, sorted(seeds)))}, the policy of seed "
            f"{card.seed}"
        )
    key = Key(card.scenario, card.action, method or card.method)
    curve = Curve(key, card.seed, " ".join(card.command.split()), thinned(rows))
    return FinishedRun(policy, card, network, config, curve)


def require_shippable(runs: Sequence[FinishedRun]) -> None:
    """Raises `ValueError` for a policy that is too large, for a method that has no name in the registry, and
    for runs of several methods or tasks, or of the same seed."""
    first = runs[0]
    for run in runs:
        _require_shippable(run)
        if run.curve.key != first.curve.key:
            raise ValueError(
                f"{run.policy}: {' '.join(run.curve.key)}: expected runs of one method and task, as "
                f"{first.policy}: {' '.join(first.curve.key)}"
            )
    seeds = [run.curve.seed for run in runs]
    for run in runs:
        if seeds.count(run.curve.seed) > 1:
            raise ValueError(
                f"{run.policy}: seed {run.curve.seed} twice: expected one run of a seed"
            )


def _require_shippable(run: FinishedRun) -> None:
    size = run.policy.stat().st_size
    if size > LARGEST_FILE - _SPARE:
        raise ValueError(f"{run.policy}: {size} bytes: expected at most {LARGEST_FILE - _SPARE}")
    if run.curve.key.method not in METHODS:
        raise ValueError(
            f"method {run.curve.key.method!r}: expected for a shipped policy one of "
            f"{', '.join(METHODS)}; see --method"
        )


def scored(runs: Sequence[FinishedRun], episodes: int, threads: int) -> tuple[FinishedRun, Result]:
    """The run whose policy has the median score on the leaderboard's seeds, from 0, and the result of all
    together. Raises `ValueError`."""
    scenario, config = runs[0].card.scenario, runs[0].config
    policies = {f"{_ROW}#{i}": str(run.policy) for i, run in enumerate(runs)}
    flown = {"expert": "expert", **policies}
    report = evaluate({scenario: config}, flown, episodes, 0, threads, quiet=False)
    result = report.scenarios[scenario].results[_ROW]
    return runs[list(policies).index(result.median)], result


def ship(run: FinishedRun, score: Estimate, checkout: Path) -> list[Path]:
    """Write a policy, with the score of its method, and its curve into a checkout.

    Raises `OSError`, `ValueError`.
    """
    key = run.curve.key
    path = checkout / POLICIES / f"{key.method}-{key.scenario}-{key.action}{SUFFIX}"
    three = [round(x, 5) for x in (score.value, score.low, score.high)]
    card = replace(run.card, score={key.scenario: three})
    path.parent.mkdir(exist_ok=True)
    files.save(path, card, run.network)
    return [path, keep_curve(run.curve, checkout)]


def keep_curve(curve: Curve, checkout: Path) -> Path:
    """Write a curve into a checkout; its path. Raises `OSError`."""
    path = checkout / CURVES / curve.name
    path.parent.mkdir(exist_ok=True)
    write_text(path, to_text(curve))
    return path


def shipped(checkout: Path) -> Iterator[tuple[Key, Path]]:
    """The policies of a checkout, in the usual order."""
    for scenario in SCENARIOS:
        for action in LEVEL_NAMES:
            for method in METHODS:
                path = checkout / POLICIES / f"{method}-{scenario}-{action}{SUFFIX}"
                if path.is_file():
                    yield Key(scenario, action, method), path


# -- generalisation -------------------------------------------------------------------------------


class Transfer(NamedTuple):
    """One policy on one task; a row of the file."""

    task: str
    action: str
    policy: str  # a method, trained on `USUAL`, or the name of a programmed policy
    digest: str  # of the policy's file; "-" for a programmed one
    score: float
    low: float
    high: float
    failed: float  # part of the episodes


COMPARED = ("expert", "ff")  # programmed policies that are scored beside the learned ones
# Formations that no scenario has, flown on `USUAL`'s trajectory. The one in the middle of three abreast
# is lower than usual, so that wherever it starts around its slot it is clear of the leader.
OFFSETS = {
    "three abreast": formations.line(3, below=0.45),
    "two in a column": formations.column(2),
    "six in a stack": formations.stack(6),
}


def tasks(action: str) -> dict[str, FormationConfig]:
    """The five scenarios at one action level, and `USUAL` with other offsets."""
    with warnings.catch_warnings():  # that a follower may invert on such a path
        warnings.simplefilter("ignore", FeasibilityWarning)
        return {
            **{name: configure(name, action=action) for name in SCENARIOS},
            **{
                name: configure(USUAL, action=action, offsets=offsets)
                for name, offsets in OFFSETS.items()
            },
        }


def file_digest(path: Path) -> str:
    """The first 16 digits of a file's SHA-256, which tell it from another version."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def transfers(checkout: Path, threads: int, episodes: int = EPISODES) -> list[Transfer]:
    """The scores of every shipped policy of `USUAL`, and of `COMPARED`, on all tasks of their action level.

    Raises `ValueError` if there is none, or for a bad file.
    """
    by_action: dict[str, dict[str, Path]] = {}
    for key, path in shipped(checkout):
        if key.scenario == USUAL:
            by_action.setdefault(key.action, {})[key.method] = path
    if not by_action:
        raise ValueError(f"no policy of {USUAL!r} in {checkout / POLICIES}")
    found: list[Transfer] = []
    for action, paths in by_action.items():
        names = [*COMPARED, *map(str, paths.values())]
        labels = [*COMPARED, *paths]
        digests = [*("-" for _ in COMPARED), *map(file_digest, paths.values())]
        report = evaluate(tasks(action), names, episodes, 0, threads, quiet=False)
        for task, each in report.scenarios.items():
            for name, label, mark in zip(names, labels, digests, strict=True):
                s, failed = each.results[name].score, each.results[name].summary["failed"].value
                figures = [round(x, 4) for x in (s.value, s.low, s.high, failed)]
                found.append(Transfer(task, action, label, mark, *figures))
    return found


def transfers_text(rows: Sequence[Transfer]) -> str:
    """The text of the file that `read_transfers` reads."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([Transfer._fields, *rows])
    return text.getvalue()


def _transfer(words: Sequence[str]) -> Transfer:
    """From a row of the file. Raises `ValueError`."""
    kinds = get_type_hints(Transfer)
    named = zip(Transfer._fields, words, strict=True)
    return Transfer(**{name: kinds[name](word) for name, word in named})


def read_transfers(path: Path) -> list[Transfer]:
    """The scores from their file; none if there is no file. Raises `ValueError`, `OSError`."""
    if not path.exists():
        return []
    head, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
    try:
        if tuple(head) != Transfer._fields:
            raise ValueError(f"columns {head}")
        return [_transfer(row) for row in rows]
    except ValueError as problem:
        raise ValueError(f"{path}: not what --generalise writes ({problem})") from None
