"""Saved states: those of real flights are taken, mutated ones are refused or harmless."""

from __future__ import annotations

import copy
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from episodes import wild
from states import (
    PARTS,
    begun,
    counters,
    finite,
    follower_rows,
    still,
    unchecked,
    vehicles,
)

from formation_env import configure
from formation_env.core import kernels
from formation_env.core.arrays import rows
from formation_env.core.simulation import Simulation, Snapshot
from formation_env.memory.records import LANES
from formation_env.physics.sensors import Measured

TASKS: dict[str, dict[str, Any]] = {
    "nominal": {"scenario": "nominal"},
    "paper": {"scenario": "paper", "duration": 1.0},
    "agile": {"scenario": "agile", "action": "reference"},
    "experiment": {"scenario": "experiment", "window": 7},
    "late": {"scenario": "paper", "measurement_delay": 3, "gust": 1.0},
    "swarm": {"scenario": "swarm", "followers": 40},
}


def flown(task: str, worlds: int = 3, steps: int = 12) -> Simulation:
    """In flight: one world's episode is over, or has not begun, now and then."""
    flight = Simulation(configure(**TASKS[task]), worlds)
    for world in range(worlds):
        flight.seed(world, world)
    flight.reset()
    for actions in wild(steps, *flight._shape) * np.float32(0.1):
        flight.step(actions)
    return flight


def taken(flight: Simulation) -> None:
    """Its own state, by another one, which goes on alike."""
    other = Simulation(flight.config, flight.num_worlds, 1, flight.max_steps)
    other.set_state(flight.get_state())
    for actions in wild(3, *flight._shape, seed=1):
        found, expected = other.step(actions), flight.step(actions)
        assert found.observations.tobytes() == expected.observations.tobytes()
        assert found.ends.tobytes() == expected.ends.tobytes()


@pytest.mark.parametrize("task", TASKS)
def test_the_state_of_a_flight_is_always_taken(task: str) -> None:
    """Before the first reset, in flight, ended, flown on after the end, past the time limit, seeded anew."""
    for seed in range(3):
        flight = Simulation(configure(**TASKS[task]), 5)
        flight.set_state(flight.get_state())
        for world in range(5):
            flight.seed(world, 2**64 - 1 - world - 10 * seed)
        flight.set_state(flight.get_state())
        flight.reset(np.array([True, True, False, True, True]))
        flight.set_state(flight.get_state())
        flight.reset()
        for k, actions in enumerate(wild(240, *flight._shape, seed=seed)):
            flight.step(
                actions, (kernels.STEP, kernels.STEP_OR_RESET, kernels.STEP_AND_RESET)[seed]
            )
            if k % 40 == 0:
                taken(flight)
        flight.limit(3)
        flight.seed(2, 5)
        taken(flight)


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e160, 1e200, 0.0])
@pytest.mark.parametrize("substeps", [1, 4])
def test_a_state_that_has_left_the_numbers_is_taken_as_one_that_ended(
    part: str, value: float, substeps: int
) -> None:
    flight = begun(3, substeps=substeps)
    vehicles(flight)[part][0, 1, :, 1] = value
    flight.step(still(flight))
    taken(flight)
    flight.step(still(flight), kernels.STEP_OR_RESET)
    taken(flight)


def test_the_state_of_an_extreme_task_is_taken() -> None:
    for odd in (
        {"inertia": (2e-6,) * 3},
        {"moment_max": (100.0,) * 3},
        {"inertia": (1e-3, 1e-3, 1e-9)},
    ):
        flight = Simulation(unchecked(vehicle=odd), 3)
        for world in range(3):
            flight.seed(world, world)
        flight.reset()
        for actions in np.sign(wild(30, *flight._shape)):
            flight.step(actions, kernels.STEP_OR_RESET)
            flight.set_state(flight.get_state())


def refused(flight: Simulation, snapshot: Any, message: str) -> None:
    """One short `ValueError`, and nothing has changed."""
    before = copy.deepcopy(flight.get_state().state)
    with pytest.raises(ValueError, match=message) as error:
        flight.set_state(snapshot)
    assert len(str(error.value)) <= 500
    after = flight.get_state().state
    assert all(after[name].tobytes() == before[name].tobytes() for name in before)


