"""What followers are told: noise of the stated size, delays, rates, and section IV's estimates."""

from __future__ import annotations

from math import radians
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation
from states import filled, line, measured_in

from formation_env import Limits, Noise, configure, trajectories
from formation_env._jit import kernel
from formation_env.config import FormationConfig
from formation_env.core import arrays
from formation_env.core.flight import sense_exactly
from formation_env.core.measuring import measure_with_noise
from formation_env.core.simulation import Simulation
from formation_env.memory.records import LANES, size
from formation_env.paths.references import by_name
from formation_env.physics.quadrotor import GRAVITY, Wrench
from formation_env.physics.sensors import Measured, angular_difference, corrupt
from formation_env.scenarios import PAPER_NOISE


@kernel
def _measure(memory: Any, room: Any, t: int, i: int) -> None:
    measure_with_noise(memory, room, t, i)


FREE = Limits(collision=1e-3, impact=1e3, tilt=-1.0, lost=1e4)
HOVER = trajectories.hover()
Seen = dict[str, npt.NDArray[np.float64]]


def begin(config: FormationConfig, worlds: int = 1) -> tuple[Simulation, Seen]:
    simulation = Simulation(config, worlds)
    for i in range(worlds):
        simulation.seed(i, 7 + i)
    return simulation, named(simulation, simulation.reset())


def named(simulation: Simulation, results: Any) -> Seen:
    """The observation by name, in float64."""
    return simulation.layout.unpack(results.observations.astype(np.float64))


def step(simulation: Simulation, action: Any = 0.0) -> Seen:
    config = simulation.config
    shape = (simulation.num_worlds, config.followers, config.action_size)
    row = np.broadcast_to(np.asarray(action, np.float32), shape).copy()
    return named(simulation, simulation.step(row))


