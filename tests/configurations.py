"""Configurations to draw: for every field values that it may have, plain and extreme ones."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from formation_env import (
    FeasibilityWarning,
    FormationConfig,
    Limits,
    Noise,
    PlannerGains,
    Rewards,
    TrackerGains,
    Vehicle,
    configure,
    formations,
    trajectories,
)
from formation_env.configuration.leader_path import FlightWarning
from formation_env.memory.records import notes


def spread(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of every size between two positive ones, the ends among them."""
    sizes = st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))
    return st.sampled_from((low, high)) | sizes.map(lambda x: min(max(x, low), high))


def three(low: float, high: float) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*[spread(low, high)] * 3)


def or_zero(high: float) -> st.SearchStrategy[float]:
    return st.just(0.0) | spread(1e-6, high)


def within(kind: Any) -> st.SearchStrategy[Any]:
    """A record of numbers, each between the bounds of its field."""
    fields = {
        name: spread(to.low, to.high) if to.low > 0.0 else or_zero(to.high)
        for name, to in notes(kind).items()
    }
    return st.builds(kind, **fields)


def _vehicle(mass: float, J: float, lift: float | None, **options: Any) -> Vehicle:
    thrust = None if lift is None else lift * mass * 9.81
    return Vehicle(mass, (J, J, 1.5 * J), thrust, **options)


VEHICLES = st.builds(
    _vehicle,
    mass=spread(1e-6, 1e6),
    J=spread(1e-12, 1e6),
    lift=st.none() | spread(1.001, 99.0),
    moment_max=three(1e-12, 1e9),
    rate_max=three(1e-3, 600.0),
    rate_lag=spread(1e-3, 1e3),
    limited=st.booleans(),
)
TRACKERS = st.builds(
    TrackerGains,
    k1=spread(1e-3, 1e3).map(lambda x: min(x, 0.5)),
    k2=spread(1.0, 1e9),
    k3=spread(1e-6, 1e9),
    k4=spread(1e-6, 1e9),
    kz=spread(1e-6, 1e9),
    sigma_max=spread(1e-6, 5.0),
    c=spread(2e-6, 1e9),
    p11=spread(1e-3, 1.0),
)
PLANNERS = st.builds(
    PlannerGains,
    k1=spread(1e-6, 1e9),
    k2=spread(1.001, 1e9),
    k3=or_zero(1e9),
    kz1=spread(1e-6, 1e9),
    kz2=spread(1e-6, 1e9),
    p_max=spread(1e-6, 1e9),
    z_max=spread(1e-6, 4.5),
)
PATHS = st.sampled_from(
    (
        "circle",
        "lemniscate",
        {"path": "line", "velocity": [0.5, 0.1]},
        trajectories.random_smooth(),
        trajectories.hover(),
        trajectories.figure_eight(rate=0.4),
        trajectories.circle(radius=3.0, speed=-1.0).to_dict(),
    )
)

# Field of the configuration -> values that `nominal` may have for it.
FIELDS: dict[str, st.SearchStrategy[Any]] = {
    "offsets": st.sampled_from(
        (
            [[0.5, 0.0, 0.0]],
            formations.wedge(3),
            ((0.35, 0.35, -0.3), (0.35, -0.35, -0.3)),
            np.array([[1, 0, 0], [2, 0, 0], [3, 1, 0]], np.int8),
        )
    ),
    "trajectory": PATHS,
    "path": st.sampled_from(("drawn", "as given")),
    "action": st.sampled_from(("wrench", "rates", "reference")),
    "start": st.sampled_from(("formation", "ground")),
    "start_offset": st.just(0) | st.floats(0.0, 0.17),
    "leader_start": st.none() | st.just([0, 5, 0]) | st.just((0.0, -5.0, 0.0)),
    "follower_starts": st.none() | st.just([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]),
    "trigger": spread(1e-6, 1e4),
    "control_period": spread(1e-3, 10.0) | st.sampled_from((0.02, np.float32(0.05))),
    "substeps": st.integers(1, 1000) | st.just(np.int16(7)),
    "duration": spread(0.1, 1e6) | st.just(np.longdouble(20.0)) | st.just(5),
    "measurement_period": st.none() | st.sampled_from((0.02, 0.005, 0.04)),
    "measurement_delay": st.integers(0, 5) | st.just(np.uint8(2)),
    "estimator": st.sampled_from(("direct", "differenced")),
    "window": st.integers(1, 200),
    "noise": within(Noise),
    "gust": or_zero(100.0),
    "gust_time": spread(1e-300, 1e300),
    "vehicle": VEHICLES,
    "leader_actuation": st.sampled_from(("moment", "rates")),
    "reference_actuation": st.sampled_from(("moment", "rates")),
    "reference_max": st.tuples(spread(1e-6, 100.0), spread(1e-6, 100.0), spread(1e-6, 4.5)),
    "planner": PLANNERS,
    "tracker": TRACKERS,
    "rates_tracker": TRACKERS,
    "reward": within(Rewards),
    "limits": st.builds(
        Limits,
        collision=spread(1e-6, 0.15),
        impact=spread(1e-6, 1e4),
        tilt=st.floats(-1.0, 1.0),
        lost=spread(0.5, 1e4),
        deadline=spread(1e-6, 1e9),
    ),
    "neighbours": st.integers(0, 64),
}


def accepted(scenario: str, options: dict[str, Any]) -> FormationConfig:
    """The configuration; the draw is given up where it is refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FeasibilityWarning)
        warnings.simplefilter("ignore", FlightWarning)
        try:
            return configure(scenario, **options)
        except ValueError:
            reject()
