"""What a scenario asks of the vehicles, and what makes it hard: a page of the board.

A policy is flown, and percentiles are taken of its tilt, thrust and turning and of the leader's motion over
the ticks that are scored, `metrics.window_ticks`: how the vehicles come together before is another matter,
and has a column of its own. What makes a scenario hard follows from its configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.base import Policy
from baselines.policies.transfer import transfer_unwarned
from baselines.reporting.cells import markdown_table
from baselines.scoring.evaluation import Flyable
from baselines.scoring.metrics import skipped_ticks
from baselines.scoring.results import Report
from baselines.scoring.rollout import fly
from baselines.system.progress import Bar
from formation_env import FormationConfig
from formation_env.core.simulation import Simulation
from formation_env.laws.levels import REFERENCE, numbered
from formation_env.physics.quadrotor import GRAVITY

Floats = NDArray[np.float64]

EPISODES = 20  # the first of an evaluation
PERCENTS = (1.0, 50.0, 99.0)


class Percentiles(NamedTuple):
    """What `PERCENTS` of the values do not exceed; NaN without any."""

    low: float
    median: float
    high: float


class Demands(NamedTuple):
    """Percentiles over the ticks that are scored, from the trigger (40) on, worlds, and followers where it
    says so."""

    tilt: Percentiles  # deg, of the followers: between thrust axis and vertical
    thrust: (
        Percentiles  # of the followers, over the weight: the specific force along the thrust axis
    )
    turn: Percentiles  # of the followers: the share of its limit on the body axis where that is largest
    leader_tilt: Percentiles  # deg
    speed: Percentiles  # m/s, of the leader
    acceleration: Percentiles  # m/s^2, of the leader
    start_tilt: (
        Percentiles  # deg, of the followers, from the trigger until the ticks that are scored
    )
    jump: Percentiles  # m, of the followers' slots on the tick on which the trigger fires


class Flown(NamedTuple):
    """The policy that has flown a scenario, and what that asked for."""

    policy: str
    demands: Demands


# -- measuring ------------------------------------------------------------------------------------


@final
class _Watch:
    """Gathers the motion of a rollout tick by tick; called as `rollout.fly` does."""

    def __init__(self, config: FormationConfig) -> None:
        self._config = config
        self._unscored = (skipped_ticks(config) + 0.5) * config.control_period  # s since the start
        self._before: tuple[Floats, Floats] | None = None  # velocities and thrust axes
        self._waiting: tuple[NDArray[np.bool_], Floats] | None = (
            None  # which worlds wait, and slots
        )
        self._gathered: dict[str, list[Floats]] = {name: [] for name in Demands._fields}

    def __call__(
        self, simulation: Simulation, stepped: NDArray[np.bool_], actions: NDArray[np.float32]
    ) -> None:
        v, axes = simulation.velocities, thrust_axes(simulation.attitudes)
        before, self._before = self._before, (v, axes)
        self._look_at_start(simulation, stepped)
        flown = stepped & (simulation.clock > 0.0)
        counted = flown & (simulation.clock > self._unscored)
        if before is None or not flown.any():
            return
        tilts = np.degrees(np.arctan2(np.hypot(axes[..., 0], axes[..., 1]), axes[..., 2]))
        if (before_window := flown & ~counted).any():
            self._gathered["start_tilt"].append(tilts[before_window, 1:].ravel())
        if not counted.any():
            return
        tilt = tilts[counted]
        a = (v - before[0])[counted] / self._config.control_period
        force = a - np.array([0.0, 0.0, GRAVITY])
        # Over the tick the thrust axis is about where it is half way.
        thrust = -(force * 0.5 * (axes + before[1])[counted]).sum(axis=-1) / GRAVITY
        tick = {
            "tilt": tilt[:, 1:],
            "thrust": thrust[:, 1:],
            "turn": self._turn(simulation, actions)[counted],
            "leader_tilt": tilt[:, 0],
            "speed": np.linalg.norm(v[counted, 0], axis=-1),
            "acceleration": np.linalg.norm(a[:, 0], axis=-1),
        }
        for name, values in tick.items():
            self._gathered[name].append(values.ravel())

    def _look_at_start(self, simulation: Simulation, stepped: NDArray[np.bool_]) -> None:
        """Note by how much slots jump as the trigger fires."""
        waits = ~simulation.started
        if self._waiting is None and not waits.any():
            return  # those that start in flight
        was, self._waiting = self._waiting, (waits, simulation.slots.copy())
        if was is not None and (fired := stepped & was[0] & ~waits).any():
            jumps = np.linalg.norm((self._waiting[1] - was[1])[fired], axis=-1)
            self._gathered["jump"].append(jumps.ravel())

    def _turn(self, simulation: Simulation, actions: NDArray[np.float32]) -> Floats:
        """The share of the limit of every follower, `(worlds, followers)`: see `ABOUT`."""
        if numbered(self._config.action) == REFERENCE:
            rates = simulation.angular_velocities[:, 1:] / np.array(self._config.vehicle.rate_max)
            return np.asarray(np.abs(rates).max(axis=-1))
        return np.asarray(np.minimum(np.abs(actions[..., 1:].astype(np.float64)), 1.0).max(axis=-1))

    def demands(self) -> Demands:
        return Demands(**{name: _percentiles(parts) for name, parts in self._gathered.items()})


def thrust_axes(attitudes: Floats) -> Floats:
    """The third body axis r3, inertial, of quaternions (w, x, y, z); `(..., 4)` to `(..., 3)`."""
    w, x, y, z = np.moveaxis(attitudes, -1, 0)
    return np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], -1)


def _percentiles(parts: list[Floats]) -> Percentiles:
    if not parts:
        return Percentiles(*(np.nan,) * 3)
    return Percentiles(*(float(x) for x in np.percentile(np.concatenate(parts), PERCENTS)))


def measure(policy: Policy, seeds: range, bar: Bar | None = None) -> Demands:
    """What flying its configuration asks of a policy, in one episode for each of the `seeds`."""
    watch = _Watch(policy.config)
    fly(policy, seeds, bar and bar.advance, watch=watch)
    return watch.demands()


def of_best(
    report: Report, flyable: Mapping[str, Flyable], quiet: bool = False
) -> dict[str, Flown]:
    """By scenario, what it asks of the policy with the highest score, of several training runs of the median
    one, in the first `EPISODES` of the report's episodes. `flyable` is what the report was flown with."""
    best = {name: s.best for name, s in report.scenarios.items() if s.results}
    seeds = range(report.seed, report.seed + min(EPISODES, report.episodes))
    ticks = sum(report.scenarios[name].config.max_steps * len(seeds) for name in best)
    bar, found = Bar(ticks, "flying the best", quiet), {}
    try:
        for name, row in best.items():
            scenario = report.scenarios[name]
            recipe = flyable[name].recipes[row][scenario.results[row].median]
            with transfer_unwarned():
                policy = recipe.make(scenario.config)
            found[name] = Flown(row, measure(policy, seeds, bar))
    finally:
        bar.close()
    return found


