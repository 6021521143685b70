"""Hash every number that the environments return, to see whether a change has kept all bits.

    python tests/fingerprint.py [SCENARIO ...] > before.txt
    ... change the code ...
    python tests/fingerprint.py [SCENARIO ...] | diff before.txt -

`--without reward_new` leaves out an entry of `info` that is new, to see that the others have kept theirs.
One line for each scenario, action level, face, number of worlds and number of threads: the SHA-256 of
observations, rewards, ends, `info` and true states of 60 steps from seed 0, in which some vehicles
crash and episodes begin anew. On one machine, with the same versions of NumPy and Numba, the lines
have to stay; another processor rounds differently and has other ones.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Collection, Iterable, Iterator
from typing import Any

import numpy as np

from formation_env import FormationConfig, Noise, configure
from formation_env.core import simulation
from formation_env.env import FormationEnv
from formation_env.formation_v0 import parallel_env
from formation_env.vector import FormationVectorEnv

_NOISE = Noise(0.02, 0.03, 0.04, 0.01, 0.02)
# The named ones, and what none of them has: the path as it is given, strong gusts, late measurements,
# more than 30 vehicles.
SCENARIOS: dict[str, dict[str, Any]] = {
    "nominal": {},
    "paper": {"scenario": "paper"},
    "experiment": {"scenario": "experiment"},
    "agile": {"scenario": "agile"},
    "swarm": {"scenario": "swarm"},
    "as-given": {"path": "as given"},
    "gusts": {"gust": 0.5, "gust_time": 0.4, "leader_actuation": "rates"},
    "late": {"measurement_delay": 2, "noise": _NOISE, "reference_actuation": "rates"},
    "seldom": {"measurement_period": 0.03, "measurement_delay": 1, "noise": _NOISE},
    "differenced": {"estimator": "differenced", "window": 10, "noise": _NOISE},
    # Measurements of single worlds without noise, whose last bits noise would hide, and with much of it,
    # which shows how attitudes are turned.
    "late-exact": {"scenario": "swarm", "measurement_delay": 2},
    "often-exact": {"scenario": "swarm", "measurement_period": 0.005},
    "unsteady": {"measurement_delay": 1, "noise": Noise(0.02, 0.03, 0.04, 0.1, 0.02)},
    "crowd": {"scenario": "swarm", "followers": 40, "neighbours": 3},
    "crowd-by-two": {"scenario": "swarm", "followers": 40},
}
LEVELS = ("wrench", "rates", "reference")
MODES = ("next_step", "same_step", "disabled")
WORLDS, THREADS = (1, 16, 17, 33), (1, 2)
STEPS, LIMIT = 60, 45  # an episode that has not ended is truncated after that many steps

Rows = Any  # (steps, worlds, entries of an action) of float32


def pilot(worlds: int, size: int) -> Rows:
    """Near hovering; every third world, the first among them, dives from its tenth step on."""
    rows = np.empty((STEPS, worlds, size), dtype=np.float32)
    for world in range(worlds):
        rng = np.random.default_rng(world)
        rows[:, world] = rng.uniform(-0.02, 0.02, (STEPS, size))
        if world % 3 == 0:
            rows[10:, world] = rng.uniform(-1.5, 1.5, size)
    return rows


def _feed(digest: Any, value: Any, without: Collection[str] = ()) -> None:
    """Names, dtypes, shapes and bits of a nested result, but for some entries and their masks."""
    if isinstance(value, dict):
        for name in sorted(value):
            if name.removeprefix("_") not in without:
                digest.update(name.encode())
                _feed(digest, value[name], without)
    elif isinstance(value, (tuple, list)):
        for item in value:
            _feed(digest, item, without)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        _feed(digest, value.tolist(), without)
    elif value is None:
        digest.update(b"None")
    else:
        array = np.asarray(value)
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())


def truth(flown: simulation.Simulation) -> tuple[Any, ...]:
    """The true states in float64: observations in float32 hide a change of the last bits."""
    return flown.positions, flown.velocities, flown.attitudes, flown.angular_velocities


def fly_alone(config: FormationConfig) -> Iterator[Any]:
    """All that the Gymnasium face returns, and the truth."""
    env = FormationEnv(config)
    yield env.reset(seed=0)
    for action in pilot(1, *env.action_space.shape)[:, 0]:
        step = env.step(action)
        yield step, truth(env.simulation)
        if step[2] or step[3]:
            yield env.reset()
    env.close()


def fly_agents(config: FormationConfig) -> Iterator[Any]:
    """All that the PettingZoo face returns, and its `state`."""
    env = parallel_env(scenario=config, max_cycles=LIMIT)
    yield env.reset(seed=0)
    for row in pilot(1, config.followers * config.action_size)[:, 0]:
        actions = np.split(row, config.followers)
        yield env.step(dict(zip(env.possible_agents, actions, strict=True))), env.state()
        if not env.agents:
            yield env.reset()
    env.close()


def fly_many(config: FormationConfig, mode: str, worlds: int, threads: int) -> Iterator[Any]:
    """All that the vector face returns, and the truth."""
    env = FormationVectorEnv(
        worlds, config, max_episode_steps=LIMIT, autoreset_mode=mode, threads=threads
    )
    yield env.reset(seed=0)
    for rows in pilot(worlds, *env.single_action_space.shape):
        step = env.step(rows)
        yield step, truth(env.simulation)
        over = step[2] | step[3]
        if mode == "disabled" and over.any():
            yield env.reset(options={"reset_mask": over})
    env.close()


def flights(config: FormationConfig) -> Iterator[tuple[str, Iterator[Any]]]:
    """Name and results of each flight of one task."""
    yield "gymnasium 1 1", fly_alone(config)
    yield "pettingzoo 1 1", fly_agents(config)
    for mode in MODES:
        for worlds in WORLDS:
            for threads in THREADS:
                yield f"{mode} {worlds} {threads}", fly_many(config, mode, worlds, threads)


def lines(scenarios: Iterable[str] = SCENARIOS, without: Collection[str] = ()) -> Iterator[str]:
    """`scenario level face worlds threads hash`, the face of many worlds by its autoreset mode."""
    for scenario in scenarios:
        for level in LEVELS:
            config = configure(**SCENARIOS[scenario], action=level)
            for name, results in flights(config):
                digest = hashlib.sha256()
                for result in results:
                    _feed(digest, result, without)
                yield f"{scenario} {level} {name} {digest.hexdigest()}"


if __name__ == "__main__":
    # So few vehicles would all be flown by one thread, however many are allowed.
    assert simulation._VEHICLES_PER_THREAD > 1
    simulation._VEHICLES_PER_THREAD = 1
    parser = argparse.ArgumentParser()
    parser.add_argument("scenarios", nargs="*")
    parser.add_argument("--without", nargs="+", default=())
    given = parser.parse_args()
    for line in lines(given.scenarios or SCENARIOS, given.without):
        print(line, flush=True)
