"""One world through `gym.make` and PettingZoo beside their like, the neighbours, and the expert."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import gymnasium as gym

from baselines.registry import make_policy
from baselines.scoring.rollout import fly
from benchmarks import peers
from benchmarks.grid import Point, task
from benchmarks.steps import (
    frames,
    gym_steps,
    in_flight,
    parallel_steps,
    policy_steps,
    random_steps,
    steps_only,
)
from benchmarks.timing import Sampler, in_turn, ratio, repeating, steps_within
from formation_env import configure, formation_v0
from formation_env.core.simulation import Simulation, seeded_key

Say = Callable[[str], None]
Figures = dict[str, Any]

_OWN = "Formation-v0 nominal"


def _cartpole() -> Sampler:
    env = gym.make("CartPole-v1")
    return steps_only(env, lambda k: k % 2)


def one_world(rounds: int, seconds: float, use_peers: bool, say: Say) -> Figures:
    """Microseconds a step of each face and of its like, and their ratios."""
    samplers = {
        "gym.make Formation-v0": gym_steps("nominal"),
        "gym.make CartPole-v1": _cartpole(),
        "PettingZoo Formation-v0": parallel_steps(formation_v0.parallel_env(followers=3)),
    }
    for peer in peers.PEERS if use_peers else ():
        if peer.worlds == (1,) and not _absent(peer, say):
            made = _made(peer, 1, say)
            if made is not None:
                samplers[peer.name] = made[0]
    times = in_turn(samplers, rounds, seconds)
    figures: Figures = {
        "step_us": {name: 1e6 * median(own) for name, own in times.items()},
        "over_cartpole": ratio(times["gym.make Formation-v0"], times["gym.make CartPole-v1"]),
        "over_mpe2": None,
    }
    if "MPE2 simple_spread_v3" in times:
        figures["over_mpe2"] = ratio(
            times["MPE2 simple_spread_v3"], times["PettingZoo Formation-v0"]
        )
    return figures


def frame(rounds: int, seconds: float, say: Say) -> float | None:
    """Milliseconds a picture of a leader and six followers, the least of some rounds; None without pygame."""
    if importlib.util.find_spec("pygame") is None:
        say("skipped pictures: pygame is not installed")
        return None
    config = in_flight("nominal", followers=6)
    times = in_turn({"frame": frames(config, make_policy("expert", config))}, rounds, seconds)
    return 1e3 * min(times["frame"])


def _absent(peer: peers.Peer, say: Say) -> bool:
    if peers.installed(peer) is None:
        say(f"skipped {peer.name}: {peer.package} is not installed")
        return True
    return False


def _made(peer: peers.Peer, worlds: int, say: Say) -> tuple[Sampler, int] | None:
    """A neighbour ready to be timed; a line and None where it fails."""
    try:
        with peers.hushed():
            sampler, agents = peer.make(worlds)
            sampler(1)
    except Exception as problem:  # a neighbour's fault, of whatever kind, must not end our run
        say(f"skipped {peer.name} at {worlds} worlds: {type(problem).__name__}: {problem}")
        return None
    return sampler, agents


def _best(peer: peers.Peer, seconds: float, most: int, say: Say) -> tuple[Sampler, int, int] | None:
    """A neighbour at its best batch size: sampler, agents a step, worlds."""
    best: tuple[float, Sampler, int, int] | None = None
    for worlds in [size for size in peer.worlds if size <= most] or peer.worlds[:1]:
        made = _made(peer, worlds, say)
        if made is None:
            break
        sampler, agents = made
        count = steps_within(sampler, seconds)
        rate = agents * count / sampler(count)
        if best is None or rate > best[0]:
            best = (rate, sampler, agents, worlds)
    return None if best is None else best[1:]


def batches(threads: int, rounds: int, seconds: float, most: int, say: Say) -> list[Figures]:
    """Agent steps a second of this package and of each vectorised neighbour at its best size, in turn.

    `most` bounds the worlds tried.
    """
    chosen: dict[str, tuple[Sampler, int, int]] = {}
    others = [p for p in peers.PEERS if len(p.worlds) > 1 and not _absent(p, say)]
    for peer in (_own_peer(threads), *others):
        best = _best(peer, seconds, most, say)
        if best is not None:
            chosen[peer.name] = best
    times = in_turn({name: best[0] for name, best in chosen.items()}, rounds, seconds)
    own = [t / chosen[_OWN][1] for t in times[_OWN]]
    return [
        {
            "name": name,
            "worlds": worlds,
            "agent_steps_per_s": agents / median(times[name]),
            "own_over_it": ratio([t / agents for t in times[name]], own),
        }
        for name, (_, agents, worlds) in chosen.items()
    ]


def _own_peer(threads: int) -> peers.Peer:
    def make(worlds: int) -> tuple[Sampler, int]:
        config = task(Point("nominal", "wrench", 2, worlds))
        env = gym.make_vec("Formation-v0", num_envs=worlds, scenario=config, threads=threads)
        return random_steps(env), 2 * worlds

    return peers.Peer(_OWN, "formation-env", peers.BATCHES, make)


def expert(
    scenario: str, worlds: int, threads: int, rounds: int, seconds: float, flight: float
) -> Figures:
    """The expert in the loop against the environment alone: flown through `make_vec`, and scored as
    `evaluate` does it, on one thread, in flights of `flight` seconds."""
    config = task(Point(scenario, "wrench", 2, worlds))
    alone = gym.make_vec("Formation-v0", num_envs=worlds, scenario=config, threads=threads)
    flown = gym.make_vec("Formation-v0", num_envs=worlds, scenario=config, threads=threads)
    policy = make_policy("expert", config)
    times = in_turn(
        {"alone": random_steps(alone), "expert": policy_steps(flown, policy)}, rounds, seconds
    )
    short = configure(config, duration=flight)
    together = min(worlds, 500)  # about as many as `evaluate` flies together
    scored = in_turn(
        {"alone": _bare_flight(short, together), "expert": _scored_flight(short, together)},
        rounds,
        0.0,
    )
    alone.close()
    flown.close()
    return {
        "scenario": scenario,
        "worlds": worlds,
        "step_us": {name: 1e6 * median(own) for name, own in times.items()},
        "share_vector": ratio(times["alone"], times["expert"]),
        "share_evaluate": ratio(scored["alone"], scored["expert"]),
    }


def _scored_flight(config: Any, worlds: int) -> Sampler:
    policy = make_policy("expert", config)
    return repeating(lambda: fly(policy, range(worlds)))


def _bare_flight(config: Any, worlds: int) -> Sampler:
    """The simulation alone on the expert's own actions, recorded; seeding and reset are not counted."""
    simulation = Simulation(config, worlds)
    policy = make_policy("expert", config)

    def begin() -> Any:
        for world in range(worlds):
            simulation.seed(world, seeded_key(world))
        return simulation.reset().observations

    policy.reset(seed=0, worlds=worlds)
    observations, recorded = begin(), []
    for _ in range(config.max_steps):
        recorded.append(policy.act(observations))
        observations = simulation.step(recorded[-1]).observations

    def sample(count: int) -> float:
        total = 0.0
        for _ in range(count):
            begin()
            start = time.perf_counter()
            for actions in recorded:
                simulation.step(actions)
            total += time.perf_counter() - start
        return total

    return sample