# -- the page -------------------------------------------------------------------------------------

ABOUT = (
    "Tilt, thrust and turning of the followers, and the leader's motion, flown by the policy with the "
    f"highest score: what {' / '.join(f'{p:g}' for p in PERCENTS)} % of the values do not exceed, over "
    f"followers, the ticks that are scored and the first {EPISODES} episodes; the tilt at the start, "
    "over the ticks from the start, or the trigger, until then. Thrust is the specific force along the "
    "thrust axis over gravity. Turning is a share of the limit, of the body axis where it is largest: of "
    "the moment that is commanded, at level `rates` of the angular velocity that is, at level "
    '`reference` of the angular velocity that the tracker brings about. Below, "up to" is '
    "the last of the three figures."
)
HEAD = (
    *("scenario", "policy", "tilt, deg", "thrust / weight", "turning / limit"),
    *("leader's speed, m/s", "acceleration, m/s^2", "tilt at the start, deg"),
)


def parts(report: Report, flown: Mapping[str, Flown]) -> list[str]:
    """The page's paragraphs: a table, and what makes a scenario hard, at all of its levels once."""
    named: dict[str, list[str]] = {}
    for name in flown:
        named.setdefault(causes(report.scenarios[name].config), []).append(name)
    told = [
        f"**{', '.join(names)}.** {text} {_motion(report.scenarios[names[0]].config, flown[names[0]])}"
        f"{_own_choices(report.scenarios[names[0]].config)}"
        for text, names in named.items()
    ]
    return [ABOUT, markdown_table(HEAD, [_row(*item) for item in flown.items()], 2), *told]


