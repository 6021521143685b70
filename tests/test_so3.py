"""Rotations against SciPy's, and what the shortest arc and levelling promise."""

from __future__ import annotations

import numpy as np
from closed_loop import PROPERTY, agree, hat, numbers, quaternions, vectors
from hypothesis import assume, given
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from formation_env.maths import so3


def matrix(q: so3.Quaternion) -> np.ndarray:
    return np.array(so3.rotation(q)).T


def scipy_rotation(q: so3.Quaternion) -> Rotation:
    return Rotation.from_quat([q[1], q[2], q[3], q[0]])


@PROPERTY
@given(quaternions())
def test_rotation_is_scipys(q: so3.Quaternion) -> None:
    agree(matrix(q), scipy_rotation(q).as_matrix(), 1e-14)


@PROPERTY
@given(quaternions(), quaternions())
def test_product_composes_rotations(p: so3.Quaternion, q: so3.Quaternion) -> None:
    agree(matrix(so3.multiply(p, q)), matrix(p) @ matrix(q), 1e-14)


@PROPERTY
@given(vectors(4.0))
def test_exponential_is_the_matrix_exponential(a: so3.Vector) -> None:
    agree(matrix(so3.exponential(a)), expm(hat(a)), 1e-12)


def test_exponential_near_zero_keeps_its_accuracy() -> None:
    """Both sides of where the quotient is replaced, against the exact half-angle formula."""
    for angle in (0.0, 0.99e-9, 1.01e-9, 1e-4, 1e-3):
        q = so3.exponential((0.6 * angle, 0.0, 0.8 * angle))
        exact = np.sin(0.5 * angle)
        np.testing.assert_allclose(q[1:], (0.6 * exact, 0.0, 0.8 * exact), rtol=1e-15, atol=0.0)


@PROPERTY
@given(vectors(5.0), vectors(5.0), vectors(5.0), numbers(3.0))
def test_vector_algebra(a: so3.Vector, b: so3.Vector, c: so3.Vector, s: float) -> None:
    A, B = np.array(a), np.array(b)
    agree(so3.add(a, b), A + B, 1e-15)
    agree(so3.sub(a, b), A - B, 1e-15)
    agree(so3.scale(s, a), s * A, 1e-15)
    agree(so3.add_scaled(a, s, b), A + s * B, 1e-15)
    agree(so3.times(a, b), A * B, 1e-15)
    agree(so3.dot(a, b), A @ B, 1e-14)
    agree(so3.cross(a, b), hat(a) @ B, 1e-14)
    agree(so3.norm(a), np.linalg.norm(A), 1e-14)


@PROPERTY
@given(quaternions(), vectors(5.0))
def test_body_and_inertial_components(q: so3.Quaternion, a: so3.Vector) -> None:
    R = so3.rotation(q)
    agree(so3.to_inertial(R, a), scipy_rotation(q).apply(a), 1e-14)
    agree(so3.to_body(R, a), scipy_rotation(q).inv().apply(a), 1e-14)
    agree(so3.to_body(R, so3.to_inertial(R, a)), a, 1e-14)


@PROPERTY
@given(quaternions())
def test_normalise_keeps_the_direction(q: so3.Quaternion) -> None:
    agree(so3.normalise((3.0 * q[0], 3.0 * q[1], 3.0 * q[2], 3.0 * q[3])), q, 1e-14)


@PROPERTY
@given(vectors(1.0))
def test_shortest_arc_reaches_the_axis_by_the_smallest_turn(a: so3.Vector) -> None:
    """Its third axis is the one asked for, and its angle is the one between `k` and that axis."""
    n = float(np.linalg.norm(a))
    assume(n > 0.1 and a[2] / n > -0.99)
    r3 = (a[0] / n, a[1] / n, a[2] / n)
    q = so3.shortest_arc(r3)
    agree(so3.rotation(q)[2], r3, 1e-12)
    angle = scipy_rotation(q).magnitude()
    agree(angle, np.arctan2(np.hypot(r3[0], r3[1]), r3[2]), 1e-12)


@PROPERTY
@given(numbers(3.0), quaternions())
def test_level_keeps_the_yaw_alone(yaw: float, q: so3.Quaternion) -> None:
    """`q = (turn about k)(tilt about a horizontal axis)` has that turn as its twist about `k`."""
    r3 = so3.rotation(q)[2]
    assume(r3[2] > -0.99)
    turn = so3.exponential((0.0, 0.0, yaw))
    tilted = so3.multiply(turn, so3.shortest_arc(r3))
    agree(matrix(so3.level(tilted)), matrix(turn), 1e-9)


def test_level_upside_down_has_no_yaw_to_keep() -> None:
    assert so3.level((0.0, 1.0, 0.0, 0.0)) == so3.IDENTITY
