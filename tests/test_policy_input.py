"""What policies are given: bad observations and arguments are refused, good ones give finite actions."""

from __future__ import annotations

import warnings
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines import POLICIES, make_policy
from baselines.policies.base import EpisodeWarning, Policy
from baselines.policies.expert import Expert
from baselines.policies.transfer import TransferWarning
from baselines.policies.tuned import ExpertTuned, Gains, UntunedWarning, own
from baselines.registry import SHIPPED
from formation_env import SCENARIOS, configure
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.validation.checks import LONGEST

LEVELS = ("wrench", "rates", "reference")
CONFIG = configure("nominal")
N, SIZE = CONFIG.followers, CONFIG.layout.size

# -- observations ---------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::baselines.policies.gain_files.UntunedWarning")
@pytest.mark.parametrize("name", POLICIES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_none_is_refused_by_name(name: str, value: float) -> None:
    policy = make_policy(name, CONFIG)
    rows = np.zeros((3, N, SIZE), dtype=np.float32)
    rows[2, 1, 8] = value
    with pytest.raises(
        ValueError,
        match=r"observation of follower_1 of world 2, leader_velocity\[2\] = .*: expected a finite number",
    ):
        policy.act(rows)
    rows[...] = 0.0
    rows[0, 0, SIZE - 1] = value
    with pytest.raises(ValueError, match=r"of follower_0, neighbour_velocity\[1\]\[2\] = "):
        policy.act(rows[0].reshape(-1))


def test_the_entry_is_found_wherever_it_is() -> None:
    policy = make_policy("hover", CONFIG)
    for index in [*range(N * SIZE), 700 * N * SIZE + 33]:
        rows = np.zeros((701, N, SIZE), dtype=np.float32)
        rows.flat[index] = np.nan
        world, rest = divmod(index, N * SIZE)
        named = f"observation of follower_{rest // SIZE} of world {world}, "
        with pytest.raises(ValueError, match="expected a finite number") as refusal:
            policy.act(rows)
        assert str(refusal.value).startswith(named)
        where = {n: s for n, s in CONFIG.layout.slices.items() if s.start <= rest % SIZE < s.stop}
        for name, part in where.items():
            assert f"{name}[{rest % SIZE - part.start}]" in str(refusal.value)


@pytest.mark.parametrize(
    "observation",
    [
        np.zeros((N, SIZE), dtype=bool),
        np.zeros((N, SIZE), dtype=complex),
        np.zeros((N, SIZE)).astype(str),
        np.zeros((N, SIZE)).astype(object),
        np.ma.masked_array(np.zeros((N, SIZE)), mask=True),
        [[0.0] * SIZE, [0.0]],
        "nothing",
        None,
        {"follower_0": np.zeros(SIZE)},
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_no_array_of_numbers_is_refused(observation: Any) -> None:
    with pytest.raises(ValueError, match=r"observation is .*: expected an array of real numbers"):
        make_policy("expert", CONFIG).act(observation)


@pytest.mark.parametrize("shape", [(), (SIZE,), (0, N, SIZE), (0, N * SIZE), (1, 1, N, SIZE)])
def test_a_wrong_shape_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"observation has shape .*: expected \(2, 48\), \(96,\)"):
        make_policy("expert", CONFIG).act(np.zeros(shape))


def test_what_overflows_single_precision_is_refused() -> None:
    with pytest.raises(ValueError, match=r"slot_error\[0\] = .*1e\+300.*: expected a finite"):
        make_policy("expert", CONFIG).act(np.full((N, SIZE), 1e300))


def test_other_kinds_of_arrays_are_the_same_numbers() -> None:
    """Also those for which a kernel would be compiled anew: read-only, turned, not in order."""
    simulation = Simulation(CONFIG, 3)
    for i in range(3):
        simulation.seed(i, seeded_key(i))
    rows = simulation.reset().observations
    expected = Expert(CONFIG).act(rows)
    fixed = rows.copy()
    fixed.flags.writeable = False
    spread = np.repeat(rows, 2, axis=0)[::2]
    turned = np.asfortranarray(rows)
    for same in (fixed, spread, turned, rows.astype(np.float64), rows.tolist()):
        assert np.array_equal(Expert(CONFIG).act(same), expected)
    assert not fixed.flags.writeable


# -- finite in, finite out ------------------------------------------------------------------------


def _files(level: str) -> list[str]:
    return [str(path) for path in sorted(SHIPPED.glob(f"*-{level}.safetensors"))]


@lru_cache
def crew(level: str, scenario: str) -> list[Policy]:
    """Every policy that ships and fits."""
    config = configure(scenario, action=level)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TransferWarning)
        warnings.simplefilter("ignore", UntunedWarning)
        made = [make_policy(name, config) for name in (*POLICIES, *_files(level))]
    return [*made, Expert(config, "derived")]


def observations(seed: int, level: str, scenario: str, worlds: int = 4) -> np.ndarray:
    """Anything in the observation space, corners and zeros often, bounds included."""
    layout = configure(scenario, action=level).layout
    rng = np.random.default_rng(seed)
    shape = (worlds, configure(scenario, action=level).followers, layout.size)
    kinds = np.stack(
        [
            rng.uniform(-1.0, 1.0, shape),
            rng.choice([-1.0, 1.0], shape),
            rng.choice([-1.0, 0.0, 1.0], shape),
            np.zeros(shape),
            rng.normal(size=shape) * 1e-3,
            rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(-45, 0, shape),
        ]
    )
    mixed = np.take_along_axis(kinds, rng.integers(0, len(kinds), shape)[None], axis=0)[0]
    pure = kinds[rng.integers(0, len(kinds))]
    rows = np.where(rng.random((worlds, 1, 1)) < 0.5, mixed, pure) * layout.bound
    for name in layout.slices:  # whole entries that are nothing: axes, headings, offsets
        if rng.random() < 0.1:
            rows[..., layout.slices[name]] = 0.0
    return np.clip(rows, -layout.bound, layout.bound).astype(np.float32)


@pytest.mark.filterwarnings("ignore::baselines.policies.base.EpisodeWarning")
@pytest.mark.parametrize("level", LEVELS)
@given(seed=st.integers(0, 2**32 - 1), ticks=st.lists(st.integers(0, 3), min_size=1, max_size=6))
@settings(max_examples=12)
def test_finite_in_finite_out(level: str, seed: int, ticks: list[int]) -> None:
    """Whatever follows whatever: the same observation for a while, another, one of before."""
    seen = [observations(seed + which, level, "nominal", worlds=32) for which in range(4)]
    for policy in crew(level, "nominal"):
        policy.reset(seed=seed, worlds=32)
        for which in ticks:
            for _ in range(1 + 6 * (which == 0)):
                actions = policy.act(seen[which])
                assert np.isfinite(actions).all(), policy.name
                assert np.abs(actions).max() <= 1.0


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("scenario", ["paper", "experiment", "swarm"])
@pytest.mark.filterwarnings("ignore::baselines.policies.base.EpisodeWarning")
def test_finite_in_finite_out_of_other_scenarios(level: str, scenario: str) -> None:
    for policy in crew(level, scenario):
        for seed in range(3):
            policy.reset(worlds=4)
            for which in (0, 0, 0, 1, 2, 0):
                assert np.isfinite(policy.act(observations(seed + which, level, scenario))).all()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("speed", [20.0, 90.0, 100.0])
def test_a_leader_too_fast_to_follow_gives_no_nan(level: str, speed: float) -> None:
    """It did after 24 ticks; and when the leader is slow again the policy is as one that begins."""
    config = configure("nominal", action=level)
    layout, angles = config.layout, np.linspace(0.0, 2.0 * np.pi, 64)
    rows = np.zeros((64, config.followers, layout.size), dtype=np.float32)
    named = layout.unpack(rows)
    named["body_x"][..., 0] = named["body_z"][..., 2] = 1.0
    named["heading"][..., 0] = named["started"][...] = 1.0
    named["offset"][...] = np.array(config.offsets)
    named["position"][..., 2] = -2.0
    named["previous_action"][...] = 0.1  # in flight
    slow = rows.copy()
    planar = speed * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    named["leader_velocity"][..., :2] = planar[:, None]
    for feedforward in ("zero", "derived"):
        policy = Expert(config, feedforward)
        begins = Expert(config, feedforward).act(slow)
        again = 0
        for _ in range(100):
            assert np.isfinite(policy.act(rows)).all()
            other = Expert(config, feedforward)
            other.reset(worlds=64)
            other.set_state(policy.get_state())
            back = other.act(slow)
            assert np.isfinite(back).all()
            again += int((back == begins).all(axis=(1, 2)).sum())
        assert (again > 0) == (speed >= 90.0)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_flights_stay_far_from_where_a_virtual_follower_counts_as_lost(scenario: str) -> None:
    for level in LEVELS:
        config = configure(scenario, action=level)
        simulation, policy = Simulation(config, 2), Expert(config)
        for i in range(2):
            simulation.seed(i, seeded_key(i))
        rows = simulation.reset().observations
        for _ in range(600):
            rows = simulation.step(policy.act(rows)).observations
            memory = policy.get_state()["memory"]
            assert np.abs(memory).max() < 1e3  # of 1e6; NaN fails


# -- arguments ------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::baselines.policies.gain_files.UntunedWarning")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"worlds": 0}, "worlds = 0: expected an integer from 1 to 8388608"),
        ({"worlds": 10**12}, "worlds = 1000000000000: expected an integer from 1 to 8388608"),
        ({"worlds": True}, "worlds = True: expected an integer"),
        ({"worlds": 2.0}, "worlds = 2.0: expected an integer"),
        ({"worlds": "3"}, "worlds = '3': expected an integer"),
        ({"worlds": None}, "worlds = None: expected an integer"),
        ({"seed": -1}, "seed = -1: expected an integer from 0 to 18446744073709551615"),
        ({"seed": 2**64}, "seed = 18446744073709551616: expected an integer from 0"),
        ({"seed": 10**4000}, r"seed = .*: expected an integer from 0"),
        ({"seed": 1.5}, "seed = 1.5: expected an integer"),
        ({"seed": True}, "seed = True: expected an integer"),
        ({"seed": "1"}, "seed = '1': expected an integer"),
        ({"seed": np.array([1, 2])}, r"seed = .*: expected an integer"),
    ],
)
@pytest.mark.parametrize("name", POLICIES)
def test_resets_that_are_refused(name: str, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        make_policy(name, CONFIG).reset(**arguments)
    assert len(str(refusal.value)) <= LONGEST


@pytest.mark.parametrize("seed", [0, 2**63 - 1, 2**63, 2**64 - 2, np.uint64(2**64 - 2), np.int8(7)])
def test_seeds_up_to_the_last(seed: Any) -> None:
    """World 1 of a seed is world 0 of the next."""
    rows = np.zeros((2, N, SIZE), dtype=np.float32)
    pair, single = make_policy("random", CONFIG), make_policy("random", CONFIG)
    pair.reset(seed, worlds=2)
    single.reset(int(seed) + 1)
    assert np.array_equal(pair.act(rows)[1], single.act(rows[1]))


def test_a_seed_is_kept_when_the_number_of_worlds_is_seen_later() -> None:
    """`reset(seed=7)` and a batch of three then drew as seed 0 does."""
    rows = np.zeros((3, N, SIZE), dtype=np.float32)
    late, told = make_policy("random", CONFIG), make_policy("random", CONFIG)
    late.reset(seed=7)
    told.reset(seed=7, worlds=3)
    assert np.array_equal(late.act(rows), told.act(rows))


def test_a_refused_reset_leaves_the_policy_as_it_was() -> None:
    rows = np.zeros((2, N, SIZE), dtype=np.float32)
    policy, other = make_policy("random", CONFIG), make_policy("random", CONFIG)
    for each in (policy, other):
        each.reset(seed=5, worlds=2)
    with pytest.raises(ValueError, match="worlds"):
        policy.reset(seed=6, worlds=-1)
    assert np.array_equal(policy.act(rows), other.act(rows))


@pytest.mark.parametrize("config", ["nominal", None, {"scenario": "nominal"}, 3])
@pytest.mark.parametrize("kind", POLICIES.values())
def test_what_is_no_configuration_is_refused(kind: Any, config: Any) -> None:
    with pytest.raises(ValueError, match=r"config = .*: expected a FormationConfig"):
        kind(config)


def test_options_that_are_refused() -> None:
    with pytest.raises(ValueError, match="feedforward = 'some': expected one of 'zero', 'derived'"):
        Expert(CONFIG, "some")
    with pytest.raises(ValueError, match="keep_record = 1: expected True or False"):
        Expert(CONFIG, keep_record=1)  # type: ignore[arg-type]
    for gains in ({}, 0, "fast", CONFIG.planner):
        with pytest.raises(ValueError, match=r"gains = .*: expected Gains or None"):
            ExpertTuned(CONFIG, gains)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"planner = None: expected PlannerGains"):
        Gains(None, CONFIG.tracker)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"tracker = .*: expected TrackerGains or None"):
        Gains(CONFIG.planner, CONFIG.planner)  # type: ignore[arg-type]
    assert ExpertTuned(CONFIG, own(CONFIG)).tuned


@pytest.mark.filterwarnings("ignore::baselines.policies.gain_files.UntunedWarning")
def test_unknown_keywords_are_type_errors() -> None:
    for kind in POLICIES.values():
        with pytest.raises(TypeError, match="unexpected keyword argument 'speed'"):
            kind(CONFIG, speed=3)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="unexpected keyword argument 'speed'"):
        make_policy("expert", CONFIG, speed=3)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="unexpected keyword argument 'world'"):
        make_policy("expert", CONFIG).reset(world=3)  # type: ignore[call-arg]


def test_the_warning_names_the_caller() -> None:
    """So that Python shows it once for each place in the user's code, not never or in ours."""
    policy = make_policy("expert", CONFIG)
    rows = np.ones((2, N, SIZE), dtype=np.float32)
    policy.act(rows)
    with pytest.warns(EpisodeWarning) as told:
        policy.act(rows[:1])
    assert Path(told[0].filename) == Path(__file__)
