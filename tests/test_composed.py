"""Policies of parts: the paper's two are the expert, and either can be exchanged."""

from __future__ import annotations

from typing import Any, final

import numpy as np
import pytest

from baselines.policies.cascade import Feedforward
from baselines.policies.composed import Composed
from baselines.policies.expert import Expert
from baselines.policies.lee import Lee
from baselines.policies.lqr import Lqr
from baselines.policies.paper_parts import PaperPlanner, PaperTracker
from baselines.policies.parts import Measured, Motion, Planner, Points, Tracker, measured
from baselines.scoring.rollout import fly
from formation_env import FormationConfig, configure
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.physics.quadrotor import GRAVITY, Wrench

LEVELS = ("wrench", "rates", "reference")


def started(config: FormationConfig, worlds: int) -> Simulation:
    simulation = Simulation(config, worlds)
    for i in range(worlds):
        simulation.seed(i, seeded_key(i))
    return simulation


@pytest.mark.parametrize("feedforward", ["zero", "derived"])
@pytest.mark.parametrize("scenario", ["nominal", "paper", "experiment"])
@pytest.mark.parametrize("level", LEVELS)
def test_with_both_of_the_papers_parts_it_is_the_expert(
    level: str, scenario: str, feedforward: str
) -> None:
    """To the last bit of float32 but one, over 13 s with the trigger in them, and one world begun again."""
    config = configure(scenario, action=level)
    expert = Expert(config, feedforward)
    both = Composed(config, PaperPlanner(config, feedforward), PaperTracker(config))
    simulation = started(config, 3)
    rows = simulation.reset().observations
    expert.reset(0, 3)
    both.reset(0, 3)
    exact = 0
    for tick in range(650):
        actions, others = expert.act(rows), both.act(rows)
        exact += np.array_equal(actions, others)
        assert others == pytest.approx(actions, abs=2e-7, rel=0.0), tick
        rows = simulation.step(actions).observations
        if tick == 600:
            rows = simulation.reset(np.array([False, True, False])).observations
            for policy in (expert, both):
                policy.restart(np.array([False, True, False]))
    assert exact > 600


# -- parts exchanged ------------------------------------------------------------------------------


@final
class Mine(Tracker):
    """A tracker of one's own: tilt and thrust for a wanted acceleration, about level flight."""

    def command(self, motion: Motion, point: Points) -> Wrench:
        a = point.a + 4.0 * (point.p - motion.p) + 4.0 * (point.v - motion.v)
        J = np.array(self.config.vehicle.inertia)
        up = np.array((0.0, 0.0, 1.0)) - a / GRAVITY  # where r3 is to point, about level
        tilt = np.cross(motion.R[..., :, 2], up)
        turn = J * (100.0 * (tilt[..., None, :] @ motion.R)[..., 0, :] - 20.0 * motion.w)
        return Wrench(self.config.vehicle.mass * (GRAVITY - a[..., 2]), turn)  # type: ignore[arg-type]


@final
class Still(Planner):
    """A planner of one's own: one metre above where each vehicle was first seen."""

    def begin(self, worlds: int) -> None:
        self.p = np.full((worlds, self.config.followers, 3), np.nan)

    def begin_again(self, mask: np.ndarray) -> None:
        self.p[mask] = np.nan

    def plan(self, m: Measured) -> Points:
        self.p = np.where(np.isnan(self.p), m.motion.p - np.array((0.0, 0.0, 1.0)), self.p)
        zero = np.zeros_like(self.p)
        return Points(self.p, zero, zero, zero, zero)


@pytest.mark.parametrize("tracker", [Feedforward, Lee, Lqr, Mine])
def test_the_papers_planner_over_another_tracker(tracker: Any) -> None:
    config = configure("nominal", gust=0.0)
    policy = Composed(config, PaperPlanner(config), tracker(config))
    columns = fly(policy, range(3))
    assert columns["failed"].max() == 0.0
    assert columns["slot_error_late"].max() < 0.03
    # The tracker matters: it is not the expert that flies.
    assert columns["return"] != pytest.approx(fly(Expert(config), range(3))["return"], abs=1e-6)


