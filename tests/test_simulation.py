"""A simulation among threads, what it hands out, how long it may fly, what it refuses."""

from __future__ import annotations

import copy
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from episodes import wild
from numba import config as numba_config
from states import begun, counters, disturbances, still

from formation_env import configure, splines, trajectories
from formation_env.core import arrays, kernels, simulation
from formation_env.core.exclusive import Exclusive
from formation_env.core.simulation import Simulation
from formation_env.laws.world import MAX_TICKS
from formation_env.maths.rng import words

LONG = 60.0  # s: what takes longer hangs
LATE = "another thread is at work"


# -- one thread at a time ---------------------------------------------------------------------------------


def held(flight: Simulation, calls: Callable[[], Any]) -> Any:
    """What a call ends in while another thread is inside."""
    inside, leave = threading.Event(), threading.Event()

    def other() -> None:
        with flight._alone:
            inside.set()
            leave.wait(LONG)

    thread = threading.Thread(target=other)
    thread.start()
    try:
        assert inside.wait(LONG)
        return calls()
    finally:
        leave.set()
        thread.join(LONG)


CALLS: dict[str, Callable[[Simulation], Any]] = {
    "step": lambda one: one.step(still(one)),
    "reset": lambda one: one.reset(),
    "look": lambda one: one.look(),
    "slots": lambda one: one.slots,
    "seed": lambda one: one.seed(0, 1),
    "get_state": lambda one: one.get_state(),
    "set_state": lambda one: one.set_state(None),  # type: ignore[arg-type]
    "limit": lambda one: one.limit(3),
    "close": lambda one: one.close(),
    "pickle": pickle.dumps,
    "deepcopy": copy.deepcopy,
}


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("threads", [1, 2])
def test_who_comes_second_is_told_so(call: str, threads: int) -> None:
    flight = begun(64, threads=threads)
    start = time.monotonic()
    with pytest.raises(RuntimeError, match=LATE):
        held(flight, lambda: CALLS[call](flight))
    assert time.monotonic() - start < LONG
    flight.step(still(flight))  # and is welcome afterwards
    flight.close()


@pytest.mark.parametrize("threads", [1, 3])
def test_two_threads_that_step_come_to_an_end(
    threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each call steps, or says that another is at work: the ticks are those of the calls that stepped."""
    monkeypatch.setattr(simulation, "_VEHICLES_PER_THREAD", 1)
    monkeypatch.setattr(simulation, "cores", lambda: 4)
    flight, stepped, odd = begun(256, threads=threads), [0, 0], []
    actions = still(flight)

    def job(k: int) -> None:
        for _ in range(300):
            try:
                flight.step(actions)
                stepped[k] += 1
            except RuntimeError as error:
                odd.append(str(error))

    both = [threading.Thread(target=job, args=(k,), daemon=True) for k in range(2)]
    for one in both:
        one.start()
    for one in both:
        one.join(LONG)
        assert not one.is_alive(), "it hangs"
    assert all(LATE in text for text in odd)
    assert sum(stepped) + len(odd) == 600
    np.testing.assert_allclose(flight.time, sum(stepped) * 0.02)
    flight.close()


def test_the_same_thread_may_come_again() -> None:
    """As a signal's handler does that closes the environment in the middle of a call."""
    flight = begun(2)
    with flight._alone:
        flight.step(still(flight))
        flight.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_child_forked_in_another_threads_call_is_free() -> None:
    flight = begun(2)

    def child() -> int:
        with warnings.catch_warnings():  # of Python 3.12 on
            warnings.simplefilter("ignore", DeprecationWarning)
            number = os.fork()
        if number == 0:
            code = 1
            try:
                flight.step(still(flight))
                flight.close()
                code = 0
            finally:
                os._exit(code)
        return number

    number = held(flight, child)
    assert os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]) == 0


