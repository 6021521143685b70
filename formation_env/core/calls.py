"""What one call of the kernel is about: its mode and its arrays, by their addresses.

The words lie in the room of each thread; those of the caller go to the other threads over the desk of
`threads`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formation_env._jit import step
from formation_env.core.arrays import HELD, Verdict, action_size, call, entries, vehicles, worlds
from formation_env.core.threads import address_of, array_at, post, posted
from formation_env.memory.records import size
from formation_env.task import Outcome

# Modes: what to do with each world.
STEP, STEP_OR_RESET, STEP_AND_RESET, RESET = 0, 1, 2, 3

_MODE, _ACTIONS, _MASK, _OBSERVATIONS, _OUTPUTS, _ENDS, _LAST_OBSERVATIONS, _LAST_OUTPUTS = range(8)
OUTCOME = size(Outcome)
_ENDS_OF_A_WORLD = size(Verdict)


@step
def note_call(
    room: Any,
    mode: int,
    actions: Any,
    mask: Any,
    observations: Any,
    outputs: Any,
    ends: Any,
    last_observations: Any,
    last_outputs: Any,
) -> None:
    """Put down the caller's mode and arrays."""
    words = call(room)
    words[_MODE], words[_ACTIONS], words[_MASK] = mode, address_of(actions), address_of(mask)
    words[_OBSERVATIONS], words[_OUTPUTS] = address_of(observations), address_of(outputs)
    words[_ENDS] = address_of(ends)
    words[_LAST_OBSERVATIONS] = address_of(last_observations)
    words[_LAST_OUTPUTS] = address_of(last_outputs)


@step
def post_call(desk: int, room: Any) -> int:
    """Put the call on the desk, for the other threads; its ticket."""
    return post(desk, call(room))


@step
def take_call(desk: int, room: Any) -> None:
    """Take the call from the desk."""
    words = call(room)
    for k in range(len(words)):
        words[k] = posted(desk, k)


@step
def mode_of(room: Any) -> int:
    """One of the modes above."""
    return call(room)[_MODE]  # type: ignore[no-any-return]


@step
def actions_of(memory: Any, room: Any) -> Any:
    """Actions as given, world by world, follower by follower."""
    count = worlds(memory) * (vehicles(memory) - 1) * action_size(memory)
    return array_at(call(room)[_ACTIONS], (count,), np.float32)


@step
def mask_of(memory: Any, room: Any) -> Any:
    """Which worlds are meant."""
    return array_at(call(room)[_MASK], (worlds(memory),), np.bool_)


@step
def observations_of(memory: Any, room: Any, last: bool) -> Any:
    """Where observations go, or the last ones of episodes that end."""
    count = worlds(memory) * (vehicles(memory) - 1) * entries(memory)
    word = call(room)[_LAST_OBSERVATIONS] if last else call(room)[_OBSERVATIONS]
    return array_at(word, (count,), np.float32)


@step
def outputs_of(memory: Any, room: Any, last: bool) -> Any:
    """Where the numbers of each follower's `Outcome` go, or the last ones of episodes that end."""
    count = worlds(memory) * (vehicles(memory) - 1) * OUTCOME
    word = call(room)[_LAST_OUTPUTS] if last else call(room)[_OUTPUTS]
    return array_at(word, (count,), np.float64)


@step
def ends_of(memory: Any, room: Any) -> Any:
    """Where the numbers of each world's `Verdict` go, row by row."""
    return array_at(call(room)[_ENDS], (_ENDS_OF_A_WORLD * worlds(memory),), np.float64)


# Results of more bytes than this are written past the cache, which they and the state exceed by far: it
# gains 5 to 11 % of a step of 65,536 worlds of `nominal`.
_STREAMED = 6_000_000


@step
def streamed(memory: Any) -> bool:
    """Whether results go past the cache: there are many, of few followers in each world."""
    n = vehicles(memory) - 1
    size_of_all = worlds(memory) * n * (4 * entries(memory) + 8 * OUTCOME)
    return n <= HELD and size_of_all > _STREAMED  # type: ignore[no-any-return]
