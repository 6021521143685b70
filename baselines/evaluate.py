"""Score policies on scenarios: `python -m baselines.evaluate`, or `formation-evaluate`.

Policies are named, or are files (see `baselines.files`), or your own code (`baselines.own`). Each flies the
same episodes: world i of a scenario has the seed `seed + i`, as `gym.make(...).reset(seed=seed + i)` has.
The score is absolute, 0 to 1: it needs no other policy. Results do not depend on the number of threads, nor
on whether the episodes are shared out over a Ray cluster (`--ray`).

Writes the full report, `results.json` (layout: see `baselines.reporting.report`) and `results.md`, into the
output folder, then prints the scores. `--plot` also draws them (`baselines.reporting.plots`), `--matrix`
writes every episode's figures, `--leaderboard` `LEADERBOARD.md`, its pages and the README's extract of it.
From Python the same is `baselines.evaluate(policies, scenarios)`: this module can be called.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, final

from baselines.own import PolicyError, label
from baselines.registry import available
from baselines.reporting import board, plots, report
from baselines.reporting.further import Further, fly_further
from baselines.scoring import cluster, options, suite
from baselines.scoring import evaluation as scoring
from baselines.scoring.evaluation import EPISODES, Executor
from baselines.scoring.results import Report, Sweep, summary
from baselines.scoring.runs import find_runs
from baselines.scoring.tasks import (
    at_values,
    changed,
    check_scenario,
    read_sweep,
    scenario_fields,
    swept,
    tasks,
)
from baselines.system import console, pictures
from baselines.system.progress import compiling
from baselines.system.text import wrapped
from baselines.system.writing import FolderTaken, claim, write_text
from formation_env import SCENARIOS, FormationConfig
from formation_env.validation.checks import integer

# Of the leaderboard: scenarios at their own action level, and at the other one of `wrench` and `rates`. At
# `reference` the environment's own tracker flies, and the score of every policy is that tracker's.
BOARD_SCENARIOS = (
    *SCENARIOS,
    "nominal:rates",
    "paper:rates",
    "experiment:wrench",
    "agile:rates",
    "swarm:rates",
)
FILES = ("results.json", "results.md")


# -- from Python ----------------------------------------------------------------------------------


def evaluate(
    policies: Any,
    scenarios: Any = "nominal",
    *,
    episodes: int = EPISODES,
    seed: int = 0,
    threads: int | None = None,
    quiet: bool = False,
    sweep: str | Sequence[str] = (),
    plot: str | Path | None = None,
) -> Report:
    """Score policies on scenarios, on the seeds `seed` to `seed + episodes - 1` for each.

    `policies`: one or a list of names, paths, `module:Name` (see `baselines.make_policy`), classes or
    functions that are called with the configuration, and objects with `reset(seed)` and `act(observation)`
    (see `baselines.own`); or a dictionary that gives them names, where a list is of training runs of one
    method (as are names that end in `#0`, `#1`, ...) and makes one row. `scenarios`: one or a list of names
    (`"paper"`, `"paper:rates"`), or a dictionary from names of yours to `FormationConfig`s or to
    dictionaries of fields, such as `{"windy": {"scenario": "paper", "gust": 0.5}}`.
    `threads` is by default one for each core; `quiet` shows no progress. `sweep`: one or a list of
    `"gust=0:2:9"` as the command's `--sweep` takes them: every scenario is flown once for each value, on the
    same seeds. `plot`: a folder for pictures of the results, as `--plot` (or later `baselines.plot`) writes
    them.

    The result prints as a table. `result.scenarios[name].results[policy]` holds the score with its interval,
    the metrics, the failures and every episode of each run. Raises `ValueError` naming what is wrong, and
    `PolicyError` where your own policy fails in flight; `OSError` where the folder cannot be written.
    """
    if plot is not None:
        if not pictures.installed():
            raise ValueError(f"plot = {str(plot)!r}: {pictures.MISSING}")
        with claim(Path(plot)):  # before anything flies
            pass
    threads = os.cpu_count() or 1 if threads is None else integer("threads", threads, 1, 1024)
    episodes = integer("episodes", episodes, 1, 1_000_000)
    seed = integer("seed", seed, 0, 2**32)
    named = _by_name(policies)
    with compiling(quiet):
        configs, sweeps = _configurations(scenarios, sweep)
        flyable = scoring.find_flyable(configs, named)
        scoring.warm(configs, flyable)
    found = scoring.evaluate(
        configs,
        named,
        episodes,
        seed,
        threads,
        quiet,
        flyable=flyable,
        sweeps=sweeps,
        curves=plot is not None,
    )
    if plot is not None:
        plots.plot(found, plot)
    return found


def _by_name(policies: Any) -> dict[str, Any]:
    if isinstance(policies, Mapping):
        return dict(policies)
    each = list(policies) if isinstance(policies, (list, tuple)) else [policies]
    found: dict[str, Any] = {}
    for policy in each:
        name = label(policy)
        if name in found:
            raise ValueError(
                f"policies: two are called {name!r}: give a dictionary with their names"
            )
        found[name] = policy
    if not found:
        raise ValueError("policies = []: expected at least one")
    return found


def _configurations(
    scenarios: Any, sweep: str | Sequence[str]
) -> tuple[dict[str, FormationConfig], tuple[Sweep, ...]]:
    """By name, once for each value of a sweep. Raises `ValueError` naming task and field."""
    settings = [read_sweep(text) for text in ([sweep] if isinstance(sweep, str) else sweep)]
    origins: dict[str, Any]
    if isinstance(scenarios, FormationConfig):
        origins = {scenarios.scenario: scenarios}
    elif isinstance(scenarios, Mapping):
        origins = {str(name): each for name, each in scenarios.items()}
    else:
        names = [scenarios] if isinstance(scenarios, str) else list(scenarios)
        for name in names:
            check_scenario(name)
        origins = {name: scenario_fields(name) for name in names}
    if settings:
        return at_values(origins, settings), swept(list(origins), settings)
    made = {
        name: each if isinstance(each, FormationConfig) else changed(each, [])
        for name, each in origins.items()
    }
    return made, ()


# -- the command ----------------------------------------------------------------------------------


@contextmanager
def _executor(given: argparse.Namespace) -> Iterator[Executor | None]:
    """Within, what flies the episodes on a cluster; None without one. Raises `ClusterError`."""
    if not given.ray:
        yield None
        return
    with cluster.joined(given.address, given.threads) as ray:
        yield partial(cluster.fly_all, ray)


def _configs(given: argparse.Namespace) -> dict[str, FormationConfig]:
    """The chosen tasks. Raises `ValueError` naming task and field."""
    if given.scenarios is None:
        all_scenarios = list(SCENARIOS if given.leaderboard is None else BOARD_SCENARIOS)
        given.scenarios = [] if given.config else all_scenarios
    origins = [*given.scenarios, *(path.stem for path in given.config)]
    given.swept = swept(origins, given.sweeps)
    return tasks(
        given.scenarios, given.config, given.settings, given.sweeps, given.action, given.duration
    )


def _claim(given: argparse.Namespace, scenarios: Sequence[str], stack: ExitStack) -> None:
    """Claim the folders that are written into. Raises `ValueError` naming what cannot be written."""
    written = [given.output / name for name in FILES]
    if given.matrix is not None:
        written.append(suite.file_of(given.matrix))
    if given.leaderboard is not None:
        try:
            board.check(given.leaderboard)
        except ValueError as problem:
            raise ValueError(f"argument --leaderboard: {problem}") from None
        written.append(given.leaderboard / board.NAME)
    if given.plot is not None:
        if not pictures.installed():
            raise ValueError(f"argument --plot: {pictures.MISSING}")
        for name in plots.names(scenarios, given.swept).values():
            written += [given.plot / f"{name}.png", given.plot / f"{name}.svg"]
    folders: dict[Path, tuple[Path, list[str]]] = {}
    for path in written:
        _, names = folders.setdefault(path.parent.resolve(), (path.parent, []))
        names.append(path.name)
    for folder, names in folders.values():
        try:
            stack.enter_context(claim(folder))
        except FolderTaken as problem:
            raise ValueError(f"{folder}: {problem.strerror}") from None
        except OSError as problem:
            reason = problem.strerror or problem
            raise ValueError(
                f"cannot write into {folder}: {reason}; expected a writable folder"
            ) from None
        for name in names:
            if (folder / name).is_dir():
                raise ValueError(f"{folder / name} is a folder: expected a file or nothing")


def _command(given: argparse.Namespace, available_policies: list[str]) -> str:
    """The command that repeats the figures: without what does not change them."""
    words = ["python -m baselines.evaluate"]
    all_scenarios = (
        [] if given.config else list(SCENARIOS if given.leaderboard is None else BOARD_SCENARIOS)
    )
    for name, chosen in {"policies": available_policies, "scenarios": all_scenarios}.items():
        if getattr(given, name) != chosen:
            words.append(f"--{name} {shlex.quote(','.join(getattr(given, name)))}")
    words += [f"--runs {shlex.quote(str(path))}" for path in given.runs]
    words += [f"--config {shlex.quote(str(path))}" for path in given.config]
    for option, settings in (("--set", given.settings), ("--sweep", given.sweeps)):
        words += [f"{option} {shlex.quote(f'{s.field}={s.text}')}" for s in settings]
    for name, usual in {"episodes": EPISODES, "seed": 0, "action": None, "duration": None}.items():
        if getattr(given, name) != usual:
            words.append(f"--{name} {getattr(given, name)}")
    return " ".join([*words, *(["--leaderboard"] if given.leaderboard is not None else [])])


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    parser = options.parser()
    given = parser.parse_args(arguments)
    with ExitStack() as stack, _collected_warnings() as collected:
        try:
            flown, further, command = _fly(given, parser, stack)
        except (cluster.ClusterError, PolicyError) as problem:
            if problem.__cause__ is not None:
                console.complain("".join(traceback.format_exception(problem.__cause__)).rstrip())
            console.complain(f"{parser.prog}: error: {problem}; nothing was written")
            return 1
        except KeyboardInterrupt:
            console.complain("interrupted: nothing was written")
            return 130
        try:
            written = _write(flown, further, given, command)
        except OSError as problem:
            console.complain(f"{parser.prog}: error: {problem}; earlier results are kept")
            return 1
    _print(flown, collected, written)
    return 0


def _fly(
    given: argparse.Namespace, parser: argparse.ArgumentParser, stack: ExitStack
) -> tuple[Report, Further, str]:
    """The results, what is flown for a leaderboard beside them, and the command that repeats them.

    The folders are claimed until `stack` is closed.

    Raises `SystemExit` for what is wrong with the options, `ClusterError` and `PolicyError`.
    """
    try:
        if given.address is not None and not given.ray:
            raise ValueError("argument --address: only with --ray")
        with compiling():
            configs = _configs(given)
            runs = find_runs(given.runs)
            available_policies = list(dict.fromkeys([*available(configs.values()), *runs]))
            given.policies = getattr(given, "policies", available_policies)
            policies = {name: runs.get(name, name) for name in given.policies}
            flyable = scoring.find_flyable(configs, policies)
            _claim(given, list(configs), stack)
            if not given.ray:
                scoring.warm(configs, flyable)
    except ValueError as problem:
        parser.error(str(problem))
    try:
        with _executor(given) as executor:
            g = given
            flown = scoring.evaluate(
                configs,
                policies,
                g.episodes,
                g.seed,
                g.threads,
                False,
                executor,
                flyable,
                g.swept,
                g.plot is not None,
            )
    except cluster.Unreachable as problem:
        parser.error(str(problem))
    further = Further() if given.leaderboard is None else fly_further(flown, flyable, given.threads)
    return flown, further, _command(given, available_policies)


@contextmanager
def _collected_warnings() -> Iterator[list[warnings.WarningMessage]]:
    """Within, warnings are kept for the end instead of printed across the bar; shown if there is none."""
    with warnings.catch_warnings(record=True) as collected:
        try:
            yield collected
        except BaseException:
            for text in _texts(collected):
                console.complain(wrapped(text))
            raise


def _texts(collected: Sequence[warnings.WarningMessage]) -> list[str]:
    return list(dict.fromkeys(f"warning: {' '.join(str(w.message).split())}" for w in collected))


def _write(result: Report, further: Further, given: argparse.Namespace, command: str) -> list[Path]:
    """Write all files; returns their paths. Raises `OSError`."""
    folder: Path = given.output
    about = f"# Results\n\n```bash\n{command}\n```\n\n"
    write_text(folder / "results.json", report.to_json(result, command))
    write_text(folder / "results.md", about + report.markdown(result))
    written = [folder / "results.md", folder / "results.json"]
    if given.plot is not None:
        plots.plot(result, given.plot)
        written.append(given.plot)
    if given.matrix is not None:
        written.append(suite.write(suite.matrix(result), given.matrix))
    if given.leaderboard is not None:
        written += board.write(result, given.leaderboard, command, further)
    return written


def _print(
    result: Report, collected: Sequence[warnings.WarningMessage], written: Sequence[Path]
) -> None:
    """What ends a run: scores, failures, warnings, and where the rest is."""
    console.say(summary(result))
    if _texts(collected):
        console.say("\n" + "\n".join(map(wrapped, _texts(collected))))
    files = ", ".join(map(str, written))
    console.say("\n" + wrapped(f"all metrics and differences: {files}"))


@final
class _Callable(ModuleType):
    """This module as a function, so that `baselines.evaluate(...)` and `python -m baselines.evaluate` are
    both what they say: importing a submodule sets the package's attribute of its name."""

    def __call__(self, *args: Any, **options: Any) -> Report:
        return evaluate(*args, **options)


sys.modules[__name__].__class__ = _Callable

if __name__ == "__main__":
    sys.exit(main())