@pytest.mark.parametrize("level", LEVELS)
def test_ones_own_planner_over_the_papers_tracker(level: str) -> None:
    """Vehicles come to rest a metre above where they began, at every level; and again after a reset."""
    still = {"gust": 0.0, "limits": {"lost": 100.0}, "duration": 16.0}
    config = configure("nominal", action=level, **still)
    policy = Composed(config, Still(config), PaperTracker(config))
    simulation = started(config, 2)
    rows = simulation.reset().observations
    policy.reset(0, 2)
    for _ in range(2):
        first = measured(rows.copy(), config).motion.p
        for _ in range(750):
            rows = simulation.step(policy.act(rows)).observations
        now = measured(rows, config).motion
        assert now.p == pytest.approx(first - np.array((0.0, 0.0, 1.0)), abs=0.05)
        rows = simulation.reset().observations  # noticed without `restart`


def test_at_reference_the_planner_alone_matters() -> None:
    """Its trackers' default flies the environment's guide as the expert does."""
    config = configure("nominal", action="reference")
    policy = Composed(config, PaperPlanner(config), Mine(config))
    assert fly(policy, range(2))["return"] == pytest.approx(
        fly(Expert(config), range(2))["return"], rel=1e-7
    )


# -- what is refused ------------------------------------------------------------------------------


class Odd(Planner):
    """Gives what it is told to give."""

    def __init__(self, config: FormationConfig, change: Any) -> None:
        super().__init__(config)
        self._change = change

    def plan(self, m: Measured) -> Points:
        zero = np.zeros_like(m.motion.p)
        return Points(zero, zero, zero, zero, zero)._replace(**self._change(zero))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: {"v": a[..., :2]}, r"v of Odd.plan: shape \(1, 2, 2\): expected .* \(1, 2, 3\)"),
        (lambda a: {"a": 0.0}, r"a of Odd.plan: float: expected numbers of shape \(1, 2, 3\)"),
        (lambda a: {"s": a + np.nan}, "s of Odd.plan: expected finite numbers, not nan"),
    ],
)
def test_what_a_planner_cannot_give_is_named(change: Any, message: str) -> None:
    config = configure("nominal")
    policy = Composed(config, Odd(config, change), PaperTracker(config))
    with pytest.raises(ValueError, match=message):
        policy.act(started(config, 1).reset().observations)


def test_what_a_tracker_cannot_give_is_named() -> None:
    config = configure("nominal")

    class Bad(Tracker):
        def command(self, motion: Motion, point: Points) -> Wrench:
            return Wrench(np.ones(3), motion.w)  # type: ignore[arg-type]

    policy = Composed(config, PaperPlanner(config), Bad(config))
    with pytest.raises(ValueError, match=r"the thrust of Bad.command: shape \(3,\): expected"):
        policy.act(started(config, 1).reset().observations)


def test_parts_of_another_kind_or_configuration_are_refused() -> None:
    config, other = configure("nominal"), configure("paper")
    planner, tracker = PaperPlanner(config), PaperTracker(config)
    with pytest.raises(
        ValueError, match="planner is PaperTracker: expected a part of kind Planner"
    ):
        Composed(config, tracker, tracker)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="tracker was made for another configuration"):
        Composed(config, planner, PaperTracker(other))
    with pytest.raises(
        ValueError, match="estimator is PaperPlanner: expected a part of kind Estimator"
    ):
        Composed(config, planner, tracker, planner)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="feedforward = 'some'"):
        PaperPlanner(config, "some")
    with pytest.raises(ValueError, match="config = None: expected a FormationConfig"):
        PaperPlanner(None)  # type: ignore[arg-type]


def test_an_observation_that_cannot_be_planned_for_holds_the_vehicle() -> None:
    """A leader with `d_x = 0`: what the paper's planner divides by."""
    config = configure("nominal")
    m = measured(started(config, 1).reset().observations, config)
    planner = PaperPlanner(config)
    planner.begin(1)
    point = planner.plan(m._replace(offset=0.0 * m.offset))
    assert np.array_equal(point.p, m.motion.p) and not point.v.any()
