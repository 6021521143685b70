"""One turn of `benchmarks.against`: times the points asked for, of the package that is imported here.

It runs in a process of its own and imports only public names of the package, since the package may be
another checkout's. Called with its options as JSON; prints the figures as JSON.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import gymnasium as gym

import formation_env
from baselines import make_policy
from benchmarks.steps import (
    frames,
    gym_steps,
    in_flight,
    parallel_steps,
    policy_steps,
    random_steps,
)
from benchmarks.timing import Sampler, in_turn
from formation_env import formation_v0


def sampler(point: str, scenario: str, threads: int) -> Sampler:
    """What is timed at a point: `gym.make`, `pettingzoo`, `frame-FOLLOWERS`, `vector-WORLDS` or
    `expert-WORLDS`."""
    config = in_flight(scenario)
    kind, _, worlds = point.partition("-")
    if kind == "frame":
        config = in_flight(scenario, followers=int(worlds))
        return frames(config, make_policy("expert", config))
    if kind == "gym.make":
        return gym_steps(config)
    if kind == "pettingzoo":
        return parallel_steps(formation_v0.parallel_env(scenario=config))
    env: Any = gym.make_vec("Formation-v0", num_envs=int(worlds), scenario=config, threads=threads)
    return (
        policy_steps(env, make_policy("expert", config)) if kind == "expert" else random_steps(env)
    )


def main() -> None:
    """Time the points in turn, `rounds` samples of `seconds` each, and print the least of each."""
    request = json.loads(sys.argv[1])
    samplers = {
        point: sampler(point, request["scenario"], request["threads"])
        for point in request["points"]
    }
    times = in_turn(samplers, request["rounds"], request["seconds"])
    least = {point: min(samples) for point, samples in times.items()}
    print(json.dumps({"package": formation_env.__file__, "seconds": least}))


if __name__ == "__main__":
    main()
