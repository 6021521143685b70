"""Threads that share the tiles of one call: atomics, a desk that hands tiles out, and the threads.

A pool wakes its threads by the operating system and runs Python in each of them for every call: some
tens of microseconds, as long as a step of hundreds of worlds. So a worker stays within the compiled
kernel and looks out for the next call on a *desk*, a few words of memory that all see. There the caller
writes where its arrays are, and each thread takes tiles one by one: first those of a range of its own, so
that state stays in the cache of its core, then what is left in the ranges of others. No thread waits for a
worker that sleeps or that the operating system has stopped, only for the tiles it has begun.

A claim is a compare-and-swap on a word that holds the call's ticket and the next tile. What a call has on
the desk is overwritten when all its tiles are done, and then no word of that ticket has a tile left: a
worker that has read half of the old and half of the new call claims nothing with it.

A thread that waits asks the operating system every microsecond to let another one run: woken, a worker often
starts on the very core of its caller, and would keep it from posting what it waits for.

A worker without work for `PATIENCE` rounds of that goes to sleep, and the next call rings its bell. If the
two miss each other the caller flies that step alone.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import threading
import weakref
from collections.abc import Callable, Sequence
from functools import cache
from math import prod
from time import perf_counter
from typing import Any, final

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np import arrayobj
from numpy.typing import NDArray

from formation_env._jit import builtin, device, kernel
from formation_env.memory.lowering import lengths_of, view_of

ROUND = 1e-6  # s: of waiting on the core, then others may have it
PATIENCE = 100  # rounds: about the cost of falling asleep and waking

_LINE = 64  # bytes that go from core to core together
# Places on the desk, in bytes; each line is written by one and read by others at another time.
_TICKET, _DONE, _CALL, _SIZES, _CLOSED, _CLAIMS = (k * _LINE for k in range(6))
_TICKET_BITS, _TILE_BITS = 31, 32
_TILE_MASK = (1 << _TILE_BITS) - 1
_LAST_TICKET = (1 << _TICKET_BITS) - 1

# -- atomics on words of 64 bits, by their addresses ----------------------------------------------


def _word(builder: Any, address: Any) -> Any:
    return builder.inttoptr(address, ir.IntType(64).as_pointer())


@intrinsic  # type: ignore[untyped-decorator]
def load_word(typing: Any, address: Any) -> Any:
    """The word; what its writer wrote before it is seen after (acquire)."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load_atomic(_word(builder, arguments[0]), "acquire", 8)

    return types.int64(types.int64), build


@intrinsic  # type: ignore[untyped-decorator]
def store_word(typing: Any, address: Any, value: Any) -> Any:
    """Write the word; a thread that reads it sees what was written before (release)."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store_atomic(arguments[1], _word(builder, arguments[0]), "release", 8)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), build


@intrinsic  # type: ignore[untyped-decorator]
def swap_word(typing: Any, address: Any, old: Any, new: Any) -> Any:
    """Write `new` if the word is `old`; returns what it was."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = _word(builder, arguments[0])
        pair = builder.cmpxchg(word, arguments[1], arguments[2], "acq_rel", "acquire")
        return builder.extract_value(pair, 0)

    return types.int64(types.int64, types.int64, types.int64), build


@intrinsic  # type: ignore[untyped-decorator]
def add_word(typing: Any, address: Any, value: Any) -> Any:
    """Add to the word; returns what it was."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.atomic_rmw("add", _word(builder, arguments[0]), arguments[1], "acq_rel")

    return types.int64(types.int64, types.int64), build


@intrinsic  # type: ignore[untyped-decorator]
def pause(typing: Any) -> Any:
    """Spend some nanoseconds, and leave the core to its other thread."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        machine = binding.get_process_triple()
        number = ir.IntType(32)
        if machine.startswith(("x86_64", "i386", "i686")):
            name, kinds, values = "llvm.x86.sse2.pause", [], []
        elif machine.startswith(("aarch64", "arm64")):
            name, kinds, values = "llvm.aarch64.isb", [number], [number(15)]
        else:
            return context.get_dummy_value()
        kind = ir.FunctionType(ir.VoidType(), kinds)
        builder.call(cgutils.get_or_insert_function(builder.module, kind, name), values)
        return context.get_dummy_value()

    return types.void(), build


