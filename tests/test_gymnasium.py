"""The Gymnasium face: its contract, its manual, its truth, and how an episode ends."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from episodes import LEVELS, SCENARIOS, arrays, episode, gentle, reward_terms, same, wild
from gymnasium.utils.env_checker import check_env

from formation_env import Limits, trajectories
from formation_env.core.simulation import Simulation
from formation_env.env import FormationEnv
from formation_env.laws.levels import REFERENCE
from formation_env.physics.quadrotor import GRAVITY
from formation_env.task import (
    COLLISION,
    FAILURES,
    IMPACT,
    LOST,
    NEIGHBOUR_ENTRIES,
    NO_FAILURE,
    Layout,
    Rewards,
    Terms,
)

PYGAME = importlib.util.find_spec("pygame") is not None
HOVER = trajectories.hover()
ABOVE = ((0.5, 0.0, -0.3), (0.5, 0.0, -1.0))  # one follower exactly above the other
STILL: dict[str, Any] = {"trajectory": HOVER, "start_offset": 0.0, "gust": 0.0}


@pytest.mark.parametrize(
    "made",
    [
        "import formation_env\nenv = gym.make('Formation-v0')",
        "env = gym.make('formation_env:Formation-v0')",
    ],
)
def test_it_is_made_by_name(made: str, root: Path) -> None:
    code = f"import gymnasium as gym\n{made}\nprint(env.unwrapped)"
    command = [sys.executable, "-W", "error", "-c", code]
    run = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "FormationEnv" in run.stdout


@pytest.mark.parametrize("action", LEVELS)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_checker_has_nothing_to_say(scenario: str, action: str) -> None:
    """Its warnings are errors here. Drawing does not depend on the action level."""
    env = gym.make("Formation-v0", scenario=scenario, action=action)
    check_env(env.unwrapped, skip_render_check=action != "wrench" or not PYGAME)
    env.close()


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_observations_lie_in_their_space(scenario: str) -> None:
    env = FormationEnv(scenario)
    actions = wild(150, *env.action_space.shape)
    for step in episode(env, actions, seed=1):
        assert step[0] in env.observation_space
        assert np.isfinite(step[0]).all()


def test_every_entry_is_clipped_to_its_bound() -> None:
    """A follower spun by rates of hundreds of rad/s reports 100."""
    vehicle = gym.make("Formation-v0").unwrapped.config.vehicle
    fast = type(vehicle)(rate_max=(500.0, 500.0, 500.0), rate_lag=0.01)
    env = FormationEnv(action="rates", vehicle=fast)
    env.reset(seed=0)
    for _ in range(5):
        obs = env.step(np.ones(8, np.float32))[0]
    rows = env.config.layout.unpack(obs.reshape(2, -1))
    assert (rows["angular_velocity"] == 100.0).all()
    assert (np.abs(env.simulation.angular_velocities[0, 1:]) > 300.0).all()


# -- what is returned belongs to the caller ---------------------------------------------------------


def test_results_share_no_memory_between_steps() -> None:
    env = FormationEnv()
    steps = episode(env, gentle(12, 8), seed=0)
    kept = [arrays(step) for step in steps]
    for i, early in enumerate(kept):
        for late in kept[i + 1 :]:
            assert not any(np.shares_memory(a, b) for a in early for b in late)
    internal = [*env.get_state().state.values(), *env.simulation._state]
    assert not any(np.shares_memory(a, b) for a in arrays(kept) for b in internal)


def test_writing_into_results_changes_nothing() -> None:
    spoiled, untouched = FormationEnv("paper"), FormationEnv("paper")
    actions = wild(40, 8)
    expected = episode(untouched, actions, seed=5)
    found: list[Any] = []

    def keep(step: Any) -> None:
        found.append(tuple(s.copy() if isinstance(s, np.ndarray) else s for s in step[:-1]))
        for array in arrays(step):
            array[...] = 7

    keep(spoiled.reset(seed=5))
    for action in actions:
        step = spoiled.step(action)
        over = step[2] or step[3]
        keep(step)
        if over:
            keep(spoiled.reset())
    assert same(found, [step[:-1] for step in expected])


def test_an_action_may_be_written_over_afterwards() -> None:
    one, two = FormationEnv(), FormationEnv()
    one.reset(seed=0), two.reset(seed=0)
    action = np.full(8, 0.1, np.float32)
    one.step(action)
    two.step(action.copy())
    action[:] = -1.0
    assert same(one.step(np.zeros(8, np.float32)), two.step(np.zeros(8, np.float32)))


# -- the manual ---------------------------------------------------------------------------------------


def manual_rows() -> list[list[str]]:
    """Cells of the observation table in the class docstring."""
    text = FormationEnv.__doc__ or ""
    table = text.split("## Observation Space")[1].split("Before the trigger")[0]
    lines = [line.strip() for line in table.splitlines() if line.strip().startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_manual_tells_the_layout() -> None:
    """Index, name, unit, frame and bound of every entry, in order."""
    layout = Layout(REFERENCE, 2)
    rows = manual_rows()
    assert len(rows) == len(layout.entries) + 1
    for entry, (index, name, unit, frame, _, bound) in zip(layout.entries, rows, strict=False):
        assert name == f"`{entry.name}`"
        assert (unit, frame, float(bound)) == (entry.unit, entry.frame, entry.bound)
        where = layout.slices[entry.name]
        if entry.name.startswith("guide"):
            assert index == f"+{entry.size}"
        else:
            numbers = [int(i) for i in index.split("-")]
            assert (numbers[0], numbers[-1] + 1) == (where.start, where.stop)
        assert (layout.bound[where] == entry.bound).all()
    index, names, units, _, _, bounds = rows[-1]
    assert index == f"+{sum(e.size for e in NEIGHBOUR_ENTRIES)} each"
    assert re.findall(r"`(neighbour_\w+)`", names) == [e.name for e in NEIGHBOUR_ENTRIES]
    assert units == ", ".join(e.unit for e in NEIGHBOUR_ENTRIES)
    assert [float(b) for b in bounds.split(",")] == [e.bound for e in NEIGHBOUR_ENTRIES]


def test_manual_tells_the_defaults() -> None:
    text = FormationEnv.__doc__ or ""
    config = FormationEnv().config
    vehicle, limits = config.vehicle, config.limits
    assert f"moment -+({', '.join(map(str, vehicle.moment_max))})" in text
    assert f"rates -+({', '.join(f'{x:g}' for x in vehicle.rate_max)})" in text
    weights = config.reward
    assert f"| reach {weights.reach} m, precision {weights.precision} m |" in text
    assert f"| waiting {weights.waiting} |" in text
    assert f"closer than {limits.collision} m" in text
    assert f"`limits.deadline` ({limits.deadline:g} s)" in text
    assert f"{config.max_steps} in `nominal`" in text
    codes = re.findall(r"(\d) ([a-z ]+)", text.split("`task.FAILURES`: ")[1].split(" |")[0])
    assert [int(code) for code, _ in codes] == list(range(len(FAILURES)))
    assert all(name in said for name, (_, said) in zip(FAILURES, codes, strict=True))
    assert f"more than {limits.lost:g} m from its slot" in text
    assert f"{np.degrees(np.arccos(limits.tilt)):.0f} degrees from level" in text
    assert f"`start_offset` ({config.start_offset} m)" in text
    assert f"`trigger` ({config.trigger} m)" in text
    for heading in (
        "Description",
        "Action Space",
        "Observation Space",
        "Rewards",
        "Starting State",
    ):
        assert f"## {heading}\n" in text
    assert "## Version History" in text


# -- the truth in info --------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_info_is_the_truth(scenario: str) -> None:
    env = FormationEnv(scenario)
    n = env.config.followers
    _, info = env.reset(seed=2)
    for action in gentle(30, n * env.config.action_size):
        p = env.simulation.positions[0]
        np.testing.assert_array_equal(info["slot_error"], info["slots"] - p[1:])
        gaps = np.linalg.norm(p[1:, None] - p[None], axis=2)
        gaps[np.arange(n), np.arange(n) + 1] = np.inf
        np.testing.assert_allclose(info["separation"], gaps.min(axis=1), rtol=1e-12)
        _, reward, _, _, info = env.step(action)
        terms = reward_terms(info)
        assert reward == pytest.approx(np.sum(list(terms.values()), axis=0).mean(), rel=1e-14)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_info_holds_only_arrays(scenario: str) -> None:
    """Other libraries make a tensor of every entry, and always of the same ones."""
    env = FormationEnv(scenario)
    n = env.config.followers
    shapes = {
        "slots": (n, 3),
        "slot_error": (n, 3),
        "separation": (n,),
        "failure": (n,),
        **{f"reward_{term}": (n,) for term in Terms._fields},
    }
    for step in episode(env, wild(60, n * env.config.action_size), seed=1):
        info = step[-1]
        assert all(type(value) is np.ndarray for value in info.values())
        assert {name: value.shape for name, value in info.items()} == shapes
        assert info.pop("failure").dtype == np.int64
        assert all(value.dtype == np.float64 for value in info.values())


@pytest.mark.parametrize("action", LEVELS)
def test_reward_is_what_the_manual_says(action: str) -> None:
    rewards = Rewards(0.4, 0.06, waiting=0.02, effort=0.3, smoothness=0.7, failure=5.0)
    env = FormationEnv(action=action, reward=rewards)
    k = env.config.action_size
    env.reset(seed=4)
    previous = np.zeros((2, k))
    over = False
    for row in wild(200, 2 * k, seed=3):
        _, _, over, _, info = env.step(row)
        executed = np.clip(row.reshape(2, k).astype(np.float64), -1.0, 1.0)
        error = np.linalg.norm(info["slots"] - env.simulation.positions[0, 1:], axis=1)
        terms = reward_terms(info)
        wide, narrow = 1 / (1 + (error / 0.4) ** 2), 1 / (1 + (error / 0.06) ** 2)
        np.testing.assert_allclose(terms["formation"], 0.5 * (wide + narrow), rtol=1e-12)
        np.testing.assert_array_equal(terms["waiting"], 0.0)
        np.testing.assert_allclose(terms["effort"], -0.3 * (executed**2).mean(1), rtol=1e-12)
        change = ((executed - previous) ** 2).mean(1)
        np.testing.assert_allclose(terms["smoothness"], -0.7 * change, rtol=1e-12, atol=1e-15)
        failed = bool((info["failure"] != NO_FAILURE).any())
        np.testing.assert_array_equal(terms["failure"], -5.0 * failed)
        previous = executed
        if over:
            break
    assert over or action == "reference"


# -- how an episode ends --------------------------------------------------------------------------------


def run_to_the_end(env: FormationEnv, action: Any) -> tuple[int, bool, bool, dict[str, Any]]:
    """Number of the last step, terminated, truncated, info."""
    env.reset(seed=0)
    action = np.array(action, dtype=np.float32).ravel()
    for k in range(1, 2000):
        _, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            return k, terminated, truncated, info
    raise AssertionError("the episode did not end")


def ticks(travel: float, period: float = 0.02) -> int:
    """Control ticks until a vehicle accelerated by g has moved more than `travel` metres."""
    return int(np.ceil(np.sqrt(2.0 * travel / GRAVITY) / period))


def test_without_thrust_it_falls_to_the_floor() -> None:
    env = FormationEnv(**STILL)
    last, terminated, truncated, info = run_to_the_end(env, [-1, 0, 0, 0] * 2)
    assert last == ticks(1.2)  # from 1.5 m, 0.3 m below the leader
    assert (terminated, truncated) == (True, False)
    np.testing.assert_array_equal(info["failure"], [IMPACT, IMPACT])


def test_all_pay_for_the_one_that_fails() -> None:
    env = FormationEnv(**STILL)
    _, terminated, _, info = run_to_the_end(env, [-1, 0, 0, 0, 0, 0, 0, 0])
    assert terminated
    np.testing.assert_array_equal(info["failure"], [IMPACT, NO_FAILURE])
    np.testing.assert_array_equal(info["reward_failure"], [-10.0, -10.0])


def test_full_thrust_loses_it() -> None:
    """Action +1 is twice the weight: it climbs at g."""
    limits = Limits(collision=0.2, impact=1.0, tilt=0.5, lost=0.5)
    env = FormationEnv(**STILL, limits=limits)
    last, terminated, _, info = run_to_the_end(env, [0, 0, 0, 0, 1, 0, 0, 0])
    assert (last, terminated) == (ticks(0.5), True)
    np.testing.assert_array_equal(info["failure"], [NO_FAILURE, LOST])


def test_constant_tilt_loses_it() -> None:
    """A short turn about the body's y axis, then it slides away for good."""
    env = FormationEnv(**STILL, action="rates", duration=60.0)
    env.reset(seed=0)
    tilt = np.array([0, 0, 0.3, 0, 0, 0, 0, 0], np.float32)
    for _ in range(5):
        env.step(tilt)
    terminated = truncated = False
    while not (terminated or truncated):
        action = np.array([0.02, 0, 0, 0, 0, 0, 0, 0], np.float32)
        _, _, terminated, truncated, info = env.step(action)
    assert info["failure"][0] == LOST
    assert np.linalg.norm(info["slot_error"][0]) > 10.0


