"""Tasks under changes: what is changed, what policies are told, void cells, and the means of a board."""

from __future__ import annotations

import warnings
from math import hypot, isnan

import numpy as np
import pytest

from baselines import make_policy
from baselines.policies.gain_files import UntunedWarning
from baselines.policies.simple import Hover
from baselines.reporting import robustness as page
from baselines.scoring import robustness
from baselines.scoring.changes import CHANGES, Change, changed
from baselines.scoring.evaluation import evaluate, find_flyable
from baselines.scoring.robustness import LEADER, Cell, Robustness, fly_changes, leader_starts
from baselines.scoring.rollout import fly
from formation_env import SCENARIOS, FormationConfig, configure
from formation_env.trajectories import circle

BY_NAME = {change.name: change for change in CHANGES}
LATE, NOISE, MASS, WIDE, MORE, LONG, OFF = BY_NAME


# -- the table ------------------------------------------------------------------------------------


def different(a: FormationConfig, b: FormationConfig) -> set[str]:
    return {name for name in a.__dataclass_fields__ if getattr(a, name) != getattr(b, name)}


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_change_changes_what_it_says_and_nothing_else(scenario: str) -> None:
    """And without a warning: those are errors here."""
    config = configure(scenario)
    fields = {
        LATE: {"measurement_delay"},
        NOISE: {"noise"},
        MASS: {"vehicle"},
        WIDE: {"offsets"},
        MORE: {"offsets", "follower_starts", "leader_start"},
        LONG: {"duration"},
        OFF: {"offsets", "start_offset"},
    }
    impossible = {("experiment", WIDE), ("experiment", OFF), ("paper", OFF)}
    for change in CHANGES:
        if (scenario, change.name) in impossible:
            continue
        assert different(config, changed(config, change)) <= fields[change.name], change.name
    assert [c.name for c in CHANGES if c.told] == [WIDE, MORE, LONG, OFF]


def test_how_much_it_changes() -> None:
    config = configure("paper", measurement_delay=2)
    assert changed(config, BY_NAME[LATE]).measurement_delay == 3
    noise = changed(config, BY_NAME[NOISE]).noise
    assert noise.position == hypot(0.2, 0.002) and noise.angular_velocity > 0.01
    assert changed(configure("nominal"), BY_NAME[NOISE]).noise.velocity == 0.005
    assert changed(config, BY_NAME[WIDE]).offsets[0] == pytest.approx((0.42, 0.42, -0.36))
    assert changed(config, BY_NAME[MORE]).followers == 3
    assert changed(config, BY_NAME[LONG]).duration == 2.0 * config.duration
    off = changed(configure("nominal"), BY_NAME[OFF])
    assert (off.offsets, off.start_offset) == (((0.35, 0.35, 1.5),), 0.5)


def test_a_heavier_vehicle_falls_where_the_nominal_one_hovers() -> None:
    """Action 0 gives the weight of the nominal vehicle: by 10 % more mass it falls with g / 11."""
    config = configure("nominal", gust=0.0, start_offset=0.0, duration=1.0)
    heavy = changed(config, BY_NAME[MASS])
    assert heavy.vehicle.mass == pytest.approx(1.1 * config.vehicle.mass)
    heights = []
    for world in (config, heavy):
        seen: list[float] = []
        fly(
            Hover(config),
            range(1),
            watch=lambda simulation, *_: seen.append(simulation.velocities[0, 1, 2]),  # noqa: B023
            world=world,
        )
        heights.append(seen[-1] - seen[0])
    ticks = len(seen) - 1
    assert heights[1] - heights[0] == pytest.approx(9.81 / 11.0 * ticks * 0.02, rel=0.02)


def test_a_world_that_a_policy_is_not_told_of_is_what_is_scored() -> None:
    """Hovering reads no configuration, so it is told all; a filter for exact sensors does not filter, as `ff`
    never does."""
    config = configure("nominal", duration=1.0)
    world = configure(config, noise={"position": 0.1}, duration=2.0, gust=0.0)

    def score(name: str, told: FormationConfig) -> float:
        return float(fly(make_policy(name, told), range(3), world=world)["score"].mean())

    assert score("hover", config) == score("hover", world)
    assert score("ff-filter", config) == pytest.approx(score("ff", config), abs=1e-6)
    assert abs(score("ff-filter", world) - score("ff", world)) > 5e-4


