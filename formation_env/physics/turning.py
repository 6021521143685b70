"""Whether a vehicle can meet the floor within a tick, and how far it can turn in it: bounds, not guesses.

Most ticks are flown by a loop that does not look for the floor, so "it stays up" has to be certain for
every accepted vehicle and state. What is bounded is what `quadrotor.fly` computes, the stages of Runge
and Kutta included, in a tick of `n` substeps of `h` seconds with the actuators held.

**Height.** If the downward acceleration in each stage is at most `A >= 0`, then `v` grows by at most `h
A` in a substep and `p` by at most `h v + h^2 A / 2`, since `p' - p = h v + h^2 (a1 + a2 + a3) / 6`. After
`t <= P = n h` that makes at most `p + t v + t^2 A / 2`, which is convex in `t`: it stays below the
floor's 0 if it does for `t = 0` and for `t = P`. A thrust `T` pushes down with at most `|r3z| T / m`, and
`r3z = 1 - 2 (x^2 + y^2)` of a stage, whose quaternion is not normalised, is at most `2 |q|^2 - 1` in
size. Let `z` bound `h |w|` in all stages; a quaternion's derivative is `q w / 2`, at right angles to `q`.
Then the stages at `h / 2` and `h` have

    |q_d| <= sqrt(1 + z^2 / 4) + z^2 / 8 + z^3 / 32 <= 1.2743  for z <= 1,   and the earlier ones less,

so that `|r3z| < 2.25` and `A = g + |push| + 2.25 |T| / m`. Hence what is left is to show `h |w| <= 1`.

**Driven by rates.** For `h <= 2 rate_lag` each stage's `w`, and the next one, lies between `w` and what
is commanded: the factors `1 - x/2`, `1 - x/2 + x^2/4` and `1 - x + x^2/2 - x^3/6 + x^4/24` of their
difference are in [0, 1] for `x = h / rate_lag` in [0, 2]. So `h max(|w|, |w_c|) <= 1` suffices.

**Driven by moments.** Let `u_i = sqrt(J_i / J_min) w_i`, so that `|w| <= |u|`. Euler's equation becomes
`u' = m + G(u)` with `|m| <= mu = sum |M_i| / sqrt(J_i J_min)`, `G(u)` at right angles to `u` (it does no
work), and `|G(u)| <= c |u|^2`, `c = max |J_j - J_k| sqrt(J_min / (J_i J_j J_k)) / sqrt(3)`. Suppose all
stages of the tick have `h |u| <= z`, and let `e = h^2 mu`, `g = c z^2`. Then `h^2 |u'| <= e + g` in every
stage. `G` of a stage that is `a h u'` away from `u` has `|u . G| <= a h |u'| |G|`, and the mean of `a` is
`1/2`: so without the moment a substep adds at most `g (e + g) + g^2` to `h^2 |u|^2`; the moment adds `e`
to `h |u|`. After all substeps, and a stage ahead,

    h |u| <= sqrt(s + n g (2 g + e)) + n e + (e + g),    s = (h |u|)^2 at the start.

Where that is at most `z` the supposition holds, stage after stage. Any `z <= 1` proves it; the one taken
admits the largest `s` without moment: `c z = (sqrt(1 + 16 n) - 3) / (4 (2 n - 1))`.

What is not a number or infinite fulfils no inequality and is never certain. Slacks of 1e-9 cover
rounding.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from formation_env._jit import device
from formation_env.maths.so3 import Vector, dot, times
from formation_env.physics.quadrotor import GRAVITY, Airframe

_SLACK = 1e-9
_HALF_TILT = 1.125  # half of 2.25, the largest |r3z| in a stage


class Turning(NamedTuple):
    """What bounds the turning of a vehicle driven by moments: constants of a vehicle and a clock."""

    weights: Vector  # s^2, h^2 J_i / J_min
    effects: Vector  # 1 / (N m), h^2 / sqrt(J_i J_min)
    room: float  # z - g
    gain: float  # g
    substeps: float  # n


def turning(airframe: Airframe, period: float, substeps: int) -> Turning:
    """The constants of `slow_by_moment` for ticks of `period` seconds."""
    h, n, J = period / substeps, float(substeps), airframe.inertia
    least = min(J)
    coupling = 0.0
    for i in range(3):
        j, k = J[(i + 1) % 3], J[(i + 2) % 3]
        unequal = abs(j - k) + 1e-15 * (j + k)  # the rounding of two large terms that cancel
        coupling = max(coupling, unequal / sqrt(j) / sqrt(k) * sqrt(least / J[i]))
    c = coupling / sqrt(3.0)
    best = (sqrt(1.0 + 16.0 * n) - 3.0) / (4.0 * (2.0 * n - 1.0))
    z = best / max(c, best)
    g = c * z * z
    a, b, d = (h * h * (x / least) for x in J)
    e, f, k = (h * h / (sqrt(x) * sqrt(least)) for x in J)
    return Turning((a, b, d), (e, f, k), (z - g) * (1.0 - _SLACK), g, n)


@device
def slow_by_moment(w: Vector, moment: Vector, t: Turning) -> bool:
    """Whether `h |w| <= 1` in all stages of a tick, under a moment held (N m)."""
    s = dot(t.weights, times(w, w))
    e = (
        t.effects[0] * abs(moment[0])
        + t.effects[1] * abs(moment[1])
        + t.effects[2] * abs(moment[2])
    )
    room = t.room - (t.substeps + 1.0) * e
    return (room >= 0.0) & (room * room >= s + t.substeps * t.gain * (2.0 * t.gain + e))


@device
def slow_by_rates(w: Vector, commanded: Vector, h: float, rate_lag: float) -> bool:
    """The same under an angular velocity commanded (rad/s)."""
    near, far = h * h * dot(w, w), h * h * dot(commanded, commanded)
    return (near <= 1.0 - _SLACK) & (far <= 1.0 - _SLACK) & (h <= 2.0 * rate_lag)


@device
def stays_up(z: float, v: float, thrust: float, push: float, period: float, mass: float) -> bool:
    """Whether a vehicle with `h |w| <= 1` stays above the floor for `period` seconds.

    `z`, `v` (m, m/s) and the gust `push` (m/s^2) are downward, `thrust` is held (N).
    """
    a = 0.5 * (GRAVITY + abs(push)) + _HALF_TILT * (abs(thrust) / mass)
    fall = period * (v + period * a)
    slack = _SLACK * (abs(z) + period * (abs(v) + period * a))
    return (z + slack < 0.0) & (z + fall + slack < 0.0)
