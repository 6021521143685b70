"""The tracker against section III-B: errors, closed-form rates, and theorem 2 with its function.

The paper's formulas are written here in matrices, and time derivatives by differences along the
motion; of the package the tests take the laws.
"""

from __future__ import annotations

import numpy as np
import pytest
from closed_loop import PROPERTY, Array, Sines, agree, hat, quaternions, rate, vector, vectors
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from formation_env.laws import tracker
from formation_env.laws.tracker import Motion, TrackerLaw
from formation_env.maths import so3
from formation_env.maths.so3 import Quaternion, Vector
from formation_env.paths.references import TrajectoryPoint
from formation_env.physics.quadrotor import GRAVITY

PAPER = TrackerLaw(
    k1=0.5, k2=1.5, k3=10.0, k4=0.5, kz=1.0, sigma_max=5.0, c=50.0, p11=1.0, p12=1.0 / 3.0, p22=0.5
)
# No two gains alike and none special, so that no factor can stand for another.
GENERIC = TrackerLaw(
    k1=0.7, k2=1.3, k3=4.0, k4=0.9, kz=1.2, sigma_max=3.0, c=20.0, p11=0.8, p12=0.3, p22=0.55
)
MASS = 0.1  # kg
K = np.array([0.0, 0.0, 1.0])

LAWS = st.sampled_from([PAPER, GENERIC])
SEEDS = st.integers(0, 20)
TIMES = st.floats(0.0, 5.0)
STATES = st.tuples(vectors(4.0), vectors(2.0), quaternions(), vectors(2.0), TIMES).map(
    lambda s: np.array([*s[0], *s[1], *s[2], *s[3], s[4]])
)


def motion(x: Array) -> Motion:
    """From the state vector `p, R v, q, omega, t` (14 numbers)."""
    q = so3.normalise(vector(x[6:10]))
    return Motion(vector(x[0:3]), vector(x[3:6]), so3.rotation(q), vector(x[10:13]))


def target(x: Array, seed: int) -> TrajectoryPoint:
    return TrajectoryPoint(*Sines(seed).at(x[13]))


def R_of(x: Array) -> Array:
    return Rotation.from_quat([x[7], x[8], x[9], x[6]]).as_matrix()


def flow(x: Array, thrust: float, tau: Array | Vector) -> Array:
    """(41)-(43), (45), (47), and `t_dot = 1`."""
    q, w = x[6:10], x[10:13]
    v_dot = GRAVITY * K - thrust / MASS * R_of(x)[:, 2]
    q_dot = 0.5 * np.array(so3.multiply(vector(q), (0.0, *vector(w))))
    return np.concatenate([x[3:6], v_dot, q_dot, tau, [1.0]])


# ---- the paper's formulas


def sigma_e(y: Array, law: TrackerLaw) -> Array:
    """(50)."""
    return law.sigma_max * y / np.sqrt(law.c + y**2)


def sigma_slope(y: Array, law: TrackerLaw) -> Array:
    return law.sigma_max * law.c / (law.c + y**2) ** 1.5


def tracking_errors(x: Array, seed: int) -> tuple[Array, Array]:
    """(48), (49)."""
    ref = target(x, seed)
    return x[0:3] - ref.p, x[3:6] - ref.v


def thrust_vector(x: Array, seed: int, law: TrackerLaw) -> Array:
    """`T_d r3d / m` (51)-(52)."""
    e1, e2 = tracking_errors(x, seed)
    return GRAVITY * K - target(x, seed).a + sigma_e(law.k1 * e1 + law.k2 * e2, law)


def direction(x: Array, seed: int, law: TrackerLaw) -> Array:
    b = thrust_vector(x, seed, law)
    return b / np.linalg.norm(b)


def paper_thrust(x: Array, seed: int, law: TrackerLaw) -> float:
    """(54)."""
    b = thrust_vector(x, seed, law)
    return float(MASS * np.linalg.norm(b) * direction(x, seed, law) @ R_of(x)[:, 2])


def delta(x: Array, seed: int, law: TrackerLaw) -> Array:
    """(58)."""
    e1, e2 = tracking_errors(x, seed)
    y = law.k1 * e1 + law.k2 * e2
    s = sigma_e(y, law)
    inner = law.p11 * s - law.p12 * e2
    return law.k2 * np.diag(sigma_slope(y, law)) @ inner + (law.k2 - law.p12) * s + law.p22 * e2


def paper_e4(x: Array, seed: int, law: TrackerLaw) -> Array:
    """(65), with `r3d_dot` by differences under the thrust (54)."""
    R, r3d = R_of(x), direction(x, seed, law)
    x_dot = flow(x, paper_thrust(x, seed, law), np.zeros(3))
    r3d_dot = rate(lambda y: direction(y, seed, law), x, x_dot)
    n = np.linalg.norm(thrust_vector(x, seed, law))
    B = R.T @ (law.k3 * r3d + n * delta(x, seed, law))
    return hat(K) @ (x[10:13] - R.T @ hat(r3d) @ r3d_dot) - hat(K) @ hat(K) @ B


