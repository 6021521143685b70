"""What the three faces share: reading actions, describing results, drawing. No mathematics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final

import numpy as np
from gymnasium import logger, spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from formation_env.maths.so3 import Vector
from formation_env.memory.records import define, fields, size, slices
from formation_env.physics.quadrotor import Body
from formation_env.task import ANYWHERE, COLUMNS, FAILED, SEPARATION, Terms
from formation_env.validation.checks import choice, refuse

if TYPE_CHECKING:
    from formation_env.config import FormationConfig
    from formation_env.core.simulation import Simulation
    from formation_env.rendering import Memory, Renderer

RENDER_MODES = ("human", "rgb_array")

FLOAT = np.dtype(np.float32)
_INTEGER = np.dtype(np.int64)
_MANY = 256  # worlds
# Of a vehicle's numbers in `states`, by the fields of `Body`: m, m/s, 1, rad/s.
_BOUNDS = {"p": ANYWHERE, "v": 100.0, "q": 1.0, "w": 100.0}

# Columns of the reward's terms by their names in `info`.
TERMS = {f"reward_{n}": COLUMNS["terms"].start + where.start for n, where in slices(Terms).items()}
# Made once: a step takes some ten views, and building each one's index anew would cost half as much again
# as taking it. The dictionaries are displays in code made of the fields, which is as fast as written out.
_INDICES: dict[str, Any] = {
    "slots": (..., COLUMNS["slot"]),
    "slot_error": (..., COLUMNS["slot_error"]),
    "separation": (..., SEPARATION),
    "failure": None,
    **{name: (..., column) for name, column in TERMS.items()},
}


def _info_of_rows() -> Any:
    """`info(outputs, failures)`: views by name of result rows."""
    shown = [
        f"{n!r}: " + ("failures" if i is None else f"outputs[{n}]") for n, i in _INDICES.items()
    ]
    source = "def info(outputs, failures):\n    return {" + ", ".join(shown) + "}\n"
    return define("info", source, _INDICES)


def _info_of_agent() -> Any:
    """`info(slot, error, row)`: what PettingZoo reports of one follower, from views and a row's numbers."""
    shown = ["'slot': slot", "'slot_error': error", f"'separation': row[{SEPARATION}]"]
    shown += [f"'failure': int(row[{FAILED}])", *(f"{n!r}: row[{k}]" for n, k in TERMS.items())]
    source = "def info(slot, error, row):\n    return {" + ", ".join(shown) + "}\n"
    return define("info", source, {})


_describe_rows, describe_agent = _info_of_rows(), _info_of_agent()


def observation_space(config: FormationConfig, rows: int) -> Any:
    """`rows` observation rows side by side, finite bounds, float32."""
    bound = np.tile(config.layout.bound, rows)
    return spaces.Box(-bound, bound, dtype=np.float32)


def action_space(config: FormationConfig, rows: int) -> Any:
    """`rows` actions side by side in [-1, 1], float32."""
    return spaces.Box(-1.0, 1.0, (rows * config.action_size,), dtype=np.float32)


def fps(config: FormationConfig) -> int:
    """Pictures a second of an episode in its own time: one a tick, as a whole number."""
    return max(1, round(1.0 / config.control_period))


def state_space(followers: int) -> Any:
    """Bounds of a row of `states`."""
    vehicle = [_BOUNDS[name] for name, kind in fields(Body).items() for _ in range(size(kind))]
    slot = [_BOUNDS["p"]] * size(Vector)
    bound = np.array(vehicle * (followers + 1) + slot * followers + [1.0], dtype=np.float32)
    return spaces.Box(-bound, bound, dtype=np.float32)


def states(simulation: Simulation, slots: NDArray[np.float64]) -> NDArray[np.float32]:
    """The truth about every world, float32 `(worlds, numbers)`, clipped to `state_space`.

    A row is what `FormationParallelEnv.state` describes; `slots` are `(worlds, followers, 3)`, m, inertial.
    Of a vehicle whose state can no longer be computed, so that its episode has ended, the numbers are
    finite all the same.
    """
    s, worlds = simulation, simulation.num_worlds
    vehicles = (s.positions, s.velocities, s.attitudes, s.angular_velocities)
    parts = (np.concatenate(vehicles, axis=2), slots, s.started)
    with np.errstate(over="ignore"):
        flat = np.concatenate([x.reshape(worlds, -1) for x in parts], axis=1).astype(np.float32)
    bound = state_space(s.config.followers).high
    return np.clip(np.nan_to_num(flat, copy=False, posinf=np.inf, neginf=-np.inf), -bound, bound)


