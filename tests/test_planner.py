"""The planner against section II: its error dynamics, theorem 1, and the simulation of II-D.

The closed loop of `planar_loop` is written from the paper; of the package it takes the laws alone.
"""

from __future__ import annotations

from cmath import exp
from typing import Any, Protocol

import numpy as np
import pytest
from closed_loop import PROPERTY, Sines, agree, numbers, rate, vector, vectors
from hypothesis import given
from hypothesis import strategies as st
from planar_loop import (
    GENERIC,
    LAWS,
    PAPER,
    SEEDS,
    STATES,
    D,
    control,
    flow,
    gamma,
    paper_errors,
    planar,
    skew,
    virtual,
)
from scipy.integrate import solve_ivp

from formation_env.laws import planner
from formation_env.laws.planner import PlannerLaw, Virtual
from formation_env.maths.so3 import Vector
from formation_env.paths.references import TrajectoryPoint


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_errors_are_the_papers(x: np.ndarray, seed: int, law: PlannerLaw) -> None:
    leader = TrajectoryPoint(*Sines(seed).at(x[9]))
    e1, e2 = planner.errors(
        virtual(x), planner.plane(leader.p), planner.plane(leader.v), planner.plane(D), law
    )
    agree([e1.real, e1.imag, e2.real, e2.imag], paper_errors(x, leader, D, law), 1e-12)


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_error_dynamics(x: np.ndarray, seed: int, law: PlannerLaw) -> None:
    """`e1_dot = -S e1 - k1 sigma + k1 e2` (9) and `e2_dot = -k1 k2 e2 - k3 xi` (22, corrected)."""
    sines = Sines(seed)

    def errors_at(y: np.ndarray) -> np.ndarray:
        return paper_errors(y, TrajectoryPoint(*sines.at(y[9])), D, law)

    leader = TrajectoryPoint(*sines.at(x[9]))
    found = rate(errors_at, x, flow(x, leader, D, law))
    e1, e2 = np.split(errors_at(x), 2)
    sigma = law.p_max * np.tanh(e1 / law.p_max)
    e1_dot = -skew(x[4]) @ e1 - law.k1 * sigma + law.k1 * e2
    e2_dot = -law.k1 * law.k2 * e2 - law.k3 * x[5:7]
    agree(found, [*e1_dot, *e2_dot], 1e-7)


@PROPERTY
@given(STATES, SEEDS, LAWS)
def test_rate_of_the_lyapunov_function(x: np.ndarray, seed: int, law: PlannerLaw) -> None:
    """`V3_dot = -k1 e1.sigma + k1 e1.e2 - k1 k2 e2.e2`, negative where the proof says so."""
    sines = Sines(seed)

    def V3(y: np.ndarray) -> np.ndarray:
        e = paper_errors(y, TrajectoryPoint(*sines.at(y[9])), D, law)
        return np.array(0.5 * e @ e + 0.5 * law.k3 * y[5:7] @ y[5:7])

    leader = TrajectoryPoint(*sines.at(x[9]))
    found = rate(V3, x, flow(x, leader, D, law))
    e1, e2 = np.split(paper_errors(x, leader, D, law), 2)
    sigma = law.p_max * np.tanh(e1 / law.p_max)
    agree(found, -law.k1 * e1 @ sigma + law.k1 * e1 @ e2 - law.k1 * law.k2 * e2 @ e2, 1e-7)
    if np.linalg.norm(e1) <= law.k2 * np.linalg.norm(e2):
        assert found <= 1e-9


class Moving(Protocol):
    """A leader in closed form."""

    def at(self, t: float) -> tuple[Any, ...]: ...


def fly(sines: Moving, x: np.ndarray, end: float, law: PlannerLaw, **more: Any) -> np.ndarray:
    """The closed loop from `x` for `end` seconds by SciPy, sampled at 200 instants."""
    return solve_ivp(
        lambda _t, y: flow(y, TrajectoryPoint(*sines.at(y[9])), D, law, **more),
        (0.0, end),
        x,
        method="DOP853",
        rtol=1e-9,
        atol=1e-10,
        t_eval=np.linspace(0.0, end, 200),
    ).y.T


