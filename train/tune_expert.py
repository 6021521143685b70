"""Find gains for the paper's laws: `python -m train.tune_expert --scenario paper`.

CMA-ES (pycma) searches the gains of the follower's planner and tracker for the largest mean return
over training seeds, the same ones for every candidate; a failure costs what it costs in the return.
The point it starts from is the configuration's own gains, and every point it may visit satisfies the
paper's conditions (`train.gain_space`). The best few by training, and the own gains, then fly
validation seeds, and the best of those is the result. Nothing here sees the leaderboard's seeds.

Results do not depend on the number of threads, and the same options give the same gains. What was
found so far is in `OUTPUT/SCENARIO-ACTION.json`; after an interruption `--resume` goes on with it: the
search is repeated from its journal, without flying what was flown.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, final

import numpy as np

import formation_env
from baselines import make_policy
from baselines.policies.base import Policy
from baselines.policies.tuned import FEEDFORWARDS, VERSION, ExpertTuned, Gains, own, read
from baselines.scoring.intervals import Estimate
from baselines.scoring.results import Result, judge
from baselines.scoring.rollout import fly_all
from baselines.system import console
from baselines.system.progress import compiling
from baselines.system.reading import read_bytes
from baselines.system.writing import claim, write_text
from formation_env import FormationConfig, configure
from formation_env.checks import integer, number, require
from train.command_line import read as read_options
from train.gain_space import GainSpace
from train.search import Candidate, Search, search

PROGRAM, SCRIPT = "train.tune_expert", "formation-tune-expert"

# First seeds. The leaderboard's are 0 to 99; at most `_MOST` episodes keep the three apart.
TRAINING, VALIDATION, _MOST = 100_000, 200_000, 100_000

_WORST = -1e3  # the return of gains with which the law leaves the range of numbers
_EVERY = 5.0  # s between two writings of the journal


@final
@dataclass(frozen=True)
class Options:
    """Search gains for the paper's laws with CMA-ES, on seeds of its own.

    Results do not depend on the number of threads.
    """

    scenario: str = "nominal"
    """Name of the scenario that gains are searched for: nominal, paper, experiment, agile or swarm."""
    action: str | None = None
    """Action level: wrench, rates or reference; by default the scenario's own."""
    feedforward: str = "both"
    """How the third and fourth derivatives of the reference are taken: zero, derived, or both tried."""
    episodes: int = 64
    """Number of training episodes that every candidate flies, of the same seeds."""
    evaluations: int = 2000
    """Number of candidates in all, shared out evenly where both feedforwards are tried."""
    validation: int = 256
    """Number of validation episodes, on which the best candidates are compared."""
    finalists: int = 8
    """Number of candidates of each feedforward that fly the validation episodes."""
    spread: float = 0.5
    """Standard deviation of the first candidates about the own gains, in the logarithm of a gain.
    1 is a factor of e."""
    seed: int = 1
    """Seed of the search."""
    output: Path = field(default_factory=lambda: Path("runs/tune"))
    """Folder for the journal, SCENARIO-ACTION.json; made if it is not there."""
    gains: Path | None = None
    """File of gains that takes up the result, such as baselines/tuned_gains.json; by default none."""
    resume: bool = False
    """Go on with the journal that is in the output folder."""
    threads: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Number of candidates that are flown at a time, a thread each; by default one for each core."""
    quiet: bool = False
    """Print no progress bar."""

    def check(self) -> FormationConfig:
        """The configuration searched. Raises `ValueError` naming the option that is wrong."""
        config = configure(self.scenario)
        if self.action is not None:
            config = configure(self.scenario, action=self.action)
        allowed = ("both", *FEEDFORWARDS)
        known = self.feedforward in allowed
        require(known, "feedforward", self.feedforward, f"one of {', '.join(allowed)}")
        integer("episodes", self.episodes, 1, _MOST)
        integer("evaluations", self.evaluations, 1, 10_000_000)
        integer("validation", self.validation, 1, _MOST)
        integer("finalists", self.finalists, 1, 1000)
        number("spread", self.spread, 0.0)
        integer("seed", self.seed, 0, 2**63)
        integer("threads", self.threads, 1, 1024)
        return config

    def choices(self, config: FormationConfig) -> tuple[str, ...]:
        """The feedforwards tried; at level `reference` nobody takes one from the expert."""
        if config.action == "reference":
            return ("zero",)
        return FEEDFORWARDS if self.feedforward == "both" else (self.feedforward,)


# -- flying ---------------------------------------------------------------------------------------


def _return(policy: Policy, seeds: range) -> float:
    """Mean return over the seeds."""
    try:
        value = float(fly_all(policy, seeds)["return"].mean())
    except ValueError as problem:
        if "expected finite numbers" not in str(problem):
            raise
        return _WORST  # the law overflowed and the simulation refused its action
    return value if np.isfinite(value) else _WORST


# -- the journal ----------------------------------------------------------------------------------

# What may differ when a search is gone on with.
_FREE = ("resume", "threads", "quiet", "output", "gains", "evaluations")


@final
class Journal:
    """What has been flown, in one file that is written whole or not at all."""

    def __init__(self, path: Path, options: Options, config: FormationConfig, command: str) -> None:
        self._path, self._space = path, GainSpace(config)
        fixed = {k: v for k, v in asdict(options).items() if k not in _FREE}
        self._head: dict[str, Any] = {
            "command": command,
            "package": formation_env.__version__,
            "options": {**fixed, "action": config.action},
            "training": [TRAINING, TRAINING + options.episodes - 1],
        }
        self._written = time.monotonic()
        self.candidates: dict[str, list[Candidate]] = {}

    def known(self) -> dict[str, list[float]]:
        """The values in the file. Raises `ValueError` if it is of another search."""
        try:
            before = json.loads(read_bytes(self._path).decode("utf-8"))
            options, package, values = before["options"], before["package"], before["values"]
            known = {k: [float(x) for x in v] for k, v in values.items()}
        except OSError as problem:
            raise ValueError(
                f"--resume: {self._path}: {problem.strerror}; expected a journal"
            ) from None
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            raise ValueError(f"--resume: {self._path} is not a journal of {PROGRAM}") from None
        now = json.loads(json.dumps({**self._head["options"], "package": self._head["package"]}))
        for name, value in {**options, "package": package}.items():
            if now.get(name) != value:
                raise ValueError(
                    f"--resume: {self._path} was begun with {name} = {value!r}, not {now.get(name)!r}"
                )
        return known

    def add(self, feedforward: str, generation: Sequence[Candidate]) -> None:
        """Note a generation; the file follows within seconds."""
        self.candidates.setdefault(feedforward, []).extend(generation)
        if time.monotonic() - self._written > _EVERY:
            self.write(None)

    def best(self, feedforward: str, count: int) -> list[Candidate]:
        """The best by training, no two alike; the earlier first where they are equally good."""
        ordered = sorted(self.candidates[feedforward], key=lambda c: -c.value)
        return list(dict.fromkeys(ordered))[:count]

    def write(self, result: dict[str, Any] | None) -> None:
        """Write the file: values in the order flown, the best gains so far, and the result."""
        everyone = [c for each in self.candidates.values() for c in each]
        best = max(everyone, key=lambda c: c.value)
        document = {
            **self._head,
            "evaluations": len(everyone),
            "best_by_training": {
                "return": best.value,
                **self._space.gains(np.array(best.x), best.feedforward).document(),
            },
            "result": result,
            "values": {name: [c.value for c in each] for name, each in self.candidates.items()},
        }
        write_text(self._path, json.dumps(document, indent=1, allow_nan=False) + "\n")
        self._written = time.monotonic()


# -- validation -----------------------------------------------------------------------------------


class Verdict(NamedTuple):
    """The gains chosen and what they are worth on the validation seeds."""

    gains: Gains
    result: Result


def validate(
    config: FormationConfig, finalists: Sequence[Gains], seeds: range, pool: ThreadPoolExecutor
) -> Verdict:
    """The finalist with the largest mean return over the seeds, the first where equal."""
    policies = [ExpertTuned(config, gains) for gains in finalists]
    anchors = [make_policy(name, config) for name in ("hover", "expert")]
    hover, expert, *columns = pool.map(lambda p: fly_all(p, seeds), [*anchors, *policies])
    best = max(range(len(columns)), key=lambda i: columns[i]["return"].mean())
    return Verdict(finalists[best], judge(columns[best], hover, expert))


def _interval(e: Estimate) -> list[float | None]:
    return [float(x) if np.isfinite(x) else None for x in (e.value, e.low, e.high)]


def made(options: Options, command: str, verdict: Verdict) -> dict[str, Any]:
    """How gains were found and what they are worth."""
    result = verdict.result
    return {
        "command": command,
        "package": formation_env.__version__,
        "seed": options.seed,
        "training": [TRAINING, TRAINING + options.episodes - 1],
        "validation": [VALIDATION, VALIDATION + options.validation - 1],
        "score": _interval(result.score),
        "return": _interval(result.summary["return"]),
        "return_minus_expert": _interval(result.differences["return"]),
        "failed": _interval(result.summary["failed"]),
    }


def take_up(path: Path, scenario: str, action: str, entry: dict[str, Any]) -> None:
    """Put an entry into a file of gains, which is made if it is not there."""
    gains: dict[str, dict[str, Any]] = {}
    if path.exists():
        read(path)  # a broken file is refused, not overwritten
        gains = json.loads(path.read_text(encoding="utf-8"))["gains"]
    gains.setdefault(scenario, {})[action] = entry
    document = {"version": VERSION, "gains": gains}
    write_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


# -- command line ---------------------------------------------------------------------------------


def command_of(options: Options) -> str:
    """The command that repeats the result: without what does not change it."""
    words = ["python", "-m", PROGRAM]
    for each in fields(options):
        value, usual = getattr(options, each.name), getattr(Options(), each.name)
        if value != usual and each.name not in ("resume", "threads", "quiet", "output"):
            words += [f"--{each.name}", str(value)]
    return shlex.join(words)


def tune(options: Options) -> Verdict:
    """The whole search. Raises `ValueError` for wrong options, before anything is written."""
    config, command = options.check(), command_of(options)
    path = options.output / f"{config.scenario}-{config.action}.json"
    if options.gains is not None and options.gains.exists():
        read(options.gains)
    if options.resume:
        Journal(path, options, config, command).known()  # refused before a folder is made
    with claim(options.output):
        return _searched(options, config, Journal(path, options, config, command), path)


def _searched(options: Options, config: FormationConfig, journal: Journal, path: Path) -> Verdict:
    """The search in a folder of its own, its journal and its entry in a file of gains."""
    command = command_of(options)
    known = journal.known() if options.resume else {}
    if path.exists() and not options.resume:
        raise ValueError(f"{path} exists: expected --resume to go on with it, or another --output")
    verdict = _run(options, config, journal, known)
    entry = {**verdict.gains.document(), "made": made(options, command, verdict)}
    journal.write(entry)
    if options.gains is not None:
        take_up(options.gains, config.scenario, config.action, entry)
    return verdict


def _run(
    options: Options, config: FormationConfig, journal: Journal, known: dict[str, list[float]]
) -> Verdict:
    from tqdm import tqdm

    space, choices = GainSpace(config), options.choices(config)
    seeds = range(TRAINING, TRAINING + options.episodes)
    share = max(1, options.evaluations // len(choices))
    # Before many threads do so at once: the first flight compiles, and the own gains must fly.
    with compiling(options.quiet):
        hover = _return(make_policy("hover", config), seeds)
        own_return = _return(make_policy("expert", config), seeds)
    with (
        ThreadPoolExecutor(options.threads, thread_name_prefix="tune") as pool,
        tqdm(total=share * len(choices), disable=options.quiet, unit=" candidates") as bar,
    ):

        def value(candidates: Sequence[Gains]) -> list[float]:
            # Made here, not in the threads: how `configure` silences warnings is not for threads.
            policies = [ExpertTuned(config, gains) for gains in candidates]
            return list(pool.map(lambda policy: _return(policy, seeds), policies))

        def told(feedforward: str, generation: Sequence[Candidate]) -> None:
            journal.add(feedforward, generation)
            bar.update(len(generation))
            best = journal.best(feedforward, 1)[0].value
            score = (best - hover) / (own_return - hover) if own_return != hover else float("nan")
            bar.set_description_str(f"{feedforward}: score {score:.3f}", refresh=False)

        try:
            for choice in choices:
                drive = Search(space, value, told, options.spread, options.seed)
                search(drive, choice, share, known.get(choice, ()))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            if journal.candidates:
                journal.write(None)
            raise
        return validate(config, _finalists(options, config, journal), _validation(options), pool)


def _validation(options: Options) -> range:
    return range(VALIDATION, VALIDATION + options.validation)


def _finalists(options: Options, config: FormationConfig, journal: Journal) -> list[Gains]:
    """The own gains, then the best by training."""
    space = GainSpace(config)
    best = [
        space.gains(np.array(c.x), c.feedforward)
        for choice in options.choices(config)
        for c in journal.best(choice, options.finalists)
    ]
    return [own(config), *best]


def _refuse(message: object) -> NoReturn:
    print(f"{SCRIPT}: error: {message}", file=sys.stderr)
    raise SystemExit(2)


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    try:
        import cma  # noqa: F401  # its absence is better known now than after compiling
        import tyro  # noqa: F401
    except ImportError as problem:
        _refuse(f'{problem.name} is missing: pip install "formation-env[train]"')
    options = read_options(Options, SCRIPT, arguments)
    try:
        verdict = tune(options)
    except ValueError as problem:
        _refuse(problem)
    except OSError as problem:
        print(f"{SCRIPT}: error: {problem}; earlier files are kept", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted: --resume goes on where the journal ends", file=sys.stderr)
        return 130
    score, gain = verdict.result.score, verdict.result.differences["return"]
    console.say(
        f"score {score.value:.3f} ({score.low:.3f} .. {score.high:.3f}) on validation seeds, "
    )
    console.say(
        f"return {gain.value:+.4f} ({gain.low:+.4f} .. {gain.high:+.4f}) beside the expert's"
    )
    console.say(json.dumps(verdict.gains.document(), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
