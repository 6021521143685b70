"""What is accepted stays within the numbers: bounds where they are needed, and nothing else refused."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import numpy as np
import pytest
from configurations import FIELDS, accepted, spread
from episodes import SCENARIOS
from hypothesis import given, settings
from hypothesis import strategies as st

from formation_env import PlannerGains, TrackerGains, Vehicle, configure
from formation_env.configuration.bounds import RK4_STABLE
from formation_env.laws.world import MAX_TICKS
from formation_env.validation.checks import LONGEST
from formation_env.vector import FormationVectorEnv

# -- the rate loop ------------------------------------------------------------------------------------


def growth(z: float) -> float:
    """What a classical Runge-Kutta step of `h` makes of `x' = -x / lag`, `z = h / lag`."""
    k1 = -1.0
    k2 = -(1.0 + 0.5 * z * k1)
    k3 = -(1.0 + 0.5 * z * k2)
    k4 = -(1.0 + z * k3)
    return 1.0 + z * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0


def test_the_stability_bound_of_runge_kutta() -> None:
    """The step neither grows nor alternates below it: `omega` stays between command and start."""
    inside = [growth(z) for z in np.linspace(1e-9, RK4_STABLE * (1.0 - 1e-9), 2001)]
    assert 0.0 < min(inside) < max(inside) < 1.0
    assert growth(RK4_STABLE * (1.0 + 1e-9)) > 1.0


@pytest.mark.parametrize("options", [{"action": "rates"}, {"leader_actuation": "rates"}], ids=str)
@pytest.mark.parametrize(("substeps", "bound"), [(4, 0.005 / RK4_STABLE), (1, 0.02 / RK4_STABLE)])
def test_a_rate_loop_faster_than_a_substep_can_follow_is_refused(
    options: dict[str, Any], substeps: int, bound: float
) -> None:
    configure(vehicle={"rate_lag": 1.0001 * bound}, substeps=substeps, **options)
    for lag in (0.9999 * bound, 1e-4, 1e-300):
        with pytest.raises(ValueError, match=r"^vehicle\.rate_lag = .*above .* rate_lag < 2\.785"):
            configure(vehicle={"rate_lag": lag}, substeps=substeps, **options)


def test_a_rate_loop_that_nothing_uses_is_not_judged() -> None:
    configure(vehicle={"rate_lag": 1e-4})


def test_a_spin_of_half_a_turn_in_a_substep_is_refused() -> None:
    configure(action="rates", vehicle={"rate_max": (500.0, 500.0, 628.0)})
    with pytest.raises(ValueError, match=r"^vehicle\.rate_max = .*below 628\.3 rad/s, half a turn"):
        configure(action="rates", vehicle={"rate_max": (5.0, 5.0, 629.0)})


# -- moments ------------------------------------------------------------------------------------------

NAMED = {
    "Crazyflie 2.x": (0.0319, (1.68e-5, 1.68e-5, 2.98e-5), 0.48, 0.086),
    "Crazyflie 2.1 brushless": (0.0434, (2.5e-5, 2.8e-5, 4.9e-5), 0.80, 0.021),
    "Crazyflie, identified": (0.0306, (9.42e-6, 9.64e-6, 1.75e-5), 0.44, 0.055),
    "Hummingbird": (0.716, (0.007, 0.007, 0.012), 24.0, 0.0125),
    "Pelican": (1.04, (0.01, 0.01, 0.02), 28.1, 0.0125),
    "Holybro X500": (2.0, (0.0217, 0.0213, 0.0394), 63.7, 0.054),
    "PX4 SIH": (1.0, (0.025, 0.025, 0.030), 20.0, 0.05),
}


@pytest.mark.parametrize("name", NAMED)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_named_vehicles_are_accepted(scenario: str, name: str) -> None:
    """Also the smallest with the moments of the paper's vehicle, which a user may have left as they are."""
    mass, inertia, thrust, lag = NAMED[name]
    vehicle = Vehicle(mass, inertia, thrust, rate_lag=lag)
    for action in ("wrench", "rates", "reference"):
        configure(scenario, action=action, vehicle=vehicle)


