"""The evaluation itself: every policy flies the same episodes of every scenario."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

from baselines.files import Card, load
from baselines.own import PolicyError
from baselines.policies.base import Policy
from baselines.policies.learned import Misfit
from baselines.policies.transfer import differences, transfer_unwarned
from baselines.registry import POLICIES, Recipe, Unshipped, shipped_file
from baselines.scoring.results import REFERENCES, Report, Scenario, Source, Sweep, judge
from baselines.scoring.rollout import Episodes, chunks, fly, joined
from baselines.scoring.runs import make_row, rows_of, run_names, teacher_of
from baselines.system.progress import Bar, compiling
from formation_env import FormationConfig

EPISODES = 100

Key = TypeVar("Key", bound=Hashable)


class Flight(NamedTuple):
    """One policy in the worlds of some consecutive seeds."""

    config: FormationConfig  # that the policy is made for
    recipe: Recipe
    seeds: range
    world: FormationConfig | None = None  # that is flown, if it is another one
    curves: bool = False  # whether slot errors against time are gathered

    @property
    def flown(self) -> FormationConfig:
        """The configuration of the worlds."""
        return self.world or self.config

    @property
    def ticks(self) -> int:
        """Of all its worlds."""
        return self.flown.max_steps * len(self.seeds)


# Flies flights, in any order, and returns their episodes in the order given; calls the function with the
# number of worlds' ticks that have been done since its last call.
Executor = Callable[[Sequence[Flight], Callable[[int], None]], list[Episodes]]


class Flyable(NamedTuple):
    """The rows of one scenario: how the runs of those that fit it are made, and why the others do not."""

    recipes: dict[str, dict[str, Recipe]]
    absent: dict[str, str]  # rows that cannot fly it, and why


def find_flyable(
    configs: Mapping[str, FormationConfig], policies: Sequence[str] | Mapping[str, Any]
) -> dict[str, Flyable]:
    """How to make each policy on each configuration that it fits.

    `policies` are names, or what `registry.recipe` takes (or what `runs` says of training runs) by the name
    to call it. Raises `ValueError` for an unknown policy, a bad file, and a policy that fits no
    configuration.
    """
    found = {name: Flyable({}, {}) for name in configs}
    for row, source in named(policies).items():
        problems = []
        for name, config in configs.items():
            try:
                found[name].recipes[row] = make_row(row, source, config)
            except Misfit as problem:
                short = "no file of this method is shipped for it"
                problems.append(str(problem))
                found[name].absent[row] = short if isinstance(problem, Unshipped) else str(problem)
        if not any(row in each.recipes for each in found.values()):
            raise ValueError("; ".join(dict.fromkeys(problems)))
    return found


def named(policies: Sequence[str] | Mapping[str, Any]) -> dict[str, Any]:
    """The rows of policies by name; those of a sequence are names themselves. Raises `ValueError` for another
    policy under the name of one that others are compared with."""
    if not isinstance(policies, Mapping):
        return rows_of({policy: policy for policy in policies})
    rows = rows_of(policies)
    for name in REFERENCES:
        source = rows.get(name, name)
        if source != name and source is not POLICIES.get(name):
            raise ValueError(f"policy {name!r}: this name is taken: give yours another one")
    return rows


def evaluate(
    configs: Mapping[str, FormationConfig],
    policies: Sequence[str] | Mapping[str, Any],
    episodes: int = EPISODES,
    seed: int = 0,
    threads: int = 1,
    quiet: bool = True,
    executor: Executor | None = None,
    flyable: Mapping[str, Flyable] | None = None,
    sweeps: Sequence[Sweep] = (),
    curves: bool = False,
) -> Report:
    """Score `policies` on named configurations, seeds `seed` to `seed + episodes - 1` for each.

    A policy flies where it fits, by `executor` or else on so many threads of this process. `flyable` is
    what `find_flyable` gave for these, if that has been called, and `warm` too if they fly
    here. `sweeps` says which of the configurations are the values of one field; `curves` has slot errors
    against time gathered in the others. Raises `ValueError` as `find_flyable` does, `PolicyError` where a
    user's own policy fails, and what the executor raises.
    """
    if flyable is None:
        with compiling(quiet):
            flyable = find_flyable(configs, policies)
            if executor is None:
                warm(configs, flyable)
    seeds = range(seed, seed + episodes)
    swept = {name for each in sweeps for name in each.scenarios}
    flights = {
        (name, row, run): Flight(
            config, flyable[name].recipes[row][run], seeds, curves=curves and name not in swept
        )
        for name, config in configs.items()
        for row, run in run_names(flyable[name].recipes)
    }
    columns: dict[str, dict[str, dict[str, Episodes]]] = {name: {} for name in configs}
    for (name, row, run), flown in fly_all(flights, threads, quiet, executor).items():
        columns[name].setdefault(row, {})[run] = flown
    scenarios = {
        name: _scenario(config, flyable[name], columns[name]) for name, config in configs.items()
    }
    return Report(seed, episodes, scenarios, tuple(sweeps))


def _scenario(
    config: FormationConfig, flyable: Flyable, columns: Mapping[str, dict[str, Episodes]]
) -> Scenario:
    """The results of all rows that have flown."""
    references = {
        name: next(iter(columns[name].values())) for name in REFERENCES if name in columns
    }
    results = {row: judge(columns[row], references) for row in flyable.recipes}
    return Scenario(config, results, _sources(flyable, config), flyable.absent)


def warm(configs: Mapping[str, FormationConfig], flyable: Mapping[str, Flyable]) -> None:
    """Use all kernels once, so that they are compiled before time is counted."""
    for name, each in flyable.items():
        for row, run in run_names(each.recipes):
            made = each.recipes[row][run]
            if not made.own:
                with transfer_unwarned():
                    fly(made.make(configs[name]), range(1), most=2)


def _sources(flyable: Flyable, config: FormationConfig) -> dict[str, Source]:
    """Where the rows come from whose runs are policy files, by the row."""
    found = {}
    for row, runs in flyable.recipes.items():
        first, cards = next(iter(runs.values())), [made.card for made in runs.values()]
        card = first.card
        if card is None:
            continue
        path = shipped_file(card.method, card.scenario, card.action)
        ships = path.is_file() and any(_same_run(load(path)[0], each) for each in cards)
        found[row] = Source(
            path.name if ships else first.file,
            card.method,
            card.scenario,
            card.action,
            bool(differences(card, config)),
            teacher_of(card),
            card.history,
            first.hidden,
        )
    return found


def _same_run(card: Card, other: Card | None) -> bool:
    """Whether two cards are of one training run; scores may have been written into one of them since."""
    return other is not None and replace(card, score=other.score) == other


def fly_all(
    flights: Mapping[Key, Flight],
    threads: int,
    quiet: bool,
    executor: Executor | None = None,
    title: str = "flying",
) -> dict[Key, Episodes]:
    """The episodes of every flight, in the order of their seeds, with a progress bar of that title.

    What flies a flight takes groups of its worlds, by `executor` or else on so many threads of this process.
    Raises `PolicyError` where a user's own policy fails, and what the executor raises.
    """
    groups = [
        (key, flight._replace(seeds=seeds))
        for key, flight in flights.items()
        for seeds in chunks(flight.seeds.start, len(flight.seeds), flight.flown.followers)
    ]
    each = [flight for _, flight in groups]
    bar = Bar(sum(flight.ticks for flight in each), title, quiet)
    try:
        parts = _fly_here(each, threads, bar) if executor is None else executor(each, bar.advance)
    finally:
        bar.close()
    grouped: dict[Key, list[Episodes]] = {}
    for (key, _), part in zip(groups, parts, strict=True):
        grouped.setdefault(key, []).append(part)
    return {key: joined(group) for key, group in grouped.items()}


def _fly_here(flights: Sequence[Flight], threads: int, bar: Bar) -> list[Episodes]:
    """The flights shared out between threads of this process."""
    with transfer_unwarned():
        policies = [flight.recipe.make(flight.config) for flight in flights]
    with ThreadPoolExecutor(threads, thread_name_prefix="evaluate") as pool:
        try:
            futures = [
                pool.submit(_fly, policy, flight, bar)
                for policy, flight in zip(policies, flights, strict=True)
            ]
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
            failures = [future.exception() for future in done]
            for failure in filter(None, failures):  # at once, not after all flights before it
                raise failure
            return [future.result() for future in futures]
        except BaseException:
            bar.stop()
            pool.shutdown(cancel_futures=True)
            raise


def _fly(policy: Policy, flight: Flight, bar: Bar) -> Episodes:
    """One flight. Raises `PolicyError` where a user's own policy fails."""
    try:
        return fly(policy, flight.seeds, bar.advance, world=flight.world, curves=flight.curves)
    except Exception as problem:
        if not flight.recipe.own or bar.stopped:
            raise
        text = " ".join(f"{type(problem).__name__}: {problem}".split())
        raise PolicyError(f"policy {flight.recipe.own}: {text[:400]}") from problem
