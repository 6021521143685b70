"""The slots against the paper: they solve (6) along the zero dynamics (23), integrated by SciPy."""

from __future__ import annotations

from cmath import exp, phase

import numpy as np
import pytest
from closed_loop import PROPERTY, Sines, agree, numbers, rate, vector, vectors
from hypothesis import given
from scipy.integrate import solve_ivp

from formation_env.laws import slots
from formation_env.maths.so3 import Vector

D = (0.35, -0.5, -0.3)  # m


def planar(theta: float) -> np.ndarray:
    """The rotation matrix (1)."""
    return np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])


def zero_dynamics(theta: float, v: Vector, d: Vector) -> np.ndarray:
    """`(u, theta_dot)` of (23), by solving with `Gamma` (14)."""
    gamma = np.array([[1.0, -d[1]], [0.0, d[0]]])
    return np.linalg.solve(gamma, planar(theta).T @ np.array(v[:2]))


@PROPERTY
@given(numbers(3.0), vectors(5.0), vectors(3.0))
def test_leader_is_seen_at_d(theta: float, p_L: Vector, v_L: Vector) -> None:
    """(6) in the plane and (32) with `e_z = 0` in height."""
    s = slots.slot(exp(1j * theta), p_L, v_L, D)
    seen = planar(theta).T @ (np.array(p_L[:2]) - np.array(s.p[:2]))
    agree([*seen, p_L[2] - s.p[2]], D, 1e-14)


@PROPERTY
@given(numbers(3.0), vectors(3.0))
def test_heading_rate_is_the_zero_dynamics(theta: float, v_L: Vector) -> None:
    found = slots.heading_rate(exp(1j * theta), complex(v_L[0], v_L[1]), D[0])
    agree(found, zero_dynamics(theta, v_L, D)[1], 1e-13)


@PROPERTY
@given(numbers(3.0), vectors(3.0))
def test_slot_moves_as_a_unicycle(theta: float, v_L: Vector) -> None:
    """Its velocity points along the heading, with the speed `u` of (23): (3) holds for a slot."""
    v = slots.slot(exp(1j * theta), (1.0, 2.0, -1.0), v_L, D).v
    u = zero_dynamics(theta, v_L, D)[0]
    agree(v, [u * np.cos(theta), u * np.sin(theta), v_L[2]], 1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_slot_velocity_is_the_rate_of_its_position(seed: int) -> None:
    leader = Sines(seed)
    theta, t = 0.7 * seed, 0.9 * seed

    def position(x: np.ndarray) -> np.ndarray:
        p, v = leader.at(x[1])[:2]
        return np.array(slots.slot(exp(1j * x[0]), p, v, D).p)

    v = leader.at(t)[1]
    motion = np.array([zero_dynamics(theta, v, D)[1], 1.0])
    found = slots.slot(exp(1j * theta), leader.at(t)[0], v, D).v
    agree(found, rate(position, np.array([theta, t]), motion), 1e-9)


def integrate(leader: Sines, d_x: float, steps: int, end: float = 6.0) -> complex:
    """The heading at `end` from 0.4 rad at 0, by the package's step."""
    R, h = exp(0.4j), end / steps
    for i in range(steps):
        v0, v1 = leader.at(i * h)[1], leader.at((i + 1) * h)[1]
        R = slots.advance_heading(R, complex(*v0[:2]), complex(*v1[:2]), d_x, h)
    return R


def test_heading_against_scipy_with_second_order() -> None:
    """Halving the step divides the error by four; the heading stays on the unit circle."""
    leader, d_x = Sines(5), 0.6
    exact = solve_ivp(
        lambda t, y: [zero_dynamics(y[0], leader.at(t)[1], (d_x, 0.0, 0.0))[1]],
        (0.0, 6.0),
        [0.4],
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    ).y[0, -1]
    steps = np.array([300, 600, 1200, 2400])
    errors = [abs(phase(integrate(leader, d_x, n) * exp(-1j * exact))) for n in steps]
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.15)
    assert errors[-1] < 1e-5
    assert abs(integrate(leader, d_x, 2400)) == pytest.approx(1.0, abs=1e-12)


@PROPERTY
@given(numbers(0.2), numbers(3.0))
def test_turn_is_a_rotation_to_second_order(angle: float, theta: float) -> None:
    turned = slots.turn(exp(1j * theta), angle)
    assert abs(turned) == pytest.approx(1.0, abs=1e-14)
    assert abs(phase(turned * exp(-1j * (theta + angle)))) <= abs(angle) ** 3 / 11.0 + 1e-15


@pytest.mark.parametrize("curvature", [0.5, -0.8])
def test_heading_settles_where_the_analysis_says(curvature: float) -> None:
    """On a circle, `theta - theta_L` goes to `-arcsin(d_x kappa_L)` (28)."""
    speed, d_x, h = 0.7, 0.6, 0.01
    turning = speed * curvature
    R = exp(0.9j)
    for i in range(3000):
        v0, v1 = (speed * exp(1j * turning * h * k) for k in (i, i + 1))
        R = slots.advance_heading(R, v0, v1, d_x, h)
    behind = phase(R * exp(-1j * turning * 30.0))
    assert behind == pytest.approx(-np.arcsin(d_x * curvature), abs=1e-4)


def test_equal_d_x_is_a_rigid_formation() -> None:
    """II-D: followers that share `d_x` and the start keep their distance, |d_y1 - d_y2|."""
    leader, R, h = Sines(2), exp(0.2j), 0.02
    for i in range(200):
        p, v = leader.at(i * h)[:2]
        left = slots.slot(R, p, v, (0.35, 0.35, 0.0))
        right = slots.slot(R, p, v, (0.35, -0.35, 0.0))
        assert np.hypot(*(np.array(left.p[:2]) - right.p[:2])) == pytest.approx(0.7, abs=1e-12)
        v_next = leader.at((i + 1) * h)[1]
        R = slots.advance_heading(R, complex(*v[:2]), complex(*v_next[:2]), 0.35, h)


@PROPERTY
@given(numbers(3.0), vectors(5.0))
def test_frames(theta: float, a: Vector) -> None:
    R = exp(1j * theta)
    rotated = vector([*(planar(theta) @ np.array(a[:2])), a[2]])
    agree(slots.out_of_frame(R, a), rotated, 1e-13)
    agree(slots.in_frame(R, rotated), a, 1e-13)