@pytest.mark.parametrize(
    ("vehicle", "axis"),
    [
        ({"inertia": (2e-6, 2e-6, 4e-6)}, 0),
        ({"moment_max": (100.0, 100.0, 100.0)}, 0),
        ({"moment_max": (0.05, 11.0, 0.02)}, 1),
        ({"inertia": (1e-3, 1e-3, 1e-9)}, 2),
    ],
)
def test_moments_that_a_substep_cannot_follow_are_refused(vehicle: Any, axis: int) -> None:
    with pytest.raises(ValueError, match=rf"^vehicle\.moment_max\[{axis}\] = .*more substeps$"):
        configure(vehicle=vehicle)
    configure("experiment", action="rates", vehicle=vehicle)  # no moments there


def test_more_substeps_follow_more() -> None:
    """`alpha T h <= 1` with alpha = 25,000 rad/s^2 and T = 0.02 s."""
    small = {"inertia": (2e-6, 2e-6, 4e-6)}
    with pytest.raises(ValueError, match="substep"):
        configure(vehicle=small, substeps=9)
    configure(vehicle=small, substeps=10)


# -- numbers ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise": {"position": 1e100}}, r"^noise\.position = 1e\+100: .* at most 1000$"),
        ({"noise": {"velocity": 101.0}}, r"^noise\.velocity = 101\.0: .* at most 100$"),
        ({"noise": {"attitude": 4}}, r"^noise\.attitude = 4: .* at most 3\.14159$"),
        ({"reward": {"effort": 1e308}}, r"^reward\.effort = 1e\+308: .* at most 1e\+06$"),
        ({"reward": {"smoothness": 1e7}}, r"^reward\.smoothness = 10000000\.0: .* at most 1e\+06$"),
        ({"reward": {"failure": 1e9}}, r"^reward\.failure = "),
        ({"reward": {"reach": 1e-200}}, r"^reward\.reach = 1e-200: .* at least 1e-06"),
        ({"reward": {"precision": 0.0}}, r"^reward\.precision = 0\.0: .* at least 1e-06"),
        ({"reward": {"waiting": -0.01}}, r"^reward\.waiting = -0\.01: .* at least 0 "),
        ({"limits": {"lost": 1e5}}, r"^limits\.lost = 100000\.0: .* at most 10000$"),
        ({"limits": {"deadline": 0.0}}, r"^limits\.deadline = 0\.0: .* above 0"),
        ({"limits": {"deadline": 1e10}}, r"^limits\.deadline = 1.*: .* at most 1e\+09$"),
        ({"limits": {"tilt": 1.5}}, r"^limits\.tilt = 1\.5: .* at least -1 and at most 1$"),
        ({"gust": 1e300}, r"^gust = 1e\+300: .* at most 100$"),
        ({"trigger": 1e300}, r"^trigger = 1e\+300: .* at most 10000$"),
        ({"reference_max": (1e300, 1.0, 1.0)}, r"^reference_max\[0\] = 1e\+300: .* at most 100$"),
        ({"vehicle": {"mass": 1e300}}, r"^vehicle\.mass = 1e\+300: .* at most 1e\+06$"),
        ({"vehicle": {"mass": 1e-300}}, r"^vehicle\.mass = 1e-300: .* at least 1e-06"),
        ({"vehicle": {"inertia": (1e300,) * 3}}, r"^vehicle\.inertia\[0\] = 1e\+300: .* 1e\+09$"),
        (
            {"vehicle": {"thrust_max": 1e9}},
            r"^vehicle\.thrust_max = 1000000000\.0: .* at most 98\.1$",
        ),
        ({"planner": {"kz1": 1e10}}, r"^planner\.kz1 = 10000000000\.0: .* at most 1e\+09$"),
        ({"rates_tracker": {"c": 1e-9}}, r"^rates_tracker\.c = 1e-09: .* above 1e-06"),
        ({"offsets": ((1e-4, 1.0, -0.3),)}, r"^offsets\[0\] = .*0\.001 m at least$"),
        ({"offsets": ((0.5, 2e3, -0.3),)}, r"^offsets\[0\] = \[0\.5, 2000\.0, -0\.3\]: .* 1000$"),
        ({"control_period": 11.0}, r"^control_period = 11\.0: .* at most 10$"),
        ({"control_period": 1e-300}, r"^control_period = 1e-300: .*substeps x 1e-06 s = 4e-06 s"),
        ({"measurement_period": 1e300}, r"^measurement_period = 1e\+300: .*at most 1000000$"),
        (
            {"measurement_period": 1e-300},
            r"^measurement_period = 1e-300: .*whole number of substeps",
        ),
        (
            {"duration": 10**20},
            r"^duration = 1e\+20: .*at most 2\^40 control periods = 2\.19902e\+10",
        ),
        ({"duration": 10**400}, r"^duration = 1.*: expected a finite number above 0$"),
        ({"duration": inf}, r"^duration = inf: expected a finite number above 0$"),
    ],
    ids=lambda x: str(x)[:40],
)
def test_the_bound_is_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        configure(**options)
    assert len(str(caught.value)) <= LONGEST


