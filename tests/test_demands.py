"""What scenarios ask of the vehicles: figures of flights that are known, and sentences that follow the
configuration."""

from __future__ import annotations

from math import asin, atan, degrees

import numpy as np
import pytest

from baselines import make_policy
from baselines.reporting import board, demands
from baselines.reporting.demands import Demands, Flown, Percentiles, causes, measure, parts
from baselines.reporting.further import Further
from baselines.scoring.evaluation import evaluate, find_flyable
from baselines.scoring.rollout import fly
from baselines.scoring.suite import matrix
from formation_env import SCENARIOS, FormationConfig, configure
from formation_env.config import NO_NOISE
from formation_env.core.simulation import Simulation
from formation_env.physics.quadrotor import GRAVITY
from formation_env.trajectories import circle, hover

STILL = {"path": "as given", "gust": 0.0, "start_offset": 0.0}
NOTHING = Demands(*[Percentiles(np.nan, np.nan, np.nan)] * len(Demands._fields))


def flown(config: FormationConfig, policy: str = "expert", worlds: int = 3) -> Demands:
    return measure(make_policy(policy, config), range(worlds))


@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
def test_hovering_asks_for_the_weight_and_nothing_else(action: str) -> None:
    d = flown(configure("nominal", trajectory=hover(), action=action, duration=2.0, **STILL))
    assert np.isnan(d.jump.median), "they start in formation"
    for name, expected in Demands(*(0.0,) * len(Demands._fields))._asdict().items():  # type: ignore[arg-type]
        if name == "jump":
            continue
        wanted = 1.0 if name == "thrust" else expected
        assert getattr(d, name) == pytest.approx([wanted] * 3, abs=1e-5), name


@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
def test_a_circle_asks_for_the_tilt_of_its_acceleration(action: str) -> None:
    """At radius r and speed V the leader's acceleration is a = V^2 / r and its tilt atan(a / g). In formation
    a follower turns as fast, V / r, at the heading (28): on a circle whose radius follows from (6)."""
    radius, speed, d = 4.0, 2.0, 0.35 + 0.7j
    config = configure(
        "nominal",
        offsets=((d.real, d.imag, -0.3),),
        trajectory=circle(radius, speed),
        action=action,
        duration=40.0,
        **STILL,
    )
    found, a = flown(config, "expert", 1), speed**2 / radius
    assert found.leader_tilt.median == pytest.approx(degrees(atan(a / GRAVITY)), rel=0.02)
    assert found.acceleration.median == pytest.approx(a, rel=0.02)
    assert found.speed.median == pytest.approx(speed, rel=0.02)
    # In the leader's frame, its velocity along 1, the centre is at `j r`.
    slot = -d * np.exp(-1j * asin(d.real / radius))
    own = a * abs(slot - 1j * radius) / radius / GRAVITY
    assert abs(own * GRAVITY / a - 1.0) > 0.1, "not the leader's"
    assert found.tilt.median == pytest.approx(degrees(atan(own)), rel=0.02)
    assert found.thrust.median == pytest.approx(np.hypot(1.0, own), rel=0.002)
    if action != "wrench":  # the thrust axis turns with the circle
        rate = speed / radius * np.sin(atan(own))
        assert 0.6 * rate < found.turn.median * config.vehicle.rate_max[0] < 1.1 * rate


def test_turning_is_a_share_of_the_limit() -> None:
    """Actions of -1 to 1 at random, their largest entry of three: the median is `0.5^(1/3)`."""
    config = configure("nominal", duration=0.4, limits={"lost": 1e4}, **STILL)
    share = flown(config, "random", 400).turn
    assert share.median == pytest.approx(0.5 ** (1.0 / 3.0), abs=0.02)
    assert 0.2 < share.low < 0.25 and 0.99 < share.high <= 1.0


def test_only_ticks_after_the_trigger_count() -> None:
    """On the floor the specific force is less than the weight, and the leader still stands there."""
    assert np.isnan(flown(configure("paper", duration=1.0), "hover").tilt.median)
    d = flown(configure("paper", noise=NO_NOISE, path="as given", duration=20.0))
    assert d.thrust.low > 0.9 and 0.2 < d.speed.median < 0.7


def test_what_is_scored_is_what_counts_and_the_start_has_its_own_figures() -> None:
    """Of 6 s the last 5 are scored; before, `ff` flies to its slots from up to 0.15 m."""
    config, tilts = configure("nominal", duration=6.0), []
    policy = make_policy("ff", config)

    def watch(simulation: Simulation, *_: object) -> None:
        axes = demands.thrust_axes(simulation.attitudes)[:, 1:]
        tilts.append(np.degrees(np.arccos(axes[..., 2])).ravel())

    fly(policy, range(3), watch=watch)
    d = measure(policy, range(3))
    # The first tick has none before it to be compared with.
    assert d.start_tilt == pytest.approx(np.percentile(tilts[1:50], demands.PERCENTS), abs=1e-6)
    assert d.tilt == pytest.approx(np.percentile(tilts[50:], demands.PERCENTS), abs=1e-6)
    assert d.tilt.high < 0.8 * d.start_tilt.high