# What of a scenario the paper does not print.
_PATHS = "where a path lies and begins, the time limit"
_OURS = {
    "nominal": f"the gusts, the start in the air and its offset, {_PATHS}, and the limits of the actuators; "
    "trajectory (31), formation, vehicle and gains are those of III-C",
    "paper": "the rate at which the noise is drawn, the trigger's distance and deadline, "
    f"{_PATHS}, and the limits of the actuators; the rest is that of III-C",
    "experiment": "the reading of the path (70), the noise of the motion capture, the gusts, the trigger's "
    f"distance and deadline, {_PATHS}, inertia and limits of the vehicles, and their tracker; the rest is "
    "that of section IV, and [a page](../experiment.md) says what it comes to",
    "agile": "all but the formation, the vehicle and the gains, those of III-C",
    "swarm": "all but the vehicle and the gains, those of III-C",
}


def _own_choices(config: FormationConfig) -> str:
    found = _OURS.get(config.scenario)
    return f" Not from the paper: {found}." if found else ""


def _row(name: str, flown: Flown) -> list[str]:
    d = flown.demands
    cells = [
        _cell(d.tilt, 1), _cell(d.thrust, 3), _cell(d.turn, 3), _cell(d.speed, 2),
        _cell(d.acceleration, 2), _cell(d.start_tilt, 1),
    ]  # fmt: skip
    return [f"`{name}`", f"`{flown.policy}`", *cells]


def _cell(p: Percentiles, digits: int) -> str:
    return "-" if np.isnan(p.median) else " / ".join(f"{x:.{digits}f}" for x in p)


def causes(config: FormationConfig) -> str:
    """What makes a scenario hard by its configuration."""
    found = [_measured(config), *_gusts(config), *_start(config), *_crowd(config)]
    return f"{'; '.join(found)}."


def _measured(config: FormationConfig) -> str:
    """How the followers know of the leader and of themselves."""
    period = config.measurement_period or config.control_period
    if config.estimator == "differenced":
        text = (
            f"Only positions and attitudes are measured, at {1.0 / period:g} Hz against commands at "
            f"{1.0 / config.control_period:g} Hz: velocities are differences, the leader's acceleration is "
            f"a mean over {config.window} samples and so {0.5 * config.window * period:g} s late"
        )
    else:
        n = config.noise
        noise = {"m": n.position, "m/s": n.velocity, "m/s^2": n.acceleration}
        noise |= {"degrees": n.attitude * 180.0 / pi, "degrees/s": n.angular_velocity * 180.0 / pi}
        shown = ", ".join(f"{x:.3g} {unit}" for unit, x in noise.items() if x > 0.0)
        text = "Measurements are exact"
        if shown:
            text = f"Measurements have white noise of {shown}, drawn anew {1.0 / period:g} times a second"
    delay = config.measurement_delay * period
    return f"{text}, {delay:g} s late" if delay else text


def _gusts(config: FormationConfig) -> list[str]:
    what = (
        f"gusts of {config.gust:g} m/s^2 (standard deviation, correlated over {config.gust_time:g} s) push "
        "every vehicle"
    )
    return [what] if config.gust else []


def _start(config: FormationConfig) -> list[str]:
    if config.start != "ground":
        how = f"up to {config.start_offset:g} m from" if config.start_offset else "at"
        return [f"followers start {how} their places, in flight"]
    what = (
        f"all start on the floor and have {config.limits.deadline:g} s until every vehicle is within "
        f"{config.trigger:g} m of its place"
    )
    return [what]


def _crowd(config: FormationConfig) -> list[str]:
    d = np.array([(0.0, 0.0, 0.0), *config.offsets])
    apart = np.linalg.norm(d[:, None] - d, axis=-1)[~np.eye(len(d), dtype=bool)].min()
    what = (
        f"{len(d)} vehicles, whose places are down to {apart:.2f} m apart, fail together if two come within "
        f"{config.limits.collision:g} m"
    )
    return [what] if config.followers > 2 else []


def _motion(config: FormationConfig, flown: Flown) -> str:
    """How the leader moves, and what following it took."""
    d = flown.demands
    if np.isnan(d.speed.median):
        return "No flight got as far as what is scored."
    path = ", on another path in every episode," if config.trajectory.random is not None else ""
    jump = (
        ""
        if np.isnan(d.jump.median)
        else (
            f" As the formation starts places jump by {d.jump.median:.2f} m (median; 1 % by more than "
            f"{d.jump.high:.2f} m): from those beside the leader's first point to those beside the leader."
        )
    )
    return (
        f"The leader flies{path} at {d.speed.median:.2g} m/s and is accelerated by up to "
        f"{d.acceleration.high:.2g} m/s^2; `{flown.policy}` follows it with up to {d.tilt.high:.2g} "
        f"degrees of tilt and thrusts of {d.thrust.low:.2f} to {d.thrust.high:.2f} weights.{jump}"
    )