@intrinsic  # type: ignore[untyped-decorator]
def give_way(typing: Any) -> Any:
    """Let the operating system run another thread on this core, where it can be asked to."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(32), [])
        for name in ("sched_yield", "SwitchToThread"):
            if binding.address_of_symbol(name) is not None:
                builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [])
                break
        return context.get_dummy_value()

    return types.void(), build


def _build_array_at(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    view = signature.return_type
    address = context.cast(builder, arguments[0], signature.args[0], types.int64)
    data = builder.inttoptr(address, context.get_data_type(view.dtype).as_pointer())
    lengths = lengths_of(context, builder, signature.args[1], arguments[1])
    return view_of(context, builder, view, data, lengths)


@builtin(lambda address, shape, kind: types.Array(kind.dtype, len(shape), "C"), _build_array_at)
def array_at(address: int, shape: tuple[int, ...], kind: Any) -> Any:
    """The C-contiguous array of `kind` that begins at an address and that the caller keeps alive."""
    count = prod(shape) * np.dtype(kind).itemsize
    held = (ctypes.c_char * count).from_address(int(address)) if count else b""
    return np.frombuffer(held, dtype=kind).reshape(shape)


def _build_address_of(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    data = arrayobj.make_array(signature.args[0])(context, builder, arguments[0]).data
    return builder.ptrtoint(data, ir.IntType(64))


@builtin(lambda block: types.int64, _build_address_of)
def address_of(block: Any) -> int:
    """Where the numbers of an array begin."""
    return int(block.ctypes.data)


# -- the desk, within the kernel ------------------------------------------------------------------


@device
def _home(desk: int, member: int) -> int:
    """The first tile of a member's own range: those of all together are all tiles."""
    return load_word(desk + _SIZES) * member // load_word(desk + _SIZES + 8)  # type: ignore[no-any-return]


@device
def post(desk: int, call: Any) -> int:
    """Begin a call: eight words for the workers, and all tiles to be had. Returns its ticket.

    To be called when all tiles of the call before are done.
    """
    ticket = load_word(desk + _TICKET) % _LAST_TICKET + 1
    store_word(desk + _DONE, 0)
    for k in range(8):
        store_word(desk + _CALL + 8 * k, call[k])
    for member in range(load_word(desk + _SIZES + 8)):
        claims = desk + _CLAIMS + member * _LINE
        store_word(claims, (ticket << _TILE_BITS) | _home(desk, member))
    store_word(desk + _TICKET, ticket)
    return ticket  # type: ignore[no-any-return]


@device
def posted(desk: int, k: int) -> int:
    """Word `k` of the call: valid for a thread that then claims a tile under the ticket read before."""
    return load_word(desk + _CALL + 8 * k)  # type: ignore[no-any-return]


@device
def await_ticket(desk: int, last: int) -> int:
    """The ticket of another call than `last`, or -1 if none has come in time or none will."""
    for _ in range(PATIENCE):
        for _ in range(load_word(desk + _SIZES + 16)):
            ticket = load_word(desk + _TICKET)
            if ticket != last:
                return ticket  # type: ignore[no-any-return]
            pause()
        if load_word(desk + _CLOSED) != 0:
            break
        give_way()
    return -1


@device
def claim(desk: int, ticket: int, member: int) -> int:
    """A tile that no other thread flies in this call, or -1 if all are taken or it is not the call."""
    members = load_word(desk + _SIZES + 8)
    for k in range(members):
        owner = (member + k) % members
        claims, end = desk + _CLAIMS + owner * _LINE, _home(desk, owner + 1)
        seen = load_word(claims)
        while seen >> _TILE_BITS == ticket and (seen & _TILE_MASK) < end:
            found = swap_word(claims, seen, seen + 1)
            if found == seen:
                return seen & _TILE_MASK  # type: ignore[no-any-return]
            seen = found
    return -1


