"""Flights shared out over a Ray cluster: the one module here that imports Ray, where `--ray` is given.

Ray's workers have to find this package, in the same version, on every machine. Numbers are those of a
local run to the last bit where the machines are of one kind; see `docs/guarantees.md`.
"""

from __future__ import annotations

import logging
import os
import platform
import socket
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import formation_env
from baselines.registry import Recipe
from baselines.scoring.evaluation import Flight
from baselines.scoring.rollout import Episodes, fly
from formation_env import FormationConfig

MISSING = 'Ray is not installed: pip install "formation-env[ray]"'
PATIENCE = 60.0  # s, to wait for a cluster
_REACH = 5.0  # s, for its machine to answer at all
_MEMORY = 200 * 2**20  # bytes of object store of a local cluster: results are small
# Joins a cluster and says so. A process of its own, because the attempt may hang and cannot be stopped.
_PROBE = "import sys, ray; ray.init(address=sys.argv[1], log_to_driver=False); print('joined')"


class ClusterError(RuntimeError):
    """A cluster that fails; the message is for the user."""


class Unreachable(ClusterError):
    """No cluster to begin with."""


# -- joining --------------------------------------------------------------------------------------


def load_ray() -> Any:
    """The library. Raises `Unreachable` that names the command if it is not installed."""
    # No usage report leaves the machine unless its user asks for it, and the default that is to come.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its own, at import
        try:
            import ray
        except ModuleNotFoundError:
            raise Unreachable(MISSING) from None
    return ray


@contextmanager
def joined(address: str | None, cpus: int | None = None) -> Iterator[Any]:
    """Ray, connected to the cluster at an address, or to one of its own on `cpus` cores.

    What was started is stopped at the end. Raises `Unreachable` if the library is missing or the
    cluster cannot be joined, within about `PATIENCE` seconds.
    """
    ray = load_ray()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if address is None:
                _start(ray, cpus)
            else:
                _check(address)
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        yield ray
    finally:
        ray.shutdown()


def _start(ray: Any, cpus: int | None) -> None:
    """A cluster for this process alone, whatever others may run here."""
    try:
        ray.init(
            address="local",
            num_cpus=cpus,
            include_dashboard=False,
            object_store_memory=_MEMORY,
            log_to_driver=False,
            logging_level=logging.ERROR,
        )
    except (OSError, RuntimeError, ValueError) as problem:
        raise Unreachable(f"cannot start a local Ray cluster: {_line(problem)}") from None


def _check(address: str) -> None:
    """Make sure that there is a cluster, without waiting forever for one."""
    host, _, port = address.rpartition(":")
    if address != "auto":
        if not (host and port.isdecimal() and 0 < int(port) < 2**16):
            raise Unreachable(f"--address {address!r}: expected HOST:PORT or auto")
        try:
            socket.create_connection((host.strip("[]"), int(port)), _REACH).close()
        except OSError as problem:
            reason = problem.strerror or problem
            raise Unreachable(f"--address {address}: nobody answers there ({reason})") from None
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE, address],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise Unreachable(
            f"--address {address}: no Ray cluster answered within {PATIENCE:g} s"
        ) from None
    if probe.returncode != 0 or "joined" not in probe.stdout:
        last = _line(probe.stderr) or f"exit status {probe.returncode}"
        raise Unreachable(f"--address {address}: cannot join a Ray cluster there ({last})")


def _line(text: object) -> str:
    """The last line, not too long."""
    lines = str(text).strip().splitlines()
    return lines[-1][:300] if lines else ""


# -- flying ---------------------------------------------------------------------------------------


def _fly(
    config: FormationConfig,
    recipe: Recipe,
    seeds: range,
    world: FormationConfig | None,
    curves: bool,
    version: str,
) -> Episodes:
    """A worker's part. Raises `RuntimeError` where it has another version of this package."""
    if formation_env.__version__ != version:
        raise RuntimeError(
            f"{platform.node()} has formation-env {formation_env.__version__}, expected {version}"
        )
    return fly(recipe.make(config), seeds, world=world, curves=curves)


def fly_all(ray: Any, flights: Sequence[Flight], progress: Callable[[int], None]) -> list[Episodes]:
    """The episodes of every flight, in their order, flown one to a core wherever there is one.

    `progress` is called with the number of worlds' ticks that have been done. Flights of a worker that is
    lost are flown again by another.
    Raises `ClusterError` if that does not help.
    """
    task = ray.remote(num_cpus=1, max_retries=3, scheduling_strategy="SPREAD")(_fly)
    # A policy's numbers travel once to each machine, not with every flight.
    each = {id(f.recipe): f.recipe for f in flights}
    recipes = {key: ray.put(recipe) for key, recipe in each.items()}
    references = [
        task.remote(
            f.config, recipes[id(f.recipe)], f.seeds, f.world, f.curves, formation_env.__version__
        )
        for f in flights
    ]
    ticks = {reference: f.ticks for reference, f in zip(references, flights, strict=True)}
    waiting = references
    try:
        while waiting:
            finished, waiting = ray.wait(waiting)
            for reference in finished:
                ray.get(reference)
                progress(ticks[reference])
        return [dict(part) for part in ray.get(references)]
    except ray.exceptions.RayError as problem:
        raise ClusterError(f"{type(problem).__name__}: {_line(problem)}") from None
    finally:
        for reference in waiting:
            ray.cancel(reference, force=True)
