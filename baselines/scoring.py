"""The evaluation itself: every policy flies the same episodes of every scenario."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from baselines.intervals import Estimate, difference, estimate, normalised, summarise
from baselines.learned import Misfit
from baselines.metrics import KINDS
from baselines.own import PolicyError
from baselines.policy import Policy
from baselines.progress import Bar, compiling
from baselines.registry import POLICIES, Recipe, Unshipped, make_policy, recipe
from baselines.rollout import Episodes, chunks, fly
from baselines.transfer import differences, marked
from formation_env import FeasibilityWarning, FormationConfig

EPISODES = 100
# The policies that the score is normalised with.
ANCHORS = ("expert", "hover")
TUNED = "expert-tuned"
# What is compared with the expert's seed by seed.
COMPARED = ("return", "slot_error_rms")


class Result(NamedTuple):
    """One policy on one scenario."""

    score: Estimate
    summary: dict[str, Estimate]
    differences: dict[str, Estimate]  # to the expert
    failures: dict[str, int]
    to_tuned: dict[str, Estimate]  # differences to the expert with searched gains, if it has flown


class Source(NamedTuple):
    """The file that a policy was flown from."""

    file: str  # name without the folder
    method: str
    scenario: str  # trained on
    action: str  # at this level
    differs: bool  # whether the task flown is another one than it was trained for


class Scenario(NamedTuple):
    """All policies on one scenario."""

    config: FormationConfig
    results: dict[str, Result]
    span: float  # the expert's mean return minus hover's, the unit of the score
    measuring: dict[str, Estimate] | None  # the expert's, with velocity and acceleration measured
    sources: dict[str, Source]  # of those policies that are files
    absent: dict[str, str]  # policies that cannot fly here, and why

    def untrained(self, policy: str) -> bool:
        """Whether the policy is a file that was trained for another task: `transfer.differences`."""
        source = self.sources.get(policy)
        return source is not None and source.differs


class Flight(NamedTuple):
    """One policy in the worlds of some consecutive seeds."""

    config: FormationConfig
    recipe: Recipe
    seeds: range


# Flies flights, in any order, and returns their episodes in the order given; on the way it tells of
# worlds' ticks that have been dealt with.
Fleet = Callable[[Sequence[Flight], Callable[[int], None]], list[Episodes]]


class Report(NamedTuple):
    """A whole evaluation."""

    seed: int
    episodes: int
    scenarios: dict[str, Scenario]

    def __str__(self) -> str:
        """What the command prints: scores and failures."""
        from baselines.terminal import summary

        return summary(self)


def judge(
    columns: Episodes, hover: Episodes, expert: Episodes, tuned: Episodes | None = None
) -> Result:
    """A policy's result from its episodes and those of the policies it is compared with on the same
    seeds."""
    returns = [each["return"] for each in (columns, hover, expert)]
    kinds = np.bincount(columns["failure"].astype(np.int64), minlength=len(KINDS))
    return Result(
        estimate(normalised, *returns),
        summarise(columns),
        {name: difference(columns, expert, name) for name in COMPARED},
        {kind: int(kinds[k]) for k, kind in enumerate(KINDS) if k > 0},
        {} if tuned is None else {name: difference(columns, tuned, name) for name in COMPARED},
    )


def above_expert(results: dict[str, Result]) -> list[str]:
    """The policies with a score above the expert's."""
    return [p for p, r in results.items() if r.differences["return"].value > 0.0]


class Crew(NamedTuple):
    """The policies of one scenario: how those that fit it are made, and why the others do not."""

    recipes: dict[str, Recipe]
    absent: dict[str, str]  # policies that cannot fly it, and why


def enlist(
    configs: Mapping[str, FormationConfig], policies: Sequence[str] | Mapping[str, Any]
) -> dict[str, Crew]:
    """How to make each policy on each configuration that it fits.

    `policies` are names, or what `registry.recipe` takes by the name to call it. Raises `ValueError` for
    an unknown policy, a bad file, and a policy that fits no configuration.
    """
    crews = {name: Crew({}, {}) for name in configs}
    for policy, source in named(policies).items():
        problems = []
        for name, config in configs.items():
            try:
                crews[name].recipes[policy] = recipe(source, config)
            except Misfit as problem:
                short = "no file of this method is shipped for it"
                problems.append(str(problem))
                crews[name].absent[policy] = (
                    short if isinstance(problem, Unshipped) else str(problem)
                )
        if not any(policy in crew.recipes for crew in crews.values()):
            raise ValueError("; ".join(dict.fromkeys(problems)))
    return crews


