"""What tests share that put a simulation into a state of their own, or into a task that is refused."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from formation_env import FormationConfig, Vehicle, configure
from formation_env._jit import plain
from formation_env.core import arrays
from formation_env.core.simulation import Simulation
from formation_env.laws.levels import LEVELS, follower_layout
from formation_env.memory.records import LANES, define, fields, flatten, size
from formation_env.physics.disturbances import States
from formation_env.physics.sensors import Measured
from formation_env.task import COLUMNS, Terms

Floats = npt.NDArray[np.float64]
Named = dict[str, npt.NDArray[Any]]

# The parts of a vehicle's state that are its own, without the acceleration last measured.
PARTS = ("p", "v", "q", "w")


def compiled(function: Any) -> Any:
    """A function as kernels have it: some are another piece of code than what Python calls."""
    names = ", ".join(inspect.signature(plain(function)).parameters)
    source = f"def call({names}):\n    return function({names})\n"
    return njit(error_model="numpy")(define("call", source, {"function": function}))


def as_python(function: Any) -> Any:
    """What Python calls."""
    return function


def tile(layout: Any, kind: Any = np.float64) -> npt.NDArray[Any]:
    """Zeros: the rows of a record in all lanes."""
    return np.zeros(size(layout) * LANES, kind)


def filled(layout: Any, draw: np.random.Generator) -> Floats:
    """The same with normal numbers; what is named `q` are unit quaternions, complex numbers unit vectors."""
    x = draw.normal(size=size(layout) * LANES)
    for name, kind in fields(layout).items():
        if name == "q" or kind is complex:
            part = arrays.rows(x, layout)[name]
            part /= np.linalg.norm(part, axis=0)
    return x


def line(record: Any) -> Floats:
    """The numbers of a record as those that are the same in all lanes are handed to a loop."""
    return np.array(flatten(record))


def lane_of(x: Any, layout: Any, lane: int) -> dict[str, Any]:
    """The fields of a record in one lane, each a tuple of numbers, or a number."""
    named = arrays.rows(x, layout)
    columns = {name: tuple(part[:, lane].tolist()) for name, part in named.items()}
    return {name: column if len(column) > 1 else column[0] for name, column in columns.items()}


def measured_in(x: Any, lane: int) -> Measured:
    """The measurement in one lane."""
    return Measured(**lane_of(x, Measured, lane))


def vehicles(simulation: Simulation) -> Named:
    """The true states of all vehicles in the simulation's own memory, by name: `(T, n + 1, numbers, L)`."""
    return arrays.rows(simulation._state.vehicles, Measured)


def disturbances(simulation: Simulation) -> Named:
    """The states of what disturbs the vehicles, likewise."""
    behind = simulation._state.vehicles[..., size(Measured) * LANES :]
    return arrays.rows(behind, States)


def samples(simulation: Simulation) -> Named:
    """The measurements of all vehicles, likewise: `(T, n + 1, samples, numbers, L)`."""
    return arrays.rows(simulation._state.samples, Measured)


def follower_rows(simulation: Simulation, tiles: Any = None) -> Named:
    """What is kept of all followers, likewise, or those of a saved state: `(T, n, numbers, L)`."""
    layout = follower_layout(LEVELS[simulation.config.world.level].state)
    return arrays.rows(simulation._state.followers if tiles is None else tiles, layout)


def counters(tiles: Any) -> Named:
    """What is counted in each world, of the state's array of that name, in place: `(T, L)` each."""
    named = arrays.rows(tiles, arrays.Counters)
    return {name: part[:, 0, :] for name, part in named.items()}


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


def outcome(results: Any, name: str) -> npt.NDArray[Any]:
    """One field of every follower's `task.Outcome`, `(worlds, followers)` or with a vector's numbers last."""
    column = COLUMNS[name]
    found = results.outputs[..., column]
    return found[..., 0] if column.stop - column.start == 1 else found


def term(results: Any, name: str) -> npt.NDArray[Any]:
    """One term of every follower's reward, `(worlds, followers)`."""
    terms = results.outputs[..., COLUMNS["terms"]]
    return terms[..., Terms._fields.index(name)]


def finite(results: Any) -> bool:
    """Whether rewards and their terms are finite."""
    return all(np.isfinite(results.outputs[..., COLUMNS[n]]).all() for n in ("reward", "terms"))


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
