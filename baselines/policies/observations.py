"""What a policy is given to act on, checked: its shape, its type, and that every entry is finite."""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env import FormationConfig
from formation_env._jit import kernel
from formation_env.memory.records import size
from formation_env.task import NEIGHBOUR_ENTRIES, Layout, Neighbour
from formation_env.validation.checks import refuse

Rows = NDArray[np.float32]


class Observed(NamedTuple):
    """Observations as rows, and the shape in which their actions go back."""

    rows: Rows  # (worlds, followers, entries), C-contiguous
    shape: tuple[int, ...]


@kernel
def first_not_finite(numbers: Rows) -> int:
    """Index of the first NaN or infinity in a row of numbers; -1 if there is none."""
    any_bad = False
    for i in range(len(numbers)):  # vector code, since it does not stop early
        any_bad = any_bad | (not abs(numbers[i]) < inf)
    if any_bad:
        for i in range(len(numbers)):
            if not abs(numbers[i]) < inf:
                return i
    return -1


def observed(observation: Any, config: FormationConfig) -> Observed:
    """Observations of one or more worlds as rows.

    Raises `ValueError` for what `Policy.act` does not take, naming world, follower and entry of a
    number that is not finite.
    """
    given = _real(observation)
    shape = given.shape
    n, size, k = config.followers, config.layout.size, config.action_size
    if shape in ((n * size,), (n, size)):
        worlds = 1
        result: tuple[int, ...] = (n * k,) if len(shape) == 1 else (n, k)
    elif len(shape) == 2 and shape[1] == n * size:
        worlds, result = shape[0], (shape[0], n * k)
    elif len(shape) == 3 and shape[1:] == (n, size):
        worlds, result = shape[0], (shape[0], n, k)
    else:
        worlds, result = 0, ()
    if worlds == 0:
        raise ValueError(
            f"observation has shape {shape}: expected ({n}, {size}), ({n * size},), or either "
            "with the number of worlds in front"
        )
    rows = _single(given).reshape(worlds, n, size)
    bad = first_not_finite(rows.reshape(-1))
    if bad >= 0:
        _refuse_entry(float(given.reshape(-1)[bad]), bad, worlds, config)
    return Observed(rows, result)


def _real(observation: Any) -> NDArray[Any]:
    """An array of whole or floating-point numbers."""
    masked = isinstance(observation, np.ma.MaskedArray)
    try:
        given = np.asarray(observation)
    except (TypeError, ValueError):  # rows of unequal length
        given = np.zeros(0, dtype=object)
    if masked or given.dtype.kind not in "fiu":
        kind = "a masked array" if masked else f"of type {given.dtype}"[:100]
        raise ValueError(f"observation is {kind}: expected an array of real numbers")
    return given


def _single(given: NDArray[Any]) -> Rows:
    """As float32 that the kernels take without being compiled anew: whole, in order and writeable."""
    if given.dtype == np.float32 and given.flags.carray:
        return given
    with np.errstate(over="ignore"):  # what is beyond float32 is refused as infinite
        return np.array(given, dtype=np.float32, order="C", subok=False)


def _refuse_entry(value: float, index: int, worlds: int, config: FormationConfig) -> None:
    n, size = config.followers, config.layout.size
    world, follower = divmod(index // size, n)
    where = f" of world {world}" if worlds > 1 else ""
    entry = entry_name(config.layout, index % size)
    refuse(f"observation of follower_{follower}{where}, {entry}", value, "a finite number")


def entry_name(layout: Layout, column: int) -> str:
    """What a column of an observation row is called: `leader_velocity[2]`, or of a neighbour
    `neighbour_position[1][2]`."""
    for name, where in layout.slices.items():
        if where.start <= column < where.stop:
            return f"{name}[{column - where.start}]"
    neighbour, column = divmod(column - layout.first_neighbour, size(Neighbour))
    for entry in NEIGHBOUR_ENTRIES:
        if column < entry.size:
            return f"{entry.name}[{neighbour}][{column}]"
        column -= entry.size
    raise IndexError(column)
