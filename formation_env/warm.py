"""Compile ahead of time, so that no later run has to: `python -m formation_env.warm`.

Compiles the simulation and what installed packages add, such as the policies of `baselines`, and keeps all of
it where later processes look for it. Run again, it only finds that all is there.

A package adds its kernels by an entry point of the group `formation_env.warm`: a function without arguments
that uses each of them once.
"""

from __future__ import annotations

import argparse
import os
import pkgutil
import sys
import time
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from formation_env._jit import KERNELS
from formation_env.core import kernels
from formation_env.core.simulation import Simulation
from formation_env.core.threads import Team
from formation_env.scenarios import configure

GROUP = "formation_env.warm"
OWN = "formation_env.warm:use_kernels"


def use_kernels() -> None:
    """Use every kernel of the simulation once, with arguments of the types that all faces give it."""
    config = configure("agile")  # its paths are drawn
    config.trajectory.drawn(0)
    simulation = Simulation(config)
    simulation.reset()
    actions = np.zeros((1, config.followers, config.action_size), dtype=np.float32)
    simulation.step(actions)
    # What several threads need besides, whether or not this machine has the cores for them.
    kernels.first_bad_action(kernels.STEP, actions, np.zeros(1))
    Team(1, []).close()


def _sources(named: Sequence[str]) -> list[str]:
    """`module:function` of what uses kernels: those named, or else all that there are."""
    if named:
        return list(named)
    return [OWN, *sorted({point.value for point in entry_points(group=GROUP)})]


def _found(source: str) -> Callable[[], Any]:
    """The function that is meant. Raises `ValueError` naming what is wrong."""
    try:
        function = pkgutil.resolve_name(source)
    except (ValueError, ImportError, AttributeError) as problem:
        raise ValueError(f"{source}: {problem}; expected module:function") from None
    if not callable(function):
        raise ValueError(f"{source}: expected a function without arguments")
    return function  # type: ignore[no-any-return]


def _name(kernel: Any) -> str:
    return f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"


def _require_folders() -> None:
    """Raises `OSError` where a compiled kernel could not be kept."""
    for kernel in KERNELS:
        if not hasattr(kernel, "stats"):
            raise OSError("NUMBA_DISABLE_JIT is set: nothing is compiled")
        if kernel.stats.cache_path is None:
            where = os.path.dirname(kernel.py_func.__code__.co_filename)
            raise OSError(
                f"no folder to keep what is compiled in: neither {where}, nor the user's cache folder, can "
                "be written; name another in the environment variable NUMBA_CACHE_DIR"
            )


def warm(named: Sequence[str] = ()) -> str:
    """Compile what is not compiled yet, and say what that was and where it is kept.

    Raises `ValueError` for a name of which there is no function, `OSError` where nothing can be kept.
    """
    began = time.monotonic()
    for use in [_found(source) for source in _sources(named)]:
        _require_folders()  # of what has been imported by now: before a minute has been spent
        use()
    used = [one for one in KERNELS if one.signatures]
    if not used:
        raise ValueError(f"{', '.join(named)}: no kernel was used")
    compiled = [_name(one) for one in used if sum(one.stats.cache_misses.values())]
    folder = os.path.commonpath([one.stats.cache_path for one in used])
    seconds = f"{time.monotonic() - began:.1f} s"
    if not compiled:
        return f"all {len(used)} kernels were there already ({seconds}), in {folder}"
    return "\n".join(
        [
            f"compiled {len(compiled)} of {len(used)} kernels ({seconds}):",
            *(f"  {name}" for name in compiled),
            f"kept in {folder}",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m formation_env.warm",
        description="Compile ahead of time what the first run would compile, and keep it for later ones.",
    )
    parser.add_argument(
        "functions",
        nargs="*",
        metavar="module:function",
        help="what uses the kernels to be compiled (default: the simulation's and those of installed "
        f"packages, {OWN} first)",
    )
    try:
        print(warm(parser.parse_args(arguments).functions))
    except (ValueError, OSError) as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
