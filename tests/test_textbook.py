"""The textbook's controllers: the slot's motion, and for each law what it achieves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from baselines import make_policy
from baselines.policies.cascade import Feedforward, Limits, LoopGains, limited, turning
from baselines.policies.lee import Lee
from baselines.policies.lqr import Lqr, LqrWeights
from baselines.policies.parts import Measured, Motion, Points, measured
from baselines.policies.slot_motion import SlotPlanner, slot_motion
from baselines.scoring.rollout import fly
from formation_env import FormationConfig, configure
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.physics.quadrotor import GRAVITY, Body, Wrench, derivative
from formation_env.task import COLUMNS

NAMES = ("ff", "ff-filter", "lee", "lqr")
LEVELS = ("wrench", "rates", "reference")
K = np.array((0.0, 0.0, 1.0))


# -- the slot's motion ----------------------------------------------------------------------------


def flown(config: FormationConfig, name: str, ticks: int) -> list[Measured]:
    """What one world's followers measure, tick by tick."""
    simulation = Simulation(config, 1)
    simulation.seed(0, seeded_key(3))
    policy, rows = make_policy(name, config), simulation.reset().observations
    policy.reset(seed=0)
    found = []
    for _ in range(ticks):
        found.append(measured(rows.copy(), config))
        rows = simulation.step(policy.act(rows)).observations
    return found


@pytest.mark.parametrize("scenario", ["nominal", "agile"])
def test_the_slots_motion_is_the_derivative_of_its_position(scenario: str) -> None:
    """By central differences along a flight with ticks of 10 ms: truncation and float32 leave 1 or 2 %."""
    config = configure(scenario, control_period=0.01, substeps=2, gust=0.0)
    planner = SlotPlanner(config)
    points = [planner.plan(m) for m in flown(config, "expert", 300)]
    p, v, a = (np.stack([getattr(point, name) for point in points]) for name in "pva")
    h = config.control_period
    dp, dv = (p[2:] - p[:-2]) / (2 * h), (v[2:] - v[:-2]) / (2 * h)
    assert np.abs(dp - v[1:-1]).max() < 0.01 * np.abs(v).max()
    assert np.abs(dv - a[1:-1]).max() < 0.02 * np.abs(a).max()
    # Both turning terms matter here: the leader's own motion is another.
    leader = np.stack([m.leader.a for m in flown(config, "expert", 300)])
    assert np.abs(a - leader).max() > 0.1


def test_the_slot_error_is_the_simulations() -> None:
    config = configure("nominal")
    simulation = Simulation(config, 1)
    simulation.seed(0, seeded_key(1))
    policy, results = make_policy("expert", config), simulation.reset()
    for _ in range(50):
        results = simulation.step(policy.act(results.observations))
    m = measured(results.observations, config)
    error = SlotPlanner(config).plan(m).p - m.motion.p
    assert error[0] == pytest.approx(results.outputs[0][:, COLUMNS["slot_error"]], abs=2e-6)


def test_before_the_trigger_the_slot_stands_still() -> None:
    config = configure("paper", noise={"velocity": 0.0, "position": 0.0})
    m = flown(config, "hover", 30)[-1]
    moving = m._replace(leader=m.leader._replace(v=m.leader.v + 1.0, a=m.leader.a + 1.0))
    assert not m.started.any()
    s = slot_motion(moving)
    assert not s.velocity.any() and not s.acceleration.any() and not s.turn_rate.any()
    started = slot_motion(moving._replace(started=np.ones_like(m.started)))
    assert np.abs(started.acceleration).min(axis=(0, 1))[:2].max() > 0.1


def test_a_leader_that_cannot_be_seen_sideways_gives_finite_numbers() -> None:
    """`d_x = 0`, or next to it."""
    config = configure("nominal")
    m = flown(config, "expert", 3)[-1]
    for d_x in (0.0, 1e-300, -1e-30):
        offset = m.offset.copy()
        offset[..., 0] = d_x
        for part in slot_motion(m._replace(offset=offset)):
            assert np.isfinite(part).all()


# -- the loops ------------------------------------------------------------------------------------


