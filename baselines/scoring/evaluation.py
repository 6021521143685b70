"""The evaluation itself: every policy flies the same episodes of every scenario."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from baselines.own import PolicyError
from baselines.policies.base import Policy
from baselines.policies.learned import Misfit
from baselines.policies.transfer import differences, transfer_unwarned
from baselines.registry import POLICIES, Recipe, Unshipped, make_policy, recipe
from baselines.scoring.intervals import Estimate, summarise
from baselines.scoring.results import Report, Scenario, Source, above_expert, judge
from baselines.scoring.rollout import Episodes, chunks, fly
from baselines.system.progress import Bar, compiling
from formation_env import FeasibilityWarning, FormationConfig

EPISODES = 100
# The policies that the score is normalised with.
ANCHORS = ("expert", "hover")
TUNED = "expert-tuned"


class Flight(NamedTuple):
    """One policy in the worlds of some consecutive seeds."""

    config: FormationConfig
    recipe: Recipe
    seeds: range


# Flies flights, in any order, and returns their episodes in the order given; calls the function with the
# number of worlds' ticks that have been done since its last call.
Executor = Callable[[Sequence[Flight], Callable[[int], None]], list[Episodes]]


class Flyable(NamedTuple):
    """The policies of one scenario: how those that fit it are made, and why the others do not."""

    recipes: dict[str, Recipe]
    absent: dict[str, str]  # policies that cannot fly it, and why


def find_flyable(
    configs: Mapping[str, FormationConfig], policies: Sequence[str] | Mapping[str, Any]
) -> dict[str, Flyable]:
    """How to make each policy on each configuration that it fits.

    `policies` are names, or what `registry.recipe` takes by the name to call it. Raises `ValueError` for
    an unknown policy, a bad file, and a policy that fits no configuration.
    """
    found = {name: Flyable({}, {}) for name in configs}
    for policy, source in named(policies).items():
        problems = []
        for name, config in configs.items():
            try:
                found[name].recipes[policy] = recipe(source, config)
            except Misfit as problem:
                short = "no file of this method is shipped for it"
                problems.append(str(problem))
                found[name].absent[policy] = (
                    short if isinstance(problem, Unshipped) else str(problem)
                )
        if not any(policy in each.recipes for each in found.values()):
            raise ValueError("; ".join(dict.fromkeys(problems)))
    return found


def find_flyable_with_anchors(
    configs: Mapping[str, FormationConfig], policies: Sequence[str] | Mapping[str, Any]
) -> dict[str, Flyable]:
    """`find_flyable` of the policies and of those that the score is normalised with."""
    return find_flyable(configs, {**named(policies), **{name: name for name in ANCHORS}})


def named(policies: Sequence[str] | Mapping[str, Any]) -> dict[str, Any]:
    """Policies by name; those of a sequence are names themselves. Raises `ValueError` for another policy
    under the name of one that the score is normalised with."""
    if not isinstance(policies, Mapping):
        return {policy: policy for policy in policies}
    for name in ANCHORS:
        source = policies.get(name, name)
        if source != name and source is not POLICIES[name]:
            raise ValueError(f"policy {name!r}: this name is taken: give yours another one")
    return dict(policies)


def evaluate(
    configs: Mapping[str, FormationConfig],
    policies: Sequence[str] | Mapping[str, Any],
    episodes: int = EPISODES,
    seed: int = 0,
    threads: int = 1,
    quiet: bool = True,
    executor: Executor | None = None,
    flyable: Mapping[str, Flyable] | None = None,
) -> Report:
    """Score `policies` on named configurations, seeds `seed` to `seed + episodes - 1` for each.

    A policy flies where it fits, by `executor` or else on so many threads of this process. `flyable` is
    what `find_flyable_with_anchors` gave for these, if that has been called, and `warm` too if they fly
    here. Raises `ValueError` as `find_flyable` does, `PolicyError` where a user's own policy fails, and
    what the executor raises.
    """
    if flyable is None:
        with compiling(quiet):
            flyable = find_flyable_with_anchors(configs, policies)
            if executor is None:
                warm(configs, flyable)
    jobs = [
        (name, policy, seeds)
        for name, config in configs.items()
        for policy in flyable[name].recipes
        for seeds in chunks(seed, episodes, config.followers)
    ]
    flights = [Flight(configs[name], flyable[name].recipes[p], seeds) for name, p, seeds in jobs]
    columns = _collect(jobs, _fly_all(flights, threads, quiet, executor))
    scored = list(named(policies))
    scenarios = {
        name: _scenario(config, flyable[name], scored, columns[name], range(seed, seed + episodes))
        for name, config in configs.items()
    }
    return Report(seed, episodes, scenarios)


def _scenario(
    config: FormationConfig,
    flyable: Flyable,
    scored: Sequence[str],
    columns: Mapping[str, Episodes],
    seeds: range,
) -> Scenario:
    """The results of those of the policies `scored` that have flown, from the episodes of all."""
    hover, expert = columns["hover"], columns["expert"]
    results = {
        policy: judge(columns[policy], hover, expert, columns.get(TUNED))
        for policy in scored
        if policy in flyable.recipes
    }
    measuring = None
    if config.estimator == "differenced" and above_expert(results):
        measuring = _measuring(config, seeds)
    span = float(expert["return"].mean() - hover["return"].mean())
    return Scenario(config, results, span, measuring, _sources(flyable, config), flyable.absent)


def warm(configs: Mapping[str, FormationConfig], flyable: Mapping[str, Flyable]) -> None:
    """Use all kernels once, so that they are compiled before time is counted."""
    for name, each in flyable.items():
        for made in each.recipes.values():
            if not made.own:
                with transfer_unwarned():
                    fly(made.make(configs[name]), range(1), most=2)


def _sources(flyable: Flyable, config: FormationConfig) -> dict[str, Source]:
    return {
        policy: Source(
            made.file,
            made.card.method,
            made.card.scenario,
            made.card.action,
            bool(differences(made.card, config)),
        )
        for policy, made in flyable.recipes.items()
        if made.card is not None
    }


def _measuring(config: FormationConfig, seeds: range) -> dict[str, Estimate]:
    """The expert where velocities and accelerations are measured, not differenced from positions."""
    with warnings.catch_warnings():  # the configuration itself has warned already
        warnings.simplefilter("ignore", FeasibilityWarning)
        direct = replace(config, estimator="direct")
    first = next(chunks(seeds.start, len(seeds), config.followers))
    return summarise(fly(make_policy("expert", direct), first))


def _fly_all(
    flights: Sequence[Flight], threads: int, quiet: bool, executor: Executor | None
) -> list[Episodes]:
    """The episodes of every flight, with a progress bar."""
    bar = Bar(sum(f.config.max_steps * len(f.seeds) for f in flights), "flying", quiet)
    try:
        if executor is None:
            return _fly_here(flights, threads, bar)
        return executor(flights, bar.advance)
    finally:
        bar.close()


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
        return fly(policy, flight.seeds, bar.advance)
    except Exception as problem:
        if not flight.recipe.own or bar.stopped:
            raise
        text = " ".join(f"{type(problem).__name__}: {problem}".split())
        raise PolicyError(f"policy {flight.recipe.own}: {text[:400]}") from problem


def _collect(
    jobs: list[tuple[str, str, range]], parts: Iterable[Episodes]
) -> dict[str, dict[str, Episodes]]:
    """The groups of one scenario and policy put together again, in the order of their seeds."""
    grouped: dict[str, dict[str, list[Episodes]]] = {}
    for (name, policy, _), part in zip(jobs, parts, strict=True):
        grouped.setdefault(name, {}).setdefault(policy, []).append(part)
    return {
        name: {
            policy: {k: np.concatenate([x[k] for x in group]) for k in group[0]}
            for policy, group in policies.items()
        }
        for name, policies in grouped.items()
    }