@pytest.mark.parametrize(
    ("config", "change", "reason"),
    [
        (configure("experiment"), WIDE, "backwards"),
        (configure("paper"), OFF, "all start on the floor"),
        (configure("nominal", offsets=((0.4, 0.0, -0.4),)), MORE, "formation"),
        (configure("nominal", trajectory=circle(3.0), duration=5.0), LATE, ""),
    ],
)
def test_what_cannot_be_says_why(config: FormationConfig, change: str, reason: str) -> None:
    if not reason:
        assert changed(config, BY_NAME[change]).measurement_delay == 1
        return
    with pytest.raises(ValueError, match=reason):
        changed(config, BY_NAME[change])


# -- what is flown --------------------------------------------------------------------------------


def test_a_leader_that_cannot_get_up_is_found() -> None:
    """On the experiment's measurements a sample later its tracker oscillates a hand above the floor."""
    config = configure("experiment")
    assert leader_starts(config, range(4))
    assert not leader_starts(changed(config, BY_NAME[LATE]), range(4))
    assert leader_starts(changed(configure("paper"), BY_NAME[LATE]), range(4))
    assert leader_starts(changed(configure("nominal"), BY_NAME[LATE]), range(4)), "in flight"


def test_the_leader_has_the_ticks_of_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    """A deadline of 2.5 ticks is over after the third, as in the task."""
    most = []
    monkeypatch.setattr(robustness, "fly", lambda *_, **options: most.append(options["most"]))
    config = configure("paper", limits={"deadline": 0.05})
    assert not leader_starts(config, range(1))
    assert most == [config.deadline_steps] == [3]


def test_gains_that_win_near_the_slot_cannot_come_back_from_half_a_metre() -> None:
    """Which only this change shows: `lee-tuned` fails from where `ff` never does."""
    config = changed(configure("nominal", duration=12.0), BY_NAME[OFF])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UntunedWarning)
        failed = {
            name: fly(make_policy(name, config), range(8))["failed"].mean()
            for name in ("ff", "lee-tuned")
        }
    assert failed["ff"] == 0.0 < failed["lee-tuned"]


class Told:
    """A policy of a user that takes two followers only, and stands still."""

    def __init__(self, config: FormationConfig) -> None:
        if config.followers != 2:
            raise ValueError(f"{config.followers} followers: expected 2")
        self._size = config.followers, config.action_size

    def reset(self, seed: int) -> None:
        pass

    def act(self, observation: np.ndarray) -> np.ndarray:
        return np.zeros(self._size, dtype=np.float32)


@pytest.fixture(scope="module")
def flown() -> Robustness:
    configs = {
        "nominal": configure("nominal", duration=1.0),
        "nominal:rates": configure("nominal", action="rates", duration=1.0),
        "experiment": configure("experiment", duration=17.0),
    }
    policies = {"ff": "ff", "hover": "hover", "mine": Told}
    flyable = find_flyable(configs, policies)
    report = evaluate(configs, policies, episodes=3, seed=5, flyable=flyable)
    chosen = [BY_NAME[name] for name in (LATE, WIDE, MORE)]
    return fly_changes(report, flyable, changes=chosen)


def test_every_cell_is_the_flight_that_it_names(flown: Robustness) -> None:
    """Untold: a policy for the task as it is in another world; told: one for the changed task."""
    config = configure("nominal", duration=1.0)
    late, wide = (changed(config, BY_NAME[name]) for name in (LATE, WIDE))
    expected = {
        LATE: fly(make_policy("ff", config), range(5, 8), world=late),
        WIDE: fly(make_policy("ff", wide), range(5, 8)),
    }
    for name, columns in expected.items():
        cell = flown.cells["ff", "nominal", name]
        assert cell == Cell(columns["score"].mean(), columns["failed"].mean())
    plain = fly(make_policy("ff", config), range(5, 8))
    assert flown.plain["ff", "nominal"].score == plain["score"].mean()
    assert flown.seeds == range(5, 8)