def P_of(law: TrackerLaw) -> Array:
    """(56)."""
    return np.kron([[law.p11, -law.p12], [-law.p12, law.p22]], np.eye(3))


def Q_of(y: Array, law: TrackerLaw) -> Array:
    """The matrix below (58), at `y = k1 e1 + k2 e2`."""
    s1, one = np.diag(sigma_slope(y, law)), np.eye(3)
    k1, k2, p11, p12, p22 = law.k1, law.k2, law.p11, law.p12, law.p22
    Q11 = (k2 - p12) * one + p11 * k2 * s1
    Q12 = -0.5 * (k1 * p11 + k2 * p12) * s1 - 0.5 * (k1 - p22) * one
    return np.block([[Q11, Q12], [Q12, p12 * k1 * s1]])


def stacked(x: Array, seed: int, law: TrackerLaw) -> tuple[Array, Array]:
    """`[sigma_e, e2]` and `k1 e1 + k2 e2`."""
    e1, e2 = tracking_errors(x, seed)
    y = law.k1 * e1 + law.k2 * e2
    return np.concatenate([sigma_e(y, law), e2]), y


# ---- the laws against them


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_thrust_and_errors_are_the_papers(x: Array, seed: int, law: TrackerLaw) -> None:
    m, ref = motion(x), target(x, seed)
    e = tracker.errors(m, ref, law)
    e1, e2 = tracking_errors(x, seed)
    agree(e.e1, e1, 1e-13)
    agree(e.e2, e2, 1e-13)
    agree(e.e3, R_of(x)[:, 2] - direction(x, seed, law), 1e-12)
    agree(e.e4, paper_e4(x, seed, law), 1e-8)
    agree(tracker.torque(m, ref, MASS, law).thrust, paper_thrust(x, seed, law), 1e-12)
    agree(tracker.rate_command(m, ref, MASS, law).thrust, paper_thrust(x, seed, law), 1e-12)


@PROPERTY
@given(vectors(20.0), LAWS)
def test_saturation_and_its_derivatives(y: Vector, law: TrackerLaw) -> None:
    """(50): bounded by `sigma_max`, slope `sigma_max / sqrt(c)` at zero; its derivatives."""
    at, ones = np.array(y), np.ones(3)
    agree(tracker.saturation(y, law), sigma_e(at, law), 1e-13)
    assert np.abs(tracker.saturation(y, law)).max() < law.sigma_max
    slope = rate(lambda z: np.array(tracker.saturation(vector(z), law)), at, ones)
    agree(tracker.saturation_slope(y, law), slope, 1e-9)
    curvature = rate(lambda z: np.array(tracker.saturation_slope(vector(z), law)), at, ones)
    agree(tracker.saturation_curvature(y, law), curvature, 1e-9)
    agree(tracker.saturation_slope(so3.ZERO, law), ones * law.sigma_max / np.sqrt(law.c), 1e-14)


