"""The neighbours that are installed, each through its own public API and at its own defaults.

What a step does differs: point masses in the plane (MPE2, VMAS `simple_spread`), a drone without the
other drones (crazyflow, VMAS `drone`, PyFlyt). An agent step is one agent moved on by one control tick,
with its observation and reward. Where a neighbour can choose how much it integrates a tick, it is left at
its cheapest.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import NamedTuple

import gymnasium as gym
import numpy as np

from benchmarks.steps import parallel_steps, steps_only
from benchmarks.timing import Sampler, repeating


class Peer(NamedTuple):
    """A neighbour: how to make it with so many worlds; `make` raises `ImportError` if it is absent."""

    name: str
    package: str
    worlds: tuple[int, ...]  # sizes to try
    make: Callable[[int], tuple[Sampler, int]]  # a sampler, and agents a step


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Without a neighbour's banners and deprecation warnings."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        yield


def _vmas(scenario: str, threads: int) -> Callable[[int], tuple[Sampler, int]]:
    """With two of PyTorch's threads it is either faster or, on a busy machine, many times slower."""

    def make(worlds: int) -> tuple[Sampler, int]:
        vmas, torch = import_module("vmas"), import_module("torch")
        env = vmas.make_env(scenario, num_envs=worlds, device="cpu", seed=0)
        env.reset()
        actions = [
            torch.as_tensor(space.sample()).expand(worlds, -1).contiguous()
            for space in env.action_space
        ]
        steps = repeating(lambda: env.step(actions))

        def sample(count: int) -> float:
            torch.set_num_threads(threads)  # of the process, so set anew at every turn
            return steps(count)

        return sample, worlds * env.n_agents

    return make


def _crazyflow(worlds: int) -> tuple[Sampler, int]:
    import_module("crazyflow.envs")
    jax = import_module("jax")
    env = gym.make_vec("DroneReachPos-v0", num_envs=worlds)
    env.reset(seed=0)
    actions = np.tile(np.array([0.0, 0.0, 0.0, 0.3], dtype=np.float32), (worlds, 1))
    # JAX returns before it has computed.
    return repeating(lambda: jax.block_until_ready(env.step(actions)[:4])), worlds


def _pyflyt(worlds: int) -> tuple[Sampler, int]:
    env = import_module("PyFlyt.pz_envs").MAQuadXHoverEnvV2()
    actions = {agent: np.array([0.0, 0.0, 0.0, 0.4]) for agent in env.possible_agents}
    return steps_only(env, lambda _: actions), len(env.possible_agents)


def _mpe2(worlds: int) -> tuple[Sampler, int]:
    env = import_module("mpe2.simple_spread_v3").parallel_env(N=3)
    return parallel_steps(env), 3


# Worlds at which a vectorised environment is tried.
BATCHES = (256, 1024, 4096, 16384, 65536)

PEERS = (
    Peer("VMAS simple_spread, 1 thread", "vmas", BATCHES, _vmas("simple_spread", 1)),
    Peer("VMAS simple_spread, 2 threads", "vmas", BATCHES, _vmas("simple_spread", 2)),
    Peer("VMAS drone, 1 thread", "vmas", BATCHES, _vmas("drone", 1)),
    Peer("VMAS drone, 2 threads", "vmas", BATCHES, _vmas("drone", 2)),
    Peer("crazyflow DroneReachPos-v0", "crazyflow", BATCHES, _crazyflow),
    Peer("MPE2 simple_spread_v3", "mpe2", (1,), _mpe2),
    Peer("PyFlyt MAQuadXHover", "PyFlyt", (1,), _pyflyt),
)


def installed(peer: Peer) -> str | None:
    """The version of a neighbour, or None."""
    try:
        return version(peer.package)
    except PackageNotFoundError:
        return None
