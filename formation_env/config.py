"""Everything a user may set, checked before anything flies.

`FormationConfig` is one immutable description of a task. Start from a scenario and override by
keyword: `configure("paper", action="rates", duration=60.0)`. Whatever is wrong raises `ValueError`
naming the field, its value and the paper's condition.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from math import ceil, exp, inf, isclose, sqrt
from typing import Any, final

import numpy as np

from formation_env import formations
from formation_env.checks import integer, number, require
from formation_env.feasibility import Feasibility, check, require_feasible
from formation_env.gains import RATES_GAINS, PlannerGains, TrackerGains
from formation_env.leader_path import require_flyable
from formation_env.quadrotor import GRAVITY, MOMENT, RATES
from formation_env.sensors import Noise
from formation_env.slots import out_of_frame
from formation_env.so3 import Vector
from formation_env.task import Layout, Limits, Rewards
from formation_env.trajectories import Trajectory, figure_eight, path_start
from formation_env.vehicle import Vehicle, vector3
from formation_env.world import RATE, REFERENCE, WRENCH, Clock, Gusts, Reach, World

LEVELS = {"wrench": WRENCH, "rates": RATE, "reference": REFERENCE}
ACTUATIONS = {"moment": MOMENT, "rates": RATES}
STARTS = ("formation", "ground")
MAX_FOLLOWERS = 4096

NO_NOISE = Noise(0.0, 0.0, 0.0, 0.0, 0.0)


def rows(name: str, value: Any) -> tuple[Vector, ...]:
    """`value` as rows of three finite numbers."""
    try:
        table = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {value!r}: expected rows of 3 numbers") from None
    if table.ndim != 2 or table.shape[1] != 3 or len(table) == 0 or not np.isfinite(table).all():
        raise ValueError(f"{name} = {value!r}: expected (followers, 3) finite numbers")
    return tuple((float(a), float(b), float(c)) for a, b, c in table)


@final
@dataclass(frozen=True)
class FormationConfig:
    """One task: who flies where, what is measured, what is commanded, what it is worth.

    Lengths in metres, times in seconds, angles in radians, inertial frame north-east-down. Made by
    `configure` (or `gym.make`'s keywords), which starts from a scenario. Raises `ValueError` naming
    the field where a value is impossible; warns with `FeasibilityWarning` where only the sufficient
    bound (29)-(30) against an inversion of a virtual follower fails.
    """

    scenario: str = "nominal"
    offsets: tuple[Vector, ...] = ((0.35, 0.35, -0.3), (0.35, -0.35, -0.3))  # d_i
    trajectory: Trajectory = field(default_factory=figure_eight)
    action: str = "wrench"
    start: str = "formation"
    start_offset: float = 0.2  # m, radius of the ball around the slot; start="formation"
    leader_start: Vector | None = None  # on the floor; None: under the first reference point
    follower_starts: tuple[Vector, ...] | None = None  # None: in rows behind the leader
    trigger: float = 0.25  # m, e_max of (40); start="ground"
    control_period: float = 0.02
    substeps: int = 4
    duration: float = 20.0
    measurement_period: float | None = None  # None: the control period
    measurement_delay: int = 0  # samples
    estimator: str = "direct"  # or "differenced", section IV
    window: int = 100  # samples in the acceleration's moving average
    noise: Noise = NO_NOISE
    gust: float = 0.0  # m/s^2, standard deviation of a random push on every vehicle
    gust_time: float = 1.0  # s, its correlation time
    vehicle: Vehicle = field(default_factory=Vehicle)
    leader_actuation: str = "moment"
    reference_actuation: str = "moment"  # what flies a follower at action="reference"
    reference_max: Vector = (4.0, 4.0, 4.0)  # m/s^2 at action +-1
    planner: PlannerGains = field(default_factory=PlannerGains)
    tracker: TrackerGains = field(default_factory=TrackerGains)  # vehicles driven by moments
    rates_tracker: TrackerGains = RATES_GAINS  # vehicles driven by rates
    reward: Rewards = Rewards(scale=0.3, effort=0.05, smoothness=0.05, failure=10.0)
    limits: Limits = Limits(collision=0.2, impact=1.0, tilt=0.5, lost=10.0)
    neighbours: int = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "offsets", rows("offsets", self.offsets))
        object.__setattr__(self, "reference_max", vector3("reference_max", self.reference_max, 0.0))
        self._check_choices()
        self._check_numbers()
        self._check_clock()
        self._check_formation()
        self._check_starts()
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
        require_flyable(
            self.trajectory,
            float(self.duration),
            self.offsets,
            self.leader_start,
            self.follower_starts,
            self.vehicle,
            ACTUATIONS[self.leader_actuation],
        )
        require_feasible(self.feasibility())

    # -- checks -----------------------------------------------------------------------------------

    def _check_choices(self) -> None:
        choices: tuple[tuple[str, Any], ...] = (
            ("action", LEVELS),
            ("start", STARTS),
            ("estimator", ("direct", "differenced")),
            ("leader_actuation", ACTUATIONS),
            ("reference_actuation", ACTUATIONS),
        )
        for name, allowed in choices:
            value = getattr(self, name)
            known = isinstance(value, str) and value in allowed
            require(known, name, value, "one of " + ", ".join(map(repr, allowed)))
        kinds = (
            ("trajectory", Trajectory),
            ("noise", Noise),
            ("vehicle", Vehicle),
            ("planner", PlannerGains),
            ("tracker", TrackerGains),
            ("rates_tracker", TrackerGains),
            ("reward", Rewards),
            ("limits", Limits),
        )
        for name, kind in kinds:
            value = getattr(self, name)
            require(isinstance(value, kind), name, value, f"a {kind.__name__}")

    def _check_numbers(self) -> None:
        for name in ("trigger", "control_period", "duration", "gust_time"):
            number(name, getattr(self, name), 0.0)
        for name in ("start_offset", "gust"):
            number(name, getattr(self, name), 0.0, strict=False)
        for group in ("noise", "reward"):
            values = getattr(self, group)
            for name in values._fields:
                strict = name == "scale"
                number(f"{group}.{name}", getattr(values, name), 0.0, strict=strict)
        for name in ("collision", "impact", "lost"):
            number(f"limits.{name}", getattr(self.limits, name), 0.0)
        number("limits.tilt", self.limits.tilt, -1.0, strict=False)
        integer("substeps", self.substeps, 1, 1000)
        integer("measurement_delay", self.measurement_delay, 0, 1000)
        integer("window", self.window, 1, 10000)
        integer("neighbours", self.neighbours, 0, 64)

    def _check_clock(self) -> None:
        substep = self.control_period / self.substeps
        if self.measurement_period is not None:
            number("measurement_period", self.measurement_period, 0.0)
            steps = self.measurement_period / substep
            require(
                round(steps) >= 1 and isclose(steps, round(steps), rel_tol=1e-6),
                "measurement_period",
                self.measurement_period,
                f"a whole number of substeps of control_period / substeps = {substep:g} s",
            )
        require(
            self.duration >= 0.999 * self.control_period,
            "duration",
            self.duration,
            f"at least one control_period = {self.control_period:g} s",
        )
        require(
            self.duration <= self.trajectory.duration * (1.0 + 1e-9),
            "duration",
            self.duration,
            f"at most the trajectory's {self.trajectory.duration:g} s",
        )

    def _check_formation(self) -> None:
        require(
            self.followers <= MAX_FOLLOWERS,
            "offsets",
            self.followers,
            f"<= {MAX_FOLLOWERS} followers",
        )
        for i, d in enumerate(self.offsets):
            require(
                d[0] > 0.0,
                f"offsets[{i}]",
                d,
                "d_x > 0: Gamma (14) needs d_x != 0, and with the heading started along the leader's "
                "the zero dynamics (26) are stable only for a leader ahead",
            )
            require(max(map(abs, d)) <= 1e3, f"offsets[{i}]", d, "components of at most 1000 m")
        gap = formations.min_separation(np.array(self.offsets))
        require(
            gap > self.limits.collision,
            "offsets",
            f"{gap:.3g} m apart",
            f"vehicles further apart than limits.collision = {self.limits.collision:g} m",
        )
        lowest = _lowest(self.trajectory, self.duration)
        for i, d in enumerate(self.offsets):
            require(
                lowest - d[2] < 0.0,
                f"offsets[{i}]",
                d,
                f"a slot above the floor: the leader comes down to p_z = {lowest:.3g} m "
                "and the slot's height is p_Lz - d_z (32)",
            )

    def _check_starts(self) -> None:
        if self.leader_start is not None:
            object.__setattr__(self, "leader_start", vector3("leader_start", self.leader_start))
        if self.follower_starts is not None:
            starts = rows("follower_starts", self.follower_starts)
            object.__setattr__(self, "follower_starts", starts)
            require(
                len(starts) == self.followers,
                "follower_starts",
                f"{len(starts)} rows",
                f"one row for each of the {self.followers} followers",
            )
        if self.start == "ground":
            points = np.array(self.ground_starts())
            require(
                bool((points[:, 2] == 0.0).all()),
                "follower_starts and leader_start",
                points[:, 2].tolist(),
                "p_z = 0, the floor",
            )
            gap = _least_distance(points)
            name = "follower_starts and leader_start"
        else:
            offsets, r = np.array(self.offsets), self.start_offset
            to_leader = float(np.linalg.norm(offsets, axis=1).min())
            gap = min(_least_distance(offsets) - 2.0 * r, to_leader - r)
            name = "start_offset"
        require(
            gap > self.limits.collision,
            name,
            self.start_offset if name == "start_offset" else f"{gap:.3g} m apart",
            f"vehicles that start further apart than limits.collision = {self.limits.collision:g} m",
        )

    # -- what follows from the fields ---------------------------------------------------------------

    @property
    def followers(self) -> int:
        """Number of followers."""
        return len(self.offsets)

    @property
    def action_size(self) -> int:
        """Entries of one follower's action: 4, or 3 at action level `reference`."""
        return 3 if self.action == "reference" else 4

    @property
    def max_steps(self) -> int:
        """Control ticks in an episode."""
        return max(1, round(self.duration / self.control_period))

    @cached_property
    def layout(self) -> Layout:
        """Names of the observation's entries."""
        return Layout(LEVELS[self.action], self.neighbours)

    @property
    def follower_actuation(self) -> int:
        """What a follower's body is turned by: MOMENT or RATES."""
        if self.action == "reference":
            return ACTUATIONS[self.reference_actuation]
        return RATES if self.action == "rates" else MOMENT

    def feasibility(self) -> tuple[Feasibility, ...]:
        """Report on (23)-(30) for every follower along the leader's trajectory."""
        return _feasibility(self.offsets, self.trajectory, float(self.duration))

    def ground_starts(self) -> tuple[Vector, ...]:
        """Where the leader and the followers stand at the start on the ground, leader first."""
        kind, table = self.trajectory.kind, self.trajectory.table
        R, p = path_start(kind, table)
        leader = self.leader_start or (p[0], p[1], 0.0)
        if self.follower_starts is not None:
            return (leader, *self.follower_starts)
        grid = formations.grid(self.followers, columns=ceil(sqrt(self.followers)), plane="xy")
        places = [out_of_frame(R, (-float(d[0]), -float(d[1]), 0.0)) for d in grid]
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
            Noise(*map(float, self.noise)),
            self._clock(),
            Reach(
                vehicle.full_thrust,
                vehicle.rate_max if rates else vehicle.moment_max,
                self.reference_max,
            ),
            self._gusts(),
            ACTUATIONS[self.leader_actuation],
            self.follower_actuation,
            LEVELS[self.action],
            float(self.trigger),
            int(self.start == "ground"),
            float(self.start_offset),
        )

    def _clock(self) -> Clock:
        period = self.control_period
        measured = period if self.measurement_period is None else self.measurement_period
        window = self.window if self.estimator == "differenced" else 0
        every = round(measured / (period / self.substeps))
        return Clock(period, int(self.substeps), every, int(self.measurement_delay), window)

    def _gusts(self) -> Gusts:
        keep = exp(-self.control_period / self.gust_time)
        return Gusts(keep, self.gust * sqrt(1.0 - keep * keep))


@lru_cache(maxsize=64)
def _feasibility(
    offsets: tuple[Vector, ...], trajectory: Trajectory, duration: float
) -> tuple[Feasibility, ...]:
    return check(np.array(offsets), trajectory, duration)


@lru_cache(maxsize=64)
def _lowest(trajectory: Trajectory, duration: float) -> float:
    """Largest `p_z` (lowest point) of the reference, m; the floor is 0."""
    if trajectory.random is not None:
        return -trajectory.random.height + trajectory.random.climb
    times = np.linspace(0.0, min(duration, trajectory.duration), 501)
    return float(trajectory(times)[:, 0, 2].max())


def _least_distance(points: Any) -> float:
    """Least distance between two of `points`, `(N, 3)`."""
    if len(points) < 2:
        return inf
    from scipy.spatial import cKDTree

    return float(cKDTree(points).query(points, k=2)[0][:, 1].min())