@PROPERTY
@given(STATES, SEEDS, LAWS, vectors(5.0))
def test_closed_form_rates(x: Array, seed: int, law: TrackerLaw, tau: Vector) -> None:
    """Every `_dot` is the rate of its quantity under the thrust law (54), whatever the torque."""
    x_dot = flow(x, paper_thrust(x, seed, law), tau)

    def loops(y: Array) -> tuple[tracker.Outer, tracker.Pointing]:
        m = motion(y)
        o = tracker.outer(m, target(y, seed), law)
        return o, tracker.pointing(m, o, law)

    def moving(y: Array) -> Array:
        o, p = loops(y)
        return np.concatenate([o.e1, o.e2, o.sigma, o.b, o.b_dot, o.delta, p.A, p.B])

    o, p = loops(x)
    expected = np.split(rate(moving, x, x_dot, 1e-4), 8)
    found = (o.e2, o.e2_dot, o.sigma_dot, o.b_dot, o.b_ddot, o.delta_dot, p.A_dot, p.B_dot)
    for value, changing in zip(found, expected, strict=True):
        agree(value, changing, 1e-7)


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_torque_makes_e4_a_damped_error(x: Array, seed: int, law: TrackerLaw) -> None:
    """(67): `e4_dot = -k4 e4 - (R^T r3d)_xy`; (68): `omega_z_dot = -k_z omega_z`."""
    command = tracker.torque(motion(x), target(x, seed), MASS, law)
    x_dot = flow(x, command.thrust, command.tau)

    def e4(y: Array) -> Array:
        return np.array(tracker.errors(motion(y), target(y, seed), law).e4)

    pull = R_of(x).T @ direction(x, seed, law)
    expected = -law.k4 * e4(x) - np.array([pull[0], pull[1], 0.0])
    agree(rate(e4, x, x_dot, 1e-4), expected, 1e-7)
    agree(command.tau[2], -law.kz * x[12], 1e-13)


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_lyapunov_function_is_the_papers(x: Array, seed: int, law: TrackerLaw) -> None:
    """(55), (60), (63), (66), the integral by quadrature, with the block matrices as printed."""
    found = tracker.certificate(motion(x), target(x, seed), law)
    z, y = stacked(x, seed, law)
    stored = sum(quad(lambda u: float(sigma_e(np.array(u), law)), 0.0, end)[0] for end in y)
    V_sigma = 0.5 * z @ P_of(law) @ z + stored
    e = tracker.errors(motion(x), target(x, seed), law)
    V3 = V_sigma + 0.5 * np.dot(e.e3, e.e3)
    agree(found.V_sigma, V_sigma, 1e-9)
    agree(found.V3, V3, 1e-9)
    agree(found.V4, V3 + 0.5 * np.dot(e.e4, e.e4), 1e-9)
    agree(found.W, z @ Q_of(y, law) @ z, 1e-10)


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_theorem_2(x: Array, seed: int, law: TrackerLaw) -> None:
    """Along the closed loop `V4` changes as (69) says, and never rises."""
    command = tracker.torque(motion(x), target(x, seed), MASS, law)
    x_dot = flow(x, command.thrust, command.tau)
    now = tracker.certificate(motion(x), target(x, seed), law)

    def V(y: Array) -> Array:
        c = tracker.certificate(motion(y), target(y, seed), law)
        return np.array([c.V_sigma, c.V4])

    tilt = hat(R_of(x)[:, 2]) @ direction(x, seed, law)
    n = np.linalg.norm(thrust_vector(x, seed, law))
    square = hat(R_of(x)[:, 2]) @ hat(R_of(x)[:, 2])
    V_sigma_dot = -now.W - n * delta(x, seed, law) @ square @ direction(x, seed, law)
    e4 = paper_e4(x, seed, law)
    V4_dot = -now.W - law.k3 * tilt @ tilt - law.k4 * e4 @ e4
    agree(rate(V, x, x_dot, 1e-4), [V_sigma_dot, V4_dot], 1e-7)
    agree(now.V4_dot, V4_dot, 1e-7)
    if law is PAPER:
        assert now.W >= 0.0
        assert now.V4_dot <= 0.0


@PROPERTY
@given(vectors(100.0))
def test_Q_is_positive_definite_with_the_papers_gains(y: Vector) -> None:
    assert np.linalg.eigvalsh(Q_of(np.array(y), PAPER)).min() > 0.0
    assert np.linalg.eigvalsh(P_of(PAPER)).min() > 0.0


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_rates_stop_the_backstepping_one_step_earlier(x: Array, seed: int, law: TrackerLaw) -> None:
    """They make `e4 = 0`, and `V3` falls as (64) without its last line."""
    ref = target(x, seed)
    command = tracker.rate_command(motion(x), ref, MASS, law)
    x = np.concatenate([x[:10], command.w, x[13:]])
    agree(tracker.errors(motion(x), ref, law).e4, np.zeros(3), 1e-12)
    assert command.w[2] == 0.0
    now = tracker.certificate(motion(x), ref, law)
    x_dot = flow(x, command.thrust, np.zeros(3))
    found = rate(
        lambda y: np.array(tracker.certificate(motion(y), target(y, seed), law).V3), x, x_dot, 1e-4
    )
    tilt = hat(R_of(x)[:, 2]) @ direction(x, seed, law)
    agree(found, -now.W - law.k3 * tilt @ tilt, 1e-7)


@PROPERTY
@given(STATES, SEEDS, LAWS, st.floats(0.02, 0.3))
def test_rates_through_a_lag_still_drive_e4_to_zero(
    x: Array, seed: int, law: TrackerLaw, lag: float
) -> None:
    """With `omega_dot = (omega_c - omega) / lag`: `e4_dot = -e4 / lag`, and `omega_z` alike."""
    command = tracker.rate_command_through_lag(motion(x), target(x, seed), MASS, law, lag)
    agree(command.thrust, paper_thrust(x, seed, law), 1e-12)
    w_dot = (np.array(command.w) - x[10:13]) / lag

    def e4(y: Array) -> Array:
        return np.array(tracker.errors(motion(y), target(y, seed), law).e4)

    found = rate(e4, x, flow(x, command.thrust, w_dot), 1e-4)
    agree(found, -e4(x) / lag, 1e-7)
    agree(w_dot[2], -x[12] / lag, 1e-12)