def motions(seed: int, size: int = 50, tilt: float = 0.3) -> tuple[Motion, Points]:
    """Vehicles about level, and points of trajectories near them, `(1, size, 3)`."""
    rng = np.random.default_rng(seed)
    shape = (1, size, 3)
    p, v, w = rng.normal(size=shape), rng.normal(size=shape), rng.normal(size=shape)
    yaw, axis = rng.uniform(-np.pi, np.pi, size), tilt * rng.normal(size=shape)
    turn = np.zeros((1, size, 3, 3))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(yaw)
    turn[..., 1, 0], turn[..., 0, 1], turn[..., 2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    R = exponential(axis) @ turn
    path = [0.3 * rng.normal(size=shape) for _ in range(5)]
    return Motion(p, v, R, w), Points(p + path[0], v + path[1], *path[2:])


def exponential(axis: np.ndarray) -> np.ndarray:
    """The rotations by rotation vectors, by SciPy."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(axis.reshape(-1, 3)).as_matrix().reshape(*axis.shape, 3)


def alpha_of(wrench: Wrench, motion: Motion, config: FormationConfig) -> np.ndarray:
    """The angular acceleration of a vehicle under a command, rad/s^2."""
    turn: Any = wrench.turn
    if config.action == "rates":
        return np.asarray((turn - motion.w) / config.vehicle.rate_lag)
    J = np.array(config.vehicle.inertia)
    return np.asarray((turn - np.cross(motion.w, J * motion.w)) / J)


@pytest.mark.parametrize("level", ["wrench", "rates"])
def test_what_turns_a_vehicle_makes_the_angular_acceleration(level: str) -> None:
    config = configure("nominal", action=level, vehicle={"inertia": (1e-3, 1.5e-3, 2e-3)})
    motion, _ = motions(0)
    alpha = np.random.default_rng(1).normal(size=motion.w.shape)
    wrench = Wrench(0.0, turning(alpha, motion.w, config))  # type: ignore[arg-type]
    assert alpha_of(wrench, motion, config) == pytest.approx(alpha)


def test_limits_keep_the_horizontal_direction() -> None:
    a = np.array(((3.0, -4.0, 1.0), (0.3, 0.4, -7.0)))
    assert limited(a, Limits(2.5, 2.0)) == pytest.approx(
        np.array(((1.5, -2.0, 1.0), (0.3, 0.4, -2.0)))
    )


@pytest.mark.parametrize("tracker", [Feedforward, Lee])
def test_on_the_slot_with_its_acceleration_nothing_is_left_to_correct(tracker: Any) -> None:
    """With null errors and the thrust turned to where it is wanted, the vehicle accelerates as its slot does:
    the derivative of the velocity error is zero, whatever the acceleration."""
    config = configure("nominal")
    motion, point = motions(2)
    b = GRAVITY * K - point.a
    r3 = b / np.linalg.norm(b, axis=-1, keepdims=True)
    r1 = np.cross(np.array((0.0, 1.0, 0.0)), r3)
    r1 /= np.linalg.norm(r1, axis=-1, keepdims=True)
    R = np.stack((r1, np.cross(r3, r1), r3), axis=-1)
    on = Motion(point.p, point.v, R, np.zeros_like(motion.w))
    still = point._replace(j=np.zeros_like(b), s=np.zeros_like(b))
    wrench = tracker(config).command(on, still)
    lift = np.asarray(wrench.thrust)[..., None] / config.vehicle.mass
    assert GRAVITY * K - lift * r3 == pytest.approx(point.a)
    assert alpha_of(wrench, on, config) == pytest.approx(0.0, abs=1e-9)


def test_lees_attitude_errors_are_those_of_the_matrices() -> None:
    """(10) and (11) of the article, from whole matrices: `e_R = (R_d^T R - R^T R_d)^v / 2`."""
    tracker = Lee(configure("nominal"))
    motion, point = motions(3)
    d = tracker.wanted(motion, point)
    e = tracker.errors(motion, d)
    b1 = motion.R[..., :, 0]
    c = -np.cross(d.b3, np.cross(d.b3, b1))
    c /= np.linalg.norm(c, axis=-1, keepdims=True)
    R_d = np.stack((c, np.cross(d.b3, c), d.b3), axis=-1)
    swapped = np.swapaxes(R_d, -1, -2) @ motion.R
    skew = 0.5 * (swapped - np.swapaxes(swapped, -1, -2))
    vee = np.stack((skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]), axis=-1)
    assert e.R == pytest.approx(vee, abs=1e-12)
    assert np.linalg.det(R_d) == pytest.approx(1.0)
    assert e.w == pytest.approx(motion.w - (np.swapaxes(motion.R, -1, -2) @ d.w[..., None])[..., 0])


def moved(motion: Motion, point: Points, wrench: Wrench, config: Any, h: float) -> Any:
    """Vehicles and points `h` seconds later, to second order (the model (41)-(44), the points' series)."""
    p, v, R, w = motion
    a = GRAVITY * K - np.asarray(wrench.thrust)[..., None] / config.vehicle.mass * R[..., :, 2]
    w_mid = w + 0.5 * h * alpha_of(wrench, motion, config)
    after = Motion(
        p + h * v + 0.5 * h * h * a,
        v + h * a,
        R @ exponential(h * w_mid),
        w + h * alpha_of(wrench, motion, config),
    )
    q, u, b, j, s = point
    on = Points(
        q + h * u + h**2 / 2 * b, u + h * b + h**2 / 2 * j, b + h * j + h**2 / 2 * s, j + h * s, s
    )
    return after, on


@pytest.mark.parametrize("level", ["wrench", "rates"])
def test_lees_wanted_attitude_moves_as_it_says_and_its_errors_decay(level: str) -> None:
    """Central differences along the closed loop: `b3_dot = omega_d x b3`, the rate of `omega_d`, and
    `e_omega_dot = -k_R e_R - k_omega e_omega`, by which the article's function of the attitude falls."""
    config = configure("nominal", action=level)
    tracker = Lee(config, LoopGains(sideways=1e3, upwards=9.0))
    motion, point = motions(4)
    wrench = tracker.command(motion, point)
    h = 1e-5
    parts = []
    for step in (-h, h):
        there, on = moved(motion, point, wrench, config, step)
        d = tracker.wanted(there, on)
        parts.append((d, tracker.errors(there, d)))
    (d0, e0), (d1, e1) = parts
    d, e = tracker.wanted(motion, point), tracker.errors(motion, tracker.wanted(motion, point))
    assert np.cross(d.w, d.b3) == pytest.approx((d1.b3 - d0.b3) / (2 * h), abs=1e-4)
    # Along b3 the wanted attitude does not turn, and its rate there is not defined by b3.
    rate = (d1.w - d0.w) / (2 * h)
    assert np.cross(d.b3, np.cross(d.w_dot, d.b3)) == pytest.approx(
        np.cross(d.b3, np.cross(rate, d.b3)), abs=2e-3
    )
    g = tracker.gains
    assert (e1.w - e0.w) / (2 * h) == pytest.approx(-g.attitude * e.R - g.rate * e.w, abs=0.02)


def test_lees_position_errors_vanish_where_the_thrust_is_aligned() -> None:
    """Linearised: with `r3 = b3`, `e_ddot + k_v e_dot + k_x e = 0` exactly."""
    config = configure("nominal")
    tracker = Lee(config, LoopGains(sideways=1e3, upwards=9.0))
    motion, point = motions(5)
    d = tracker.wanted(motion, point)
    r1 = np.cross(np.array((0.0, 1.0, 0.0)), d.b3)
    r1 /= np.linalg.norm(r1, axis=-1, keepdims=True)
    aligned = motion._replace(R=np.stack((r1, np.cross(d.b3, r1), d.b3), axis=-1))
    lift = np.asarray(tracker.command(aligned, point).thrust)[..., None] / config.vehicle.mass
    e_ddot = GRAVITY * K - lift * d.b3 - point.a
    e, e_dot = motion.p - point.p, motion.v - point.v
    assert e_ddot == pytest.approx(-4.0 * e_dot - 4.0 * e)


# -- the regulator --------------------------------------------------------------------------------


@pytest.mark.parametrize("level", ["wrench", "rates"])
def test_the_regulators_gain_solves_the_riccati_equation(level: str) -> None:
    """From `K` alone: `A - B K` is stable, and the `P` of its cost (Lyapunov's equation) gives `K` back."""
    from scipy.linalg import solve_continuous_lyapunov

    tracker = Lqr(configure("nominal", action=level))
    A, B, Q, R = tracker.hover
    closed = A - B @ tracker.K
    assert np.linalg.eigvals(closed).real.max() < -0.5
    P = solve_continuous_lyapunov(closed.T, -(Q + tracker.K.T @ R @ tracker.K))
    residual = A.T @ P + P @ A - P @ B @ np.linalg.solve(R, B.T @ P) + Q
    assert np.abs(residual).max() < 1e-8 * np.abs(P).max()
    assert np.linalg.solve(R, B.T @ P) == pytest.approx(tracker.K, rel=1e-6, abs=1e-9)
    assert np.linalg.eigvalsh(0.5 * (P + P.T)).min() > 0.0


@pytest.mark.parametrize("level", ["wrench", "rates"])
def test_the_linearisation_is_that_of_the_rigid_body(level: str) -> None:
    """`A x + B u` by the difference of the model's own derivative at hover, one state and input at a time."""
    config = configure("nominal", action=level)
    A, B, _, _ = Lqr(config).hover
    airframe, eps = config.vehicle.airframe(), 1e-6

    def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        q = (1.0, 0.5 * x[6], 0.5 * x[7], 0.0)  # of a small rotation vector
        body = Body(tuple(x[:3]), tuple(x[3:6]), q, tuple(x[8:]))
        wrench = Wrench(config.vehicle.mass * GRAVITY + u[0], tuple(u[1:]))
        d = derivative(body, wrench, (0.0, 0.0, 0.0), config.follower_actuation, airframe)
        return np.array((*d.p, *d.v, 2.0 * d.q[1], 2.0 * d.q[2], *d.w))

    zero, no = np.zeros(11), np.zeros(4)
    states = [(rate(eps * e, no) - rate(-eps * e, no)) / (2 * eps) for e in np.eye(11)]
    inputs = [(rate(zero, eps * e) - rate(zero, -eps * e)) / (2 * eps) for e in np.eye(4)]
    assert np.array(states).T == pytest.approx(A, abs=1e-6)
    assert np.array(inputs).T == pytest.approx(B, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("level", ["wrench", "rates"])
def test_near_hover_the_regulators_command_is_its_gain(level: str) -> None:
    """`u = -K x` in the vehicle's own yaw, to first order in `x`, for other moments of inertia too."""
    config = configure("nominal", action=level, vehicle={"inertia": (1e-3, 1.5e-3, 2e-3)})
    tracker = Lqr(config)
    size, eps = 40, 1e-6
    rng = np.random.default_rng(6)
    x = eps * rng.normal(size=(1, size, 11))
    yaw = rng.uniform(-np.pi, np.pi, size)
    turn = np.zeros((1, size, 3, 3))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(yaw)
    turn[..., 1, 0], turn[..., 0, 1], turn[..., 2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    tilt = np.concatenate((x[..., 6:8], np.zeros((1, size, 1))), axis=-1)
    p, v = ((turn @ x[..., s, None])[..., 0] for s in (slice(0, 3), slice(3, 6)))
    motion = Motion(p, v, turn @ exponential(tilt), x[..., 8:])
    zero = np.zeros_like(p)
    thrust, moment = tracker.command(motion, Points(zero, zero, zero, zero, zero))
    u = np.concatenate(
        (np.asarray(thrust)[..., None] - config.vehicle.mass * GRAVITY, moment), axis=-1
    )
    assert u / eps == pytest.approx(-x @ tracker.K.T / eps, rel=1e-4, abs=1e-4)


def test_weights_and_gains_that_cannot_be_are_refused() -> None:
    config = configure("nominal")
    with pytest.raises(ValueError, match=r"gains.position = 0.0: expected a finite number above 0"):
        make_policy("ff", config).tracker.__class__(config, LoopGains(position=0.0))  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match=r"gains.upwards = 9.81"):
        Lee(config, LoopGains(upwards=GRAVITY))
    with pytest.raises(ValueError, match=r"weights.tilt = nan"):
        Lqr(config, LqrWeights(tilt=float("nan")))
    with pytest.raises(ValueError, match=r"gains = 3: expected a LoopGains"):
        Lee(config, 3)  # type: ignore[arg-type]


# -- in flight ------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", NAMES)
def test_on_nominal_they_keep_the_slot_to_centimetres(name: str, level: str) -> None:
    config = configure("nominal", action=level, gust=0.0)
    columns = fly(make_policy(name, config), range(3))
    assert columns["failed"].max() == 0.0
    assert columns["slot_error_late"].max() < 0.03


def test_with_noise_the_filter_keeps_the_slot_better() -> None:
    config = configure("paper")
    plain, filtered = (fly(make_policy(name, config), range(4)) for name in ("ff", "ff-filter"))
    assert filtered["slot_error_late"].mean() < 0.95 * plain["slot_error_late"].mean()


def test_without_noise_the_filter_changes_nothing_that_matters() -> None:
    config = configure("nominal")
    plain, filtered = (fly(make_policy(name, config), range(3)) for name in ("ff", "ff-filter"))
    assert filtered["slot_error"] == pytest.approx(plain["slot_error"], rel=0.01)


@pytest.mark.parametrize("name", ["ff", "lee", "lqr"])
def test_without_memory_no_episode_is_noticed(name: str) -> None:
    assert not make_policy(name, configure("nominal")).remembers
    assert make_policy("ff-filter", configure("nominal")).remembers