def test_copies_are_free_and_independent() -> None:
    flight = begun(2)
    with flight._alone:
        others = [copy.deepcopy(flight), pickle.loads(pickle.dumps(flight))]
    for other in others:
        assert held(flight, lambda one=other: one.step(still(one)).rewards.shape) == (2,)  # type: ignore[misc]
    assert flight.time.tolist() == [0.0, 0.0]


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_an_interrupt_ends_two_stepping_threads() -> None:
    program = (
        "import threading, numpy as np\n"
        "from formation_env import configure\n"
        "from formation_env.core import simulation\n"
        "simulation._VEHICLES_PER_THREAD, simulation.cores = 1, lambda: 3\n"
        "made = simulation.Simulation(configure('nominal'), 64, 3)\n"
        "made.reset()\n"
        "def job():\n"
        "    while True:\n"
        "        try:\n"
        "            made.step(np.zeros((64, 2, 4), np.float32))\n"
        "        except RuntimeError:\n"
        "            pass\n"
        "threading.Thread(target=job, daemon=True).start()\n"
        "print('ready', flush=True)\n"
        "job()\n"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == "ready\n"
        time.sleep(0.3)
        run.send_signal(signal.SIGINT)
        try:
            _, errors = run.communicate(timeout=LONG)
        finally:
            run.kill()
    assert "KeyboardInterrupt" in errors


def test_an_exclusive_is_left_by_whoever_raises() -> None:
    alone = Exclusive()
    with pytest.raises(KeyError), alone:
        raise KeyError
    found: list[bool] = []

    def job() -> None:
        with alone:
            found.append(True)

    thread = threading.Thread(target=job)
    thread.start()
    thread.join(LONG)
    assert found == [True]


# -- what it hands out is for reading ------------------------------------------------------------------------

ARRAYS = [
    *("positions", "leaders", "velocities", "attitudes", "angular_velocities", "slots"),
    *("started", "seeded", "over", "time", "clock"),
]


@pytest.mark.parametrize("worlds", [1, 17])
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_are_read_only_copies(name: str, worlds: int) -> None:
    flight = begun(worlds)
    array = getattr(flight, name)
    with pytest.raises(ValueError, match="read-only"):
        array[...] = 0
    before = array.copy()
    for actions in wild(3, *flight._shape):
        flight.step(actions)
    np.testing.assert_array_equal(array, before)


@pytest.mark.parametrize(
    "name", ["config", "num_worlds", "threads", "max_steps", "layout", *ARRAYS]
)
def test_nothing_of_it_can_be_assigned(name: str) -> None:
    flight = begun()
    with pytest.raises(AttributeError):
        setattr(flight, name, getattr(flight, name))


# -- long episodes -----------------------------------------------------------------------------------------

TIMES = np.linspace(0.0, 30.0, 40)
POINTS = np.stack([np.sin(TIMES), 2.0 * np.cos(0.7 * TIMES), -1.5 - 0.3 * np.sin(TIMES)], axis=1)


def _lines(flight: Simulation) -> int:
    """Of the leader's reference that are tabulated."""
    return len(arrays.MEMORY.views(flight._memory)["references"]) // arrays.LINE


PATHS: dict[str, Callable[[], Any]] = {
    "sines": trajectories.figure_eight,
    "circle": trajectories.circle,
    "line": trajectories.line,
    "lemniscate": trajectories.lemniscate,
    "spline": lambda: splines.waypoints(TIMES.tolist(), POINTS.tolist()),
}
PERIODIC = ("sines", "circle", "lemniscate")


@pytest.mark.parametrize("scenario", ["nominal", "paper", "experiment"])
@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("lies", ["drawn", "as given"])
def test_a_reference_evaluated_is_the_one_tabulated(
    lies: str, path: str, scenario: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit for bit, across the end of an episode and beyond the last row of the table.

    Begun at any phase of a periodic path, whose table is longer by a period.
    """
    with warnings.catch_warnings():  # not all paths suit the formation
        warnings.simplefilter("ignore")
        config = configure(scenario, trajectory=PATHS[path](), duration=1.0, path=lies)
    lines = config.max_steps + config.phases + 1
    assert (config.phases > 0) == (lies == "drawn" and path in PERIODIC)
    tabulated = Simulation(config, 3)
    monkeypatch.setattr(simulation, "TABULATED", 0)
    evaluated = Simulation(config, 3)
    assert _lines(tabulated) == lines
    assert _lines(evaluated) == 0
    for flight in (tabulated, evaluated):
        for world in range(3):
            flight.seed(world, world)
        flight.reset()
    first = counters(tabulated._state.counters)["first"].reshape(-1)[:3]
    assert (len(set(first.tolist())) > 1) == (config.phases > 0)
    for k, actions in enumerate(wild(140, *tabulated._shape) * np.float32(0.02)):
        mode = kernels.STEP_OR_RESET if k < 60 else kernels.STEP
        for flight in (tabulated, evaluated):
            counted = counters(flight._state.counters)
            counted["started"][:] = 1
            if k == 60:  # 40 ticks before the table's end
                counted["clock"][:] = lines - 40 - counted["first"]
        one, two = (flight.step(actions, mode) for flight in (tabulated, evaluated))
        assert one.observations.tobytes() == two.observations.tobytes(), k
        assert one.outputs.tobytes() == two.outputs.tobytes(), k
        assert tabulated.positions.tobytes() == evaluated.positions.tobytes(), k
    for flight in (tabulated, evaluated):
        counted = counters(flight._state.counters)
        np.testing.assert_array_equal(
            (counted["clock"] + counted["first"]).reshape(-1)[:3], lines + 40
        )


@pytest.mark.parametrize("duration", [1e9, MAX_TICKS * 0.02])
def test_an_endless_episode_takes_no_more_memory(duration: float) -> None:
    path = trajectories.circle()
    config, short = configure(duration=duration, trajectory=path), configure(trajectory=path)
    sizes = []
    for one in (short, config):
        Simulation(one, 4)
        tracemalloc.start()
        flight = Simulation(one, 4)
        sizes.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert sizes[1] <= sizes[0]
    assert flight.max_steps == round(duration / 0.02)
    for world in range(4):
        flight.seed(world, world)
    flight.reset()
    expected = Simulation(short, 4)
    for world in range(4):
        expected.seed(world, world)
    expected.reset()
    for actions in wild(20, *flight._shape) * np.float32(0.1):
        found = flight.step(actions)
        assert found.observations.tobytes() == expected.step(actions).observations.tobytes()


@pytest.mark.parametrize("scenario", ["nominal", "paper"])
def test_late_ticks_are_as_good_as_early_ones(scenario: str) -> None:
    """In the last ticks of the longest episode: counters, clock, random draws; then it ends in time."""
    flight = begun(
        2, scenario, duration=MAX_TICKS * 0.02, gust=1.0, trajectory=trajectories.hover()
    )
    snapshot = flight.get_state()
    for name in ("tick", "clock"):
        counters(snapshot.state["counters"])[name][:] = MAX_TICKS - 3
    flight.set_state(snapshot)
    truncated = []
    for _ in range(3):
        results = flight.step(still(flight))
        assert np.isfinite(results.outputs).all()
        assert np.abs(disturbances(flight)["gusts"]).max() < 6.0  # m/s^2
        truncated.append(results.truncated.tolist())
    assert truncated == [[False, False], [False, False], [True, True]]


def test_random_draws_go_on_beyond_32_bits() -> None:
    """Each a word of 32 bits, and none of them the one of 2^32 ticks before."""
    key = np.uint64(7)
    early = [words(key, 2, 1, np.uint64(k), 0) for k in range(50)]
    for shift in (2**32, 2**40, 2**49):
        late = [words(key, 2, 1, np.uint64(shift + k), 0) for k in range(50)]
        assert all(0 <= int(word) < 2**32 for draw in late for word in draw)
        assert not {tuple(map(int, one)) for one in early} & {tuple(map(int, one)) for one in late}


def test_a_late_limit_is_no_matter() -> None:
    flight = Simulation(configure(), max_steps=10**30)
    assert flight.max_steps == configure().max_steps
    flight.limit(10**30)
    assert flight.max_steps == configure().max_steps


# -- refusals -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Simulation(None), "config = None: expected a FormationConfig"),  # type: ignore[arg-type]
        (lambda: Simulation(configure(), 0), "num_worlds = 0"),
        (lambda: Simulation(configure(), 1.5), "num_worlds = 1.5"),  # type: ignore[arg-type]
        (lambda: Simulation(configure(), 1, 0), "threads = 0"),
        (lambda: Simulation(configure(), 1, 1, 0), "max_steps = 0"),
        (lambda: begun().limit(-1), "max_steps = -1"),
        (lambda: begun().seed(1, 0), "world = 1"),
        (lambda: begun().seed(0, -1), "key = -1"),
        (lambda: begun().seed(0, 2**64), "key = 18446744073709551616"),
        (lambda: begun().seed(0, True), "key = True"),
        (lambda: begun().reference(np.array([np.nan])), r"times\[0\] = nan"),
        (lambda: begun().reference(np.zeros(2), 1), "world = 1"),
        (lambda: begun(3).step(np.zeros((1, 2, 4), np.float32)), r"actions = .* \(3, 2, 4\)"),
        (lambda: begun().step(np.zeros((1, 2, 4))), "actions = .*expected float32"),
        (lambda: begun().reset(np.zeros(2, np.bool_)), "mask = .*expected 1 booleans"),
        (lambda: begun().reset([True]), "mask"),  # type: ignore[arg-type]
    ],
)
def test_impossible_arguments_are_named(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        call()
    assert len(str(error.value)) <= 500


@pytest.mark.skipif(bool(numba_config.DISABLE_JIT), reason="nothing is compiled")
def test_layouts_of_an_array_compile_nothing_anew() -> None:
    flight = begun(3)
    for actions in (np.zeros((3, 2, 8), np.float32)[..., ::2], np.asfortranarray(still(flight))):
        flight.step(actions)
    assert len(kernels.advance.signatures) == 1  # type: ignore[attr-defined]