def enlist_all(
    configs: Mapping[str, FormationConfig], policies: Sequence[str] | Mapping[str, Any]
) -> dict[str, Crew]:
    """`enlist` with the policies that the score is normalised with."""
    return enlist(configs, {**named(policies), **{name: name for name in ANCHORS}})


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
    fleet: Fleet | None = None,
    crews: Mapping[str, Crew] | None = None,
) -> Report:
    """Score `policies` on named configurations, seeds `seed` to `seed + episodes - 1` for each.

    A policy flies where it fits, on `fleet` or else on so many threads of this process. `crews` is what
    `enlist_all` gave for these, if that has been called, and `warm` too if they fly here. Raises
    `ValueError` as `enlist` does, `PolicyError` where a user's own policy fails, and what the fleet raises.
    """
    wanted = named(policies)
    if crews is None:
        with compiling(quiet):
            crews = enlist_all(configs, policies)
            if fleet is None:
                warm(configs, crews)
    jobs = [
        (name, policy, seeds)
        for name, config in configs.items()
        for policy in crews[name].recipes
        for seeds in chunks(seed, episodes, config.followers)
    ]
    flights = [Flight(configs[name], crews[name].recipes[p], seeds) for name, p, seeds in jobs]
    columns = _collect(jobs, _fly_all(flights, threads, quiet, fleet))
    scenarios = {}
    for name, config in configs.items():
        each, crew = columns[name], crews[name]
        flown = [p for p in wanted if p in crew.recipes]
        others = each["hover"], each["expert"], each.get(TUNED)
        results = {p: judge(each[p], *others) for p in flown}
        measuring = None
        if config.estimator == "differenced" and above_expert(results):
            measuring = _measuring(config, episodes, seed)
        span = float(each["expert"]["return"].mean() - each["hover"]["return"].mean())
        scenarios[name] = Scenario(
            config, results, span, measuring, _sources(crew, config), crew.absent
        )
    return Report(seed, episodes, scenarios)


def warm(configs: Mapping[str, FormationConfig], crews: Mapping[str, Crew]) -> None:
    """Use all kernels once, so that they are compiled before time is counted."""
    for name, crew in crews.items():
        for made in crew.recipes.values():
            if not made.own:
                with marked():
                    fly(made.make(configs[name]), range(1), most=2)


def _sources(crew: Crew, config: FormationConfig) -> dict[str, Source]:
    return {
        policy: Source(
            made.file,
            made.card.method,
            made.card.scenario,
            made.card.action,
            bool(differences(made.card, config)),
        )
        for policy, made in crew.recipes.items()
        if made.card is not None
    }


def _measuring(config: FormationConfig, episodes: int, seed: int) -> dict[str, Estimate]:
    """The expert where velocities and accelerations are measured, not differenced from positions."""
    with warnings.catch_warnings():  # the configuration itself has warned already
        warnings.simplefilter("ignore", FeasibilityWarning)
        direct = replace(config, estimator="direct")
    first = next(chunks(seed, episodes, config.followers))
    return summarise(fly(make_policy("expert", direct), first))


def _fly_all(
    flights: Sequence[Flight], threads: int, quiet: bool, fleet: Fleet | None
) -> list[Episodes]:
    """The episodes of every flight, with a progress bar."""
    bar = Bar(sum(f.config.max_steps * len(f.seeds) for f in flights), "flying", quiet)
    try:
        return _fly_here(flights, threads, bar) if fleet is None else fleet(flights, bar.advance)
    finally:
        bar.close()


def _fly_here(flights: Sequence[Flight], threads: int, bar: Bar) -> list[Episodes]:
    """The flights shared out between threads of this process."""
    with marked():
        pilots = [flight.recipe.make(flight.config) for flight in flights]
    with ThreadPoolExecutor(threads, thread_name_prefix="evaluate") as pool:
        try:
            futures = [
                pool.submit(_fly, pilot, flight, bar)
                for pilot, flight in zip(pilots, flights, strict=True)
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


def _fly(pilot: Policy, flight: Flight, bar: Bar) -> Episodes:
    """One flight. Raises `PolicyError` where a user's own policy fails."""
    try:
        return fly(pilot, flight.seeds, bar.advance)
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
