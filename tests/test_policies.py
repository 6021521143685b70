"""The baselines: what they do on observations whose answer is known, and that seeds fix everything."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from baselines import POLICIES, make_policy
from baselines.policies import expert_lanes
from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from formation_env import FormationConfig, configure
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.memory.records import slices
from formation_env.physics.quadrotor import GRAVITY
from formation_env.task import COLUMNS
from formation_env.trajectories import hover

LEVELS = ("wrench", "rates", "reference")


def at_rest(config: FormationConfig, **changed: Any) -> np.ndarray:
    """Rows `(1, followers, entries)` of level vehicles at their slots, everything still."""
    n = config.followers
    zero = {k: np.zeros((1, n, s.stop - s.start)) for k, s in config.layout.slices.items()}
    neighbours = {
        "neighbour_present": np.zeros((1, n, config.neighbours, 1)),
        "neighbour_position": np.zeros((1, n, config.neighbours, 3)),
        "neighbour_velocity": np.zeros((1, n, config.neighbours, 3)),
    }
    level = {"body_x": (1.0, 0.0, 0.0), "body_z": (0.0, 0.0, 1.0), "heading": (1.0, 0.0)}
    named = {**zero, **neighbours}
    for name, value in {**level, "started": (1.0,), **changed}.items():
        named[name] = np.broadcast_to(np.asarray(value, dtype=float), named[name].shape)
    return config.layout.pack(named)


@pytest.mark.filterwarnings("ignore::baselines.policies.gain_files.UntunedWarning")
def test_names_lead_to_policies() -> None:
    config = configure("nominal")
    for name in ("expert", "expert-tuned", "ff", "ff-filter", "lee", "lqr", "hover", "random"):
        assert make_policy(name, config).name == name
    with pytest.raises(
        ValueError,
        match=r"'best': expected one of 'expert', 'expert-tuned', 'ff', .*, 'hover', 'random', 'ppo'",
    ):
        make_policy("best", config)


@pytest.mark.parametrize("level", LEVELS)
def test_ff_hovers_where_it_should_be(level: str) -> None:
    config = configure("nominal", action=level)
    action = make_policy("ff", config).act(at_rest(config))
    assert action == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("heading", [0.0, 2.1])
def test_ff_thrust_balances_weight_and_pull(heading: float) -> None:
    """A slot 0.5 m above: kp e = 2 m/s^2 upwards, so the thrust is m (g + 2) and nothing turns."""
    config = configure("nominal")
    rows = at_rest(config, slot_error=(0, 0, -0.5), heading=(np.cos(heading), np.sin(heading)))
    action = make_policy("ff", config).act(rows)
    expected = 2.0 * config.vehicle.mass * (GRAVITY + 2.0) / config.world.reach.thrust - 1.0
    assert action[..., 0] == pytest.approx(expected, abs=1e-6)
    assert action[..., 1:] == pytest.approx(0.0, abs=1e-6)


def test_ff_feeds_the_leaders_velocity_forward_only_after_the_trigger() -> None:
    """At rest with the leader passing at 1 m/s: catch up once started, stay before."""
    config = configure("nominal", action="reference")
    ff = make_policy("ff", config)
    moving = {"leader_velocity": (1.0, 0.0, 0.0), "relative_velocity": (1.0, 0.0, 0.0)}
    started = ff.act(at_rest(config, **moving))
    waiting = ff.act(at_rest(config, **moving, started=0.0))
    assert started[..., 0] == pytest.approx(4.0 / config.reference_max[0], abs=1e-6)
    assert waiting == pytest.approx(0.0, abs=1e-6)


def settle(policy: Policy, config: FormationConfig, seconds: float) -> np.ndarray:
    """Slot errors (m) of both followers in three worlds after some time."""
    simulation = Simulation(config, 3)
    for i in range(3):
        simulation.seed(i, seeded_key(i))
    results = simulation.reset()
    policy.reset(seed=0, worlds=3)
    for _ in range(round(seconds / config.control_period)):
        results = simulation.step(policy.act(results.observations))
    return np.linalg.norm(results.outputs[..., COLUMNS["slot_error"]], axis=-1)


@pytest.mark.parametrize(
    ("level", "seconds"), [("wrench", 4.0), ("rates", 4.0), ("reference", 12.0)]
)
def test_ff_settles_on_a_resting_formation(level: str, seconds: float) -> None:
    """From up to 0.2 m away behind a leader that hovers. Poles at -2 1/s leave 2 % after 3 s; at level
    `reference` the vehicle follows by the paper's tracker, poles at -0.5 1/s. A wrong sign in any of the
    loops leaves much more or crashes."""
    config = configure("nominal", action=level, trajectory=hover((0.0, 0.0, -2.0)), gust=0.0)
    assert settle(make_policy("ff", config), config, seconds).max() < 0.01


def test_ff_turned_scene_turns_nothing() -> None:
    """Yawing the world about the vertical changes no action, up to the rounding of positions."""
    config = configure("nominal")
    ff = make_policy("ff", config)
    moved = {"slot_error": (0.3, -0.2, 0.1), "relative_velocity": (0.1, 0.4, -0.1)}
    a = ff.act(at_rest(config, **moved))
    b = ff.act(at_rest(config, **moved, heading=(0.0, 1.0), position=(5.0, -3.0, -8.0)))
    assert a == pytest.approx(b, abs=1e-6)
    assert np.abs(a).max() > 0.1


def test_random_draws_by_world_follower_and_tick() -> None:
    """World i of seed s draws what world 0 of seed s + i draws; no draw occurs twice."""
    config = configure("swarm")
    rows = np.zeros((4, config.followers, config.layout.size), dtype=np.float32)
    together, alone = make_policy("random", config), make_policy("random", config)
    together.reset(seed=10, worlds=4)
    alone.reset(seed=12, worlds=1)
    drawn = np.stack([together.act(rows) for _ in range(50)])
    single = np.stack([alone.act(rows[:1]) for _ in range(50)])
    assert np.array_equal(drawn[:, 2:3], single)
    assert len(np.unique(drawn)) > 0.999 * drawn.size
    assert np.abs(drawn).max() <= 1.0
    # Uniform in [-1, 1]: mean 0, variance 1/3, to five standard errors of 12800 draws.
    assert drawn.mean() == pytest.approx(0.0, abs=5 * (1 / 3 / drawn.size) ** 0.5)
    assert drawn.var() == pytest.approx(1 / 3, abs=5 * (4 / 45 / drawn.size) ** 0.5)


def test_random_begins_again_when_reset() -> None:
    config = configure("nominal")
    rows = np.zeros((2, config.followers, config.layout.size), dtype=np.float32)
    policy = make_policy("random", config)
    policy.reset(seed=3, worlds=2)
    first, second = policy.act(rows), policy.act(rows)
    policy.reset(seed=3, worlds=2)
    assert np.array_equal(policy.act(rows), first)
    assert not np.array_equal(first, second)


@pytest.mark.filterwarnings("ignore::baselines.policies.gain_files.UntunedWarning")
@pytest.mark.parametrize("name", POLICIES)
@pytest.mark.parametrize("level", LEVELS)
def test_a_world_does_not_see_the_others(name: str, level: str) -> None:
    """Rows decided together are bit for bit those decided alone, in every form `act` takes."""
    config = configure("nominal", action=level)
    n, size = config.followers, config.layout.size
    simulation = Simulation(config, 5)
    for i in range(5):
        simulation.seed(i, seeded_key(i))
    rows = simulation.reset().observations
    together, flat, alone = (make_policy(name, config) for _ in range(3))
    together.reset(seed=0, worlds=5)
    flat.reset(seed=0, worlds=5)
    alone.reset(seed=3, worlds=1)
    for _ in range(3):
        actions = together.act(rows)
        assert np.array_equal(flat.act(rows.reshape(5, n * size)), actions.reshape(5, -1))
        assert np.array_equal(alone.act(rows[3]), actions[3])
        rows = simulation.step(actions).observations


@pytest.mark.filterwarnings("ignore::baselines.policies.gain_files.UntunedWarning")
@pytest.mark.parametrize("name", POLICIES)
def test_wrong_observation_is_refused(name: str) -> None:
    config = configure("nominal")
    with pytest.raises(ValueError, match=r"observation has shape \(7,\): expected"):
        make_policy(name, config).act(np.zeros(7))


@pytest.mark.parametrize("worlds", [1, 8, 9])
@pytest.mark.parametrize("level", LEVELS)
def test_an_expert_with_a_record_decides_alike(level: str, worlds: int) -> None:
    """Keeping a record changes no action, and its trajectory starts where null errors put it (II-E).

    Null as far as the row says: its heading is of float32, so of a length that is not quite 1, and
    `d` turned by it is as much too long or too short.
    """
    config = configure("nominal", action=level)
    simulation = Simulation(config, worlds)
    for i in range(worlds):
        simulation.seed(i, seeded_key(i))
    plain, noting = Expert(config), Expert(config, keep_record=True)
    plain.reset(0, worlds)
    noting.reset(0, worlds)
    rows = simulation.reset().observations
    for tick in range(5):
        actions = noting.act(rows)
        assert np.array_equal(plain.act(rows), actions)
        if tick == 0:
            row = config.layout.unpack(rows.astype(np.float64))
            excess = np.linalg.norm(row["heading"], axis=-1, keepdims=True) - 1.0
            assert np.abs(excess).max() < np.finfo(np.float32).eps
            said = excess * row["offset"][..., :2]
            assert np.abs(noting.record["planner_e1"] - said).max() < 1e-12
            assert np.abs(noting.record["planner_ez"]).max() < 1e-12
        rows = simulation.step(actions).observations
    assert np.isfinite(np.concatenate(list(noting.record.values()), axis=-1)).all()


@pytest.mark.parametrize("level", LEVELS)
def test_the_expert_reads_rows_as_they_are_laid_out(level: str) -> None:
    """The records that it loads rows into have the entries of the layout, in order and size."""
    layout = configure("nominal", action=level).layout
    entries = slices(expert_lanes.Observation)
    if level == "reference":
        start = expert_lanes.OBSERVED
        guide = slices(expert_lanes.Guide)
        for field, name in (("p", "guide_position"), ("v", "guide_velocity")):
            entries[name] = slice(start + guide[field].start, start + guide[field].stop)
    assert list(entries.items()) == list(layout.slices.items())


def test_the_experts_loops_are_vector_code() -> None:
    """Packed arithmetic in the machine code, compiled anew (a kernel from the cache has no listing)."""
    program = (
        "import numpy as np\n"
        "from baselines.policies import expert_lanes as e\n"
        "from formation_env import configure\n"
        "L = e.LANES\n"
        "rows, x = np.ones(e.OBSERVED * L, np.float32), np.ones(e.VIRTUAL * L)\n"
        "points = np.ones(e.size(e.TrajectoryPoint) * L)\n"
        "c = configure('paper')\n"
        "for loop in (e.plan, e.plan_derived):\n"
        "    loop(rows, x, 0.02, c.planner.law(), points)\n"
        "    code = next(iter(loop.inspect_asm().values()))\n"
        "    print(code.count('mulpd') + code.count('.2d'))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=300
    )
    assert all(int(line) > 50 for line in done.stdout.split())  # none where the compiler gave up
