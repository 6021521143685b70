"""Break the laws by one symbol at a time and see whether the tests notice.

    python tests/mutants.py [--jobs 2] [--only MODULE ...]

Prints a verdict for each mutant; the exit status is 1 if any survives, 2 if one no longer fits the
sources or a module's tests fail without any. `mutation` applies them; other lists are in
`mutants_of_core`, `mutants_of_worlds` and `mutants_of_paths`.
"""

from __future__ import annotations

import sys

from mutants_of_core import CORE
from mutants_of_paths import PATHS
from mutants_of_worlds import WORLDS
from mutation import Mutant, main

MUTANTS = [
    # The planner: errors (7), (11), the law (21), the height (33)-(34), the start, the step.
    Mutant("planner", "e1 = Rt * (p_L - f.p) - d", "e1 = Rt * (p_L - f.p) + d"),
    Mutant("planner", "-spin(f.omega, d) + Rt * v_L", "spin(f.omega, d) + Rt * v_L"),
    Mutant("planner", "scaled(1.0 / law.k1, -spin", "scaled(1.0 / law.k2, -spin"),
    Mutant("planner", "return complex(p_max * tanh", "return complex(-p_max * tanh"),
    Mutant("planner", "1.0 - a * a, 1.0 - b * b", "1.0 - a * a, 1.0 - a * b"),
    Mutant("planner", "tau = nu.imag / d.real", "tau = nu.imag * d.real"),
    Mutant("planner", "nu.real + d.imag * tau", "nu.real - d.imag * tau"),
    Mutant("planner", "delta = -spin(f.omega, V)", "delta = spin(f.omega, V)"),
    Mutant("planner", "-spin(f.omega, e1 + d) + V", "-spin(f.omega, e1 - d) + V"),
    Mutant("planner", "law.k1**2 * law.k2, e2", "law.k1**3 * law.k2, e2"),
    Mutant("planner", "law.k1 * law.k3, xi", "law.k2 * law.k3, xi"),
    Mutant("planner", "e_z = leader.p[2] - f.z - d_z", "e_z = leader.p[2] - f.z + d_z"),
    Mutant("planner", "law.kz1 * e_z + law.kz2", "law.kz1 * e_z - law.kz2"),
    Mutant("planner", "min(max(x, -law.z_max)", "min(max(x, law.z_max)"),
    Mutant("planner", "k = 0.5 * h * h", "k = 1.5 * h * h"),
    Mutant("planner", "v[1] + h * a[1]", "v[1] - h * a[1]"),
    Mutant("planner", "_coast(leader, 0.5 * h), _coast", "_coast(leader, 0.4 * h), _coast"),
    Mutant("planner", "_step(f, h, leader, middle, end", "_step(f, h, leader, end, end"),
    Mutant("planner", "plane(v_L) * direction.conjugate()", "plane(v_L) * direction"),
    Mutant("planner", "plane(p_L) - from_leader", "plane(p_L) + from_leader"),
    Mutant("planner", "p_L[2] - d[2]", "p_L[2] + d[2]"),
    Mutant("planner", "complex(T, f.omega * f.u)", "complex(T, -f.omega * f.u)"),
    # Feed-forward: the second and third derivatives of the law.
    Mutant("feedforward", "bend = -2.0 /", "bend = 2.0 /"),
    Mutant("feedforward", "sigma1) + each(sigma, sigma2)", "sigma1) - each(sigma, sigma2)"),
    Mutant("feedforward", "m.e2) - scaled(law.k3, f.xi)", "m.e2) + scaled(law.k3, f.xi)"),
    Mutant("feedforward", "A1, J1 = J - spin(w, A)", "A1, J1 = J + spin(w, A)"),
    Mutant("feedforward", "V2 = A1 - _spin_dot", "V2 = A1 + _spin_dot"),
    Mutant("feedforward", "spin(w2, a) + scaled(2.0", "spin(w2, a) + scaled(1.0"),
    Mutant("feedforward", "+ scaled(2.0, each(slope1", "+ scaled(3.0, each(slope1"),
    Mutant("feedforward", "y2 = V1 - T - _spin", "y2 = V1 + T - _spin"),
    Mutant("feedforward", "mu(V3, sigma3, e2_ddot, e2_dot", "mu(V3, sigma3, e2_ddot, m.e2"),
    Mutant("feedforward", "m.T_dot - w * w * u", "m.T_dot + w * w * u"),
    Mutant("feedforward", "3.0 * m.tau * m.T", "2.0 * m.tau * m.T"),
    Mutant("feedforward", "free = abs(a_z) < law.z_max", "free = abs(a_z) > law.z_max"),
    Mutant("feedforward", "law.kz2 * (leader.j[2] - j_z)", "law.kz2 * (leader.j[2] + j_z)"),
    # The slots: (6) and the zero dynamics (23).
    Mutant("slots", "(R.conjugate() * v_L).imag", "(R * v_L).imag"),
    Mutant("slots", "0.5 * h * (rate + ahead)", "0.5 * h * (rate + rate)"),
    Mutant("slots", "half = complex(1.0, 0.5 * angle)", "half = complex(1.0, -0.5 * angle)"),
    Mutant("slots", "p_L[0] - offset[0]", "p_L[0] + offset[0]"),
    Mutant("slots", "v_L[1] - rate * offset[0]", "v_L[1] + rate * offset[0]"),
    Mutant("slots", "c * a[1] - s * a[0], a[2]", "c * a[1] + s * a[0], a[2]"),
    # Rotations.
    Mutant("so3", "2.0 * (x * y + w * z), 2.0", "2.0 * (x * y - w * z), 2.0"),
    Mutant("so3", "p[0] * q[2] - p[1] * q[3]", "p[0] * q[2] + p[1] * q[3]"),
    Mutant("so3", "pick(tiny, 0.5, sine", "pick(tiny, 0.25, sine"),
    Mutant("so3", "(1.0 + r3[2], -r3[1], r3[0], 0.0)", "(1.0 + r3[2], r3[1], r3[0], 0.0)"),
    Mutant("so3", "a[2] * b[0] - a[0] * b[2]", "a[2] * b[0] + a[0] * b[2]"),
    # The rigid body: (41)-(46), actuators, step, floor.
    Mutant("quadrotor", "push[2] + GRAVITY - a * r3[2]", "push[2] - GRAVITY - a * r3[2]"),
    Mutant("quadrotor", "push[0] - a * r3[0]", "push[0] + a * r3[0]"),
    Mutant("quadrotor", "turn[1] - gyroscopic[1]", "turn[1] + gyroscopic[1]"),
    Mutant("quadrotor", "gyroscopic[2]) / J[2]", "gyroscopic[2]) / J[1]"),
    Mutant("quadrotor", "torque), 1.0, cross(w", "torque), -1.0, cross(w"),
    Mutant("quadrotor", "rate * (turn[2] - w[2])", "rate * (turn[2] + w[2])"),
    Mutant("quadrotor", "qw * w[1] + qz * w[0]", "qw * w[1] - qz * w[0]"),
    Mutant("runge_kutta", "e = rate(moved(x, h, c)", "e = rate(moved(x, h, a)"),
    Mutant("runge_kutta", "b), h / 3.0, c)", "b), h / 6.0, c)"),
    Mutant("runge_kutta", "c = rate(moved(x, 0.5 * h, b), middle", "c = rate(moved(x, 0.5 * h, b), end"),
    Mutant("runge_kutta", "{path} + h * rate{path}", "{path} - h * rate{path}"),
    Mutant("quadrotor", "after.v, normalise(after.q)", "after.v, (after.q)"),
    Mutant("quadrotor", "if actuation == MOMENT else", "if actuation == RATES else"),
    Mutant("quadrotor", "min(max(x, low), high)", "min(max(x, -low), high)"),
    Mutant("quadrotor", "(body.p[2] > 0.0) |", "(body.p[2] < 0.0) |"),
    Mutant("quadrotor", "body.v[2] >= 0.0", "body.v[2] <= 0.0"),
    Mutant("quadrotor", "max(body.v[2], 0.0)", "max(-body.v[2], 0.0)"),
    # The tracker: errors, closed-form rates, laws, Lyapunov function.
    Mutant("tracker", "(-ref.a[0], -ref.a[1]", "(-ref.a[0], ref.a[1]"),
    Mutant("tracker", "GRAVITY - ref.a[2]", "GRAVITY + ref.a[2]"),
    Mutant("tracker", "add_scaled(scale(k1, e1)", "add_scaled(scale(k2, e1)"),
    Mutant("tracker", "return -3.0 * x /", "return 3.0 * x /"),
    Mutant("tracker", "lift_dot = dot(b_dot, r3) + dot", "lift_dot = dot(b_dot, r3) - dot"),
    Mutant("tracker", "(m.w[1], -m.w[0], 0.0)", "(m.w[1], m.w[0], 0.0)"),
    Mutant("tracker", "b_ddot = sub(s_ddot, ref.s)", "b_ddot = add(s_ddot, ref.s)"),
    Mutant("tracker", "scale(p11, s), -p12, e2)", "scale(p11, s), p12, e2)"),
    Mutant("tracker", "inner)), k2 - p12, s)", "inner)), k2 + p12, s)"),
    Mutant("tracker", "-2.0 * n_dot, r3d_dot", "-1.0 * n_dot, r3d_dot"),
    Mutant("tracker", "o.b_dot, -n_dot, r3d)", "o.b_dot, n_dot, r3d)"),
    Mutant("tracker", "bend), cross(m.w, A))", "bend), cross(A, m.w))"),
    Mutant("tracker", "y_dot), cross(m.w, B))", "y_dot), cross(m.w, A))"),
    Mutant("tracker", "-(w[1] - p.A[1]) + p.B[0]", "-(w[1] - p.A[1]) - p.B[0]"),
    Mutant("tracker", "(w[0] - p.A[0]) + p.B[1], 0.0)", "(w[0] + p.A[0]) + p.B[1], 0.0)"),
    Mutant("tracker", "law.k4 * e4[0] + r3d_body[0]", "law.k4 * e4[0] - r3d_body[0]"),
    Mutant("tracker", "law.k4 * e4[1] + r3d_body[1]", "law.k3 * e4[1] + r3d_body[1]"),
    Mutant("tracker", "-g[1] + p.A_dot[0] - p.B_dot[1]", "-g[1] + p.A_dot[0] + p.B_dot[1]"),
    Mutant("tracker", "g[0] + p.A_dot[1] + p.B_dot[0]", "g[0] - p.A_dot[1] + p.B_dot[0]"),
    Mutant("tracker", "-law.kz * m.w[2]", "law.kz * m.w[2]"),
    Mutant("tracker", "p.A[0] - p.B[1] + lag", "p.A[0] + p.B[1] + lag"),
    Mutant("tracker", "lag * (p.A_dot[1] + p.B_dot[0])", "lag * (p.A_dot[1] - p.B_dot[0])"),
    Mutant("tracker", "V3 = V_sigma + 1.0 - dot", "V3 = V_sigma + 1.0 + dot"),
    Mutant("tracker", "V3 + 0.5 * dot(e4, e4)", "V3 + 1.5 * dot(e4, e4)"),
    Mutant("tracker", "-0.5 * (k1 * p11 + k2 * p12)", "-0.5 * (k1 * p11 - k2 * p12)"),
    Mutant("tracker", "_each(-0.5 * (k1 - p22))", "_each(-0.5 * (k1 + p22))"),
    Mutant("tracker", "V4_dot = -W - law.k3", "V4_dot = -W - law.k4"),
    # The floor's bound: height, turning by rates and by moments.
    Mutant("turning", "0.5 * (GRAVITY + abs(push))", "0.5 * (GRAVITY - abs(push))"),
    Mutant("turning", "0.5 * (GRAVITY + abs(push))", "0.4 * (GRAVITY + abs(push))"),
    Mutant("turning", "0.5 * (GRAVITY + abs(push))", "0.6 * (GRAVITY + abs(push))"),
    Mutant("turning", "_HALF_TILT = 1.125", "_HALF_TILT = 0.5"),
    Mutant("turning", "_HALF_TILT = 1.125", "_HALF_TILT = 1.5"),
    Mutant("turning", "* (abs(thrust) / mass)", "* (thrust / mass)"),
    Mutant("turning", "period * (v + period * a)", "period * (v - period * a)"),
    Mutant("turning", "period * (v + period * a)", "period * (abs(v) + period * a)"),
    Mutant("turning", "(z + slack < 0.0) & (z + fall", "(z + slack < 9.0) & (z + fall"),
    Mutant("turning", "near, far = h * h * dot(w, w)", "near, far = h * h * h * dot(w, w)"),
    Mutant("turning", "(far <= 1.0 - _SLACK)", "(far <= 4.0 - _SLACK)"),
    Mutant("turning", "h <= 2.0 * rate_lag", "h <= 20.0 * rate_lag"),
    Mutant("turning", "h * h * (x / least)", "h * h * (least / x)"),
    Mutant("turning", "h * h / (sqrt(x) * sqrt(least))", "h / (sqrt(x) * sqrt(least))"),
    Mutant("turning", "c * z * z", "0.1 * c * z * z"),
    Mutant("turning", "z = best / max(c, best)", "z = 3.0 * best / max(c, best)"),
    Mutant("turning", "t.room - (t.substeps + 1.0) * e", "t.room - e"),
    Mutant("turning", "room * room >= s + t", "room * room >= 0.1 * s + t"),
    Mutant("turning", "(room >= 0.0) &", "(room >= -9.0) &"),
    Mutant("turning", "t.effects[2] * abs(moment[2])", "t.effects[2] * moment[2]"),
    # The gains: the conditions of theorems 1 and 2, (53)-(59).
    Mutant("gains", 'low = 1.0 if f.name == "k2"', 'low = 0.9 if f.name == "k2"'),
    Mutant("gains", "p12 * p12 < self.p11 * p22", "p12 * p12 < 2.0 * self.p11 * p22"),
    Mutant("gains", "steepest = self.sigma_max / sqrt(self.c)",
           "steepest = self.sigma_max / self.c"),
    Mutant("gains", "flat = (k2 - p12) * p12 * k1", "flat = (k2 + p12) * p12 * k1"),
    Mutant("gains", "0.25 * (k1 * p11 + k2 * p12) ** 2", "0.5 * (k1 * p11 + k2 * p12) ** 2"),
    Mutant("gains", "self.p11 * self.k1 / self.k2", "self.p11 * self.k2 / self.k1"),
    # Functions that the compiler can vectorise: logarithm, sine and cosine, tanh.
    Mutant("elementary", "Single(0.33333670610) * f", "Single(0.33333370610) * f"),
    Mutant("elementary", "e * Single(0.69314718056)", "e * Single(0.69314618056)"),
    Mutant("elementary", "Single(-0.16666664662) + z", "Single(-0.16666464662) + z"),
    Mutant("elementary", "Single(0.04166665064) * z", "Single(0.04166465064) * z"),
    Mutant("elementary", "8.33333333332248946124e-03", "8.33333333232248946124e-03"),
    Mutant("elementary", "-1.38888888888741095749e-03", "-1.38888887888741095749e-03"),
    Mutant("elementary", "odd = (quarter == 1.0) |", "odd = (quarter == 0.0) |"),
    Mutant("elementary", "pick(quarter >= 2.0, -a, a)", "pick(quarter > 2.0, -a, a)"),
    Mutant("elementary", "- n * _HALF_PI_LOW", "+ n * _HALF_PI_LOW"),
    Mutant("elementary", "return complex(c, s)", "return complex(s, c)"),
    Mutant("elementary", "- n * _LOG_2_LOW", "+ n * _LOG_2_LOW"),
    Mutant("elementary", "4.166666666662399e-02", "4.166666676662399e-02"),
    Mutant("elementary", "less_one + (power - 1.0)", "less_one + (power + 1.0)"),
    Mutant("elementary", "t = -m / (m + 2.0)", "t = -m / (m - 2.0)"),
    Mutant("elementary", "size > 20.0, 20.0", "size > 2.0, 20.0"),
    Mutant("elementary", "pick(x < 0.0, -t, t)", "pick(x < 0.0, t, t)"),
    *CORE,
    *WORLDS,
    *PATHS,
]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main(MUTANTS))
