"""What Python calls: the loop over the tiles of all worlds, by one thread or many."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation_env._compiling import announced
from formation_env._jit import kernel, step
from formation_env.core import arrays
from formation_env.core.arrays import Counters
from formation_env.core.calls import RESET as RESET
from formation_env.core.calls import (
    STEP as STEP,  # as `kernels.STEP`, ..., which `Simulation.step` takes
)
from formation_env.core.calls import STEP_AND_RESET as STEP_AND_RESET
from formation_env.core.calls import STEP_OR_RESET as STEP_OR_RESET
from formation_env.core.calls import note_call, post_call, streamed, take_call
from formation_env.core.threads import await_ticket, claim, report, settle
from formation_env.core.tick import tick
from formation_env.memory.records import LANES, at
from formation_env.memory.shuffles import carve, count_finite, drain
from formation_env.memory.store import Floats

_OVER = at(Counters, "over") * LANES


@step
def bad_action(mode: int, actions: Any, memory: Any) -> int:
    """Number of the first row `(world, follower)` that holds a non-finite number, or -1.

    Of the worlds that step; what others are given is not used.
    """
    numbers, row = carve(actions, 0, (actions.size,)), actions.shape[1] * actions.shape[2]
    if count_finite(numbers) < len(numbers):
        for k in range(len(numbers)):
            if not np.isfinite(numbers[k]):
                w = k // row
                over = arrays.counters(memory, w // LANES)[_OVER + w % LANES]
                if mode == STEP_OR_RESET and over != 0:
                    continue
                return int(k // actions.shape[2])
    return -1


@announced("the simulation")
@kernel
def advance(
    desk: int,
    member: int,
    mode: int,
    actions: NDArray[np.float32],
    mask: NDArray[np.bool_],
    memory: Floats,
    room: Floats,
    observations: NDArray[np.float32],
    outputs: Floats,
    ends: Floats,
    last_observations: NDArray[np.float32],
    last_outputs: Floats,
) -> int:
    """Step or reset those worlds that `mask` names; show all.

    `memory` is what `arrays.allocate` made, `room` what `arrays.room` did, and the rest `Results`.
    Returns the number of the first row of `actions` that holds a non-finite number, having done nothing
    then, or -1.

    `desk` is 0, or the address of a `threads.Team`'s: then workers fly some of the tiles. They are in here
    too, as its `member` 1, 2, ..., with actions and results of no world, and take part in the calls of
    member 0 until none has come for a while. They do not wait for long, so the caller has to have seen
    to the actions, with `first_bad_action`, before it wakes them.
    """
    # Views that are not counted: counting them in every function costs more than some of these do.
    memory, room = carve(memory, 0, (len(memory),)), carve(room, 0, (len(room),))
    if desk == 0:
        bad = bad_action(mode, actions, memory)
        if bad >= 0:
            return bad
    ticket, tiles = 0, arrays.tile_count(memory)
    if member == 0:
        note_call(
            room, mode, actions, mask, observations, outputs, ends, last_observations, last_outputs
        )
        if desk != 0:
            ticket = post_call(desk, room)
    while True:
        if member > 0:
            ticket = await_ticket(desk, ticket)
            if ticket < 0:
                return -1
            take_call(desk, room)
        done = 0
        t = 0 if desk == 0 else claim(desk, ticket, member)
        while 0 <= t < tiles:
            tick(memory, room, t)
            done += 1
            t = t + 1 if desk == 0 else claim(desk, ticket, member)
        if streamed(memory):
            drain()
        if member > 0:
            report(desk, done)
        else:
            if desk != 0:
                settle(desk, tiles - done)
            return -1


@kernel
def first_bad_action(mode: int, actions: NDArray[np.float32], memory: Floats) -> int:
    """Number of the first row `(world, follower)` that holds a non-finite number and matters, or -1."""
    return bad_action(mode, actions, memory)