def test_position_error_falls_while_the_other_errors_are_zero() -> None:
    """From a start with `e2 = xi = 0`, `|e1|` falls all the way to zero."""
    sines = Sines(3)
    x = np.array([-2.0, 3.0, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    _, e2 = np.split(paper_errors(x, TrajectoryPoint(*sines.at(0.0)), D, GENERIC), 2)
    x[3:5] = GENERIC.k1 * np.linalg.solve(gamma(D), e2)
    path = fly(sines, x, 20.0, GENERIC)
    errors = np.array([paper_errors(y, TrajectoryPoint(*sines.at(y[9])), D, GENERIC) for y in path])
    size = np.linalg.norm(errors[:, :2], axis=1)
    assert size[0] > 2.0
    assert np.abs(errors[:, 2:]).max() < 1e-7
    assert (np.diff(size) < 0.0).all()
    assert size[-1] < 1e-3 * size[0]


def test_every_error_goes_to_zero() -> None:
    """Theorem 1, the integral state included, with a leader that never stops manoeuvring."""
    sines = Sines(4)
    x = np.array([2.0, -3.0, 2.5, -1.0, 1.0, 0.5, -0.5, 1.0, 0.5, 0.0])
    end = fly(sines, x, 60.0, GENERIC)[-1]
    agree(paper_errors(end, TrajectoryPoint(*sines.at(end[9])), D, GENERIC), np.zeros(4), 1e-4)
    agree(end[5:7], [0.0, 0.0], 1e-4)


@pytest.mark.parametrize("k3", [0.0, 0.4])
def test_integral_state_rejects_a_constant_perturbation(k3: float) -> None:
    """(18): a bias `b` on the actuation leaves nothing if `k3 > 0`, else `-Gamma b / (k1^2 k2)`."""
    law, sines, bias = GENERIC._replace(k3=k3), Sines(6), (0.1, -0.15)
    x = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    end = fly(sines, x, 60.0, law, bias=bias)[-1]
    e2 = paper_errors(end, TrajectoryPoint(*sines.at(end[9])), D, law)[2:]
    left = -gamma(D) @ bias / (law.k1**2 * law.k2) if k3 == 0.0 else np.zeros(2)
    agree(e2, left, 1e-4)


@PROPERTY
@given(STATES, SEEDS, numbers(3.0), vectors(10.0))
def test_turning_and_shifting_the_scene_changes_nothing(
    x: np.ndarray, seed: int, angle: float, shift: Vector
) -> None:
    """North and the origin are conventions: the actuation is the same in any frame."""
    R, leader = planar(angle), TrajectoryPoint(*Sines(seed).at(x[9]))

    def turned(a: Vector, by: Vector = (0.0, 0.0, 0.0)) -> Vector:
        x_, y_ = R @ np.array(a[:2])
        return (float(x_) + by[0], float(y_) + by[1], a[2] + by[2])

    there = TrajectoryPoint(turned(leader.p, shift), *(turned(a) for a in leader[1:]))
    y = x.copy()
    y[0:2], y[2], y[7] = R @ x[0:2] + shift[:2], x[2] + angle, x[7] + shift[2]
    agree(control(y, there, D, GENERIC), control(x, leader, D, GENERIC), 1e-11)
    here, then = (
        planner.climb(virtual(s), at, D[2], GENERIC) for s, at in ((x, leader), (y, there))
    )
    agree(then, here, 1e-12)


@PROPERTY
@given(numbers(5.0), numbers(5.0), numbers(3.0), numbers(3.0))
def test_gamma_is_inverted(a: float, b: float, d_x: float, d_y: float) -> None:
    d_x = d_x + (0.2 if d_x >= 0.0 else -0.2)
    found = planner.gamma_solve(complex(a, b), complex(d_x, d_y))
    agree(found, np.linalg.solve(gamma((d_x, d_y, 0.0)), [a, b]), 1e-12)


@PROPERTY
@given(numbers(8.0), numbers(8.0))
def test_saturation(a: float, b: float) -> None:
    """(10): `p_max tanh(x / p_max)` per axis; its slope is its derivative, one at zero."""
    x = np.array([a, b])

    def sigma(y: np.ndarray) -> np.ndarray:
        s = planner.saturation(complex(y[0], y[1]), 1.3)
        return np.array([s.real, s.imag])

    agree(sigma(x), 1.3 * np.tanh(x / 1.3), 1e-14)
    slope = planner.saturation_slope(complex(a, b), 1.3)
    agree([slope.real, slope.imag], rate(sigma, x, np.ones(2)), 1e-9)
    assert planner.saturation_slope(0j, 1.3) == 1 + 1j


@PROPERTY
@given(STATES, SEEDS)
def test_vertical_law(x: np.ndarray, seed: int) -> None:
    """(32)-(34): the leader's acceleration and a spring and damper on `e_z`, within `z_max`."""
    leader = TrajectoryPoint(*Sines(seed).at(x[9]))
    a_z = planner.climb(virtual(x), leader, D[2], GENERIC)
    e_z, e_z_dot = leader.p[2] - x[7] - D[2], leader.v[2] - x[8]
    wanted = leader.a[2] + GENERIC.kz1 * e_z + GENERIC.kz2 * e_z_dot
    agree(a_z, np.clip(wanted, -GENERIC.z_max, GENERIC.z_max), 1e-13)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_vertical_acceleration_is_bounded_both_ways(side: float) -> None:
    leader = TrajectoryPoint((0.0, 0.0, 100.0 * side), *([(0.0, 0.0, 0.0)] * 4))
    x = np.zeros(10)
    assert planner.climb(virtual(x), leader, 0.0, GENERIC) == side * GENERIC.z_max


@PROPERTY
@given(vectors(5.0), vectors(2.0), numbers(3.0), st.booleans())
def test_place_starts_with_null_errors(
    p_L: Vector, v_L: Vector, heading: float, moving: bool
) -> None:
    """II-E: `e1 = 0` and `e_z = 0`; `e2 = 0` and the leader's climb as well when moving."""
    direction = exp(1j * heading)
    f = planner.place(p_L, v_L, D, direction, moving)
    leader = TrajectoryPoint(p_L, v_L, *([(0.0, 0.0, 0.0)] * 3))
    x = np.array([f.p.real, f.p.imag, f.theta, f.u, f.omega, 0.0, 0.0, f.z, f.w, 0.0])
    e = paper_errors(x, leader, D, GENERIC)
    agree(e[:2], [0.0, 0.0], 1e-13)
    agree(exp(1j * f.theta).real, direction.real, 1e-14)
    agree(exp(1j * f.theta).imag, direction.imag, 1e-14)
    assert f.xi == 0j
    agree(p_L[2] - f.z - D[2], 0.0, 1e-14)
    if moving:
        agree(e[2:], [0.0, 0.0], 1e-12)
        assert f.w == v_L[2]
    else:
        assert (f.u, f.omega, f.w) == (0.0, 0.0, 0.0)


class Accelerating:
    """A leader with a constant acceleration, for which holding the sample is exact."""

    def at(self, t: float) -> tuple[Any, ...]:
        a = np.array([0.7, -0.5, 0.4])
        v = np.array([-0.8, 0.9, -0.3])
        p = np.array([1.0, 0.5, -2.0])
        zero = np.zeros(3)
        terms = (p + v * t + 0.5 * a * t * t, v + a * t, a, zero, zero)
        return tuple(vector(x) for x in terms)


START = np.array([0.5, 1.5, 2.0, 0.6, -0.8, 0.3, -0.2, -0.5, 0.2, 0.0])


def state(f: Virtual) -> np.ndarray:
    return np.array([f.p.real, f.p.imag, f.theta, f.u, f.omega, f.xi.real, f.xi.imag, f.z, f.w])


def test_advance_is_of_fourth_order_where_the_leader_coasts() -> None:
    leader = Accelerating()
    exact = fly(leader, START, 3.0, GENERIC)[-1][:9]
    steps, errors = np.array([24, 48, 96]), []
    for n in steps:
        f = virtual(START)
        for i in range(n):
            f = planner.advance(f, TrajectoryPoint(*leader.at(3.0 * i / n)), D, 3.0 / n, GENERIC)
        errors.append(np.abs(state(f) - exact).max())
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(4.0, abs=0.3)


def test_advance_follows_a_manoeuvring_leader() -> None:
    """With samples of a moving acceleration the error is the hold's, of first order in the step."""
    sines = Sines(8)
    exact = fly(sines, START, 3.0, GENERIC)[-1][:9]
    errors = []
    for n in (300, 600):
        f = virtual(START)
        for i in range(n):
            f = planner.advance(f, TrajectoryPoint(*sines.at(3.0 * i / n)), D, 3.0 / n, GENERIC)
        errors.append(np.abs(state(f) - exact).max())
    assert errors[1] < 5e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)


@PROPERTY
@given(STATES, SEEDS)
def test_derivative_is_the_closed_loop(x: np.ndarray, seed: int) -> None:
    leader = TrajectoryPoint(*Sines(seed).at(x[9]))
    agree(
        state(planner.derivative(virtual(x), leader, D, GENERIC)),
        flow(x, leader, D, GENERIC)[:9],
        1e-12,
    )


@PROPERTY
@given(STATES, SEEDS)
def test_reference_is_the_virtual_motion(x: np.ndarray, seed: int) -> None:
    """(35): velocity and acceleration are the rates of position and velocity; no jerk, no snap."""
    leader = TrajectoryPoint(*Sines(seed).at(x[9]))

    def motion(y: np.ndarray) -> np.ndarray:
        ref = planner.trajectory_point(
            virtual(y), TrajectoryPoint(*Sines(seed).at(y[9])), D, GENERIC
        )
        return np.array([*ref.p, *ref.v])

    ref = planner.trajectory_point(virtual(x), leader, D, GENERIC)
    agree([*ref.v, *ref.a], rate(motion, x, flow(x, leader, D, GENERIC)), 1e-8)
    assert ref.p == (x[0], x[1], x[7])
    assert ref.j == ref.s == (0.0, 0.0, 0.0)


class Lemniscate:
    """The leader of II-D (31)."""

    def at(self, t: float) -> tuple[Any, ...]:
        return (
            (2.0 * np.cos(0.25 * t), np.sin(0.5 * t), 0.0),
            (-0.5 * np.sin(0.25 * t), 0.5 * np.cos(0.5 * t), 0.0),
            (-0.125 * np.cos(0.25 * t), -0.25 * np.sin(0.5 * t), 0.0),
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0),
        )


