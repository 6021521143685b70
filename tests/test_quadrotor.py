"""The rigid body against mechanics: closed forms, conservation laws, order, and SciPy's solver."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
import pytest
from closed_loop import PROPERTY, agree, hat, numbers, quaternions, rate, vector, vectors
from hypothesis import given
from numba import config, njit
from scipy.integrate import solve_ivp

from formation_env.maths import so3
from formation_env.maths.so3 import IDENTITY, ZERO, Quaternion, Vector
from formation_env.physics import quadrotor as quad
from formation_env.physics.quadrotor import GRAVITY, MOMENT, RATES, Airframe, Body, Wrench

FREE = (inf, inf, inf)
AIRFRAME = Airframe(0.3, (1.0e-3, 1.7e-3, 2.6e-3), -inf, inf, FREE, FREE, 0.08)
IDLE = Wrench(0.0, ZERO)
TUMBLE = Body((0.3, -0.2, -4.0), (0.5, 1.0, -0.4), (0.5, 0.5, -0.5, 0.5), (6.0, -4.0, 3.0))
PUSH = (0.3, -0.5, 0.2)
COMMAND = Wrench(2.4, (2e-3, -3e-3, 1e-3))


def fly(
    body: Body,
    wrench: Wrench,
    end: float,
    steps: int,
    push: Vector = ZERO,
    actuation: int = MOMENT,
    airframe: Airframe = AIRFRAME,
) -> Body:
    for _ in range(steps):
        body = quad.fly(body, wrench, push, end / steps, actuation, airframe)
    return body


def matrix(q: Quaternion) -> np.ndarray:
    return np.array(so3.rotation(q)).T


def newton_euler(x: np.ndarray, wrench: Wrench, push: Vector) -> np.ndarray:
    """(41)-(45) as printed, in matrices; state `(p, R v, R, omega)`, 18 numbers."""
    R, w = x[6:15].reshape(3, 3), x[15:]
    J = np.diag(AIRFRAME.inertia)
    v_dot = GRAVITY * np.array([0, 0, 1]) - wrench.thrust / AIRFRAME.mass * R[:, 2] + push
    w_dot = np.linalg.solve(J, np.array(wrench.turn) - hat(w) @ J @ w)
    return np.concatenate([x[3:6], v_dot, (R @ hat(w)).ravel(), w_dot])


def solve(body: Body, wrench: Wrench, push: Vector, end: float) -> np.ndarray:
    start = np.concatenate([body.p, body.v, matrix(body.q).ravel(), body.w])
    return solve_ivp(
        lambda _t, x: newton_euler(x, wrench, push),
        (0.0, end),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    ).y[:, -1]


def packed(body: Body) -> np.ndarray:
    return np.concatenate([body.p, body.v, matrix(body.q).ravel(), body.w])


@PROPERTY
@given(vectors(5.0), vectors(5.0), quaternions(), vectors(5.0))
def test_derivative_is_newton_and_euler(p: Vector, v: Vector, q: Quaternion, w: Vector) -> None:
    body = Body(p, v, q, w)
    d = quad.derivative(body, COMMAND, PUSH, MOMENT, AIRFRAME)
    expected = newton_euler(packed(body), COMMAND, PUSH)
    R_dot = rate(lambda x: matrix(vector(x)), np.array(q), np.array(d.q))
    agree(np.concatenate([d.p, d.v, R_dot.ravel(), d.w]), expected, 1e-9)
    agree(np.dot(d.q, q), 0.0, 1e-14)  # along the sphere, not off it


def test_free_fall_is_exact() -> None:
    """`p = p0 + v0 t + g t^2 / 2` to rounding: the integrator is exact for polynomials."""
    start = Body((1.0, -2.0, -50.0), (0.5, 0.25, -1.0), IDENTITY, (2.0, -1.0, 4.0))
    body = fly(start, IDLE, 2.0, 17)
    drop = 0.5 * GRAVITY * 4.0
    np.testing.assert_allclose(body.p, (2.0, -1.5, -52.0 + drop), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(body.v, (0.5, 0.25, -1.0 + 2.0 * GRAVITY), rtol=0.0, atol=1e-12)


def test_hover_thrust_keeps_still() -> None:
    body = Body((1.0, 2.0, -3.0), ZERO, so3.exponential((0.0, 0.0, 1.1)), ZERO)
    after = fly(body, Wrench(AIRFRAME.mass * GRAVITY, ZERO), 5.0, 500)
    agree([*after.p, *after.v, *after.q, *after.w], [*body.p, *body.v, *body.q, *body.w], 1e-12)


def test_without_moment_energy_and_angular_momentum_stay() -> None:
    """A tumbling asymmetric body: `omega . J omega` and the inertial `R J omega`."""

    def conserved(body: Body) -> np.ndarray:
        momentum = np.array(AIRFRAME.inertia) * body.w
        return np.array([np.dot(body.w, momentum), *(matrix(body.q) @ momentum)])

    before, after = conserved(TUMBLE), conserved(fly(TUMBLE, IDLE, 3.0, 3000))
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-9 * np.abs(before).max())


def test_against_scipy_with_matrices() -> None:
    found = packed(fly(TUMBLE, COMMAND, 1.0, 2000, PUSH))
    agree(found, solve(TUMBLE, COMMAND, PUSH, 1.0), 1e-9)


def test_the_integrator_is_of_fourth_order() -> None:
    exact = solve(TUMBLE, COMMAND, PUSH, 0.5)
    steps = np.array([20, 40, 80, 160])
    errors = [np.abs(packed(fly(TUMBLE, COMMAND, 0.5, n, PUSH)) - exact).max() for n in steps]
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(4.0, abs=0.2)


@njit
def _hour(body: Body, wrench: Wrench, h: float, airframe: Airframe, steps: int) -> Quaternion:
    for _ in range(steps):
        body = quad.fly(body, wrench, (0.0, 0.0, 0.0), h, 0, airframe)
    return body.q


def test_attitude_stays_on_the_group_for_an_hour() -> None:
    """3600 s of tumbling in steps of 5 ms (20 s of it where the compiler is off)."""
    steps = 4000 if config.DISABLE_JIT else 720_000
    q = _hour(TUMBLE, IDLE, 0.005, AIRFRAME, steps)
    assert abs(np.linalg.norm(q) - 1.0) < 1e-9
    R = matrix(q)
    agree(R.T @ R, np.eye(3), 1e-9)


@PROPERTY
@given(vectors(20.0), vectors(8.0))
def test_input_transformation_leaves_an_integrator(tau: Vector, w: Vector) -> None:
    """(46) makes (44) read `omega_dot = tau` (47)."""
    m_ext = quad.moment(tau, w, AIRFRAME.inertia)
    agree(quad.angular_acceleration(w, m_ext, MOMENT, AIRFRAME), tau, 1e-12)


def test_rate_loop_is_a_first_order_lag() -> None:
    """`omega = omega_c + (omega_0 - omega_c) exp(-t / rate_lag)`, whatever the inertia."""
    command, t = (1.0, -2.0, 0.5), 0.2
    w = fly(TUMBLE, Wrench(1.0, command), t, 200, actuation=RATES).w
    decay = np.exp(-t / AIRFRAME.rate_lag)
    expected = np.array(command) + (np.array(TUMBLE.w) - command) * decay
    np.testing.assert_allclose(w, expected, rtol=0.0, atol=1e-8)


LIMITED = AIRFRAME._replace(
    thrust_min=0.0, thrust_max=6.0, moment_max=(0.1, 0.2, 0.3), rate_max=(4.0, 5.0, 6.0)
)


@PROPERTY
@given(numbers(12.0), vectors(12.0))
def test_saturation_gives_the_nearest_deliverable_wrench(thrust: float, turn: Vector) -> None:
    for actuation, limit in ((MOMENT, LIMITED.moment_max), (RATES, LIMITED.rate_max)):
        got = quad.saturate(Wrench(thrust, turn), actuation, LIMITED)
        assert got.thrust == float(np.clip(thrust, 0.0, 6.0))
        assert got.turn == vector(np.clip(turn, -np.array(limit), limit))


def test_unlimited_actuators_deliver_everything() -> None:
    wild = Wrench(-1e6, (1e6, -1e6, 1e6))
    assert quad.saturate(wild, MOMENT, AIRFRAME) == wild


def ground(
    body: Body, wrench: Wrench, end: float, h: float = 1e-3
) -> list[tuple[Body, quad.Contact]]:
    """Flight with the floor below: `(body, contact)` after each substep."""
    history = []
    for _ in range(round(end / h)):
        after = quad.fly(body, wrench, ZERO, h, MOMENT, AIRFRAME)
        body, contact = quad.touch_floor(after, body)
        history.append((body, contact))
    return history


@pytest.mark.parametrize("part", [0.0, 0.5, 0.999])
def test_rests_on_the_floor_below_its_weight(part: float) -> None:
    """Nothing moves while `T < m g`, and the reported touch-down speed is at most `g h`."""
    start = Body((1.0, -2.0, 0.0), ZERO, so3.exponential((0.0, 0.0, 0.8)), ZERO)
    for body, contact in ground(start, Wrench(part * AIRFRAME.mass * GRAVITY, ZERO), 0.5):
        assert body.p == start.p
        assert body.v == ZERO
        agree(body.q, start.q, 1e-14)
        assert contact.touching
        assert 0.0 <= contact.speed <= GRAVITY * 1e-3


def test_nothing_makes_a_standing_vehicle_creep() -> None:
    """A moment below what lifts it, about any axis, leaves it where it stands."""
    start = Body((1.0, -2.0, 0.0), ZERO, so3.exponential((0.0, 0.0, 0.8)), ZERO)
    pushed = Wrench(0.9 * AIRFRAME.mass * GRAVITY, (0.01, -0.02, 0.02))
    body = ground(start, pushed, 0.5)[-1][0]
    assert body.p == start.p
    agree(body.q, start.q, 1e-14)


def test_takes_off_above_its_weight() -> None:
    start = Body(ZERO, ZERO, IDENTITY, ZERO)
    history = ground(start, Wrench(1.1 * AIRFRAME.mass * GRAVITY, ZERO), 1.0)
    assert not any(contact.touching for _, contact in history)
    assert all(contact.speed == 0.0 for _, contact in history)
    assert history[-1][0].p[2] == pytest.approx(-0.05 * GRAVITY, abs=1e-12)


@pytest.mark.parametrize("height", [0.2, 3.0])
def test_impact_speed_is_that_of_the_fall(height: float) -> None:
    """`sqrt(2 g h)`, to the speed gained within a substep."""
    start = Body((0.0, 0.0, -height), ZERO, IDENTITY, ZERO)
    contacts = [c for _, c in ground(start, IDLE, 1.0) if c.touching]
    fall = sqrt(2.0 * GRAVITY * height)
    assert fall <= contacts[0].speed <= fall + GRAVITY * 1e-3


@PROPERTY
@given(quaternions(), vectors(3.0), vectors(3.0))
def test_touch_down_stops_and_levels(q: Quaternion, v: Vector, w: Vector) -> None:
    """On the floor at rest; the tilt before it is reported; position in the plane is kept."""
    below = Body((1.5, -0.5, 0.01), v, q, w)
    body, contact = quad.touch_floor(below, below)
    assert body.p == (1.5, -0.5, 0.0)
    assert body.v == ZERO and body.w == ZERO
    agree(so3.rotation(body.q)[2], (0.0, 0.0, 1.0), 1e-14)
    assert contact.speed == max(v[2], 0.0)
    agree(contact.uprightness, matrix(q)[2, 2], 1e-14)


@PROPERTY
@given(numbers(3.0), vectors(0.4))
def test_touch_down_keeps_the_yaw(yaw: float, tilt: Vector) -> None:
    turn = so3.exponential((0.0, 0.0, yaw))
    q = so3.multiply(turn, so3.exponential((tilt[0], tilt[1], 0.0)))
    below = Body((0.0, 0.0, 0.01), ZERO, q, ZERO)
    body, _ = quad.touch_floor(below, below)
    agree(matrix(body.q), matrix(turn), 1e-12)


@PROPERTY
@given(quaternions(), vectors(3.0), vectors(3.0))
def test_in_the_air_the_floor_does_nothing(q: Quaternion, v: Vector, w: Vector) -> None:
    body = Body((1.5, -0.5, -1e-9), v, q, w)
    after, contact = quad.touch_floor(body, body)
    assert after == body
    assert not contact.touching
    assert contact.speed == 0.0
    agree(contact.uprightness, matrix(q)[2, 2], 1e-14)


def test_leaving_the_floor_is_not_touching_it() -> None:
    """At height zero with an upward speed the vehicle is in the air; without one it stands."""
    rising = Body(ZERO, (0.0, 0.0, -0.1), IDENTITY, ZERO)
    assert not quad.touch_floor(rising, rising)[1].touching
    still = rising._replace(v=ZERO)
    assert quad.touch_floor(still, still)[1].touching
