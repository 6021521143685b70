"""The search for gains: candidates flown by generations, the best ones compared on validation seeds."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import formation_env
from baselines import make_policy
from baselines.policies.gain_files import VERSION
from baselines.scoring.intervals import Estimate
from baselines.scoring.results import Result, judge
from baselines.scoring.rollout import fly_all
from baselines.system.progress import compiling
from baselines.system.writing import claim, write_text
from formation_env import FormationConfig
from train.margin import changes, flown_on
from train.seeds import TUNING_SEEDS, TUNING_VALIDATION_SEEDS
from train.tune_expert.journal import Journal
from train.tune_expert.options import Options
from train.tune_expert.scores import mean_score, mean_scores
from train.tune_expert.search import Candidate, Search, search
from train.tune_expert.tunables import Tunable

_OTHERS_WRITE = 10.0  # s, at most, until other searches have written their gains


class Tasks(NamedTuple):
    """What is searched for, and what flies in the search."""

    own: FormationConfig  # the task as it is
    flown: FormationConfig  # the same with a margin, unless the options say without


# -- validation -----------------------------------------------------------------------------------


class BestGains(NamedTuple):
    """The gains with the largest mean score on the validation seeds, and their results there."""

    gains: Any
    result: Result  # on the task
    flown: Result  # on the task as it was flown in the search


def validate(
    tasks: Tasks, tunable: Tunable, finalists: Sequence[Any], seeds: range, pool: ThreadPoolExecutor
) -> BestGains:
    """The finalist with the largest mean score over the seeds on the task as it is flown, the first where
    equal."""
    gains, flown = _best(tasks.flown, tunable, finalists, seeds, pool)
    if tasks.flown == tasks.own:
        return BestGains(gains, flown, flown)
    return BestGains(gains, _best(tasks.own, tunable, [gains], seeds, pool)[1], flown)


def _best(
    config: FormationConfig,
    tunable: Tunable,
    finalists: Sequence[Any],
    seeds: range,
    pool: ThreadPoolExecutor,
) -> tuple[Any, Result]:
    """The finalist with the largest mean score on a configuration, and its result."""
    policies = [tunable.policy(config, gains) for gains in finalists]
    own_law = make_policy("expert", config)
    expert, *columns = pool.map(lambda p: fly_all(p, seeds), [own_law, *policies])
    best = max(range(len(columns)), key=lambda i: columns[i]["score"].mean())
    return finalists[best], judge({"": columns[best]}, {"expert": expert})


def _interval(e: Estimate) -> list[float | None]:
    return [float(x) if np.isfinite(x) else None for x in (e.value, e.low, e.high)]


def _figures(result: Result) -> dict[str, Any]:
    """Value, low and high of what a file of gains says of a result."""
    return {
        "score": _interval(result.score),
        "score_minus_expert": _interval(result.differences["expert"]["score"]),
        "failed": _interval(result.summary["failed"]),
    }


def provenance(options: Options, tasks: Tasks, best: BestGains) -> dict[str, Any]:
    """How gains were found and their scores on the validation seeds, as a file of gains has it.

    `margin` says what the search changed of the task and the scores there; None where it changed nothing.
    """
    validation, margin = _validation_seeds(options), changes(tasks.own, tasks.flown)
    return {
        "command": options.command(),
        "package": formation_env.__version__,
        "seed": options.seed,
        "training": [TUNING_SEEDS, TUNING_SEEDS + options.episodes - 1],
        "validation": [validation.start, validation.stop - 1],
        **_figures(best.result),
        "margin": {**margin, **_figures(best.flown)} if margin else None,
    }


def write_gains(
    tunable: Tunable, path: Path, scenario: str, action: str, entry: dict[str, Any]
) -> None:
    """Write an entry into a file of gains, which is made if it is not there.

    What other searches write into it at the same time stays.
    """
    with claim(path.parent, path.name, _OTHERS_WRITE):
        gains: dict[str, dict[str, Any]] = {}
        if path.exists():
            tunable.read(path)  # a broken file is refused, not overwritten
            gains = json.loads(path.read_text(encoding="utf-8"))["gains"]
        gains.setdefault(scenario, {})[action] = entry
        document = {"version": VERSION, "gains": gains}
        write_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def tune(options: Options) -> BestGains:
    """The whole search. Raises `ValueError` for wrong options, before anything is written."""
    config = options.check()
    tasks = Tasks(config, flown_on(config, options.margin))
    path = options.output / f"{options.tunable.stem(config)}.json"
    if options.gains is not None and options.gains.exists():
        options.tunable.read(options.gains)
    if options.resume:
        Journal(path, options, *tasks).recorded()  # refused before a folder is made
    with claim(options.output, path.name):
        return _searched(options, tasks, Journal(path, options, *tasks), path)


def _searched(options: Options, tasks: Tasks, journal: Journal, path: Path) -> BestGains:
    """The search, with a journal that no other run writes: the journal and its entry in a file of gains."""
    recorded = journal.recorded() if options.resume else {}
    if path.exists() and not options.resume:
        raise ValueError(f"{path} exists: expected --resume to go on with it, or another --output")
    config = tasks.own
    best = _run(options, tasks, journal, recorded)
    entry = {**options.tunable.document(best.gains), "made": provenance(options, tasks, best)}
    journal.write(entry)
    if options.gains is not None:
        write_gains(options.tunable, options.gains, config.scenario, config.action, entry)
    return best


def _run(
    options: Options, tasks: Tasks, journal: Journal, recorded: dict[str, list[float]]
) -> BestGains:
    """Fly and validate candidates; the journal is written, whatever ends the search."""
    from tqdm import tqdm

    config, tunable, choices = tasks.own, options.tunable, options.choices(tasks.own)
    space, all_choices = tunable.space(config), tunable.choices(config, "both")
    seeds = range(TUNING_SEEDS, TUNING_SEEDS + options.episodes)
    share = max(1, options.evaluations // len(choices))
    # Before the threads start, since the first flight compiles; and the own gains have to fly.
    with compiling(options.quiet):
        mean_score(make_policy(tunable.name, tasks.flown), seeds)
    with (
        ThreadPoolExecutor(options.threads, thread_name_prefix="tune") as pool,
        tqdm(total=share * len(choices), disable=options.quiet, unit=" candidates") as bar,
    ):

        def scores(candidates: Sequence[Any]) -> list[float]:
            return mean_scores(tunable, tasks.flown, candidates, seeds, pool)

        def on_generation(choice: str, generation: Sequence[Candidate]) -> None:
            journal.add(choice, generation)
            bar.update(len(generation))
            best = journal.best(choice, 1)[0].value
            bar.set_description_str(f"{choice}: score {best:.4f}", refresh=False)

        try:
            for choice in choices:
                flown = (scores, on_generation, options.spread, options.seed)
                settings = Search(space, *flown, all_choices)
                search(settings, choice, share, recorded.get(choice, ()))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            if journal.candidates:
                journal.write(None)
            raise
        finalists, validation = _finalists(options, config, journal), _validation_seeds(options)
        return validate(tasks, tunable, finalists, validation, pool)


def _validation_seeds(options: Options) -> range:
    return range(TUNING_VALIDATION_SEEDS, TUNING_VALIDATION_SEEDS + options.validation)


def _finalists(options: Options, config: FormationConfig, journal: Journal) -> list[Any]:
    """The plain gains, then those with the largest scores on the training seeds."""
    space = options.tunable.space(config)
    best = [
        space.gains(np.array(c.x), c.choice)
        for choice in options.choices(config)
        for c in journal.best(choice, options.finalists)
    ]
    return [options.tunable.own(config), *best]