def test_the_simulation_of_figure_2() -> None:
    """II-D: the distances go to `|d|` and to 0.7 m, headings and turning rates to each other."""
    leader = Lemniscate()
    starts = (
        ((0.35, 0.35, 0.0), [3.0, 3.0, 1.5 * np.pi, 0.5, -0.5, 0, 0, 0, 0, 0]),
        ((0.35, -0.35, 0.0), [3.0, 1.0, 0.0, 0.0, 0.5, 0, 0, 0, 0, 0]),
    )
    ends = []
    for d, x in starts:
        ends.append(
            solve_ivp(
                lambda _t, y, d=d: flow(y, TrajectoryPoint(*leader.at(y[9])), d, PAPER),
                (0.0, 60.0),
                np.array(x, dtype=float),
                method="DOP853",
                rtol=1e-9,
                atol=1e-9,
            ).y[:, -1]
        )
    for (d, _), end in zip(starts, ends, strict=True):
        distance = np.linalg.norm(np.array(leader.at(60.0)[0][:2]) - end[:2])
        assert distance == pytest.approx(np.hypot(d[0], d[1]), abs=1e-3)
    assert np.linalg.norm(ends[0][:2] - ends[1][:2]) == pytest.approx(0.7, abs=1e-3)
    assert np.cos(ends[0][2] - ends[1][2]) == pytest.approx(1.0, abs=1e-5)
    assert ends[0][4] == pytest.approx(ends[1][4], abs=1e-3)
