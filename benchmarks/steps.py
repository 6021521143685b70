"""Steps of environments to be timed. Of this package only public names, so that every checkout has them.

`benchmarks.against` measures other checkouts with this file, `timing` and `turn`.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.timing import Sampler, repeating
from formation_env import FormationConfig, configure


def in_flight(scenario: str, **changes: Any) -> FormationConfig:
    """The configuration of `scenario` with `changes`. In `paper` episodes begin in flight, in formation.

    Followers that hover at random never meet the trigger (40), and a world that waits is cheaper.
    """
    flying: dict[str, Any] = {"start": "formation"} if scenario == "paper" else {}
    return configure(scenario, **flying, **changes)


def random_steps(env: Any) -> Sampler:
    """Steps with random actions about hovering, drawn beforehand; resets happen as they fall due."""
    draw = np.random.default_rng(0)
    shape = env.action_space.shape
    drawn = [draw.uniform(-0.02, 0.02, shape).astype(np.float32) for _ in range(4)]
    env.reset(seed=0)
    turn = 0

    def step() -> None:
        nonlocal turn
        turn += 1
        env.step(drawn[turn % 4])

    return repeating(step)


def steps_only(env: Any, action: Callable[[int], Any]) -> Sampler:
    """Steps of a Gymnasium or PettingZoo parallel environment; the clock stands still in resets."""
    parallel = hasattr(env, "possible_agents")
    env.reset(seed=0)

    def sample(count: int) -> float:
        total, done, ended = 0.0, 0, False
        env.reset()
        while done < count:
            begin = perf_counter()
            while not ended and done < count:
                result = env.step(action(done))
                done += 1
                ended = not env.agents if parallel else result[2] or result[3]
            total += perf_counter() - begin
            if ended:
                env.reset()
                ended = False
        return total

    return sample


def parallel_steps(env: Any) -> Sampler:
    """Steps of a PettingZoo parallel environment with random actions drawn beforehand."""
    agents = env.possible_agents
    for i, agent in enumerate(agents):
        env.action_space(agent).seed(i)
    drawn = [{a: env.action_space(a).sample() for a in agents} for _ in range(64)]
    return steps_only(env, lambda k: drawn[k % 64])


def gym_steps(config: Any) -> Sampler:
    """Steps of one world through `gym.make` with random actions about hovering, drawn beforehand."""
    env = gym.make("Formation-v0", scenario=config)
    draw = np.random.default_rng(0)
    shape = env.action_space.shape
    drawn = [draw.uniform(-0.02, 0.02, shape).astype(np.float32) for _ in range(64)]
    return steps_only(env, lambda k: drawn[k % 64])


def policy_steps(env: Any, policy: Any) -> Sampler:
    """Steps of a vector environment flown by a policy; both count."""
    observations = env.reset(seed=0)[0]
    policy.reset(seed=0, worlds=env.num_envs)

    def step() -> None:
        nonlocal observations
        observations = env.step(policy.act(observations))[0]

    return repeating(step)


def frames(config: FormationConfig, policy: Any) -> Sampler:
    """Pictures of one world that the policy flies, with trails of full length."""
    env = gym.make("Formation-v0", scenario=config, render_mode="rgb_array")
    observation = env.reset(seed=0)[0]
    policy.reset(seed=0, worlds=1)
    for _ in range(65):  # a trail has 64 points, 0.08 s apart
        for _ in range(round(0.08 / config.control_period)):
            rows = np.reshape(observation, (1, config.followers, -1))
            observation = env.step(policy.act(rows).reshape(env.action_space.shape or ()))[0]
        env.render()
    return repeating(env.render)