def test_only_tasks_at_their_own_level_and_laws_are_tried(flown: Robustness) -> None:
    assert flown.tasks == ("nominal", "experiment")
    assert flown.policies == ["ff", "mine"]
    assert flown.void == {
        ("experiment", LATE): LEADER,
        ("experiment", WIDE): "virtual followers would move backwards there",
    }
    assert not {key for key in flown.cells if key[1:] in flown.void}
    assert set(flown.refused) == {("mine", task, MORE) for task in flown.tasks}
    assert "3 followers: expected 2" in flown.refused["mine", "nominal", MORE]


def test_only_the_first_episodes_fly_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robustness, "EPISODES", 2)
    configs = {"nominal": configure("nominal", duration=0.2)}
    flyable = find_flyable(configs, ["ff"])
    report = evaluate(configs, ["ff"], episodes=3, flyable=flyable)
    found = fly_changes(report, flyable, changes=[BY_NAME[LATE]])
    scores = report.scenarios["nominal"].results["ff"].runs["ff"]["score"]
    assert found.seeds == range(2)
    assert found.plain["ff", "nominal"].score == scores[:2].mean() != scores.mean()


# -- the page -------------------------------------------------------------------------------------


def made() -> Robustness:
    """Two policies, of which one flies one of two tasks, and a change that says nothing on the other."""
    rows = (Change("late", "later", changed, False), Change("wide", "wider", changed, True))  # type: ignore[arg-type]
    return Robustness(
        range(20),
        ("a", "b"),
        rows,
        {("x", "a"): Cell(0.9, 0.0), ("x", "b"): Cell(0.5, 0.0), ("y", "a"): Cell(0.8, 0.0)},
        {
            ("x", "a", "late"): Cell(0.2, 0.75),
            ("x", "a", "wide"): Cell(0.9, 0.0),
            ("x", "b", "wide"): Cell(0.4, 0.1),
            ("y", "a", "wide"): Cell(0.801, 0.0),
        },
        {("b", "late"): "no leader"},
        {("y", "a", "late"): "cannot"},
    )


def test_means_are_over_the_tasks_that_fly_both_ways() -> None:
    found = made()
    assert found.mean("x") == (pytest.approx(0.7), 2) and found.mean("y") == (0.8, 1)
    assert found.difference("x", "late") == pytest.approx(-0.7), "task a alone"
    assert found.difference("x", "wide") == pytest.approx(-0.05)
    assert isnan(found.difference("y", "late"))


def test_the_boards_table_and_its_caption() -> None:
    found = made()
    assert page.table(found).splitlines()[2:] == [
        "| `x` | 0.700 | -0.70 | -0.05 |",
        "| `y` | 0.800, 1 of 2 | - | +0.00 |",
    ]
    text = page.caption(found)
    assert "over `a`, `b`," in text and "on 20 seeds" in text
    assert "Policies are told of *wide*, and not of the others." in text
    assert text.endswith(" Left out: *late* on `b` (no leader).")


def test_what_is_left_out_is_told_once_for_each_reason_and_change() -> None:
    void = {
        ("a", "wide"): "on the floor",
        ("b", "wide"): "on the floor",
        ("b", "late"): "no leader",
    }
    text = page.caption(made()._replace(void=void))
    assert text.endswith(" Left out: *wide* on `a`, `b` (on the floor); *late* on `b` (no leader).")


def test_the_page_holds_every_cell() -> None:
    text = "\n".join(page.parts(made()))
    assert "| `x` | 0.900 | 0.200, 75 % | 0.900 |" in text.split("## a")[1].split("## b")[0]
    assert "| `x` | 0.500 | - | 0.400, 10 % |" in text.split("## b")[1]
    assert "`y`" not in text.split("## b")[1].split("`y` does")[0]
    assert "| `late` | later | no |" in text and "| `wide` | wider | yes |" in text
    assert text.endswith("`y` does not take a change: cannot.")
    assert "`margin`" not in text


def test_the_page_names_what_searches_and_training_have_met() -> None:
    late, *others = made().changes
    text = "\n".join(page.parts(made()._replace(changes=(late._replace(margin=True), *others))))
    assert "*late*: where a task's sensors are exact, gains are searched with these" in text
