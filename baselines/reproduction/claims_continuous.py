"""What sections II-C, II-D and III-C say of figures 2 to 5, measured."""

from __future__ import annotations

from math import hypot, pi

import numpy as np

from baselines.reproduction.claims import SILENT, SOUND, Claim
from baselines.reproduction.continuous import OFFSETS, Flight, Planar, planar
from formation_env.laws.feasibility import equilibrium
from formation_env.paths.references import Floats, by_name
from formation_env.trajectories import circle

CONVERGED = 0.05  # of an error's largest value


def _norm(x: Floats) -> Floats:
    return np.asarray(np.linalg.norm(x, axis=-1))


def _wrapped(angle: Floats) -> Floats:
    """The same angles within -pi to pi, rad."""
    return np.asarray((angle + pi) % (2.0 * pi) - pi)


# -- figures 2 and 3 --------------------------------------------------------------------------------


def _distances(m: Planar) -> list[Claim]:
    late = m.t >= 0.9 * m.t[-1]
    size = hypot(*OFFSETS[0])
    to_leader = _norm(m.leader[late, None] - m.p[late])
    apart = _norm(m.p[late, 0] - m.p[late, 1])
    off_leader = float(np.abs(to_leader - size).max())
    off_pair = float(np.abs(apart - 0.7).max())
    rule = "within 1 mm over the last tenth of the run"
    return [
        Claim(
            "distance-to-leader",
            (2,),
            "II-D",
            "the distances between leader and followers converge to fixed values",
            f"|d| = {size:.3f} m",
            f"{to_leader[-1, 0]:.5f} m and {to_leader[-1, 1]:.5f} m; off by at most "
            f"{1e3 * off_leader:.2g} mm in the last tenth",
            off_leader < 1e-3,
            rule,
            SILENT,
            {"f1": to_leader[-1, 0], "f2": to_leader[-1, 1], "largest_difference": off_leader},
        ),
        Claim(
            "distance-between-followers",
            (2,),
            "II-D",
            "the distance between the followers converges to 0.35 + 0.35 m",
            "0.7 m",
            f"{apart[-1]:.5f} m; off by at most {1e3 * off_pair:.2g} mm in the last tenth",
            off_pair < 1e-3,
            rule,
            SILENT,
            {"f1_f2": apart[-1], "largest_difference": off_pair},
        ),
    ]


def _states(m: Planar) -> list[Claim]:
    late = m.t >= 0.9 * m.t[-1]
    theta = float(np.abs(_wrapped(m.theta[late, 0] - m.theta[late, 1])).max())
    omega = float(np.abs(m.omega[late, 0] - m.omega[late, 1]).max())
    u = float(np.abs(m.u[late, 0] - m.u[late, 1]).max())
    e1 = float(_norm(m.e1[late]).max())
    e2 = float(_norm(m.e2[late]).max())
    return [
        Claim(
            "headings-and-rates-agree",
            (3,),
            "II-D",
            "angular speed and heading of the followers converge to one another",
            "0 rad, 0 rad/s",
            f"differences of at most {theta:.1e} rad (modulo 2 pi) and {omega:.1e} rad/s in the "
            "last tenth",
            theta < 1e-3 and omega < 1e-3,
            "both below 1e-3 over the last tenth of the run",
            SILENT,
            {"theta": theta, "omega": omega},
        ),
        Claim(
            "speed-independent-of-dy",
            (3,),
            "II-D",
            "each follower's u, omega and theta are independent of d_y",
            "u, omega, theta alike",
            f"omega and theta are; u differs by up to {u:.2f} m/s",
            u < 1e-3,
            "u alike within 1e-3 m/s over the last tenth of the run",
            SILENT,
            {"u": u},
            "a slip of the text: (25) has d_y in u (the follower on the outside of a bend is "
            "faster) and not in theta. The formation is rigid all the same, because that needs "
            "equal headings only.",
        ),
        Claim(
            "planner-errors-vanish",
            (3,),
            "II-B, theorem 1",
            "the errors e1 and e2 converge to zero from any start",
            "0",
            f"|e1| at most {e1:.1e} m and |e2| at most {e2:.1e} m in the last tenth",
            e1 < 1e-3 and e2 < 1e-3,
            "both below 1 mm over the last tenth of the run",
            SOUND,
            {"e1": e1, "e2": e2},
            "k3 = 0 here, as printed; theorem 1 asks for k3 > 0, which (22) does not need.",
        ),
    ]


def heading_on_a_circle(duration: float = 60.0, radius: float = 1.5, speed: float = 0.5) -> Claim:
    """The planner behind a leader on a circle: does the heading end at (28)?"""
    path = circle(radius, speed)
    m = planar(duration, 0.05, path)
    v = by_name(path(m.t[-1]))["v"]
    theta_d = _wrapped(m.theta[-1] - np.arctan2(v[1], v[0]))
    wanted = equilibrium(OFFSETS[0][0], 1.0 / radius)
    gap = float(np.abs(theta_d - wanted).max())
    return Claim(
        "heading-equilibrium",
        (),
        "II-C",
        "behind a circle only theta_d = -arcsin(d_x kappa_L) is stable (28)",
        f"{wanted:.5f} rad",
        f"{theta_d[0]:.5f} rad and {theta_d[1]:.5f} rad behind a circle of {radius:g} m after "
        f"{duration:g} s",
        gap < 1e-3,
        "within 1e-3 rad from both of II-D's starts",
        SILENT,
        {"f1": theta_d[0], "f2": theta_d[1], "expected": wanted},
    )


def planar_claims(m: Planar) -> list[Claim]:
    """II-C and II-D."""
    return [*_distances(m), *_states(m), heading_on_a_circle()]


