"""Everything a user may set, checked before anything flies.

`FormationConfig` is one immutable description of a task. Start from a scenario and override by
keyword: `configure("paper", action="rates", duration=60.0)`. Whatever is wrong raises `ValueError`
naming the field, its value and the paper's condition.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from math import ceil, inf
from typing import Annotated, Any, final

import numpy as np

from formation_env.configuration.bounds import check_clock, check_moments, check_rate_loop
from formation_env.configuration.leader_path import require_flyable
from formation_env.configuration.parts import part, rows
from formation_env.configuration.placement import (
    check_ground_starts,
    check_offsets,
    check_start_offset,
    ground_rows,
    judged,
)
from formation_env.laws import levels
from formation_env.laws.feasibility import Feasibility, FeasibilityWarning, check, require_feasible
from formation_env.laws.gains import RATES_GAINS, PlannerGains, TrackerGains
from formation_env.laws.slots import in_frame, out_of_frame
from formation_env.laws.world import Clock, Reach, World
from formation_env.maths.so3 import Vector
from formation_env.paths.course import Courses
from formation_env.physics import disturbances
from formation_env.physics.quadrotor import GRAVITY, MOMENT, RATES
from formation_env.physics.sensors import Noise
from formation_env.physics.vehicle import Vehicle, vector3
from formation_env.task import ANYWHERE, NEAR, RATE_BOUND, Layout, Limits, Rewards
from formation_env.trajectories import Trajectory, as_trajectory, figure_eight, path_start
from formation_env.validation.checks import Unit, choice, integer, number, refuse, require
from formation_env.validation.plain_form import plain

ACTUATIONS = {"moment": MOMENT, "rates": RATES}

NO_NOISE = Noise()

# Fields that are objects, with their defaults: what a dictionary of some of their fields leaves out.
PARTS: dict[str, Any] = {
    "noise": NO_NOISE,
    "vehicle": Vehicle(),
    "planner": PlannerGains(),
    "tracker": TrackerGains(),
    "rates_tracker": RATES_GAINS,
    "reward": Rewards(),
    "limits": Limits(),
}
CHOICES = {
    "action": levels.NAMES,
    "path": ("drawn", "as given"),
    "start": ("formation", "ground"),
    "estimator": ("direct", "differenced"),
    "leader_actuation": tuple(ACTUATIONS),
    "reference_actuation": tuple(ACTUATIONS),
}
# Low, high, and whether `low` itself is excluded.
NUMBERS = {
    "start_offset": (0.0, NEAR, False),
    "trigger": (0.0, ANYWHERE, True),
    "control_period": (0.0, 10.0, True),
    "duration": (0.0, inf, True),
    "gust": (0.0, RATE_BOUND, False),
    "gust_time": (0.0, inf, True),
}
COUNTS = {
    "substeps": (1, 1000),
    "measurement_delay": (0, 1000),
    "window": (1, 10000),
    "neighbours": (0, 64),
}


@final
@dataclass(frozen=True)
class FormationConfig:
    """One task: what flies where, what is measured, what is commanded, what it is worth.

    Lengths in metres, times in seconds, angles in radians, inertial frame north-east-down. Made by
    `configure` (or `gym.make`'s keywords), which starts from a scenario. Raises `ValueError` naming
    the field where a value is impossible; warns with `FeasibilityWarning` where only the sufficient
    bound (29)-(30) against an inversion of a virtual follower fails.

    `FormationConfig()` itself is none of the scenarios: it has no gusts, lasts 20 s, and its name is
    "custom", by which no gains and no policies are found; `configure()` is `nominal`.

    Every field also takes its JSON form (`to_dict`): lists, numbers, names and dictionaries. A
    dictionary may leave out fields of a part: `noise={"position": 0.1}` is the default with another
    position noise, and for `configure` the scenario's. What is stored is what was checked: plain
    `float` and `int`, tuples, and the parts as objects.
    """

    scenario: str = "custom"  # its name, by which gains and policies are looked up
    # m, d_i: where in its frame {F} a follower should see the leader
    offsets: tuple[Vector, ...] = ((0.35, 0.35, -0.3), (0.35, -0.35, -0.3))
    trajectory: Trajectory = field(default_factory=figure_eight)  # the leader's path
    path: str = "drawn"  # turned, mirrored and begun elsewhere in every episode; or "as given"
    action: str = "wrench"  # what a follower commands; or "rates", "reference"
    start: str = "formation"  # near the slots, in flight; or "ground"
    # Radius of the ball around the slot; start="formation".
    start_offset: Annotated[float, Unit("m")] = 0.15
    leader_start: Vector | None = None  # on the floor; None: under the first reference point
    follower_starts: tuple[Vector, ...] | None = None  # None: in rows behind the leader
    trigger: Annotated[float, Unit("m")] = 0.25  # e_max of (40); start="ground"
    control_period: Annotated[float, Unit("s")] = 0.02  # a tick
    substeps: int = 4  # of the integrator in a tick
    duration: Annotated[float, Unit("s")] = 20.0  # after which an episode is truncated
    measurement_period: Annotated[float | None, Unit("s")] = None  # None: the control period
    # By which all that is measured is late.
    measurement_delay: Annotated[int, Unit("samples")] = 0
    estimator: str = "direct"  # all is measured; or "differenced", section IV
    window: Annotated[int, Unit("samples")] = 100  # of the acceleration's moving average
    noise: Noise = NO_NOISE  # white, on what is measured
    # Standard deviation of a random push on every vehicle.
    gust: Annotated[float, Unit("m/s^2")] = 0.0
    gust_time: Annotated[float, Unit("s")] = 1.0  # its correlation time
    vehicle: Vehicle = PARTS["vehicle"]  # leader and followers
    leader_actuation: str = "moment"  # what flies the leader; or "rates"
    reference_actuation: str = "moment"  # what flies a follower at action="reference"
    reference_max: Annotated[Vector, Unit("m/s^2")] = (4.0, 4.0, 4.0)  # at action +-1
    planner: PlannerGains = PARTS["planner"]  # of the expert
    tracker: TrackerGains = PARTS["tracker"]  # vehicles driven by moments
    rates_tracker: TrackerGains = RATES_GAINS  # vehicles driven by rates
    reward: Rewards = PARTS["reward"]  # weights of its terms
    limits: Limits = PARTS["limits"]  # where an episode fails
    neighbours: int = 2  # how many other followers each observes, nearest first

    def __post_init__(self) -> None:
        self._convert()
        self._check_dynamics()
        self._check_places()
        require_flyable(
            self.trajectory,
            self.span,
            self.offsets,
            self.neighbours,
            self.leader_start,
            self.follower_starts,
            self.vehicle,
            ACTUATIONS[self.leader_actuation],
        )
        require_feasible(self.feasibility())

    def _store(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _convert(self) -> None:
        """Every field as what it is to be, or refused by itself."""
        require(isinstance(self.scenario, str), "scenario", self.scenario, "a name")
        self._store("trajectory", as_trajectory("trajectory", self.trajectory))
        self._store("offsets", rows("offsets", self.offsets, NEAR))
        limit = vector3("reference_max", self.reference_max, 0.0, RATE_BOUND)
        self._store("reference_max", limit)
        for name, names in CHOICES.items():
            self._store(name, choice(name, getattr(self, name), names))
        for name, (low, high, strict) in NUMBERS.items():
            self._store(name, number(name, getattr(self, name), low, high, strict=strict))
        for name, (least, most) in COUNTS.items():
            self._store(name, integer(name, getattr(self, name), least, most))
        for name, default in PARTS.items():
            self._store(name, part(name, getattr(self, name), default))
        if self.measurement_period is not None:
            period = number("measurement_period", self.measurement_period, 0.0)
            self._store("measurement_period", period)
        if self.leader_start is not None:
            start = vector3("leader_start", self.leader_start)
            self._store("leader_start", start)
        if self.follower_starts is not None:
            starts = rows("follower_starts", self.follower_starts)
            self._store("follower_starts", starts)

    # -- checks -----------------------------------------------------------------------------------

    def _check_dynamics(self) -> None:
        """The clock, what a substep can follow of the vehicles, and the bound (53)."""
        period, substep = self.control_period, self.control_period / self.substeps
        check_clock(period, self.substeps, self.measurement_period, self.duration)
        require(
            self.duration <= self.trajectory.duration * (1.0 + 1e-9),
            "duration",
            self.duration,
            f"at most the trajectory's {self.trajectory.duration:g} s",
        )
        turned_by = {self.follower_actuation, ACTUATIONS[self.leader_actuation]}
        if RATES in turned_by:
            check_rate_loop(self.vehicle, substep)
        if MOMENT in turned_by:
            check_moments(self.vehicle, period, substep)
        bound = GRAVITY - max(self.planner.z_max, self.reference_max[2])
        for name in ("tracker", "rates_tracker"):
            sigma_max = getattr(self, name).sigma_max
            require(
                sigma_max < bound,
                f"{name}.sigma_max",
                sigma_max,
                f"sigma_max < g - z_max = {bound:g} m/s^2 (53), so that the desired thrust never "
                "vanishes",
            )

    def _check_places(self) -> None:
        """The formation and the starts."""
        collision = self.limits.collision
        check_offsets(self.offsets, self.trajectory, self.span, collision)
        if self.follower_starts is not None:
            require(
                len(self.follower_starts) == self.followers,
                "follower_starts",
                f"{len(self.follower_starts)} rows",
                f"one row for each of the {self.followers} followers",
            )
        if self.start == "ground":
            check_ground_starts(self.ground_starts(), collision)
        else:
            check_start_offset(self.offsets, self.start_offset, collision)

    # -- as JSON ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """All fields in their JSON form (`plain_form`), for `json.dumps` and `from_dict`."""
        return {f.name: plain(getattr(self, f.name), f.name) for f in fields(self)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> FormationConfig:
        """The configuration of a dictionary as `to_dict` gives it; equal to the one it was made of.

        As in `FormationConfig(**data)` a field that is missing has its default; for the values of a
        scenario give the dictionary to `configure`. Raises `ValueError` naming an unknown field, or
        one whose value is impossible; warns only where a virtual follower really inverts.
        """
        known = [f.name for f in fields(cls)]
        require(isinstance(data, Mapping), "data", data, "a dictionary of a configuration's fields")
        for name in data:
            if name not in known:
                refuse(f"data[{name!r}]", data[name], f"only fields: {', '.join(known)}")
        config = quietly(cls, **data)
        require_feasible(report for report in config.feasibility() if report.inverts)
        return config

    # -- what follows from the fields ---------------------------------------------------------------

    @property
    def followers(self) -> int:
        """Number of followers."""
        return len(self.offsets)

    @property
    def action_size(self) -> int:
        """Entries of one follower's action: 4, or 3 at action level `reference`."""
        return self.level.size

    @property
    def level(self) -> levels.Level:
        """The row of `levels.LEVELS` that `action` names."""
        return levels.LEVELS[levels.numbered(self.action)]

    @property
    def max_steps(self) -> int:
        """Control ticks in an episode."""
        return max(1, round(self.duration / self.control_period))

    @property
    def deadline_steps(self) -> int:
        """Control ticks within which the trigger (40) has to fire."""
        return ceil(self.limits.deadline / self.control_period - 1e-9)

    @cached_property
    def layout(self) -> Layout:
        """Names of the observation's entries."""
        return Layout(levels.numbered(self.action), self.neighbours)

    @property
    def follower_actuation(self) -> int:
        """What a follower's body is turned by: MOMENT or RATES."""
        own = self.level.actuation
        return ACTUATIONS[self.reference_actuation] if own is None else own

    def feasibility(self) -> tuple[Feasibility, ...]:
        """Report on (23)-(30) for every follower along the leader's trajectory, wherever episodes begin."""
        return self._feasibility_of(self.offsets)

    def _feasibility_of(self, offsets: tuple[Vector, ...]) -> tuple[Feasibility, ...]:
        starts = self.phases * self.control_period
        flown = judged(self.trajectory, self.duration)
        return _feasibility(offsets, self.trajectory, starts + flown, starts)

    @property
    def phases(self) -> int:
        """Ticks of the leader's path, one of which an episode begins at; 0: always at its first."""
        period = self.trajectory.period
        return (
            0 if self.path == "as given" or period == inf else round(period / self.control_period)
        )

    @property
    def span(self) -> float:
        """Seconds of the leader's path of which an episode flies a part."""
        return self.duration + self.phases * self.control_period

    def _courses(self) -> Courses:
        """How the paths of episodes lie.

        On the mirror image a formation flies as its own image on the path. It is drawn only where none
        inverts there; the path as it is given in any case, since of an inversion there the user was warned.
        """
        if self.path == "as given":
            return Courses(0, 0, 0)
        own = dict(zip(self.offsets, self.feasibility(), strict=True))
        image = [(x, -y, z) for x, y, z in self.offsets]
        reports = [own[d] for d in image if d in own]
        if len(reports) < len(image):
            reports += self._feasibility_of(tuple(d for d in image if d not in own))
        return Courses(1, int(not any(report.inverts for report in reports)), self.phases)

    def ground_places(self) -> tuple[Vector, ...]:
        """`ground_starts`, or where the path is drawn the same relative to its first point and direction."""
        starts = self.ground_starts()
        if self.path == "as given":
            return starts
        R, p = path_start(self.trajectory.kind, self.trajectory.table)
        return tuple(in_frame(R, (x - p[0], y - p[1], z)) for x, y, z in starts)

    def ground_starts(self) -> tuple[Vector, ...]:
        """Where the leader and the followers stand at the start on the ground, leader first.

        Inertial, m; for a path that is as it is given.
        """
        kind, table = self.trajectory.kind, self.trajectory.table
        R, p = path_start(kind, table)
        leader = self.leader_start or (p[0], p[1], 0.0)
        if self.follower_starts is not None:
            return (leader, *self.follower_starts)
        places = [out_of_frame(R, (-x, -y, 0.0)) for x, y in ground_rows(self.offsets).tolist()]
        return (leader, *((leader[0] + x, leader[1] + y, 0.0) for x, y, _ in places))

    @cached_property
    def world(self) -> World:
        """The constants of an episode as the kernels take them."""
        vehicle = self.vehicle
        rates = self.follower_actuation == RATES
        return World(
            vehicle.airframe(),
            self.tracker.law(),
            self.rates_tracker.law(),
            self.noise,
            self._clock(),
            Reach(
                vehicle.full_thrust,
                vehicle.rate_max if rates else vehicle.moment_max,
                self.reference_max,
            ),
            disturbances.parameters(self),
            ACTUATIONS[self.leader_actuation],
            self.follower_actuation,
            levels.numbered(self.action),
            self.trigger,
            int(self.start == "ground"),
            self.start_offset,
            self._courses(),
        )

    def _clock(self) -> Clock:
        period = self.control_period
        measured = period if self.measurement_period is None else self.measurement_period
        window = self.window if self.estimator == "differenced" else 0
        every = round(measured / (period / self.substeps))
        return Clock(period, self.substeps, every, self.measurement_delay, window)


def quietly(
    make: Callable[..., FormationConfig],
    *args: Any,
    silent: tuple[type[Warning], ...] = (FeasibilityWarning,),
    **given: Any,
) -> FormationConfig:
    """What `make` makes, without warnings of some kinds: that only the bound (29)-(30) fails."""
    with warnings.catch_warnings():
        for kind in silent:
            warnings.simplefilter("ignore", kind)
        return make(*args, **given)


@lru_cache(maxsize=64)
def _feasibility(
    offsets: tuple[Vector, ...], trajectory: Trajectory, duration: float, starts: float
) -> tuple[Feasibility, ...]:
    return check(np.array(offsets), trajectory, duration, starts)
