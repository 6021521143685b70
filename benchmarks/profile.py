"""Where the time of one step goes: `python -m benchmarks.profile`.

Each layer is called by itself, from the outermost wrapper to the compiled kernel, and timed; a
layer's own share is what it takes beyond the layer below it. The kernel is called again with the very
arguments it was last given, and so is an empty kernel: what that one takes is the passing of arguments.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from statistics import median
from time import perf_counter
from types import ModuleType
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numba import njit
from numba.core.dispatcher import Dispatcher

from baselines.system.arguments import Parser, whole
from baselines.system.console import command, say
from benchmarks.report import table
from benchmarks.timing import Sampler, in_turn
from formation_env import formation_v0
from formation_env.core import kernels, simulation

# Steps after which a flight begins anew, so that all layers are timed in the same states.
_FLIGHT = 100


class Call(NamedTuple):
    """A compiled function and what it was called with."""

    name: str
    function: Any
    arguments: tuple[Any, ...]


@njit(nogil=True)  # type: ignore[untyped-decorator]
def _nothing(*arguments: Any) -> None:
    pass


@contextmanager
def recorded(modules: Sequence[ModuleType]) -> Iterator[list[Call]]:
    """The calls of compiled functions found in `modules` while the context lasts."""
    calls: list[Call] = []

    def spy(name: str, function: Any) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            calls.append(Call(name, function, arguments))
            return function(*arguments)

        return call

    own = [(m, n, f) for m in modules for n, f in vars(m).items() if isinstance(f, Dispatcher)]
    try:
        for module, name, function in own:
            setattr(module, name, spy(name, function))
        yield calls
    finally:
        for module, name, function in own:
            setattr(module, name, function)


def _flights(reset: Callable[[], object], step: Callable[[], object]) -> Sampler:
    """Steps of a layer; resets are not counted."""

    def sample(count: int) -> float:
        total = 0.0
        for first in range(0, count, _FLIGHT):
            reset()
            begin = perf_counter()
            for _ in range(min(_FLIGHT, count - first)):
                step()
            total += perf_counter() - begin
        return total

    return sample


def layers(env: Any, action: Any, followers: int) -> dict[str, Sampler]:
    """Samplers from the outside in: wrappers, environment, simulation, kernels, passing arguments."""
    env.reset(seed=0)
    chain, inner = [env], env
    while inner is not inner.unwrapped:
        inner = inner.env
        chain.append(inner)
    sim = inner.simulation
    rows = np.zeros((1, followers, sim.config.action_size), dtype=np.float32)

    def reset() -> None:
        env.reset(seed=0)

    samplers = {
        f"{type(layer).__name__}.step": _flights(reset, partial(layer.step, action))
        for layer in chain
    }
    samplers["Simulation.step"] = _flights(reset, lambda: sim.step(rows))
    with recorded((kernels, simulation)) as calls:
        sim.step(rows)
    samplers["kernels"] = _flights(reset, lambda: [c.function(*c.arguments) for c in calls])
    samplers["passing their arguments"] = _flights(
        reset, lambda: [_nothing(*c.arguments) for c in calls]
    )
    return samplers


def profile(name: str, samplers: dict[str, Sampler], rounds: int) -> str:
    """A table of what each layer takes, with and without the layers below it."""
    times = in_turn(samplers, rounds, 0.05)
    totals = {layer: 1e6 * median(own) for layer, own in times.items()}
    below = [*list(totals.values())[1:], 0.0]
    whole = next(iter(totals.values()))
    rows = [
        (layer, total, total - inner, f"{(total - inner) / whole:.0%}")
        for (layer, total), inner in zip(totals.items(), below, strict=True)
    ]
    head = [f"layer of one {name} step", "us with what is below", "us by itself", "share"]
    return table(head, rows)


def parser() -> Parser:
    """The options of the command, none of them read yet."""
    own = Parser(
        "benchmarks.profile",
        "Time each layer of one step, of gym.make and of PettingZoo, from the outermost wrapper to the "
        "compiled kernel.",
    )
    own.add_argument("--rounds", type=whole(1, 1000), default=15, metavar="N",
        help="Number of samples of each layer, of which the median is taken. "
        "(default: %(default)s)")  # fmt: skip
    return own


@command
def main(arguments: Sequence[str] | None = None) -> int:
    """Print the two tables; returns the exit status."""
    rounds = parser().parse_args(arguments).rounds
    single = layers(gym.make("Formation-v0"), np.zeros(8, dtype=np.float32), 2)
    say(profile("gym.make", single, rounds) + "\n")
    env = formation_v0.parallel_env(followers=3)
    actions = {agent: np.zeros(4, dtype=np.float32) for agent in env.possible_agents}
    say(profile("PettingZoo", layers(env, actions, 3), rounds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