def test_two_that_meet_collide() -> None:
    env = FormationEnv(**STILL, offsets=ABOVE)
    last, terminated, _, info = run_to_the_end(env, [0, 0, 0, 0, 1, 0, 0, 0])
    assert (last, terminated) == (ticks(0.7 - 0.353), True)
    np.testing.assert_array_equal(info["failure"], [COLLISION, COLLISION])
    assert (info["separation"] < 0.353).all()


def test_meeting_the_leader_is_a_collision() -> None:
    under = ((0.01, 0.0, -0.8),)
    env = FormationEnv(**STILL, offsets=under)
    last, _, _, info = run_to_the_end(env, [1, 0, 0, 0])
    # It climbs from 0.8 m below the leader; to be 1 cm beside it makes 0.14 mm.
    assert last in (ticks(0.8 - 0.353), ticks(0.8 - 0.353) + 1)
    assert info["failure"].tolist() == [COLLISION]


@pytest.mark.parametrize(("roll", "fails"), [(0.0, False), (1.0, True)])
def test_a_soft_landing_counts_only_upright(roll: float, fails: bool) -> None:
    """With hard landings allowed, one on the side is still an impact."""
    limits = Limits(collision=0.2, impact=100.0, tilt=0.5, lost=50.0)
    env = FormationEnv(**STILL, action="rates", limits=limits, duration=1.0)
    _, terminated, truncated, info = run_to_the_end(env, [-1, 0.4 * roll, 0, 0] * 2)
    assert (terminated, truncated) == (fails, not fails)
    assert (info["failure"] == (IMPACT if fails else NO_FAILURE)).all()