WRONG: dict[str, Any] = {
    "nothing": (None, "state is a NoneType: expected what get_state returned"),
    "a tuple": ((1, 2), "expected what get_state returned"),
    "no config": (lambda s: Snapshot(None, s.state), "another configuration"),
    "no state": (lambda s: Snapshot(s.config, None), "state.state = None: expected a dictionary"),
    "a list": (lambda s: Snapshot(s.config, list(s.state)), "expected a dictionary"),
    "empty": (lambda s: Snapshot(s.config, {}), r"state\['vehicles'\] is missing"),
    "one more": (lambda s: Snapshot(s.config, {**s.state, "x": 1}), "'x'"),
    "None": (lambda s: Snapshot(s.config, {**s.state, "keys": None}), "'keys'.* is a NoneType"),
    "lists": (
        lambda s: Snapshot(s.config, {k: v.tolist() for k, v in s.state.items()}),
        "is a list: expected float64",
    ),
    "masked": (
        lambda s: Snapshot(s.config, {**s.state, "vehicles": np.ma.array(s.state["vehicles"])}),
        "is a MaskedArray",
    ),
    "32 bits": (
        lambda s: Snapshot(s.config, {**s.state, "begins": s.state["begins"].astype(np.float32)}),
        "float32",
    ),
    "swapped": (
        lambda s: Snapshot(s.config, {**s.state, "keys": s.state["keys"].astype(">u8")}),
        "expected uint64",
    ),
    "shape": (
        lambda s: Snapshot(s.config, {**s.state, "keys": s.state["keys"][:, 1:]}),
        r"\(1, 15\)",
    ),
    "a path": (
        lambda s: Snapshot(s.config, {**s.state, "tables": s.state["tables"] + 1.0}),
        "the trajectory of the configuration",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_no_state_is_refused(what: str) -> None:
    made, message = WRONG[what]
    flight = begun(3)
    refused(flight, made(flight.get_state()) if callable(made) else made, message)


COUNTS = [
    ("tick", -1),
    ("tick", 10**18),
    ("started", 2),
    ("clock", 10**9),
    ("clock", -1),
    ("episode", -2),
    ("episode", 2**32),
    ("over", -1),
]


@pytest.mark.parametrize(("name", "value"), COUNTS)
@pytest.mark.parametrize("lane", [1, LANES - 1], ids=["world", "unused"])
def test_counters_out_of_range_are_refused(name: str, value: int, lane: int) -> None:
    flight = flown("nominal")
    snapshot = flight.get_state()
    counters(snapshot.state["counters"])[name][0, lane] = value
    refused(flight, snapshot, rf"counters\[{name}\]\[{lane}\] = {value}: expected")


def test_a_reference_clock_ahead_of_the_ticks_is_refused() -> None:
    flight = flown("nominal")
    snapshot = flight.get_state()
    counted = counters(snapshot.state["counters"])
    counted["clock"][0, 1] = counted["tick"][0, 1] + 1
    refused(flight, snapshot, r"counters\[clock\]\[1\] = .*no more than the ticks flown")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["vehicles", "samples", "followers", "begins", "speeds", "tables"])
def test_numbers_that_are_not_finite_are_refused(name: str, value: float) -> None:
    flight = flown("agile") if name == "tables" else flown("experiment")
    snapshot = flight.get_state()
    counters(snapshot.state["counters"])["over"][:, :3] = 0
    array = snapshot.state[name]
    if name not in ("speeds", "tables"):  # of which the last place is no lane
        array = array.reshape(*array.shape[:-1], -1, LANES)
    array[..., 1] = value
    refused(flight, snapshot, f"{name}.*expected")


def test_other_numbers_are_refused_by_name() -> None:
    flight = flown("experiment")

    def changed(name: str, part: str, value: Any) -> Snapshot:
        snapshot = flight.get_state()
        counters(snapshot.state["counters"])["over"][:, :3] = 0
        array = snapshot.state[name]
        named = follower_rows(flight, array) if name == "followers" else rows(array, Measured)
        place = named[part][(0,) * (named[part].ndim - 2)]
        place[:, 0] = value
        return snapshot

    quaternion, long = "squared norm of a quaternion", (2.0, 0.0, 0.0, 0.0)
    refused(flight, changed("vehicles", "q", 0.0), f"vehicles .{quaternion}")
    refused(flight, changed("vehicles", "q", long), f"vehicles .{quaternion}")
    refused(flight, changed("vehicles", "v", 1e200), "vehicles .velocity, squared")
    refused(flight, changed("samples", "q", 0.0), f"samples .{quaternion}")
    for heading in ("heading", "estimate"):
        refused(flight, changed("followers", heading, 0.0), "norm of a heading")
    action = "previous action.* = 1.5: expected -1 to 1"
    refused(flight, changed("followers", "previous", 1.5), action)
    agile = flown("agile")
    snapshot = agile.get_state()
    for harmonics in (1e9, 4.0, 0.0, 2.9, -1.0):
        snapshot.state["tables"][2, 0] = harmonics
        refused(agile, snapshot, rf"tables\[2\] = {harmonics}: expected 3 harmonics")


# -- mutations at random ----------------------------------------------------------------------------------


def mutated(state: dict[str, Any], draw: np.random.Generator) -> dict[str, Any]:
    """A state with one thing of one array changed."""
    state = {name: array.copy() for name, array in state.items()}
    name = str(draw.choice([k for k in state if state[k].size]))
    array, kind = state[name], int(draw.integers(0, 10))
    if kind == 0:
        others = [
            None,
            array.tolist(),
            array.astype(np.float32),
            array[..., :-1],
            array.ravel()[:1],
            {},
            "x",
        ]
        state[name] = others[int(draw.integers(0, len(others)))]
    elif kind == 1 and draw.random() < 0.5:
        del state[name]
    else:
        flat = array.reshape(-1)
        many = int(draw.choice([1, 1, 3, flat.size]))
        where = draw.integers(0, flat.size, many)
        if array.dtype == np.float64:
            values = [
                np.nan,
                np.inf,
                -np.inf,
                1e308,
                -1e308,
                1e160,
                1e9,
                -1e9,
                0.0,
                -1.0,
                5e-324,
                2.5,
            ]
            flat[where] = draw.choice(values)
        else:
            info = np.iinfo(array.dtype)
            values = [info.max, info.min, 10**9, 10**6, 2**31, 2**40, 1, 0, 2]
            flat[where] = np.array(values, dtype=object)[draw.integers(0, len(values))]
    return state


def fuzz(task: str, seed: int, many: int) -> Iterator[str]:
    """What became of mutations: refused, or flown on."""
    draw = np.random.default_rng(seed)
    flight = flown(task)
    saved = flight.get_state()
    bound = flight.layout.bound
    for k in range(many):
        flight.set_state(saved)
        snapshot = Snapshot(saved.config, mutated(saved.state, draw))
        try:
            flight.set_state(snapshot)
        except ValueError as error:
            yield "refused" if len(str(error)) <= 500 else "told at length"
            continue
        flight.reference(np.linspace(0.0, 9.0, 5), 1)
        shown = [flight.look()]
        for actions in wild(8, *flight._shape, seed=k) * np.float32(0.3):
            shown.append(flight.step(actions, kernels.STEP_OR_RESET))
        for results in shown:
            assert np.isfinite(results.observations).all()
            assert (np.abs(results.observations) <= bound).all()
            assert np.isfinite(results.ends).all()
            assert finite(results)
        yield "flown"


@pytest.mark.parametrize("task", TASKS)
def test_mutations_are_refused_or_harmless(task: str, root: Path) -> None:
    """In a process of its own, which survives; `python tests/test_snapshots.py TASK SEED MANY` for more."""
    command = [sys.executable, str(Path(__file__)), task, "0", "40"]
    path = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    counts = json.loads(done.stdout)
    assert sum(counts.values()) == 40
    assert min(counts.values()) > 3


if __name__ == "__main__":
    ends = list(fuzz(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
    print(json.dumps({end: ends.count(end) for end in ("refused", "flown")}))