# -- figures 4 and 5 --------------------------------------------------------------------------------


def settling_time(t: Floats, size: Floats, share: float = CONVERGED) -> float:
    """The time after which `size` stays below `share` of its largest value, s."""
    above = np.flatnonzero(size > share * size.max())
    return float(t[min(above[-1] + 1, len(t) - 1)])


def _convergence(m: Flight) -> list[Claim]:
    sizes = [_norm(e) for e in (m.e1, m.e2, m.e3, m.e4)]
    settled = [settling_time(m.t, size) for size in sizes]
    at = {s: int(np.searchsorted(m.t, s - 1e-9)) for s in (2.0, 10.0)}
    left = [float(size[at[2.0]] / size[0]) for size in sizes]
    peak = int(sizes[1].argmax())
    remaining, end = sizes[0][at[10.0]], sizes[0][-1]
    names = ("e1", "e2", "e3", "e4")
    listed = ", ".join(f"{n} {s:.1f} s" for n, s in zip(names, settled, strict=True))
    return [
        Claim(
            "tracker-converges",
            (5,),
            "III-C",
            "the time required for the convergence of the errors is approximately 10 seconds",
            "10 s",
            f"{listed}",
            max(settled) <= 10.0 and max(settled) > 5.0,
            f"converged: below {100 * CONVERGED:g} % of the error's own largest value for good; the "
            "last between 5 and 10 s",
            SILENT,
            dict(zip(names, settled, strict=True)),
        ),
        Claim(
            "attitude-first",
            (5,),
            "III-C",
            "during the first 1 to 2 s a faster convergence of e3 and e4 is observed",
            "e3, e4 before e1, e2",
            f"of their first values at 2 s: e3 {100 * left[2]:.0f} %, e4 {100 * left[3]:.0f} %, "
            f"e1 {100 * left[0]:.0f} %, e2 {100 * left[1]:.0f} %",
            max(left[2], left[3]) < min(left[0], left[1]) and max(settled[2:]) < min(settled[:2]),
            "e3 and e4 have less left at 2 s than e1 and e2, and settle before them",
            SILENT,
            dict(zip(names, left, strict=True)),
            "e3 is over within 2 s; e4 is not: it decays with k4 = 0.5 1/s, to 5 % in 6 s.",
        ),
        Claim(
            "velocity-error-grows",
            (5,),
            "III-C",
            "... at the cost of growing the error e2",
            "grows in 1 to 2 s",
            f"from {sizes[1][0]:.2f} m/s to {sizes[1][peak]:.2f} m/s at {m.t[peak]:.2f} s",
            sizes[1][peak] > 2.0 * sizes[1][0] and 0.5 < m.t[peak] <= 2.0,
            "at least doubles, with its peak within the first 2 s",
            SILENT,
            {"first": sizes[1][0], "largest": sizes[1][peak], "at": m.t[peak]},
        ),
        Claim(
            "remaining-error",
            (5,),
            "III-C",
            "even after t = 10 s a reminiscent error is noticeable, vanishing by the end",
            "noticeable, then none",
            f"|e1| = {remaining:.2f} m at 10 s, {end:.4f} m at {m.t[-1]:g} s",
            remaining > 0.1 and end < 0.01,
            "|e1| above 0.1 m at 10 s and below 0.01 m at the end",
            SILENT,
            {"at_10_s": remaining, "at_end": end},
        ),
    ]


def _inversion(m: Flight) -> Claim:
    z = m.e3[:, 2]
    upright = m.t[int(np.argmax(z > -0.1))]
    return Claim(
        "inversion",
        (4, 5),
        "III-C",
        "the rapid evolution of the third component of e3 indicates an inversion of r3",
        "rapid",
        f"e3_z from {z[0]:.2f} to -0.1 in {upright:.2f} s; r3 . r3d from {m.alignment[0]:.2f} to "
        f"{m.alignment[m.t <= 2.0][-1]:.3f} in 2 s",
        z[0] < -1.5 and 0.0 < upright < 2.0,
        "from below -1.5 to above -0.1 within 2 s",
        SILENT,
        {"first": z[0], "upright_at": upright, "alignment_at_start": m.alignment[0]},
        "the unstable equilibrium r3 = -r3d is not met: the start is 10 m off sideways, which "
        "tilts r3d.",
    )


def _lyapunov(m: Flight) -> list[Claim]:
    rise = float(np.diff(m.lyapunov).max())
    rate = float(m.lyapunov_rate.max())
    least = float(m.thrust.min())
    return [
        Claim(
            "lyapunov-falls",
            (5,),
            "III-B, theorem 2",
            "V4_dot (69) is negative: V4 never rises",
            "<= 0",
            f"largest V4_dot {rate:.1e}, largest change between two of {len(m.t)} instants {rise:.1e}",
            rate <= 1e-9 and rise <= 1e-9,
            "neither above 1e-9, the integrator's tolerance",
            SOUND,
            {"largest_rate": rate, "largest_change": rise, "first": m.lyapunov[0]},
        ),
        Claim(
            "negative-thrust",
            (4,),
            "III-B",
            "(54) gives a negative thrust while the vehicle is upside down",
            "< 0",
            f"down to {least:.2f} N, positive from {m.t[int(np.argmax(m.thrust > 0))]:.2f} s on",
            least < 0.0,
            "the least thrust is negative",
            SOUND,
            {"least": least, "largest": float(m.thrust.max())},
        ),
    ]


def flight_claims(m: Flight) -> list[Claim]:
    """III-B and the controller test of III-C."""
    return [*_convergence(m), _inversion(m), *_lyapunov(m)]
