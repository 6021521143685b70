"""Gains are accepted exactly where theorems 1 and 2 hold; the oracle is the eigenvalues of P and Q."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from closed_loop import PROPERTY
from hypothesis import assume, given
from hypothesis import strategies as st

from formation_env import PlannerGains, TrackerGains, Vehicle, configure
from formation_env.laws import tracker
from formation_env.laws.gains import RATES_GAINS
from formation_env.laws.tracker import Motion
from formation_env.laws.world import hold_at
from formation_env.physics.quadrotor import GRAVITY

gains = st.floats(0.05, 5.0, allow_subnormal=False)


def least(matrix: npt.NDArray[np.float64]) -> float:
    return float(np.linalg.eigvalsh(matrix)[0])


def P(p11: float, p12: float, p22: float) -> npt.NDArray[np.float64]:
    """(56), one axis."""
    return np.array([[p11, -p12], [-p12, p22]])


def Q(
    k1: float, k2: float, p11: float, p12: float, p22: float, slope: float
) -> npt.NDArray[np.float64]:
    """(57) with its blocks as printed, one axis; `slope` is the saturation's derivative."""
    off = -0.5 * (k1 * p11 + k2 * p12) * slope - 0.5 * (k1 - p22)
    return np.array([[(k2 - p12) + p11 * k2 * slope, off], [off, p12 * k1 * slope]])


def slopes(law: TrackerGains) -> npt.NDArray[np.float64]:
    """Slopes that `sigma_max x / sqrt(c + x^2)` takes: from almost 0 to `sigma_max / sqrt(c)`."""
    return law.sigma_max / np.sqrt(law.c) * np.array([1e-3, 0.1, 0.3, 0.5, 0.8, 1.0])


@PROPERTY
@given(gains, gains, gains, gains, gains)
def test_what_is_accepted_is_stable(
    k1: float, k2: float, p11: float, share: float, c: float
) -> None:
    """With any accepted `p12`, P and every Q are positive definite (theorem 2)."""
    p12 = p11 * k1 / k2 * share
    try:
        law = TrackerGains(k1=k1, k2=k2, p11=p11, p12=p12, c=c)
    except ValueError:
        return
    assert least(P(p11, p12, k1)) > 0.0
    for slope in slopes(law):
        assert least(Q(k1, k2, p11, p12, k1, slope)) > -1e-9


@PROPERTY
@given(gains, gains, gains, gains, gains)
def test_what_is_refused_is_not(k1: float, k2: float, p11: float, share: float, c: float) -> None:
    p12 = p11 * k1 / k2 * share
    matrices = [P(p11, p12, k1)]
    matrices += [Q(k1, k2, p11, p12, k1, 5.0 / np.sqrt(c) * s) for s in (1e-4, 1.0)]
    margin = min(np.linalg.det(matrix) for matrix in matrices)
    trace = min(float(np.trace(matrix)) for matrix in matrices)
    assume(abs(margin) > 1e-9)
    if margin < 0.0 or trace < 0.0:
        with pytest.raises(ValueError, match=r"tracker\.p12"):
            TrackerGains(k1=k1, k2=k2, p11=p11, p12=p12, c=c)
    else:
        TrackerGains(k1=k1, k2=k2, p11=p11, p12=p12, c=c)


@PROPERTY
@given(gains, gains, gains)
def test_defaults_are_the_papers_choice(k1: float, k2: float, p11: float) -> None:
    """`p22 = k1` and `k2 = p11 p22 / p12`, by which Q becomes (59)."""
    assume(k2**2 > 1.01 * p11 * k1)
    chosen = TrackerGains(k1=k1, k2=k2, p11=p11)
    law = chosen.law()
    assert law.p22 == k1
    assert p11 * law.p22 / law.p12 == pytest.approx(k2)
    for s in slopes(chosen):
        printed = np.array(
            [
                [(p11 * k1 - law.p12**2) / law.p12 + p11**2 * k1 / law.p12 * s, -k1 * p11 * s],
                [-k1 * p11 * s, law.p12 * k1 * s],
            ]
        )
        np.testing.assert_allclose(Q(k1, k2, p11, law.p12, k1, s), printed, rtol=1e-9, atol=1e-12)


def test_defaults_follow_a_replaced_gain() -> None:
    """What was derived is derived anew: it must not freeze at the old gains' values."""
    assert replace(TrackerGains(), k1=0.7).law() == TrackerGains(k1=0.7).law()
    assert replace(Vehicle(), mass=0.3).full_thrust == Vehicle(mass=0.3).full_thrust


def test_p22_other_than_k1_is_refused() -> None:
    """Far out the slope vanishes, and Q12 with it only if `p22 = k1`."""
    with pytest.raises(ValueError, match=r"tracker\.p22 = 0\.6: .*p22 = k1 = 0\.5"):
        TrackerGains(p22=0.6)
    assert least(Q(0.5, 1.5, 1.0, 1 / 3, 0.6, 1e-6)) < 0.0


