"""What a robustness test changes of a task: a table, one row for each change.

A change of what is wanted, such as a wider formation, is told to the policy: it is made for the changed
configuration. A change of the vehicle or of its sensors is not: the policy is made for the task as it is, and
the world differs from it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from math import hypot
from typing import NamedTuple

from formation_env import SCENARIOS, FeasibilityWarning, FormationConfig, configure
from formation_env.configuration.leader_path import FlightWarning
from formation_env.physics.sensors import Noise

LATER = 1  # samples
NOISE = Noise(position=0.002, velocity=0.005, attitude=0.001, angular_velocity=0.01)
WIDER, HEAVIER, LONGER = 1.2, 1.1, 2.0
OFF, ABOVE = 0.5, 1.5  # m


class Change(NamedTuple):
    """One row of `CHANGES`."""

    name: str
    meaning: str
    changed: Callable[[FormationConfig], FormationConfig]  # raises `ValueError` where it cannot be
    told: bool  # whether the policy is made for the changed configuration
    # Whether gains are searched and networks trained with it where sensors are exact: `train.margin`.
    margin: bool = False


# -- of the world, not told -----------------------------------------------------------------------


def _later(config: FormationConfig) -> FormationConfig:
    return configure(config, measurement_delay=config.measurement_delay + LATER)


def _noisier(config: FormationConfig) -> FormationConfig:
    noise = Noise(*(hypot(own, more) for own, more in zip(config.noise, NOISE, strict=True)))
    return configure(config, noise=noise)


def _heavier(config: FormationConfig) -> FormationConfig:
    """The thrust that an action gives stays what it was, N: by itself a mass changes nothing."""
    own = config.vehicle
    vehicle = replace(own, mass=HEAVIER * own.mass, thrust_max=own.full_thrust)
    return configure(config, vehicle=vehicle)


# -- of what is wanted, told ----------------------------------------------------------------------


def _wider(config: FormationConfig) -> FormationConfig:
    offsets = tuple((WIDER * x, WIDER * y, WIDER * z) for x, y, z in config.offsets)
    return configure(config, offsets=offsets)


def _more(config: FormationConfig) -> FormationConfig:
    """The scenario's formation of one more."""
    name, n = config.scenario, config.followers
    if name not in SCENARIOS or configure(name, followers=n).offsets != config.offsets:
        raise ValueError(
            "its formation is not its scenario's, which would say where one more flies"
        )
    offsets = configure(name, followers=n + 1).offsets
    return configure(config, offsets=offsets, follower_starts=None, leader_start=None)


def _farther(config: FormationConfig) -> FormationConfig:
    """One follower alone, at the first one's place but above the leader, where a start has room without
    another vehicle or the floor in it, and where it inverts as little as before."""
    if config.start == "ground":
        raise ValueError("all start on the floor")
    x, y, _ = config.offsets[0]
    return configure(config, offsets=((x, y, ABOVE),), start_offset=OFF)


def _longer(config: FormationConfig) -> FormationConfig:
    return configure(config, duration=LONGER * config.duration)


CHANGES = (
    Change(f"{LATER} sample late", f"measurements {LATER} sample later", _later, False, True),
    Change(
        "noise",
        f"white noise of {1e3 * NOISE.position:g} mm, {1e3 * NOISE.velocity:g} mm/s, "
        f"{1e3 * NOISE.attitude:g} mrad and {NOISE.angular_velocity:g} rad/s added to what is measured",
        _noisier,
        False,
        True,
    ),
    Change(
        f"mass x {HEAVIER:g}",
        f"vehicles of {HEAVIER:g} times the mass, the thrust that an action gives unchanged",
        _heavier,
        False,
    ),
    Change(f"width x {WIDER:g}", f"the formation {WIDER:g} times as wide", _wider, True),
    Change("1 more", "one follower more, as the scenario places it", _more, True),
    Change(f"time x {LONGER:g}", f"an episode {LONGER:g} times as long", _longer, True),
    Change(
        f"{OFF:g} m off",
        f"one follower alone, {ABOVE:g} m above the leader, that starts up to {OFF:g} m from its slot",
        _farther,
        True,
    ),
)


def changed(config: FormationConfig, change: Change) -> FormationConfig:
    """The changed task, without warnings. Raises `ValueError` where no such task can be, or where a virtual
    follower would move backwards (26), so that no formation is defined."""
    with warnings.catch_warnings():
        for kind in (FeasibilityWarning, FlightWarning):
            warnings.simplefilter("ignore", kind)
        found = change.changed(config)
    if any(report.inverts for report in found.feasibility()):
        raise ValueError("virtual followers would move backwards there")
    return found