@pytest.mark.parametrize("scenario", ["nominal", "paper", "experiment", "swarm"])
def test_an_episode_without_end_is_accepted(scenario: str) -> None:
    """Without a warning: what is integrated of the path is resolved, however long it is."""
    config = configure(scenario, duration=1e9)
    assert config.max_steps == round(1e9 / config.control_period)
    longest = MAX_TICKS * config.control_period
    assert configure(scenario, duration=0.999 * longest).max_steps <= MAX_TICKS
    with pytest.raises(ValueError, match=r"^duration = .*at most 2\^40 control periods"):
        configure(scenario, duration=1.001 * longest)


def test_an_episode_without_end_on_a_path_that_leads_away_is_not() -> None:
    """At 1.5 m/s the leader would be beyond what an observation can say of its position."""
    with pytest.raises(ValueError, match=r"^trajectory = .*at most 10000 m"):
        configure("agile", duration=1e9)


# -- what is stored is what was checked -----------------------------------------------------------------

AS_INT = (np.int8(2), np.uint8(2), np.int64(2), np.uint64(2))
AS_FLOAT = (np.float16(0.5), np.float32(0.5), np.float64(0.5), np.longdouble(0.5))
NOT_NUMBERS = (
    *(True, np.True_, "1", b"1", 1j, np.complex128(1.0), [1.0], np.array([1.0]), np.zeros(())),
    *(nan, inf, np.longdouble("1e4000"), np.ma.masked, np.ma.masked_array([1.0], mask=[True])),
)
COUNTS = ("substeps", "measurement_delay", "window", "neighbours")
NUMBERS = ("start_offset", "trigger", "control_period", "duration", "gust", "gust_time")


@pytest.mark.parametrize("name", COUNTS)
def test_counts_are_stored_as_int(name: str) -> None:
    for value in AS_INT:
        stored = getattr(configure(**{name: value}), name)
        assert stored == 2
        assert type(stored) is int
    assert configure(neighbours=np.int8(2)).layout.size == configure(neighbours=2).layout.size
    for bad in (*NOT_NUMBERS, 2.0, np.float64(2.0), 2**64, -(2**64), 10**400):
        with pytest.raises(ValueError, match=rf"^{name} = .*: expected an integer from"):
            configure(**{name: bad})


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_are_stored_as_float(name: str) -> None:
    value: Any
    for value in (1, *AS_INT, *AS_FLOAT) if name != "start_offset" else ():
        # A vehicle that turns slowly enough for ticks of 2 s.
        given: dict[str, Any] = {name: value, "vehicle": {"inertia": (0.5, 0.5, 0.5)}}
        config = configure(**given)
        assert getattr(config, name) == float(value)
        assert type(getattr(config, name)) is float
    for bad in NOT_NUMBERS:
        with pytest.raises(ValueError, match=rf"^{name} = .*: expected a finite number"):
            configure(**{name: bad})


@pytest.mark.parametrize("kind", [Vehicle, PlannerGains, TrackerGains])
def test_parts_store_what_they_checked(kind: Any) -> None:
    for name, value in vars(kind()).items():
        given = value
        if isinstance(value, float):
            given = np.longdouble(value)
        elif isinstance(value, tuple):
            given = np.array(value, np.longdouble)
        elif isinstance(value, bool):
            given = np.bool_(value)
        stored = getattr(kind(**{name: given}), name)
        assert stored == value
        assert type(stored) is type(value)
        bad: Any
        for bad in NOT_NUMBERS:
            if isinstance(bad, (bool, np.bool_)) and isinstance(value, bool):
                continue
            with pytest.raises(ValueError, match=rf"\.{name}(\[0\])? = .*: expected"):
                kind(**{name: bad if not isinstance(value, tuple) else [bad, 1.0, 1.0]})


