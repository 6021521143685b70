"""The floor: what it costs to advance the same vehicles through the rigid body alone.

No control, no sensors, no task, no reset: every lane of a tile goes through `quadrotor.fly` and
nothing else. Whatever the environment costs above this is its own doing. The moments of the `wrench`
level are used at every action level; a rate loop would cost slightly less.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from formation_env import FormationConfig
from formation_env._jit import device, kernel
from formation_env.physics.quadrotor import MOMENT, Airframe, Body, Wrench, fly

Floats = NDArray[np.float64]

# Vehicles side by side in a tile. A constant, and indices unsigned: otherwise nothing is vectorised.
LANES = 32
_L = np.uint64(LANES)

# With fewer a second thread costs more than it saves: the floor is the faster of both.
_TILES_PER_THREAD = 128


@device
def _load(x: Any, row: int, lane: Any) -> Any:
    i = np.uint64(row * LANES) + lane
    return (x[i], x[i + _L], x[i + _L + _L])


@device
def _put(x: Any, row: int, lane: Any, a: Any) -> None:
    i = np.uint64(row * LANES) + lane
    x[i], x[i + _L], x[i + _L + _L] = a


@kernel
def _fly_tile(x: Floats, u: Floats, substeps: int, h: float, airframe: Airframe) -> None:
    """A tile's rows are p, v, q, w (13) and T, m (4), each `LANES` wide."""
    still = (0.0, 0.0, 0.0)
    for _ in range(substeps):
        for lane in range(_L):
            vector = _load(x, 7, lane)
            q = (x[np.uint64(6 * LANES) + lane], vector[0], vector[1], vector[2])
            body = Body(_load(x, 0, lane), _load(x, 3, lane), q, _load(x, 10, lane))
            applied = Wrench(u[lane], _load(u, 1, lane))
            body = fly(body, applied, still, h, MOMENT, airframe)
            _put(x, 0, lane, body.p)
            _put(x, 3, lane, body.v)
            x[np.uint64(6 * LANES) + lane] = body.q[0]
            _put(x, 7, lane, (body.q[1], body.q[2], body.q[3]))
            _put(x, 10, lane, body.w)


@kernel
def fly_tiles(states: Floats, inputs: Floats, substeps: int, h: float, airframe: Airframe) -> None:
    """One control tick of all tiles."""
    for tile in range(np.uint64(len(states))):
        _fly_tile(states[tile], inputs[tile], substeps, h, airframe)


@final
class Floor:
    """`vehicles` rigid bodies of a configuration, turning slowly, with the actuators held."""

    def __init__(self, config: FormationConfig, vehicles: int, threads: int = 1) -> None:
        tiles = -(-vehicles // LANES)
        draw = np.random.default_rng(0)
        self.states = np.zeros((tiles, 13 * LANES))
        self.states[:, 6 * LANES : 7 * LANES] = 1.0
        self.inputs = np.empty((tiles, 4 * LANES))
        airframe = config.vehicle.airframe()
        self.inputs[:, :LANES] = airframe.mass * 9.81
        # Small enough that no body spins fast within a benchmark.
        self.inputs[:, LANES:] = 1e-6 * draw.uniform(-1.0, 1.0, (tiles, 3 * LANES))
        h = config.control_period / config.substeps
        self._arguments: tuple[Any, ...] = (config.substeps, h, airframe)
        threads = min(threads, 1 + tiles // _TILES_PER_THREAD)
        edges = [tiles * i // threads for i in range(threads + 1)]
        self._parts = [(self.states[a:b], self.inputs[a:b]) for a, b in pairwise(edges)]
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def step(self) -> None:
        """One control tick of all bodies."""
        if self._pool is None:
            fly_tiles(*self._parts[0], *self._arguments)
            return
        jobs = [self._pool.submit(fly_tiles, *part, *self._arguments) for part in self._parts[1:]]
        fly_tiles(*self._parts[0], *self._arguments)
        for job in jobs:
            job.result()

    def close(self) -> None:
        """Stop the threads, if there are any."""
        if self._pool is not None:
            self._pool.shutdown()