@device
def report(desk: int, tiles: int) -> None:
    """So many more tiles are done."""
    add_word(desk + _DONE, tiles)


@device
def settle(desk: int, tiles: int) -> None:
    """Wait until the workers have done so many tiles, which they have begun."""
    pauses = load_word(desk + _SIZES + 16)
    while load_word(desk + _DONE) < tiles:
        pause()
        pauses -= 1
        if pauses <= 0:
            give_way()  # maybe it is this core that the worker waits for


@kernel
def _rest(pauses: int) -> None:
    for _ in range(pauses):
        pause()


# -- the threads ----------------------------------------------------------------------------------


def cores() -> int:
    """How many threads can run at once in this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pauses() -> int:
    """How many `pause` make a round: 5 to 140 cycles each, as the processor likes."""
    sample, least = 1000, float("inf")
    for _ in range(5):
        start = perf_counter()
        _rest(sample)
        least = min(least, perf_counter() - start)
    return 1 + int(sample * ROUND / least)


class _Worker:
    """What the thread of one worker and its caller share."""

    def __init__(self) -> None:
        self.asleep = False
        self.bell = threading.Lock()
        self.bell.acquire()
        self.thread: threading.Thread | None = None

    def ring(self) -> None:
        """Wake it, or have it not fall asleep next time."""
        if self.bell.locked():
            self.bell.release()

    def live(self, desk: NDArray[np.int64], number: int, serve: Callable[[int, int], Any]) -> None:
        while not desk[_CLOSED // 8]:
            serve(desk.ctypes.data, number)
            self.asleep = True
            self.bell.acquire()
            self.asleep = False


@final
class Team:
    """Workers on calls that share `tiles` tiles, each `serve(desk, number)` of `servants` over and over.

    That is to return when `await_ticket` gives up. The caller is member 0, the workers 1, 2, ...
    The threads end with `close`, with the interpreter, or when the team is collected: what they serve
    must not refer to it.
    """

    def __init__(self, tiles: int, servants: Sequence[Callable[[int, int], Any]]) -> None:
        self.owner = os.getpid()
        members = len(servants) + 1
        room = np.zeros((_CLAIMS + (members + 1) * _LINE) // 8, dtype=np.int64)
        room = room[-room.ctypes.data % _LINE // 8 :]
        room[_SIZES // 8 : _SIZES // 8 + 3] = tiles, members, _pauses()
        self._desk = room
        self._workers = [_Worker() for _ in servants]
        for number, (worker, serve) in enumerate(zip(self._workers, servants, strict=True), 1):
            name, arguments = f"formation-{number}", (room, number, serve)
            worker.thread = threading.Thread(target=worker.live, args=arguments, name=name)
            worker.thread.daemon = True
            worker.thread.start()
        weakref.finalize(self, _dismiss, room, self._workers).atexit = False
        _teams.add(self)
        self.desk: int = room.ctypes.data

    def wake(self) -> int:
        """Wake the workers that sleep, without waiting; the address of the desk."""
        for worker in self._workers:
            if worker.asleep:
                worker.ring()
        return self.desk

    def close(self) -> None:
        """Stop the threads and wait for their end."""
        _dismiss(self._desk, self._workers)
        if self.owner == os.getpid():  # they are not in a forked child
            for worker in self._workers:
                if worker.thread is not None:
                    worker.thread.join()


def _dismiss(desk: NDArray[np.int64], workers: list[_Worker]) -> None:
    """Have the threads end, not waiting: a collection may run while a lock they need is held."""
    desk[_CLOSED // 8] = 1
    for worker in workers:
        worker.ring()


_teams: weakref.WeakSet[Team] = weakref.WeakSet()


@atexit.register
def _dismiss_all() -> None:
    """A thread that is still about when the interpreter goes may crash it."""
    for team in list(_teams):
        team.close()
