"""Where a follower should be: the paper's own target, taken exactly.

    p_i* = p_L - R(theta_i*) d_i,     theta_i*_dot = (R^T p_L_dot)_y / d_x      (6), (23)

The heading obeys the zero dynamics, driven by the leader's true motion, so the slot does not depend
on the policy that flies to it. Followers with equal `d_x` that start alike share one heading, and
their slots are the rigid formation of II-D.

The heading is kept as a unit complex number `R = exp(j theta)`: the same numbers without
trigonometry.
"""

from __future__ import annotations

from typing import NamedTuple

from formation_env._jit import device
from formation_env.maths.so3 import Vector


class Slot(NamedTuple):
    """A follower's target."""

    p: Vector  # m, inertial
    v: Vector  # m/s, inertial


@device
def heading_rate(R: complex, v_L: complex, d_x: float) -> float:
    """Zero dynamics (23), second row: `theta_dot = (R^T p_L_dot)_y / d_x`, rad/s."""
    return (R.conjugate() * v_L).imag / d_x


@device
def turn(R: complex, angle: float) -> complex:
    """`R` turned by `angle`, to second order and exactly on the circle (Cayley's map)."""
    half = complex(1.0, 0.5 * angle)
    turned = R * (half * half)
    s = 1.0 / (1.0 + 0.25 * angle * angle)
    return complex(s * turned.real, s * turned.imag)


@device
def advance_heading(R: complex, v0: complex, v1: complex, d_x: float, h: float) -> complex:
    """The heading `h` seconds later; the leader's planar velocity goes from `v0` to `v1`, m/s.

    Heun's method (second order) on the zero dynamics (23).
    """
    rate = heading_rate(R, v0, d_x)
    ahead = heading_rate(turn(R, h * rate), v1, d_x)
    return turn(R, 0.5 * h * (rate + ahead))


@device
def in_frame(R: complex, a: Vector) -> Vector:
    """`R^T a`: inertial components to those in the formation frame, height unchanged."""
    c, s = R.real, R.imag
    return (c * a[0] + s * a[1], c * a[1] - s * a[0], a[2])


@device
def out_of_frame(R: complex, a: Vector) -> Vector:
    """`R a`: formation-frame components to inertial ones, height unchanged."""
    c, s = R.real, R.imag
    return (c * a[0] - s * a[1], s * a[0] + c * a[1], a[2])


@device
def slot(R: complex, p_L: Vector, v_L: Vector, d: Vector) -> Slot:
    """The slot and its velocity: `p_L - R d` and `p_L_dot - R S(theta_dot) d` (6), (32) at `e_z = 0`."""
    offset = out_of_frame(R, d)
    rate = heading_rate(R, complex(v_L[0], v_L[1]), d[0])
    return Slot(
        (p_L[0] - offset[0], p_L[1] - offset[1], p_L[2] - offset[2]),
        (v_L[0] + rate * offset[1], v_L[1] - rate * offset[0], v_L[2]),
    )