@pytest.mark.parametrize(("duration", "steps"), [(0.02, 1), (0.5, 25), (1.01, 50)])
def test_it_truncates_at_the_time_limit(duration: float, steps: int) -> None:
    last, terminated, truncated, info = run_to_the_end(FormationEnv(duration=duration), [0] * 8)
    assert (last, terminated, truncated) == (steps, False, True)
    assert (info["failure"] == NO_FAILURE).all()


def test_gymnasiums_own_time_limit_truncates_earlier() -> None:
    env = gym.make("Formation-v0", max_episode_steps=7)
    last, terminated, truncated, _ = run_to_the_end(env, [0] * 8)  # type: ignore[arg-type]
    assert (last, terminated, truncated) == (7, False, True)


@pytest.mark.parametrize("action", LEVELS)
def test_one_follower_and_no_neighbours(action: str) -> None:
    env = FormationEnv("swarm", followers=1, neighbours=0, action=action)
    obs, info = env.reset(seed=0)
    assert obs.shape == (env.config.layout.first_neighbour,)
    steps = episode(env, gentle(20, env.config.action_size), seed=0)
    assert info["slots"].shape == (1, 3)
    assert not steps[-1][2]


def test_256_followers_fly() -> None:
    env = FormationEnv("swarm", followers=256)
    steps = episode(env, np.zeros((3, 1024), np.float32), seed=0)
    # A world alone has a tile of 16 to itself; with its tile full a vehicle needs less than 1 KB.
    stored = sum(array.nbytes for array in env.get_state().state.values())
    assert stored < 16 * 257 * 1024
    full = Simulation(env.config, 16).get_state().state.values()
    assert sum(array.nbytes for array in full) < 16 * 257 * 1024
    assert (
        np.linalg.norm(steps[0][1]["slot_error"], axis=1) <= env.config.start_offset + 1e-12
    ).all()
    rows = env.config.layout.unpack(steps[-1][0].reshape(256, -1))
    p = env.simulation.positions[0, 1:]
    gaps = np.linalg.norm(p[:, None] - p, axis=2)
    nearest = np.sort(gaps, axis=1)[:, 1:3]  # without itself
    np.testing.assert_allclose(
        np.linalg.norm(rows["neighbour_position"], axis=2), nearest, rtol=1e-5
    )
