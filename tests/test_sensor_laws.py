"""The laws of measurement, each alone: what is added to the truth, and what differences make of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from closed_loop import PROPERTY, Sines, agree, quaternions, vector, vectors
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from formation_env.maths import so3
from formation_env.maths.so3 import Quaternion, Vector
from formation_env.physics import sensors
from formation_env.physics.sensors import Measured, Noise

NOISE = Noise(0.2, 0.1, 0.05, 0.03, 0.02)
TRUTH = Measured((1.0, -2.0, -3.0), (0.5, 0.6, 0.7), (0.1, 0.2, 9.0), so3.IDENTITY, (1.0, 2.0, 3.0))


def errors(told: Measured, truth: Measured, noise: Noise) -> list[float]:
    """The 15 errors in standard deviations; of the attitude, the turn in body axes."""

    def rotation(q: Quaternion) -> Rotation:
        return Rotation.from_quat([q[1], q[2], q[3], q[0]])

    turn = (rotation(truth.q).inv() * rotation(told.q)).as_rotvec()
    parts = [
        np.subtract(told.p, truth.p) / noise.position,
        np.subtract(told.v, truth.v) / noise.velocity,
        np.subtract(told.a, truth.a) / noise.acceleration,
        turn / noise.attitude,
        np.subtract(told.w, truth.w) / noise.angular_velocity,
    ]
    return [float(x) for part in parts for x in part]


@PROPERTY
@given(st.permutations(range(1, 17)), quaternions())
def test_each_component_has_a_normal_number_of_its_own(drawn: list[int], q: Quaternion) -> None:
    """Given sixteen different numbers, the fifteen errors are fifteen of them."""
    numbers = [0.1 * n for n in drawn]
    fours = [tuple(numbers[k : k + 4]) for k in range(0, 16, 4)]
    truth = TRUTH._replace(q=q)
    found = errors(sensors.perturb(truth, NOISE, *fours), truth, NOISE)
    np.testing.assert_allclose(np.sort(found), np.sort(numbers[:15]), atol=1e-9)


def test_noise_is_standard_normal_and_independent() -> None:
    """Over samples, vehicles and episodes: unit covariance of the errors in standard deviations."""
    draws = [(key, who, when) for key in (1, 2) for who in (0, 3) for when in range(1500)]
    found = np.array([errors(sensors.corrupt(TRUTH, NOISE, *d), TRUTH, NOISE) for d in draws])
    np.testing.assert_allclose(found.std(axis=0), 1.0, atol=0.04)
    assert np.abs(found.mean(axis=0)).max() < 0.06
    assert np.abs(np.corrcoef(found.T) - np.eye(15)).max() < 0.07
    for group in (found[:1500] * found[1500:3000], found[:3000] * found[3000:]):
        assert np.abs(group.mean(axis=0)).max() < 0.1


@pytest.mark.parametrize("field", Noise._fields)
def test_one_kind_of_noise_is_enough_not_to_be_silent(field: str) -> None:
    none = Noise(0.0, 0.0, 0.0, 0.0, 0.0)
    assert sensors.silent(none)
    assert not sensors.silent(none._replace(**{field: 1e-9}))
    told = sensors.corrupt(TRUTH, none._replace(**{field: 0.1}), 1, 1, 1)
    changed = {kind for kind, a, b in zip("pvaqw", told, TRUTH, strict=True) if a != b}
    kinds = dict(zip(Noise._fields, "pvaqw", strict=True))
    assert changed == {kinds[field]}


@PROPERTY
@given(vectors(3.0), vectors(3.0), vectors(3.0), st.floats(0.01, 0.5))
def test_a_difference_is_the_velocity_half_a_period_ago(
    p: Vector, v: Vector, a: Vector, h: float
) -> None:
    """Exact on a parabola."""

    def position(t: float) -> Vector:
        return vector(np.array(p) + np.array(v) * t + 0.5 * np.array(a) * t * t)

    found = sensors.difference(position(h), position(0.0), h)
    agree(found, np.array(v) + 0.5 * h * np.array(a), 1e-11)


@PROPERTY
@given(quaternions(), vectors(5.0), st.floats(0.01, 0.3), st.sampled_from([-1.0, 1.0]))
def test_a_difference_of_attitudes_undoes_the_exponential(
    q: Quaternion, w: Vector, h: float, sign: float
) -> None:
    """`q exp(w h)` is where a constant `omega` in body axes leads: `w` comes back, of either sign of `q`."""
    now = so3.multiply(q, so3.exponential(so3.scale(h, w)))
    found = sensors.angular_difference(vector(sign * np.array(now)), q, h)
    if h * np.linalg.norm(w) < 3.0:
        agree(found, w, 1e-9)
    assert np.linalg.norm(found) * h <= np.pi + 1e-9, "the short way round"


def test_a_difference_of_equal_attitudes_is_zero() -> None:
    q = so3.exponential((0.3, -0.2, 0.9))
    agree(sensors.angular_difference(q, q, 0.02), np.zeros(3), 1e-12)
    tiny = so3.multiply(q, so3.exponential((3e-10, 0.0, 0.0)))
    agree(sensors.angular_difference(tiny, q, 0.02), [1.5e-8, 0.0, 0.0], 1e-13)


@PROPERTY
@given(st.integers(0, 20), st.integers(1, 40), st.floats(0.01, 0.1))
def test_the_moving_average_is_the_mean_of_the_differences(seed: int, n: int, h: float) -> None:
    v = [np.array(Sines(seed).at(k * h)[1]) for k in range(n + 1)]
    mean = np.mean([(after - before) / h for before, after in pairwise(v)], axis=0)
    found = sensors.averaged_acceleration(vector(v[-1]), vector(v[0]), n, h)
    agree(found, mean, 1e-10)
