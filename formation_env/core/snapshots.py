"""Saved states: what a simulation of the same configuration may continue from, and what it refuses.

Compiled code checks no index, so every number of a state that leads to one is checked here, and with them
all that would otherwise be NaN some ticks later. A world whose episode is over, or has not begun, may hold
anything but a wrong counter or table: it cannot go on, and a state that has left what can be computed ends
its episode.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env.core.arrays import Counters, State, by_world, rows
from formation_env.laws.levels import Follower
from formation_env.laws.world import MAX_TICKS
from formation_env.memory.records import slices
from formation_env.paths.course import Course
from formation_env.physics.sensors import Measured
from formation_env.validation.checks import refuse_where, require, shown

if TYPE_CHECKING:
    from formation_env.config import FormationConfig

Floats = NDArray[np.float64]

_EPISODES = 2**32 - 1  # an episode's number is one word of a random draw's counter


class Snapshot(NamedTuple):
    """The complete state of a simulation and what it is a state of."""

    config: FormationConfig
    state: dict[str, NDArray[Any]]


def check_snapshot(snapshot: Any, config: FormationConfig, own: State, worlds: int) -> None:
    """Raise `ValueError` unless a simulation of `worlds` worlds with the state `own` can go on from it."""
    if not isinstance(snapshot, Snapshot):
        kind = type(snapshot).__name__
        raise ValueError(f"state is a {shown(kind)[1:-1]}: expected what get_state returned")
    if snapshot.config != config:
        raise ValueError("state was saved under another configuration than this environment's")
    require(isinstance(snapshot.state, dict), "state.state", snapshot.state, "a dictionary")
    odd = sorted(map(str, set(snapshot.state) - set(own._fields)))
    require(not odd, "state.state", odd, f"no entries but {', '.join(own._fields)}")
    for name, array in own._asdict().items():
        saved: Any = snapshot.state.get(name)
        alike = type(saved) is np.ndarray
        if not alike or saved.dtype != array.dtype or saved.shape != array.shape:
            found = f"{saved.dtype} {saved.shape}" if alike else f"a {type(saved).__name__}"
            found = "missing" if name not in snapshot.state else shown(found)[1:-1]
            raise ValueError(f"state[{name!r}] is {found}: expected {array.dtype} {array.shape}")
    state = State(**snapshot.state)
    _check_counters(state, config)
    _check_tables(state, config)
    over = rows(state.counters, Counters)["over"].reshape(-1)[:worlds]
    live = np.flatnonzero(over == 0)
    _check_vehicles(by_world(state.vehicles, worlds)[live], "vehicles")
    _check_samples(by_world(state.samples, worlds)[live])
    _check_followers(by_world(state.followers, worlds)[live])
    _check_finite("begins", by_world(state.begins, worlds)[live])
    _check_courses(by_world(state.courses, worlds)[live], config)
    _check_finite("speeds", state.speeds[live])


_COUNTED = {
    "tick": (0, 2 * MAX_TICKS),
    "started": (0, 1),
    "clock": (0, 2 * MAX_TICKS),
    "episode": (-1, _EPISODES),
    "over": (0, 1),
}


def _check_counters(state: State, config: FormationConfig) -> None:
    counted = {n: x.reshape(-1) for n, x in rows(state.counters, Counters).items()}
    bounds = {**_COUNTED, "first": (0, max(0, config.phases - 1))}
    for name, (low, high) in bounds.items():
        values = counted[name]
        bad = (values < low) | (values > high)
        _refuse_where(bad, f"counters[{name}]", values, f"{low} to {high}")
    late = counted["clock"] > counted["tick"]
    _refuse_where(late, "counters[clock]", counted["clock"], "no more than the ticks flown")


def _check_tables(state: State, config: FormationConfig) -> None:
    path = config.trajectory
    if path.random is None:
        same = np.array_equal(state.tables[0], path.table)
        require(same, "state['tables']", state.tables[0], "the trajectory of the configuration")
        return
    _check_finite("tables", state.tables)
    harmonics, expected = state.tables[:, 0], float(path.random.harmonics)
    _refuse_where(harmonics != expected, "tables", harmonics, f"{expected:g} harmonics")


def _check_courses(courses: Floats, config: FormationConfig) -> None:
    where, allowed = slices(Course), config.world.courses
    square = np.square(courses[..., where["turn"]]).sum(axis=-1)
    bad = ~(np.abs(square - 1.0) <= 1e-9)
    _refuse_where(bad, "courses (squared norm of a turn)", square, "1: unit vectors")
    side = courses[..., where["side"]]
    bad = (side != 1.0) & ((side != -1.0) | (allowed.mirrored == 0))
    _refuse_where(bad, "courses (side)", side, "1, or -1 where paths are mirrored")
    if not allowed.drawn:
        turn = courses[..., where["turn"]]
        _refuse_where(turn != (1.0, 0.0), "courses (turn)", turn, "(1, 0): the path is as given")


def _check_finite(name: str, values: Floats) -> None:
    bad = ~np.isfinite(values)
    _refuse_where(bad, name, values, "finite numbers in worlds whose episode goes on")


def _check_attitudes(name: str, q: Floats, tolerance: float) -> None:
    square = np.square(q).sum(axis=-1)
    bad = ~(np.abs(square - 1.0) <= tolerance)
    _refuse_where(bad, f"{name} (squared norm of a quaternion)", square, "1: unit quaternions")


def _check_vehicles(vehicles: Floats, name: str) -> None:
    _check_finite(name, vehicles)
    where = slices(Measured)
    _check_attitudes(name, vehicles[..., where["q"]], 1e-6)
    with np.errstate(over="ignore"):
        for part, what in (("p", "position"), ("v", "velocity"), ("w", "angular velocity")):
            square = np.square(vehicles[..., where[part]]).sum(axis=-1)
            _refuse_where(
                ~np.isfinite(square), f"{name} ({what}, squared)", square, "a finite number"
            )


def _check_samples(samples: Floats) -> None:
    """A measured attitude is one turned by noise: a unit quaternion but for what is lost in large angles."""
    _check_finite("samples", samples)
    _check_attitudes("samples", samples[..., slices(Measured)["q"]], 0.5)


def _check_followers(followers: Floats) -> None:
    _check_finite("followers", followers)
    where = slices(Follower)
    for name in ("heading", "estimate"):
        square = np.square(followers[..., where[name]]).sum(axis=-1)
        bad = np.abs(square - 1.0) > 1e-3
        _refuse_where(bad, "followers (squared norm of a heading)", square, "1: unit vectors")
    previous = followers[..., where["previous"]]
    _refuse_where(np.abs(previous) > 1.0, "followers (previous action)", previous, "-1 to 1")


def _refuse_where(bad: NDArray[np.bool_], name: str, values: NDArray[Any], expected: str) -> None:
    refuse_where(bad, f"state: {name}", values, expected)