def test_a_p_that_is_not_positive_definite_is_refused() -> None:
    with pytest.raises(ValueError, match=r"tracker\.p12 = 0\.8: .*P \(56\)"):
        TrackerGains(p12=0.8)


@pytest.mark.parametrize(
    ("gain", "value", "accepted"),
    [
        ("k1", 1e-6, True),
        ("k1", 0.0, False),
        ("k2", 1.0, False),  # theorem 1: k2 > 1
        ("k2", 1.0 + 1e-9, True),
        ("k3", 0.0, True),  # no integral action, as in the paper's simulations
        ("k3", -1e-9, False),
        ("kz1", 0.0, False),
        ("kz2", 0.0, False),
        ("p_max", 0.0, False),
        ("z_max", 0.0, False),
    ],
)
def test_conditions_of_theorem_1(gain: str, value: float, accepted: bool) -> None:
    if accepted:
        assert getattr(PlannerGains(**{gain: value}).law(), gain) == value
    else:
        with pytest.raises(ValueError, match=rf"planner\.{gain} = {value!r}"):
            PlannerGains(**{gain: value})


def test_the_laws_get_every_gain_in_its_place() -> None:
    planner = PlannerGains(k1=0.1, k2=1.2, k3=0.3, kz1=0.4, kz2=0.5, p_max=0.6, z_max=0.7)
    law = planner.law()
    for name in law._fields:
        assert getattr(law, name) == getattr(planner, name)
    tracker = TrackerGains(k1=0.4, k2=1.6, k3=9.0, k4=0.7, kz=1.1, sigma_max=4.0, c=60.0, p11=1.2)
    tracker = replace(tracker, p12=0.31, p22=0.4)
    flat = tracker.law()
    for name in flat._fields:
        assert getattr(flat, name) == getattr(tracker, name), name
    assert replace(planner, k1=0.2) == PlannerGains(
        k1=0.2, k2=1.2, k3=0.3, kz1=0.4, kz2=0.5, p_max=0.6, z_max=0.7
    )


# -- vehicles driven by rates -----------------------------------------------------------------------------

LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def pull(e1: float, e2: float, gains: TrackerGains) -> float:
    """The horizontal part of `delta` (58) of a level vehicle with errors along north, 1/s^2 m."""
    m = Motion((e1, 0.0, 0.0), (e2, 0.0, 0.0), LEVEL, (0.0, 0.0, 0.0))
    return tracker.outer(m, hold_at((0.0, 0.0, 0.0)), gains.law()).delta[0]


def poles(gains: TrackerGains, lag: float) -> npt.NDArray[np.complex128]:
    """Of tilt and velocity error near hover, `omega_d` sent through an uncompensated lag."""
    delta2 = pull(0.0, 1e-6, gains) / 1e-6
    return np.roots([lag, 1.0, gains.k3, GRAVITY**2 * delta2])


def test_gains_for_rates_stand_twice_the_lag_that_they_have_to() -> None:
    """(a) of `RATES_GAINS`, by the roots: without any compensation, and the limit is where it says."""
    lag = Vehicle().rate_lag
    assert poles(RATES_GAINS, 2.0 * lag).real.max() < 0.0
    delta2 = pull(0.0, 1e-6, RATES_GAINS) / 1e-6
    least = lag * GRAVITY**2 * delta2
    assert least == pytest.approx(10.7, abs=0.05)
    for k3, stable in ((1.01 * least, True), (0.99 * least, False)):
        assert (poles(replace(RATES_GAINS, k3=k3), lag).real.max() < 0.0) == stable
    # What the paper's own gains miss.
    assert poles(TrackerGains(), lag).real.max() > 0.0


@pytest.mark.parametrize("scenario", ["paper", "experiment"])
def test_with_gains_for_rates_a_tilt_exists_wherever_a_flight_begins(scenario: str) -> None:
    """(b) of `RATES_GAINS`: `n |delta| < k3` at rest, a quarter of it left, from start to slot."""
    config = configure(scenario, action="rates")
    first, gains = np.asarray(config.trajectory(0.0)).reshape(-1)[:2], config.rates_tracker
    pairs = zip(np.array(config.ground_starts())[1:], np.array(config.offsets), strict=True)
    far = max(float(np.linalg.norm(first - p[:2]) + np.linalg.norm(d[:2])) for p, d in pairs)
    at_rest = Motion((far, 0.0, 0.0), (0.0, 0.0, 0.0), LEVEL, (0.0, 0.0, 0.0))
    n = np.linalg.norm(tracker.outer(at_rest, hold_at((0.0, 0.0, 0.0)), gains.law()).b)
    assert n * pull(far, 0.0, gains) < 0.75 * gains.k3


def test_with_half_of_k3_it_does_not() -> None:
    """Why `paper:rates` started after 18.5 s: a follower begins 4.1 m from its slot."""
    slow = replace(RATES_GAINS, k3=20.0)
    assert GRAVITY * pull(4.1, 0.0, slow) > slow.k3
    assert GRAVITY * pull(3.3, 0.0, slow) < slow.k3