def read_action(action: Any, shape: tuple[int, ...], name: str = "action") -> NDArray[np.float32]:
    """The action as float32 of the given shape, itself where it is that already.

    Raises `ValueError` if it is of another shape, or not numbers.
    """
    if type(action) is np.ndarray and action.dtype is FLOAT and action.shape == shape:
        return action  # as nearly always: nothing to check, and the kernels only read
    try:
        array = np.asarray(action)
    except ValueError:  # rows of unequal length
        refuse(name, action, f"numbers of shape {shape}")
    if isinstance(action, np.ma.MaskedArray):
        refuse(name, action, f"an array of shape {shape} without a mask")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} has dtype {array.dtype}: expected real numbers")
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}: expected {shape}")
    if array.dtype != np.float32:
        # A finite number beyond the range of float32 is out of range, not infinite.
        array = np.where(np.isfinite(array), np.clip(array, -1.0, 1.0), array)
    return array.astype(np.float32, order="C")


def describe(
    outputs: NDArray[np.float64], terminated: NDArray[np.bool_] | None = None
) -> dict[str, Any]:
    """The `info` of a step, from result rows `(..., followers, columns)`.

    `terminated` says in which worlds a follower may have failed, if that is known.

    `slots` (m, inertial), `slot_error` (slot minus true position, m, inertial), `separation`
    (distance to the nearest other vehicle, m), `failure` (an index into `task.FAILURES`) and the
    terms of the reward, `reward_formation` and so on, each with the leading shape of `outputs`.
    Nothing in it is nested: other libraries make one tensor of every entry.
    """
    described: dict[str, Any] = _describe_rows(outputs, _failures(outputs, terminated))
    return described


def _failures(
    outputs: NDArray[np.float64], terminated: NDArray[np.bool_] | None
) -> NDArray[np.int64]:
    """Kinds of failure. Of many worlds few have ended: to look at all would fetch all outputs."""
    if terminated is None or len(terminated) < _MANY:
        return outputs[..., FAILED].astype(_INTEGER)
    failures = np.zeros(outputs.shape[:-1], _INTEGER)
    ended = np.flatnonzero(terminated)
    failures[ended] = outputs[ended, :, FAILED]
    return failures


@final
class Screen:
    """Draws the worlds of a simulation in a render mode, or None for not at all.

    Makes a renderer when a world is first drawn. A copy makes its own, with the trails of the original's.
    Raises `ValueError` for an unknown mode.
    """

    def __init__(self, mode: str | None, allowed: tuple[str, ...] = RENDER_MODES) -> None:
        self.mode = None if mode is None else choice("render_mode", mode, allowed)
        self._renderers: dict[int, Renderer] = {}
        self._memories: dict[int, Memory] = {}  # of a copy's original, until it draws

    def draw(self, simulation: Simulation, world: int = 0) -> Any:
        """A frame `(height, width, 3)` of uint8 in mode `rgb_array`; a window in mode `human`.

        Raises `ResetNeeded` before the first reset, `RuntimeError` without a display for a window.
        """
        if self.mode is None:
            logger.warn("render() without a render_mode: give one when making the environment")
            return None
        if not simulation.seeded[world]:
            raise ResetNeeded("nothing to draw yet: call reset() before render()")
        from formation_env.rendering import Renderer, Scene

        period = simulation.config.control_period
        if world not in self._renderers:
            memory = self._memories.pop(world, None)
            self._renderers[world] = Renderer(self.mode, 1.0 / period, memory=memory)
        times = path_times(float(simulation.clock[world]), simulation.config.duration)
        scene = Scene(
            float(simulation.time[world]),
            bool(simulation.started[world]),
            simulation.positions[world],
            simulation.attitudes[world],
            simulation.slots[world],
            simulation.reference(times, world),
        )
        return self._renderers[world].draw(scene)

    def begin(self, simulation: Simulation, world: int = 0) -> None:
        """A new episode: forget the old one's trails, and show it if there is a window."""
        self._memories.pop(world, None)
        if world in self._renderers:
            self._renderers[world].clear()
        self.follow(simulation, world)

    def follow(self, simulation: Simulation, world: int = 0) -> None:
        """Show the world if there is a window: after every step."""
        if self.mode == "human":
            self.draw(simulation, world)

    def close(self) -> None:
        """Close the window, if there is one."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers = {}

    def __getstate__(self) -> dict[str, Any]:
        memories = {world: renderer.memory() for world, renderer in self._renderers.items()}
        return {**self.__dict__, "_renderers": {}, "_memories": self._memories | memories}


def path_times(clock: float, duration: float) -> NDArray[np.float64]:
    """Times (s) at which to draw the leader's path, 0.1 s apart: of all of it up to 200 s.

    Of a longer one they are 200 s around `clock`, at least 50 s ahead. They change once in 100 s only,
    because the path's dashes are counted from its first point.
    """
    begin = max(0.0, 100.0 * (clock // 100.0) - 50.0) if duration > 200.0 else 0.0
    end = min(begin + 200.0, duration)
    return begin + 0.1 * np.arange(np.ceil((end - begin) / 0.1), dtype=np.float64)
