"""Named tasks: where a configuration starts from.

| name | what it is |
|---|---|
| `nominal` | trajectory (31), start near the formation, slight gusts, no noise |
| `paper` | section III-C: start on the ground, trigger, white noise |
| `experiment` | section IV: 78 g, thrust and rates, 50 Hz measurements, 44 Hz commands, estimates |
| `agile` | the leader on random smooth trajectories of up to 4.2 m/s, a new one each episode |
| `swarm` | 16 followers in a wedge on a figure eight at up to 8.5 m/s |

Where and in which direction the leader's path lies is drawn in every episode, and which of its points comes
first; `path="as given"` is the paper's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from math import ceil, radians, sqrt
from typing import Any

import numpy as np

from formation_env import formations
from formation_env.config import PARTS, FormationConfig, quietly
from formation_env.configuration.leader_path import FlightWarning
from formation_env.configuration.parts import part, rows
from formation_env.laws.feasibility import FeasibilityWarning, require_feasible
from formation_env.laws.gains import PlannerGains
from formation_env.maths.so3 import Vector
from formation_env.physics.sensors import Noise
from formation_env.physics.vehicle import Vehicle
from formation_env.task import NEAR
from formation_env.trajectories import figure_eight, lemniscate, random_smooth
from formation_env.validation.checks import integer, refuse, require, unexpected_keyword

# III-C's levels. The sampling time of the white noise is not stated; at 50 Hz, the rate of the
# paper's motion capture, its steady-state claims hold.
PAPER_NOISE = Noise(
    position=0.2,
    velocity=0.1,
    acceleration=0.01,
    attitude=radians(0.02),
    angular_velocity=radians(0.02),
)


def _rows(offsets: Any) -> tuple[Vector, ...]:
    return rows("offsets", offsets, NEAR)


def nominal(followers: int = 2) -> FormationConfig:
    """Trajectory (31), III-C's pair (or a stack of pairs), start near the formation, no noise.

    A loop of (31) takes 25.1 s, which an episode covers. The gusts make the paper's gains lose some 10 cm,
    so that the formation has to be kept, not only reached.
    """
    return FormationConfig(
        scenario="nominal",
        offsets=_rows(formations.stack(followers)),
        gust=0.04,
        gust_time=0.5,
        duration=30.0,
    )


def paper(followers: int = 2) -> FormationConfig:
    """Section III-C: all at rest on the floor, the leader waits for the trigger (40), white noise."""
    pair = ((-0.5, -1.0, 0.0), (-2.0, 1.0, 0.0))
    return FormationConfig(
        scenario="paper",
        offsets=_rows(formations.stack(followers)),
        start="ground",
        leader_start=(0.0, 0.0, 0.0) if followers == 2 else None,
        follower_starts=pair if followers == 2 else None,
        noise=PAPER_NOISE,
        duration=45.0,
    )


def experiment(followers: int = 2) -> FormationConfig:
    """Section IV as far as it can be simulated.

    Commands leave at 44 Hz, positions and attitudes arrive at 50 Hz: 25 and 22 substeps of 1/1100 s, so
    the two clocks beat as they did. Assumed, since not printed: 0.1 mm and 0.05 degrees of noise from
    the motion capture, and gusts of 0.05 m/s^2 for the disturbances of a real flight.
    """
    pair = ((-0.57, -0.37, 0.0), (-1.26, -0.77, 0.0))
    return FormationConfig(
        scenario="experiment",
        offsets=_rows(formations.stack(followers)),
        trajectory=lemniscate(),
        action="rates",
        start="ground",
        leader_start=(-1.0, 0.48, 0.0) if followers == 2 else None,
        follower_starts=pair if followers == 2 else None,
        control_period=1.0 / 44.0,
        substeps=25,
        measurement_period=1.0 / 50.0,
        estimator="differenced",
        window=100,
        noise=Noise(1e-4, 0.0, 0.0, radians(0.05), 0.0),
        gust=0.05,
        gust_time=0.3,
        vehicle=Vehicle(mass=0.078),
        leader_actuation="rates",
        reference_actuation="rates",
        planner=PlannerGains(k1=0.3, k2=1.1, k3=0.17, kz1=0.2, kz2=1.0, p_max=5.0),
        duration=45.0,
    )


def agile(followers: int = 2) -> FormationConfig:
    """The leader on random smooth trajectories of up to 4.2 m/s, a new one each episode."""
    return FormationConfig(
        scenario="agile",
        offsets=_rows(formations.stack(followers)),
        trajectory=random_smooth(speed=3.0, variation=1.2, acceleration=2.0),
        duration=30.0,
    )


def swarm(followers: int = 16) -> FormationConfig:
    """A wedge behind the leader, on a figure eight wide enough that no virtual follower inverts.

    Its turns are flown at the same acceleration whatever its size, for 16 followers at up to 8.5 m/s:
    vehicles tilt by 10 degrees half of the time. An episode covers the path.
    """
    offsets = formations.wedge(followers, half_angle=radians(30.0))
    # No follower inverts while the planar |d| is below the radius of the leader's tightest turn, which
    # is (29)-(30) solved for it; (31) turns with 2.4 1/m at a size of (2, 1) m.
    reach = float(np.linalg.norm(offsets[:, :2], axis=1).max())
    size = max(1.0, 1.1 * 2.4 * reach)
    path = figure_eight(amplitude=(2.0 * size, size), rate=0.78 / sqrt(size))
    return FormationConfig(
        scenario="swarm",
        offsets=_rows(offsets),
        trajectory=path,
        duration=float(ceil(path.period)),
    )


SCENARIOS: dict[str, Callable[..., FormationConfig]] = {
    maker.__name__: maker for maker in (nominal, paper, experiment, agile, swarm)
}


FIELDS = tuple(f.name for f in fields(FormationConfig) if f.name != "scenario")


def configure(
    scenario: str | FormationConfig | Mapping[str, Any] = "nominal",
    *,
    followers: int | None = None,
    **overrides: Any,
) -> FormationConfig:
    """A scenario with some of its fields overridden.

    `scenario` is a name, or a `FormationConfig` to start from; `followers` re-forms a named scenario
    with that many; every other keyword is a field of `FormationConfig`, as it is or in its JSON form.
    A dictionary given for a part changes only what it names: `configure("paper", noise={"position":
    0.1})` keeps the scenario's other noise.

    `scenario` may also be a dictionary of fields, such as `FormationConfig.to_dict` gives. What it
    leaves out comes from the scenario that it names (`nominal` if none): `{"scenario": "paper",
    "vehicle": {"mass": 0.2}}` is `configure("paper", vehicle={"mass": 0.2})`.

    Raises `ValueError` for an unknown scenario or an impossible value, `TypeError` for an unknown keyword.

    A named scenario's own formation and trajectory warn only where a virtual follower really inverts:
    III-C's own pair fails the sufficient bound (29)-(30) on (31) and never does. So does a dictionary of
    a whole configuration, which has warned when it was made.
    """
    for name in overrides:
        if name not in FIELDS:
            raise unexpected_keyword("configure", name, ("scenario", "followers", *FIELDS))
    if isinstance(scenario, Mapping):
        if not {"scenario", *FIELDS} <= set(scenario):
            return _completed(scenario, followers, overrides)
        scenario = quietly(FormationConfig.from_dict, scenario)
    if isinstance(scenario, FormationConfig):
        if followers is not None:
            refuse("followers", followers, "none: give `offsets` to change a configuration")
        overrides = _merged(scenario, overrides)
        if {"offsets", "trajectory"} & set(overrides):
            return replace(scenario, **overrides)
        silent: tuple[type[Warning], ...] = (FeasibilityWarning, FlightWarning)
        if {"duration", "vehicle", "leader_actuation"} & set(overrides):
            silent = (FeasibilityWarning,)
        # Nothing of what it warned of when it was made has changed.
        return quietly(replace, scenario, silent=silent, **overrides)
    named = isinstance(scenario, str) and scenario in SCENARIOS
    require(named, "scenario", scenario, "one of " + ", ".join(map(repr, SCENARIOS)))
    return _named(scenario, followers, overrides)


def _named(scenario: str, followers: int | None, overrides: dict[str, Any]) -> FormationConfig:
    """A named scenario with some of its fields overridden."""
    arguments = []
    if followers is not None:
        arguments.append(integer("followers", followers, 1, formations.MAX_FOLLOWERS))
        if "offsets" in overrides:
            raise ValueError("followers and offsets given: expected one of them")
    if "offsets" in overrides:  # the scenario's own starts belong to its own formation
        overrides = {"follower_starts": None, "leader_start": None, **overrides}
    base = quietly(SCENARIOS[scenario], *arguments)
    overrides = _merged(base, overrides)
    if {"offsets", "trajectory"} & set(overrides):
        return replace(base, **overrides)
    return _certain(quietly(replace, base, **overrides))


def _completed(
    data: Mapping[str, Any], followers: int | None, overrides: dict[str, Any]
) -> FormationConfig:
    """The scenario that a dictionary names, with the dictionary's fields and then the overrides."""
    given = {"scenario": "nominal", "followers": followers, **data}
    for name in data:
        if name not in ("scenario", "followers", *FIELDS):
            refuse(f"scenario[{name!r}]", data[name], f"only fields: {', '.join(FIELDS)}")
    for name, value in overrides.items():
        both = name in PARTS and isinstance(value, Mapping) and isinstance(data.get(name), Mapping)
        given[name] = {**data[name], **value} if both else value
    return configure(**given)


def _merged(base: FormationConfig, overrides: dict[str, Any]) -> dict[str, Any]:
    """The overrides, with what a dictionary for a part leaves out as `base` has it."""
    return {
        name: part(name, value, getattr(base, name)) if name in PARTS else value
        for name, value in overrides.items()
    }


def _certain(config: FormationConfig) -> FormationConfig:
    """`config`, with a warning where a virtual follower really inverts."""
    require_feasible(report for report in config.feasibility() if report.inverts)
    return config
