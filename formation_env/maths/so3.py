"""Vectors and rotations in space, on tuples of floats.

A vector is a 3-tuple. An attitude is kept as a unit quaternion `(w, x, y, z)` (Hamilton product,
body to inertial) and handed to the control laws as the three columns `(r1, r2, r3)` of the paper's
rotation matrix `R`, so that `r3 = R k` and `R^T a = (r1.a, r2.a, r3.a)` read as in the paper.

`S(a) b = a x b` throughout. Tuples, not arrays: inside a Numba loop a call on small arrays costs
microseconds, on tuples nanoseconds, and the compiler can vectorise it across worlds.
"""

from __future__ import annotations

from math import sqrt

from formation_env._jit import device
from formation_env.maths.elementary import pick as pick  # as `so3.pick` beside `pick_vector`
from formation_env.maths.elementary import sin_cos

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Rotation = tuple[Vector, Vector, Vector]

ZERO: Vector = (0.0, 0.0, 0.0)
IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


@device
def add(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@device
def sub(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@device
def scale(s: float, a: Vector) -> Vector:
    return (s * a[0], s * a[1], s * a[2])


@device
def add_scaled(a: Vector, s: float, b: Vector) -> Vector:
    """`a + s b`."""
    return (a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2])


@device
def times(a: Vector, b: Vector) -> Vector:
    """Element by element, `diag(a) b`."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


@device
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device
def cross(a: Vector, b: Vector) -> Vector:
    """`S(a) b`."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@device
def norm(a: Vector) -> float:
    return sqrt(dot(a, a))


@device
def to_inertial(R: Rotation, a: Vector) -> Vector:
    """`R a`: body components to inertial ones."""
    r1, r2, r3 = R
    return (
        a[0] * r1[0] + a[1] * r2[0] + a[2] * r3[0],
        a[0] * r1[1] + a[1] * r2[1] + a[2] * r3[1],
        a[0] * r1[2] + a[1] * r2[2] + a[2] * r3[2],
    )


@device
def to_body(R: Rotation, a: Vector) -> Vector:
    """`R^T a`: inertial components to body ones."""
    return (dot(R[0], a), dot(R[1], a), dot(R[2], a))


@device
def rotation(q: Quaternion) -> Rotation:
    """Columns `(r1, r2, r3)` of the rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@device
def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product: the rotation `q` followed by `p`."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


@device
def normalise(q: Quaternion) -> Quaternion:
    """The nearest unit quaternion."""
    s = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (s * q[0], s * q[1], s * q[2], s * q[3])


@device
def exponential(a: Vector) -> Quaternion:
    """Unit quaternion of the rotation vector `a` (radians, `R = exp(S(a))`)."""
    angle = norm(a)
    sine, cosine = sin_cos(0.5 * angle)
    tiny = angle < 1e-9  # where sin(angle/2)/angle is 0/0, and 1/2 to the last digit around it
    s = pick(tiny, 0.5, sine / pick(tiny, 1.0, angle))
    return (cosine, s * a[0], s * a[1], s * a[2])


@device
def shortest_arc(r3: Vector) -> Quaternion:
    """Attitude with third axis `r3` (unit) reached from level by the smallest turn.

    The half-way quaternion between `k` and `r3`; undefined for `r3 = -k` (upside down), where every
    horizontal axis is a smallest turn.
    """
    return normalise((1.0 + r3[2], -r3[1], r3[0], 0.0))


@device
def level(q: Quaternion) -> Quaternion:
    """The attitude of a vehicle standing on its feet: the yaw of `q` alone (its twist about `k`).

    Where there is no such twist (`q` a half turn about a horizontal axis) the yaw is zero.
    """
    w, z = q[0], q[3]
    n = w * w + z * z
    none = n < 1e-12
    s = 1.0 / sqrt(pick(none, 1.0, n))
    return (pick(none, 1.0, s * w), 0.0, 0.0, pick(none, 0.0, s * z))


@device
def pick_vector(condition: bool, a: Vector, b: Vector) -> Vector:
    return (pick(condition, a[0], b[0]), pick(condition, a[1], b[1]), pick(condition, a[2], b[2]))
