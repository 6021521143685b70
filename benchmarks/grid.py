"""The vector environment over worlds, followers, action levels and threads, beside the floor."""

from __future__ import annotations

import gc
import tracemalloc
from statistics import median
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from benchmarks.floor import Floor
from benchmarks.steps import in_flight, random_steps
from benchmarks.timing import in_turn, ratio, repeating
from formation_env import FormationConfig

# Bytes a vehicle that a combination is reckoned to need for each environment held, returned arrays and
# their copies included, and for the floor.
_BYTES = 2048


class Point(NamedTuple):
    """One combination."""

    scenario: str
    action: str
    followers: int
    worlds: int

    @property
    def vehicles(self) -> int:
        """The leaders are vehicles too, though no agents."""
        return self.worlds * (self.followers + 1)

    def reckoned_bytes(self, threads: int) -> int:
        """Memory needed to measure it with so many settings of `threads` side by side."""
        return self.vehicles * _BYTES * threads


def task(point: Point) -> FormationConfig:
    """The configuration measured."""
    return in_flight(point.scenario, followers=point.followers, action=point.action)


def returned_bytes(value: Any, counted: set[int] | None = None) -> int:
    """Memory of the arrays in a step's result, arrays that share it counted once."""
    counted = set() if counted is None else counted
    if isinstance(value, np.ndarray):
        while isinstance(value.base, np.ndarray):
            value = value.base
        fresh = id(value) not in counted
        counted.add(id(value))
        return value.nbytes if fresh else 0
    if isinstance(value, dict):
        value = tuple(value.values())
    if isinstance(value, tuple):
        return sum(returned_bytes(item, counted) for item in value)
    return 0


def resident_bytes() -> int:
    """Memory of this process that lies in RAM now (Linux); 0 elsewhere."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            pages = int(file.read().split()[1])
    except OSError:
        return 0
    from resource import getpagesize

    return pages * getpagesize()


def memory(config: FormationConfig, worlds: int, threads: int) -> dict[str, float]:
    """Bytes a vehicle: `held` between steps, `peak` in a step beyond what it returns, `rss` growth."""
    vehicles = worlds * (config.followers + 1)
    first: Any = gym.make_vec("Formation-v0", num_envs=1, scenario=config)
    random_steps(first)(1)  # imports and machine code are not the worlds'
    first.close()
    gc.collect()
    resident = resident_bytes()
    tracemalloc.start()
    env: Any = gym.make_vec("Formation-v0", num_envs=worlds, scenario=config, threads=threads)
    actions = np.zeros(env.action_space.shape, dtype=np.float32)
    before_actions = actions.nbytes
    env.reset(seed=0)
    env.step(actions)
    gc.collect()
    held = tracemalloc.get_traced_memory()[0] - before_actions
    tracemalloc.reset_peak()
    result = env.step(actions)
    peak = tracemalloc.get_traced_memory()[1] - before_actions - returned_bytes(result)
    tracemalloc.stop()
    del result
    gc.collect()
    rss = resident_bytes() - resident - before_actions
    env.close()
    return {"held": held / vehicles, "peak": peak / vehicles, "rss": rss / vehicles}


def measure(point: Point, threads: list[int], rounds: int, seconds: float) -> list[dict[str, Any]]:
    """A row of figures for each number of threads, environment and floor timed in turn."""
    config = task(point)
    envs, floors, samplers = {}, {}, {}
    for count in threads:
        envs[count] = gym.make_vec(
            "Formation-v0", num_envs=point.worlds, scenario=config, threads=count
        )
        floors[count] = Floor(config, point.vehicles, count)
        samplers[f"env {count}"] = random_steps(envs[count])
        samplers[f"floor {count}"] = repeating(floors[count].step)
    times = in_turn(samplers, rounds, seconds)
    for count in threads:
        envs[count].close()
        floors[count].close()
    substeps = point.vehicles * config.substeps
    first = times[f"env {threads[0]}"]
    return [
        {
            **point._asdict(),
            "threads": count,
            "step_us": 1e6 * median(own),
            "step_us_least": 1e6 * min(own),
            "agent_steps_per_s": point.worlds * point.followers / median(own),
            "ns_per_agent_step": 1e9 * median(own) / (point.worlds * point.followers),
            "vehicle_substeps_per_s": substeps / median(own),
            "floor_vehicle_substeps_per_s": substeps / median(bare),
            "share_of_floor": ratio(bare, own),
            "speedup": ratio(first, own),
        }
        for count in threads
        for own, bare in [(times[f"env {count}"], times[f"floor {count}"])]
    ]