@PROPERTY
@given(STATES, SEEDS, LAWS, st.integers(1, 3), vectors(10.0))
def test_quarter_turns_and_shifts_of_the_scene_change_nothing(
    x: Array, seed: int, law: TrackerLaw, quarters: int, shift: Vector
) -> None:
    """About the vertical. Other angles do change something: (50) saturates along north and east."""
    turn = (0.0, 0.0, 0.5 * np.pi * quarters)
    Z, q = expm(hat(turn)), so3.exponential(turn)
    turned = so3.multiply(q, vector(x[6:10]))
    y = np.concatenate([Z @ x[0:3] + shift, Z @ x[3:6], turned, x[10:]])
    ref = target(x, seed)
    p, *rest = (vector(Z @ np.array(a)) for a in ref)
    there = TrajectoryPoint(vector(np.array(p) + shift), *rest)
    a = tracker.torque(motion(x), ref, MASS, law)
    b = tracker.torque(motion(y), there, MASS, law)
    agree([b.thrust, *b.tau], [a.thrust, *a.tau], 1e-10)


@PROPERTY
@given(STATES, SEEDS, LAWS, st.floats(-3.0, 3.0))
def test_turning_the_body_about_its_thrust_turns_the_torque_with_it(
    x: Array, seed: int, law: TrackerLaw, yaw: float
) -> None:
    """Which way the nose points is free: in inertial axes thrust and torque stay, at any angle."""
    turn = (0.0, 0.0, yaw)
    Z = expm(hat(turn))
    q = so3.multiply(vector(x[6:10]), so3.exponential(turn))
    y = np.concatenate([x[0:6], q, Z.T @ x[10:13], x[13:]])
    ref = target(x, seed)
    a = tracker.torque(motion(x), ref, MASS, law)
    b = tracker.torque(motion(y), ref, MASS, law)
    agree([b.thrust, *(Z @ np.array(b.tau))], [a.thrust, *a.tau], 1e-10)


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_hover_is_an_equilibrium(yaw: float) -> None:
    """At the reference, level and still: `T = m g` and no torque, at any yaw."""
    still = TrajectoryPoint((1.0, 2.0, -3.0), *([so3.ZERO] * 4))
    m = Motion(still.p, so3.ZERO, so3.rotation(so3.exponential((0.0, 0.0, yaw))), so3.ZERO)
    command = tracker.torque(m, still, MASS, PAPER)
    agree([command.thrust, *command.tau], [MASS * GRAVITY, 0.0, 0.0, 0.0], 1e-13)
    c = tracker.certificate(m, still, PAPER)
    agree([c.V_sigma, c.V3, c.V4, c.W, c.V4_dot], np.zeros(5), 1e-13)


# ---- figure 4


def lemniscate(t: float) -> TrajectoryPoint:
    """(31) at a constant height of 1.5 m."""
    x = [2.0 * 0.25**n * np.cos(0.25 * t + 0.5 * np.pi * n) for n in range(5)]
    y = [0.5**n * np.sin(0.5 * t + 0.5 * np.pi * n) for n in range(5)]
    z = [-1.5, 0.0, 0.0, 0.0, 0.0]
    return TrajectoryPoint(*(vector(row) for row in zip(x, y, z, strict=True)))


def loop(_t: float, x: Array) -> Array:
    command = tracker.torque(motion(x), lemniscate(x[13]), MASS, PAPER)
    return flow(x, command.thrust, command.tau)


def test_the_upside_down_start_of_figure_4() -> None:
    """III-C: `V4` never rises; `e3`, `e4` go first while `e2` grows; all vanish within 30 s."""
    q: Quaternion = (0.0, 1.0, 0.0, 0.0)  # phi = pi
    x = np.array([-5.0, 10.0, -10.0, 0.0, 0.0, 0.0, *q, 0.0, 0.0, 0.4, 0.0])
    path = solve_ivp(
        loop, (0.0, 30.0), x, method="DOP853", rtol=1e-9, atol=1e-9, t_eval=np.linspace(0, 30, 601)
    )
    assert path.success
    states = path.y.T
    V4 = np.array([tracker.certificate(motion(y), lemniscate(y[13]), PAPER).V4 for y in states])
    assert (np.diff(V4) < 1e-7).all()
    errors = [tracker.errors(motion(y), lemniscate(y[13]), PAPER) for y in states]
    e1, e2, e3, e4 = (np.linalg.norm([e[k] for e in errors], axis=1) for k in range(4))
    assert e3[0] > 1.9
    assert e2[40] > 2.0 * e2[0]
    assert e3[40] < 0.1 * e3[0] and e4[40] < 0.4 * e4[0] and e1[40] > 0.4 * e1[0]
    assert e1[200] < 0.1 * e1[0]
    assert max(e1[-1], e2[-1], e3[-1], e4[-1]) < 0.01
    agree(states[:, 12], 0.4 * np.exp(-PAPER.kz * path.t), 1e-7)
