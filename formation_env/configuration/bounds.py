"""Bounds that join several fields: the clock, and what may turn a vehicle within a substep.

Outside of them an accepted configuration would leave the numbers: an integration that diverges although
the vehicle does not, a count beyond what is counted.
"""

from __future__ import annotations

from math import isclose, pi

from formation_env.laws.world import MAX_TICKS
from formation_env.physics.vehicle import Vehicle
from formation_env.validation.checks import require

FINEST = 1e-6  # s, the shortest substep
_SAMPLING = 10**6  # substeps between two measurements

# The classical Runge-Kutta step h multiplies a decay x' = -x / lag by
# R(z) = 1 - z + z^2/2 - z^3/6 + z^4/24 with z = h / lag, so it is stable where |R(z)| < 1. R is positive
# everywhere and reaches 1 again at the root of 1 = z/2 - z^2/6 + z^3/24.
RK4_STABLE = 2.785293563405282


def check_clock(
    control_period: float, substeps: int, measurement_period: float | None, duration: float
) -> None:
    """Substeps that are long enough, measurements on them, and an episode that can be counted."""
    substep = control_period / substeps
    require(
        substep >= FINEST,
        "control_period",
        control_period,
        f"at least substeps x {FINEST:g} s = {substeps * FINEST:g} s",
    )
    if measurement_period is not None:
        steps = measurement_period / substep
        require(
            0.5 < steps <= _SAMPLING and isclose(steps, round(steps), rel_tol=1e-6),
            "measurement_period",
            measurement_period,
            f"a whole number of substeps of control_period / substeps = {substep:g} s, "
            f"at most {_SAMPLING}",
        )
    require(
        duration >= 0.999 * control_period,
        "duration",
        duration,
        f"at least one control_period = {control_period:g} s",
    )
    require(
        duration / control_period <= MAX_TICKS,
        "duration",
        duration,
        f"at most 2^40 control periods = {MAX_TICKS * control_period:g} s (1e9 s, 32 years, "
        "serves where an episode should never be truncated)",
    )


def check_rate_loop(vehicle: Vehicle, substep: float) -> None:
    """Vehicles driven by rates: the loop's lag and its fastest command, against a substep (s).

    The loop's decay is integrated by Runge-Kutta, stable for `substep / rate_lag < 2.785`
    (`RK4_STABLE`). A command of half a turn in a substep is no longer told from one the other way.
    """
    require(
        substep < RK4_STABLE * vehicle.rate_lag,
        "vehicle.rate_lag",
        vehicle.rate_lag,
        f"above {substep / RK4_STABLE:.3g} s: the integration of the rate loop is stable for "
        f"substep / rate_lag < {RK4_STABLE:.4g}, and control_period / substeps = {substep:g} s; "
        "give more substeps",
    )
    require(
        max(vehicle.rate_max) * substep < pi,
        "vehicle.rate_max",
        vehicle.rate_max,
        f"below {pi / substep:.4g} rad/s, half a turn in control_period / substeps = {substep:g} s",
    )


def check_moments(vehicle: Vehicle, control_period: float, substep: float) -> None:
    """Vehicles driven by moments: the largest moment against the inertia, a tick and a substep (s).

    From rest, a moment held for a tick gives `omega = moment_max / J x control_period`. Euler's
    equation turns `omega` at rates up to `|omega|`, as no difference of two moments of inertia exceeds
    the third, and Runge-Kutta follows that up to `2 sqrt(2)` radians in a substep. Asked for is one
    radian: the rest is for ticks that follow each other.
    """
    limit = 1.0 / (control_period * substep)
    for axis, (full, J) in enumerate(zip(vehicle.moment_max, vehicle.inertia, strict=True)):
        require(
            full / J <= limit * (1.0 + 1e-9),
            f"vehicle.moment_max[{axis}]",
            full,
            f"at most {limit * J:.3g} N m for inertia[{axis}] = {J:g} kg m^2: held for one "
            f"control_period it must not turn the vehicle by more than 1 rad in a substep of "
            f"{substep:g} s; give the vehicle's own moments, or more substeps",
        )
