"""What tests share that put a simulation into a state of their own, or into a task that is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from formation_env.blocks import LANES

from formation_env import FormationConfig, Vehicle, configure
from formation_env.simulation import Simulation

Floats = npt.NDArray[np.float64]

P, V, A, Q, W = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 13), slice(13, 16)


def rows(tiles: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A view of an array of tiles `(T, ..., R L)` as `(T, ..., R, L)`."""
    return tiles.reshape(*tiles.shape[:-1], -1, LANES)


def vehicles(simulation: Simulation) -> Floats:
    """The true states of all vehicles in the simulation's own memory: `(T, n + 1, R, L)`."""
    return rows(simulation._state.vehicles)


def begun(
    worlds: int = 1, scenario: Any = "nominal", threads: int = 1, **options: Any
) -> Simulation:
    """Worlds at their first tick."""
    made = Simulation(configure(scenario, **options), worlds, threads)
    for world in range(worlds):
        made.seed(world, 7 * world + 1)
    made.reset()
    return made


def still(simulation: Simulation) -> npt.NDArray[np.float32]:
    """Actions of zero."""
    config = simulation.config
    shape = (simulation.num_worlds, config.followers, config.action_size)
    return np.zeros(shape, np.float32)


def unchecked(
    scenario: str = "nominal", vehicle: dict[str, Any] | None = None, **fields: Any
) -> Any:
    """A configuration that nothing has checked: what is refused must not bring the kernels down either."""
    config = configure(scenario)
    odd = object.__new__(FormationConfig)
    values = {**config.__dict__, **fields}
    values.pop("world", None), values.pop("layout", None)
    if vehicle is not None:
        own = object.__new__(Vehicle)
        for name, value in {**config.vehicle.__dict__, **vehicle}.items():
            object.__setattr__(own, name, value)
        values["vehicle"] = own
    for name, value in values.items():
        object.__setattr__(odd, name, value)
    return odd
