"""Threads on one batch: every tile is flown once, by any thread, and no number depends on it."""

from __future__ import annotations

import copy
import gc
import os
import pickle
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numba import config, njit

from formation_env import configure
from formation_env.core import kernels, simulation, threads
from formation_env.core.simulation import Simulation

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="Python has no atomics")

LONG = 30.0  # s: a thread that has not ended by then hangs


@pytest.fixture(autouse=True)
def _many_threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Threads for the smallest batches, on any machine; none is left behind."""
    monkeypatch.setattr(simulation, "_VEHICLES_PER_THREAD", 1)
    monkeypatch.setattr(simulation, "cores", lambda: 8)
    yield
    gc.collect()
    soon(lambda: not workers())


def workers() -> list[threading.Thread]:
    return [one for one in threading.enumerate() if one.name.startswith("formation-")]


def soon(what: Callable[[], bool]) -> None:
    end = time.monotonic() + LONG
    while not what():
        assert time.monotonic() < end, f"still {workers()}"
        time.sleep(0.001)


def begun(worlds: int, many: int, scenario: str = "nominal", **options: Any) -> Simulation:
    made = Simulation(configure(scenario, **options), worlds, many)
    for world in range(worlds):
        made.seed(world, 7 * world + 1)
    return made


def actions(made: Simulation, steps: int) -> Iterator[np.ndarray]:
    draw = np.random.default_rng(0)
    shape = (made.num_worlds, made.config.followers, made.config.action_size)
    return (draw.uniform(-1, 1, shape).astype(np.float32) for _ in range(steps))


def agree(found: Simulation, expected: Simulation, results: tuple[Any, Any]) -> None:
    for a, b in zip(*results, strict=True):
        np.testing.assert_array_equal(a, b)
    for name in ("positions", "velocities", "attitudes", "angular_velocities", "clock", "over"):
        # Not the arrays of the state: lanes without a world hold what the room was last used for.
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def fly(found: Simulation, expected: Simulation, steps: int, pause: float = 0.0) -> None:
    """Both from the start and through the same actions, with pauses of up to so many seconds."""
    draw = np.random.default_rng(1)
    agree(found, expected, (found.reset(), expected.reset()))
    for rows in actions(found, steps):
        mode = kernels.STEP_AND_RESET
        agree(found, expected, (found.step(rows, mode), expected.step(rows, mode)))
        if pause:
            time.sleep(draw.uniform(0, pause))
    agree(found, expected, (found.look(), expected.look()))


@njit(nogil=True)  # type: ignore[untyped-decorator]
def _take(desk: int, ticket: int, member: int, taken: Any) -> None:
    tile = threads.claim(desk, ticket, member)
    while tile >= 0:
        taken[tile] += 1
        tile = threads.claim(desk, ticket, member)


@njit(nogil=True)  # type: ignore[untyped-decorator]
def _add_many(address: int, many: int) -> None:
    for _ in range(many):
        threads.add_word(address, 1)
        old = threads.load_word(address)
        found = threads.swap_word(address, old, old + 1)
        while found != old:
            old = found
            found = threads.swap_word(address, old, old + 1)


@njit  # type: ignore[untyped-decorator]
def _post(desk: int, word: int) -> int:
    return threads.post(desk, (word, 1, 2, 3, 4, 5, 6, 7))


@njit  # type: ignore[untyped-decorator]
def _posted(desk: int) -> int:
    return threads.posted(desk, 0)


def together(job: Callable[[int], None], many: int) -> None:
    started = [threading.Thread(target=job, args=(k,)) for k in range(many)]
    for one in started:
        one.start()
    for one in started:
        one.join(LONG)
        assert not one.is_alive()


def test_no_addition_and_no_swap_is_lost() -> None:
    word = np.zeros(1, np.int64)
    together(lambda _: _add_many(word.ctypes.data, 200_000), 3)
    assert word[0] == 3 * 2 * 200_000


@pytest.mark.parametrize(("tiles", "members"), [(1, 3), (2, 2), (7, 3), (50_001, 3)])
def test_every_tile_is_claimed_once(tiles: int, members: int) -> None:
    crew = threads.Team(tiles, [lambda desk, number: time.sleep(0.01)] * (members - 1))
    for turn in range(20):
        ticket = _post(crew.desk, turn)
        assert _posted(crew.desk) == turn
        taken = np.zeros((members, tiles), np.int64)
        _take(crew.desk, ticket - 1, 0, taken[0])
        assert not taken.any(), "claimed under an old ticket"
        together(lambda k, now=ticket, seen=taken: _take(crew.desk, now, k, seen[k]), members)  # type: ignore[misc]
        assert (taken.sum(axis=0) == 1).all()
    crew.close()


def test_tickets_begin_again() -> None:
    crew = threads.Team(4, [])
    crew._desk[0] = threads._LAST_TICKET - 1
    taken = np.zeros(4, np.int64)
    for expected in (threads._LAST_TICKET, 1, 2):
        ticket = _post(crew.desk, 0)
        assert ticket == expected
        _take(crew.desk, ticket, 0, taken)
    assert (taken == 3).all()


@pytest.mark.parametrize("many", [2, 3, 5])
@pytest.mark.parametrize("worlds", [1, 15, 16, 17, 33, 4097])
def test_threads_change_no_number(worlds: int, many: int) -> None:
    options: dict[str, Any] = {"followers": 2, "duration": 0.4}
    one, more = begun(worlds, 1, "paper", **options), begun(worlds, many, "paper", **options)
    fly(more, one, 25 if worlds < 100 else 4)
    assert one._team is None
    assert len(workers()) == min(many, -(-worlds // 16)) - 1
    more.close()


def test_steps_with_pauses() -> None:
    """Workers that look out, that fall asleep, that sleep and that wake."""
    one, more = begun(80, 1), begun(80, 3)
    fly(more, one, 1000, pause=3e-4)
    more.close()


def test_workers_do_fly_tiles() -> None:
    """On the desk stands how many tiles of the last call they did: over many calls, some."""
    more = begun(4096, 2)
    more.reset()
    assert more._team is not None
    done, end = 0, time.monotonic() + LONG
    while done == 0 and time.monotonic() < end:
        more.step(next(actions(more, 1)))
        done += int(more._team._desk[threads._DONE // 8])
    assert done > 0
    more.close()


def test_close_ends_the_threads_and_another_step_starts_them() -> None:
    one, more = begun(64, 1), begun(64, 3)
    fly(more, one, 5)
    more.close()
    assert not workers()
    more.close()
    fly(more, one, 5)
    assert len(workers()) == 2
    more.close()
    assert not workers()


def test_a_collected_simulation_leaves_no_thread() -> None:
    more = begun(64, 3)
    more.reset()
    time.sleep(0.01)  # asleep
    assert len(workers()) == 2
    del more
    gc.collect()
    soon(lambda: not workers())
    more = begun(64, 3)
    more.reset()
    del more  # awake
    gc.collect()
    soon(lambda: not workers())


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_has_threads_of_its_own(copied: Callable[[Simulation], Simulation]) -> None:
    one, more = begun(40, 1), begun(40, 2)
    one.reset(), more.reset()
    other = copied(more)
    assert other._team is None
    fly(other, one, 10)
    assert other._team is not more._team
    more.close()
    other.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_child_has_threads_of_its_own() -> None:
    one, more = begun(64, 1), begun(64, 2)
    fly(more, one, 3)
    with warnings.catch_warnings():  # of Python 3.12 on: the child is left with one thread
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        code = 1
        try:
            fly(more, one, 20)
            more.close()
            code = 0
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    fly(more, one, 3)
    more.close()


def test_two_simulations_in_two_threads() -> None:
    pairs = [(begun(100, 2), begun(100, 1)) for _ in range(2)]
    for pair in pairs:
        pair[0].reset(), pair[1].reset()
    failed: list[BaseException] = []

    def job(k: int) -> None:
        try:
            fly(*pairs[k], 200)
        except BaseException as error:
            failed.append(error)

    together(job, 2)
    assert not failed
    for more, _ in pairs:
        more.close()


def test_no_call_waits_for_a_worker_that_does_not_wake(monkeypatch: pytest.MonkeyPatch) -> None:
    one, more = begun(80, 1), begun(80, 3)
    fly(more, one, 3)
    assert more._team is not None
    crew = more._team._workers
    soon(lambda: all(worker.asleep for worker in crew))
    with monkeypatch.context() as patched:
        patched.setattr(threads._Worker, "ring", lambda worker: None)
        fly(more, one, 20)
        assert all(worker.asleep for worker in crew)
    fly(more, one, 20)
    more.close()


def test_a_bad_action_changes_nothing() -> None:
    one, more = begun(80, 1), begun(80, 2)
    one.reset(), more.reset()
    rows = next(actions(more, 1))
    rows[77, 1, 2] = np.nan
    with pytest.raises(ValueError, match="follower_1 of world 77"):
        more.step(rows)
    agree(more, one, (more.look(), one.look()))
    more.close()


def test_few_vehicles_get_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "_VEHICLES_PER_THREAD", 48)
    assert [begun(worlds, 2)._threads for worlds in (15, 17, 33)] == [1, 2, 2]
    monkeypatch.setattr(simulation, "cores", lambda: 1)
    assert begun(33, 2)._threads == 1


@pytest.mark.parametrize("pause", [0.0, 0.05])
def test_an_interpreter_ends_with_threads_about(pause: float) -> None:
    program = (
        "import time\n"
        "from formation_env import configure\n"
        "from formation_env.core import simulation\n"
        "simulation._VEHICLES_PER_THREAD, simulation.cores = 1, lambda: 3\n"
        "made = simulation.Simulation(configure('nominal'), 64, 3)\n"
        "made.reset()\n"
        "assert made._team is not None\n"
        f"time.sleep({pause})\n"
    )
    command = [sys.executable, "-W", "error", "-c", program]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=10 * LONG, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