@pytest.mark.parametrize("group", ["noise", "reward", "limits"])
def test_groups_store_what_they_checked(group: str) -> None:
    own = getattr(configure(), group)
    given = type(own)(*map(np.longdouble, own))
    stored = getattr(configure(**{group: given}), group)
    assert stored == own
    assert {type(x) for x in stored} == {float}
    for name in own._fields:
        for bad in NOT_NUMBERS:
            with pytest.raises(
                ValueError, match=rf"^{group}\.{name} = .*: expected a finite number"
            ):
                configure(**{group: {name: bad}})


@pytest.mark.parametrize("name", ["offsets", "follower_starts"])
@pytest.mark.parametrize(
    "bad",
    [
        np.ma.masked_array([[1.0, 2.0, 3.0]], mask=True),
        np.ones((1, 3), complex),
        np.ones((1, 3), bool),
        [["1", "2", "3"]],
        [[1.0, 2.0, True]],
        [[1.0, 2.0, np.longdouble("1e4000")]],
        [[1.0, 2.0, 10**400]],
        np.zeros((0, 3)),
        np.zeros((1, 2)),
        [[1.0, 2.0, 3.0], [1.0, 2.0]],
        np.full((6000, 3), nan),
        7,
    ],
    ids=lambda x: repr(x).partition(" at 0x")[0][:30].replace("\n", ""),
)
def test_tables_of_something_else_are_refused(name: str, bad: Any) -> None:
    with pytest.raises(ValueError, match=rf"^{name}(\[\d+\])? = ") as caught:
        configure(**{name: bad})
    assert len(str(caught.value)) <= LONGEST


@pytest.mark.parametrize("name", ["frameskip", "colour", "x" * 10_000, "scenarios", "n_envs"])
def test_an_unknown_keyword_is_a_type_error(name: str) -> None:
    with pytest.raises(TypeError, match=r"configure\(\) got an unexpected keyword") as caught:
        configure(**{name: 4})
    message = str(caught.value)
    assert len(message) <= LONGEST
    if len(name) < 20:
        assert f"unexpected keyword argument {name!r}: known are scenario, followers" in message
        assert "offsets, trajectory, path, action" in message
        assert message.endswith("neighbours")


# -- whatever is accepted gives numbers -----------------------------------------------------------------

SMALL = {
    **FIELDS,
    "substeps": st.integers(1, 8),
    "neighbours": st.integers(0, 3),
    "duration": spread(0.5, 100.0),
}
FEW = st.lists(st.sampled_from(sorted(SMALL)), min_size=1, max_size=4, unique=True).flatmap(
    lambda names: st.fixed_dictionaries({name: SMALL[name] for name in names})
)


def bang(rng: np.random.Generator, shape: tuple[int, ...], kind: str) -> Any:
    """One action of an adversary: at the ends, anywhere, or the same end for long."""
    if kind == "bang-bang":
        return rng.choice([-1.0, 1.0], shape).astype(np.float32)
    if kind == "one way":
        return np.sign(np.cos(np.arange(np.prod(shape)))).reshape(shape).astype(np.float32)
    return rng.uniform(-1.0, 1.0, shape).astype(np.float32)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(SCENARIOS[:4]),
    FEW,
    st.sampled_from(("bang-bang", "one way", "random")),
    st.integers(0, 2**32),
)
def test_whatever_is_accepted_gives_finite_numbers_within_the_space(
    scenario: str, options: dict[str, Any], kind: str, seed: int
) -> None:
    config = accepted(scenario, options)
    envs = FormationVectorEnv(3, config, autoreset_mode="SAME_STEP")
    rng = np.random.default_rng(seed)
    observation, info = envs.reset(seed=seed)
    for _ in range(40):
        assert envs.observation_space.contains(observation)
        observation, reward, _, _, info = envs.step(bang(rng, envs.action_space.shape, kind))
        assert np.isfinite(reward).all()
        for last in info.get("final_obs", ()):
            assert last is None or envs.single_observation_space.contains(last)
