"""Gains that check themselves: the conditions of theorems 1 and 2, before anything flies."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import sqrt
from typing import Annotated, Any, final

from formation_env.laws.planner import PlannerLaw
from formation_env.laws.tracker import TrackerLaw
from formation_env.validation.checks import Unit, number, require

MOST = 1e9  # of any gain: products of several stay far inside the floating-point range


@final
@dataclass(frozen=True)
class PlannerGains:
    """Gains of the planner (10), (21), (33)-(34); the defaults are section III-C's.

    Raises `ValueError` naming the gain unless the conditions of theorem 1 hold: `k1 > 0`, `k2 > 1`,
    `k3 >= 0` (the paper's simulations use 0, which switches the integral action off), and
    `k_z1, k_z2, p_max, z_max > 0`; none above 1e9. The paper does not print `z_max`.
    """

    k1: Annotated[float, Unit("1/s")] = 0.2
    k2: float = 2.0
    k3: float = 0.0
    kz1: Annotated[float, Unit("1/s^2")] = 0.2
    kz2: Annotated[float, Unit("1/s")] = 2.0
    p_max: Annotated[float, Unit("m")] = 5.0
    z_max: Annotated[float, Unit("m/s^2")] = 4.0

    def __post_init__(self) -> None:
        for f in fields(self):
            low = 1.0 if f.name == "k2" else 0.0
            _store(self, "planner", f.name, low, strict=f.name != "k3")

    def law(self) -> PlannerLaw:
        """The gains as the kernels take them."""
        return PlannerLaw(*(getattr(self, f.name) for f in fields(self)))


@final
@dataclass(frozen=True)
class TrackerGains:
    """Gains of the tracker (50)-(68); the defaults are section III-C's.

    `p12` and `p22` default to what makes `Q` positive definite (59): `p22 = k1`,
    `p12 = p11 k1 / k2`. Raises `ValueError` naming the condition unless

    - every gain is positive (`c > 1e-6`) and none above 1e9;
    - `p12^2 < p11 p22`, so `P` (56) is positive definite;
    - `Q` (57)-(59) is positive definite for every slope `sigma'` in `(0, sigma_max / sqrt(c)]`, which
      needs `k1 = p22` (as the slope goes to zero) and
      `(k2 - p12) p12 k1 + s (p11 p12 k1 k2 - (k1 p11 + k2 p12)^2 / 4) > 0` at both ends. The paper's
      choice `k2 = p11 p22 / p12` makes the bracket zero.

    The bound (53), `sigma_max < g - z_max`, joins tracker and planner: the configuration checks it.
    """

    k1: Annotated[float, Unit("1/s^2")] = 0.5
    k2: Annotated[float, Unit("1/s")] = 1.5
    k3: float = 10.0
    k4: float = 0.5
    kz: float = 1.0
    sigma_max: Annotated[float, Unit("m/s^2")] = 5.0
    c: float = 50.0
    p11: float = 1.0
    p12: float | None = None  # None: p11 k1 / k2
    p22: float | None = None  # None: k1

    def __post_init__(self) -> None:
        for f in fields(self):
            if getattr(self, f.name) is not None or f.default is not None:
                # As `c` goes to zero the saturation becomes a switch, its slope infinite.
                _store(self, "tracker", f.name, 1e-6 if f.name == "c" else 0.0)
        p12, p22 = self.weights
        number("tracker.p12", p12, 0.0)
        number("tracker.p22", p22, 0.0)
        require(
            p12 * p12 < self.p11 * p22,
            "tracker.p12",
            p12,
            f"p12^2 < p11 p22 = {self.p11 * p22:g}, so that P (56) is positive definite",
        )
        self._check_q(p12, p22)

    @property
    def weights(self) -> tuple[float, float]:
        """`(p12, p22)` of (56), as given or as they follow from the other gains."""
        p12 = self.p11 * self.k1 / self.k2 if self.p12 is None else self.p12
        return p12, self.k1 if self.p22 is None else self.p22

    def _check_q(self, p12: float, p22: float) -> None:
        """`Q` of (57)-(59) positive definite for every slope of the saturation."""
        k1, k2, p11 = self.k1, self.k2, self.p11
        require(
            abs(k1 - p22) <= 1e-12 * k1,
            "tracker.p22",
            p22,
            f"p22 = k1 = {k1:g}, so that Q (59) stays positive definite far from the origin",
        )
        steepest = self.sigma_max / sqrt(self.c)
        flat = (k2 - p12) * p12 * k1
        change = p11 * p12 * k1 * k2 - 0.25 * (k1 * p11 + k2 * p12) ** 2
        # A margin of rounding size: the paper's own choice makes `change` zero.
        require(
            flat > 0.0 and flat + steepest * change > -1e-12,
            "tracker.p12",
            p12,
            f"Q (57) positive definite, as with p12 = p11 p22 / k2 = {p11 * p22 / k2:g}",
        )

    def law(self) -> TrackerLaw:
        """The gains as the kernels take them."""
        given = [getattr(self, f.name) for f in fields(self)[:-2]]
        return TrackerLaw(*given, *list(self.weights))


def _store(gains: Any, group: str, name: str, low: float, strict: bool = True) -> None:
    """Check a gain and keep what was checked."""
    value = number(f"{group}.{name}", getattr(gains, name), low, MOST, strict=strict)
    object.__setattr__(gains, name, value)


# For vehicles driven by rates: a law of ours, `tracker.rate_command_through_lag`, since the paper's
# experiment used another tracker ([9]) and prints no gains of it. `k1` and `k2` are III-C's. With
# `omega = omega_d` (65) a tilt phi of the thrust and the velocity error obey, near hover and beside
# slower terms,
#
#     phi_dot = -k3 phi - g delta2 e2,  e2_dot = g phi,  delta = delta1 e1 + delta2 e2 + ... (58)
#
# so, with omega_d sent through an uncompensated lag, `lag s^3 + s^2 + k3 s + g^2 delta2 = 0`: stable while
#
#     k3 > lag g^2 delta2                                                                   (a)
#
# The compensation knows the lag and `omega_d_dot` only as well as measurements and ticks of 20 ms
# allow, so (a) wants a margin. And far from the slot the law tilts a vehicle at rest by the angle with
# `k3 sin phi = n |delta|`, n = T_d / m, which exists only while
#
#     n |delta| < k3                                                                        (b)
#
# Beyond, the vehicle rocks from limit to limit. III-C's `p11` of 1 makes delta2 2.5 and delta1 0.79 1/s^2:
# (a) is k3 > 12.1. A `p11` of 0.3 makes them 2.2 and 0.61: (a) is k3 > 10.7, and (b) holds up to
# 3.3 m with `k3` 20, less than where `paper` starts (4.1 m), and up to 6.7 m with 40.
RATES_GAINS = TrackerGains(k3=40.0, p11=0.3)