def inertial(seen: Seen, name: str) -> npt.NDArray[np.float64]:
    """A vector entry turned out of the formation frame."""
    c, s = seen["heading"][..., 0], seen["heading"][..., 1]
    x, y, z = np.moveaxis(seen[name], -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


# -- white noise ----------------------------------------------------------------------------------------


def test_noise_has_the_stated_sizes() -> None:
    """III-C's levels, every component, over many worlds that rest on the floor."""
    world, seen = begin(configure("paper", path="as given"), 4000)
    p = world.positions[:, 1:]
    own_velocity = inertial(seen, "leader_velocity") - inertial(seen, "relative_velocity")
    x, z = inertial(seen, "body_x"), inertial(seen, "body_z")
    # A small turn (a, b, c) of the body moves r1 by (0, c, -b) and r3 by (b, -a, 0).
    turn = np.stack([-z[..., 1], z[..., 0], x[..., 1]], axis=-1)
    for error, deviation in (
        (seen["position"] - p, PAPER_NOISE.position),
        (own_velocity, PAPER_NOISE.velocity),
        (inertial(seen, "leader_velocity"), PAPER_NOISE.velocity),
        (inertial(seen, "leader_acceleration"), PAPER_NOISE.acceleration),
        (turn, PAPER_NOISE.attitude),
        (seen["angular_velocity"], PAPER_NOISE.angular_velocity),
    ):
        np.testing.assert_allclose(error.std(axis=(0, 1)), deviation, rtol=0.05)
        assert np.abs(error.mean(axis=(0, 1))).max() < 0.05 * deviation
        parts = error[:, 0].T
        assert np.abs(np.corrcoef(parts) - np.eye(3)).max() < 0.08


def test_noise_is_white_and_followers_share_one_view_of_the_leader() -> None:
    world, _ = begin(configure("paper"), 300)
    p = world.positions[:, 1:]
    errors, leader = [], []
    for _ in range(40):
        seen = step(world, [-1.0, 0, 0, 0])  # they stay on the floor
        errors.append(seen["position"] - p)
        leader.append(inertial(seen, "leader_velocity"))
    noise = np.array(errors) / PAPER_NOISE.position  # (40, worlds, 2, 3)
    assert noise.std() == pytest.approx(1.0, rel=0.02)
    for lag in (1, 2, 7):
        assert abs((noise[:-lag] * noise[lag:]).mean()) < 0.02
    assert abs((noise[:, :, 0] * noise[:, :, 1]).mean()) < 0.02
    np.testing.assert_allclose(np.array(leader)[:, :, 0], np.array(leader)[:, :, 1], atol=1e-6)


def test_the_leader_is_flown_on_noisy_measurements_too() -> None:
    quiet, _ = begin(configure("paper", noise=configure().noise))
    noisy, _ = begin(configure("paper"))
    for _ in range(100):
        step(quiet, [-1, 0, 0, 0]), step(noisy, [-1, 0, 0, 0])
    assert 1e-3 < np.abs(quiet.positions[0, 0] - noisy.positions[0, 0]).max() < 0.5


@pytest.mark.parametrize("field", Noise._fields)
def test_one_kind_of_noise_leaves_the_others_exact(field: str) -> None:
    """And does not change when others are switched on: a draw is a function of what it is for."""
    only = configure().noise._replace(**{field: 0.01})
    options: dict[str, Any] = {"trajectory": HOVER, "start_offset": 0.0}
    _, alone = begin(configure(noise=only, **options))
    _, exact = begin(configure(**options))
    _, together = begin(configure(noise=Noise(0.01, 0.01, 0.01, 0.01, 0.01), **options))
    noisy = {
        "position": "position",
        "velocity": "leader_velocity",
        "acceleration": "leader_acceleration",
        "attitude": "body_z",
        "angular_velocity": "angular_velocity",
    }
    for kind, entry in noisy.items():
        if kind == field:
            assert np.abs(alone[entry] - exact[entry]).max() > 1e-4
            np.testing.assert_array_equal(alone[entry], together[entry])
        else:
            np.testing.assert_array_equal(alone[entry], exact[entry])


def test_noise_in_all_lanes_is_that_of_one_vehicle() -> None:
    """`measure_with_noise`, in steps over all lanes, against `sensors.corrupt`, bit for bit.

    But for the acceleration: with or without noise to be added, its sum is fused in another way.
    """
    noise, who = Noise(0.2, 0.1, 0.01, 0.3, 0.02), 2
    flight = begin(configure(noise=noise), 20)[0]
    memory, room, draw = flight._memory, flight._rooms[0], np.random.default_rng(4)
    views, rooms = arrays.MEMORY.views(memory), arrays.ROOM.views(room)
    x, keys = views["vehicles"][1, who], views["episode_keys"][1]
    x[: size(Measured) * LANES] = filled(Measured, draw)
    keys[:] = draw.integers(0, 2**63, LANES)
    rooms["counts"][:] = np.arange(LANES)
    rooms["commands"][who] = draw.normal(size=size(Wrench) * LANES)
    rooms["pushes"][who] = draw.normal(size=3 * LANES)
    rooms["touches"][who] = 0.0
    _measure(memory, room, 1, who)
    told = views["samples"][1, who, 0].copy()
    frame = line(flight.config.world.airframe)
    exact = x.copy()
    sense_exactly(rooms["commands"][who], rooms["touches"][who], exact, rooms["pushes"][who], frame)
    for lane in range(LANES):
        seen, truth = measured_in(told, lane), measured_in(exact[: len(told)], lane)
        alone = corrupt(truth, noise, keys[lane], who, rooms["counts"][lane])
        np.testing.assert_allclose(alone.a, seen.a, rtol=0.0, atol=1e-14)
        assert alone._replace(a=seen.a) == seen


# -- delay and rate -------------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0, 1, 5])
def test_measurements_arrive_late(delay: int) -> None:
    world, seen = begin(configure(measurement_delay=delay, limits=FREE))
    true = [world.positions[0, 1:]]
    spin = [world.angular_velocities[0, 1:]]
    for k in range(1, 25):
        seen = step(world, [0.3, 0.02, -0.01, 0.01])
        true.append(world.positions[0, 1:])
        spin.append(world.angular_velocities[0, 1:])
        then = max(k - delay, 0)
        np.testing.assert_array_equal(seen["position"][0], true[then].astype(np.float32))
        np.testing.assert_array_equal(seen["angular_velocity"][0], spin[then].astype(np.float32))


def test_measurements_are_held_between_samples() -> None:
    world, _ = begin(configure(measurement_period=0.06, limits=FREE))
    sampled = world.positions[0, 1:]
    for k in range(1, 20):
        seen = step(world, [0.3, 0.0, 0.0, 0.0])
        if k % 3 == 0:
            sampled = world.positions[0, 1:]
        np.testing.assert_array_equal(seen["position"][0], sampled.astype(np.float32))


def test_44_commands_and_50_measurements_a_second_beat() -> None:
    """A follower in free fall tells from its height when it was measured: at multiples of 1/50 s."""
    config = configure(
        "experiment",
        trajectory=trajectories.hover((0.0, 0.0, -100.0)),
        start="formation",
        start_offset=0.0,
        estimator="direct",
        noise=configure().noise,
        gust=0.0,
        limits=FREE,
        leader_start=None,
        follower_starts=None,
    )
    world, seen = begin(config)
    top = seen["position"][0, 0, 2]
    ages = []
    for k in range(1, 80):
        seen = step(world, [-1.0, 0, 0, 0])
        measured = np.sqrt(2.0 * (seen["position"][0, 0, 2] - top) / GRAVITY)
        number = measured * 50.0
        assert number == pytest.approx(k * 50 // 44, abs=5e-3)
        ages.append(k / 44.0 - measured)
    assert min(ages) > -1e-4
    assert max(ages) < 1.0 / 50.0
    assert len({round(age * 1100) for age in ages}) == 22  # substeps of 1/1100 s: 25 and 22 beat


# -- section IV's estimates -----------------------------------------------------------------------------

ESTIMATED: dict[str, Any] = {
    "estimator": "differenced",
    "action": "rates",
    "limits": FREE,
    "start_offset": 0.0,
    "gust": 0.0,
    "path": "as given",
}


def test_velocity_is_a_single_difference() -> None:
    """In free fall `(z_n - z_{n-1}) / h = g (t - h / 2)`: half a period late."""
    hover = trajectories.hover((0.0, 0.0, -100.0))
    world, _ = begin(configure(trajectory=hover, **ESTIMATED))
    for k in range(1, 40):
        seen = step(world, [-1.0, 0, 0, 0])
        velocity = inertial(seen, "leader_velocity") - inertial(seen, "relative_velocity")
        np.testing.assert_allclose(velocity[0, :, 2], GRAVITY * 0.02 * (k - 0.5), rtol=1e-5)
        np.testing.assert_allclose(velocity[0, :, :2], 0.0, atol=1e-6)


def test_leader_acceleration_is_a_moving_average_a_second_late() -> None:
    """Recomputed from the leader's true path with a plain convolution."""
    world, _ = begin(configure(duration=20.0, **ESTIMATED))
    path = [world.positions[0, 0]]
    first = world.velocities[0, 0]
    told = []
    for _ in range(600):
        seen = step(world)
        path.append(world.positions[0, 0])
        told.append(inertial(seen, "leader_acceleration")[0, 0])
    speed = np.vstack([np.tile(first, (101, 1)), np.diff(path, axis=0) / 0.02])
    jumps = np.diff(speed, axis=0) / 0.02
    average = np.stack([np.convolve(jumps[:, i], np.full(100, 0.01), "valid") for i in range(3)])
    np.testing.assert_allclose(told, average.T[1:], atol=1e-5)
    t = 0.02 * np.arange(1, 601)
    late = t > 2.0
    true = by_name(world.config.trajectory(t))["a"]
    a_second_ago = by_name(world.config.trajectory(t - 1.0))["a"]
    error = np.linalg.norm(told - a_second_ago, axis=1)[late].max()
    assert error < 0.35 * np.linalg.norm(told - true, axis=1)[late].max()


def test_angular_velocity_is_a_difference_of_attitudes() -> None:
    """In a turn about one axis it is the angle turned through, divided by the period."""
    world, _ = begin(configure(trajectory=HOVER, **ESTIMATED))
    before = 0.0
    for _ in range(100):
        seen = step(world, [0.0, 0.0, 0.0, 0.4])
        w, _, _, z = world.attitudes[0, 1]
        angle = 2.0 * np.arctan2(z, w)
        rate = ((angle - before + np.pi) % (2.0 * np.pi) - np.pi) / 0.02
        np.testing.assert_allclose(seen["angular_velocity"][0, 0], [0, 0, rate], atol=1e-5)
        before = angle
    assert rate == pytest.approx(
        2.0, abs=1e-3
    )  # 0.4 of 5 rad/s, and more than half a turn is behind


@pytest.mark.parametrize("seed", range(5))
def test_angular_difference_is_the_rotation_vector(seed: int) -> None:
    draw = np.random.default_rng(seed)
    before = Rotation.from_quat(draw.normal(size=4))
    turned = Rotation.from_rotvec(draw.normal(size=3) * 0.8)
    now = before * turned

    def wxyz(r: Rotation, sign: float = 1.0) -> tuple[float, ...]:
        x, y, z, w = (sign * r.as_quat()).tolist()
        return (w, x, y, z)

    for sign in (1.0, -1.0):  # two quaternions are one attitude
        found = angular_difference(wxyz(now, sign), wxyz(before), 0.02)
        np.testing.assert_allclose(found, turned.as_rotvec() / 0.02, rtol=1e-9)
    np.testing.assert_allclose(angular_difference(wxyz(now), wxyz(now), 0.02), 0.0, atol=1e-12)


def test_differences_amplify_noise_as_they_must() -> None:
    """A single difference of positions with noise s has `sqrt(2) s / h`; of attitudes the same."""
    s, turn = 1e-4, radians(0.05)
    noise = Noise(s, 0.0, 0.0, turn, 0.0)
    world, _ = begin(configure(trajectory=HOVER, noise=noise, **ESTIMATED), 1500)
    for _ in range(3):
        seen = step(world)
    own = inertial(seen, "leader_velocity") - inertial(seen, "relative_velocity")
    assert own[..., :2].std() == pytest.approx(np.sqrt(2) * s / 0.02, rel=0.05)
    assert seen["angular_velocity"].std() == pytest.approx(np.sqrt(2) * turn / 0.02, rel=0.05)