def test_the_jump_of_the_slots_is_that_from_the_paths_first_point_to_the_leader() -> None:
    """At the trigger (40) the leader is within 0.25 m of its first reference point; without noise it comes
    along one line, and the slot moves as far as the leader is off."""
    config = configure("paper", noise=NO_NOISE, path="as given", duration=20.0)
    d, off = flown(config, worlds=1), []

    def watch(simulation: Simulation, *_: object) -> None:
        if simulation.started[0] and not off:
            first = simulation.reference(np.zeros(1))[0]
            off.append(float(np.linalg.norm(simulation.leaders[0] - first)))

    fly(make_policy("expert", config), range(1), watch=watch)
    assert d.jump.median == pytest.approx(off[0], abs=0.02)
    assert 0.1 < d.jump.median < 0.27


def test_what_is_not_from_the_paper_is_said_of_every_scenario() -> None:
    configs = {name: configure(name, duration=0.1) for name in SCENARIOS}
    report = evaluate(configs, ["hover"], episodes=1)
    told = "\n".join(parts(report, dict.fromkeys(configs, Flown("hover", NOTHING))))
    assert told.count(" Not from the paper: ") == len(SCENARIOS)
    assert "the rate at which the noise is drawn" in told.split("**paper.**")[1].split("**exp")[0]


def test_thrust_axes_are_those_of_the_attitude() -> None:
    half = 0.5 * np.array([0.3, -0.2])
    rolled = [np.cos(half[0]), np.sin(half[0]), 0.0, 0.0]
    pitched = [np.cos(half[1]), 0.0, np.sin(half[1]), 0.0]
    axes = demands.thrust_axes(np.array([rolled, pitched]))
    assert axes[0] == pytest.approx([0.0, -np.sin(0.3), np.cos(0.3)])
    assert axes[1] == pytest.approx([np.sin(-0.2), 0.0, np.cos(-0.2)])


# -- the page -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("config", "said", "unsaid"),
    [
        (
            configure("nominal"),
            ["are exact", "0.04 m/s^2", "up to 0.15 m"],
            ["floor", "noise", "down to"],
        ),
        (configure("nominal", start_offset=0.0), ["start at their places, in flight"], ["up to"]),
        (configure("nominal", gust=0.0), ["are exact"], ["gusts"]),
        (
            configure("paper"),
            ["noise of 0.2 m, 0.1 m/s", "anew 50 times a second", "within 0.25 m", "15 s"],
            ["gusts", "in flight"],
        ),
        (configure("experiment"), ["50 Hz", "44 Hz", "100 samples", "1 s late"], ["noise"]),
        (configure("experiment", window=20), ["20 samples", "0.2 s late"], []),
        (configure("swarm"), ["17 vehicles", "0.353 m"], ["floor"]),
        (configure("nominal", measurement_delay=2), ["0.04 s late"], []),
    ],
)
def test_sentences_follow_the_configuration(
    config: FormationConfig, said: list[str], unsaid: list[str]
) -> None:
    text = causes(config)
    assert all(words in text for words in said), text
    assert not any(words in text for words in unsaid), text


def test_levels_share_a_paragraph_and_what_never_starts_has_no_figures() -> None:
    configs = {
        name: configure("paper", action=name.partition(":")[2] or "wrench", duration=0.1)
        for name in ("paper", "paper:rates")
    }
    report = evaluate(configs, ["hover"], episodes=1)
    table, told = parts(report, dict.fromkeys(configs, Flown("hover", NOTHING)))[1:]
    assert "| `paper:rates` | `hover` | - | - | - | - | - | - |" in table
    assert told.startswith("**paper, paper:rates.** ")
    assert "No flight got as far as what is scored." in told and "jump" not in told


def test_the_crowd_says_the_least_distance_of_the_slots() -> None:
    offsets = ((0.5, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.4, 0.0))
    config = configure("nominal", offsets=offsets, trajectory=circle(10.0), start_offset=0.0)
    assert "4 vehicles, whose places are down to 0.40 m apart" in causes(config)


def test_the_page_shows_the_best_row_and_its_figures() -> None:
    configs = {name: configure(name, duration=4.0) for name in ("nominal", "agile")}
    policies = ["hover", "expert"]
    flyable = find_flyable(configs, policies)
    report = evaluate(configs, policies, episodes=3, seed=5, flyable=flyable)
    found = demands.of_best(report, flyable, quiet=True)
    assert {name: each.policy for name, each in found.items()} == dict.fromkeys(configs, "expert")
    assert found["agile"].demands == measure(make_policy("expert", configs["agile"]), range(5, 8))
    page = board.pages(report, matrix(report), Further(demands=found))[board.DEMANDS]
    for name, (_, d) in found.items():
        (row,) = (line for line in page.splitlines() if line.startswith(f"| `{name}` | `expert` |"))
        assert f"| {d.tilt.low:.1f} / {d.tilt.median:.1f} / {d.tilt.high:.1f} |" in row
        assert page.count(f"**{name}.**") == 1
    assert "on another path in every episode" in page.split("**agile.**")[1]
    assert len(page.encode()) < 8000
