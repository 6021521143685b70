"""Many episodes of one policy at once, each scored as it flies.

World i of a rollout is `gym.make("Formation-v0", ...).reset(seed=seed + i)`: the same numbers, whatever
the number of worlds flown together. Nothing is recorded but what the metrics need, so memory does not
grow with the length of an episode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from baselines.policies.base import Policy
from baselines.scoring.curves import COLUMN, Gatherer
from baselines.scoring.metrics import add_tick, begin, episodes, skipped_ticks, window_ticks
from formation_env import FormationConfig
from formation_env.core.simulation import Simulation, seeded_key

Episodes = dict[str, NDArray[np.float64]]
# Called after every tick with the simulation, the worlds that have stepped, `(worlds,)`, and all actions.
Watch = Callable[[Simulation, NDArray[np.bool_], NDArray[np.float32]], None]

# Vehicles flown together: enough that Python's share is small, few enough to stay in the cache and to
# be shared out between threads.
VEHICLES = 1500


def chunks(seed: int, count: int, followers: int, vehicles: int = VEHICLES) -> Iterator[range]:
    """The seeds `seed` to `seed + count - 1` in groups of about equal size that are flown together."""
    most = max(1, vehicles // (followers + 1))
    groups = -(-count // most)
    edges = [seed + count * i // groups for i in range(groups + 1)]
    return (range(a, b) for a, b in pairwise(edges))


def fly_all(policy: Policy, seeds: range) -> Episodes:
    """The episodes of any number of consecutive `seeds`, group by group."""
    parts = [
        fly(policy, group) for group in chunks(seeds.start, len(seeds), policy.config.followers)
    ]
    return joined(parts)


def joined(parts: Sequence[Episodes]) -> Episodes:
    """The episodes of several flights as those of one, in order."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def fly(
    policy: Policy,
    seeds: range,
    progress: Callable[[int], None] | None = None,
    most: int | None = None,
    watch: Watch | None = None,
    times: int = 1,
    world: FormationConfig | None = None,
    curves: bool = False,
) -> Episodes:
    """One episode for each of the consecutive `seeds`; the columns are `metrics.EPISODE`.

    The seeds are flown `times` times over, in worlds of their own: for policies that differ from world to
    world. `most` ends them after so many ticks, for a first use that only compiles. `progress` is called
    after every tick with the number of worlds, whose ticks have been done; what it raises stops the flight.
    `watch` sees every tick that has been flown. `world` is what is flown and scored, by default the policy's
    own configuration: another one is a world that the policy has not been told of. `curves` adds
    the column `curves.COLUMN`, of slot errors against time, and changes no other number.
    """
    config, worlds = world or policy.config, times * len(seeds)
    simulation = Simulation(config, worlds)
    for i, seed in enumerate(times * list(seeds)):
        simulation.seed(i, seeded_key(seed))
    policy.reset(seed=seeds.start, worlds=worlds)
    results = simulation.reset()
    tally, skipped, window = begin(simulation.started), skipped_ticks(config), window_ticks(config)
    actions = np.zeros((worlds, config.followers, config.action_size), dtype=np.float32)
    offsets = np.array(config.offsets)
    gatherer = Gatherer(config, worlds) if curves else None
    live, living = np.ones(worlds, dtype=np.bool_), worlds
    last = config.max_steps if most is None else min(most, config.max_steps)
    for tick in range(1, last + 1):
        if progress is not None:
            progress(worlds)
        if living == 0:
            continue
        before, actions = actions, policy.act(results.observations)
        if living < worlds:
            # Ended worlds stand still, in whatever state they ended: what is decided there is void.
            actions[~live] = 0.0
        results = simulation.step(actions, mask=live)
        if watch is not None:
            watch(simulation, live, actions)
        if gatherer is not None:
            gatherer.add(tick, live & ~results.terminated, results.outputs)
        living = add_tick(
            tally,
            tick,
            skipped,
            window,
            live,
            simulation.started,
            simulation.leaders,
            results.outputs,
            results.rewards,
            results.terminated,
            results.truncated,
            actions,
            before,
            offsets,
        )
    found = episodes(tally, config)
    if gatherer is None:
        return found
    gatherer.finish(tally.ticks, found["failed"] > 0.0)
    return {**found, COLUMN: gatherer.errors}
