"""How the leader's path lies in an episode: turned about the vertical, mirrored, begun at a later point.

A follower that has learned one path in one direction has learned nothing of following; a path that lies
elsewhere in every episode asks for the same flight relative to the formation.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import NamedTuple

import numpy as np

from formation_env._jit import device
from formation_env.maths.rng import COURSE, uniforms
from formation_env.maths.so3 import Vector
from formation_env.paths.references import Floats, TrajectoryPoint


class Courses(NamedTuple):
    """How the paths of episodes may lie."""

    drawn: (
        int  # whether they are turned at all, and the vehicles begin with yaw angles of their own
    )
    mirrored: int  # whether every second one is mirrored
    phases: int  # ticks, one of which a path begins at; 0: at its first


class Course(NamedTuple):
    """How the path of one episode lies."""

    turn: complex  # exp(j angle), about the vertical
    side: float  # -1 where it is mirrored, east for west, before it is turned; else 1


@device
def draw_course(key: int, courses: Courses) -> tuple[Course, int]:
    """The course of the episode `key`, all angles alike, and the tick of the path that it begins with."""
    u = uniforms(key, COURSE, 0, 0, 0)
    angle = 2.0 * pi * u[0]
    side = -1.0 if courses.mirrored != 0 and u[1] < 0.5 else 1.0
    return Course(complex(cos(angle), sin(angle)), side), int(u[2] * courses.phases)


@device
def lay_direction(course: Course, z: complex) -> complex:
    """A direction or point in the plane of the path as it is given, where the episode's path has it."""
    return complex(z.real, course.side * z.imag) * course.turn


@device
def lay(course: Course, a: Vector) -> Vector:
    """A vector of the path as it is given, where the episode's path has it; heights stay."""
    z = lay_direction(course, complex(a[0], a[1]))
    return (z.real, z.imag, a[2])


def lay_all(course: Course, points: Floats) -> Floats:
    """`lay` of many points `(N, 3)`, in NumPy, for which `lay` would have to be compiled apart."""
    z = (points[:, 0] + 1j * course.side * points[:, 1]) * course.turn
    return np.stack((z.real, z.imag, points[:, 2]), axis=1)


@device
def lay_point(course: Course, reference: TrajectoryPoint) -> TrajectoryPoint:
    """A point of the path and its derivatives, where the episode's path has them."""
    return TrajectoryPoint(
        lay(course, reference.p),
        lay(course, reference.v),
        lay(course, reference.a),
        lay(course, reference.j),
        lay(course, reference.s),
    )
