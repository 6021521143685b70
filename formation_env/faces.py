"""What the three faces share: reading actions, describing results, drawing. No mathematics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from formation_env.memory import ERROR, FAILED, SEPARATION, SLOT, TERMS
from formation_env.task import Terms

if TYPE_CHECKING:
    from formation_env.config import FormationConfig
    from formation_env.rendering import Renderer
    from formation_env.simulation import Simulation

RENDER_MODES = ("human", "rgb_array")


def observation_space(config: FormationConfig, rows: int) -> Any:
    """`rows` observation rows side by side, finite bounds, float32."""
    bound = np.tile(config.layout.bound, rows)
    return spaces.Box(-bound, bound, dtype=np.float32)


def action_space(config: FormationConfig, rows: int) -> Any:
    """`rows` actions side by side in [-1, 1], float32."""
    return spaces.Box(-1.0, 1.0, (rows * config.action_size,), dtype=np.float32)


def read_action(action: Any, shape: tuple[int, ...], name: str = "action") -> NDArray[np.float32]:
    """The action as float32 of the given shape; `ValueError` if it is of another, or not numbers."""
    array = np.asarray(action)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} has dtype {array.dtype}: expected real numbers")
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}: expected {shape}")
    if array.dtype != np.float32:
        # A finite number beyond the range of float32 is out of range, not infinite.
        array = np.where(np.isfinite(array), np.clip(array, -1.0, 1.0), array)
    return array.astype(np.float32, order="C")


def describe(outputs: NDArray[np.float64]) -> dict[str, Any]:
    """The `info` of a step, from result rows `(..., followers, columns)`.

    `slots` (m, inertial), `slot_error` (slot minus true position, m, inertial), `separation`
    (distance to the nearest other vehicle, m), `failure` (an index into `task.FAILURES`) and
    `reward_terms`, each with the leading shape of `outputs`.
    """
    return {
        "slots": outputs[..., SLOT : SLOT + 3],
        "slot_error": outputs[..., ERROR : ERROR + 3],
        "separation": outputs[..., SEPARATION],
        "failure": outputs[..., FAILED].astype(np.int64),
        "reward_terms": {name: outputs[..., TERMS + k] for k, name in enumerate(Terms._fields)},
    }


def check_render_mode(mode: str | None) -> None:
    """Raise `ValueError` unless the mode is one of `RENDER_MODES` or None."""
    if mode is not None and mode not in RENDER_MODES:
        allowed = ", ".join(map(repr, RENDER_MODES))
        raise ValueError(f"render_mode = {mode!r}: expected one of {allowed} or None")


def make_renderer(config: FormationConfig, mode: str) -> Renderer:
    """A renderer at the frame rate of the control ticks."""
    from formation_env.rendering import Renderer

    return Renderer(mode, 1.0 / config.control_period)


def draw(
    renderer: Renderer, simulation: Simulation, slots: NDArray[np.float64], world: int = 0
) -> Any:
    """One frame of a world, None in a window; `slots` as in its last `info`."""
    from formation_env.rendering import Scene

    # The same path in every frame of an episode: its dashes are counted from its first point.
    times = np.arange(0.0, simulation.config.duration, 0.1)
    scene = Scene(
        float(simulation.time[world]),
        bool(simulation.started[world]),
        simulation.positions[world],
        simulation.attitudes[world],
        np.asarray(slots),
        simulation.reference(times, world),
    )
    return renderer.draw(scene)
