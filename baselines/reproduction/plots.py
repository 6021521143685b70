"""The pictures of figures 2 to 9 and 11 to 14. Needs Matplotlib (extra `plot`)."""

from __future__ import annotations

from collections.abc import Callable
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np

from baselines.reproduction.claims_formation import FOLLOWER_FOLLOWER, LEADER_FOLLOWER
from baselines.reproduction.continuous import OFFSETS, Flight, Planar
from baselines.reproduction.sampled import TRANSIENT, Run
from baselines.reproduction.space import flight_in_space
from baselines.reproduction.style import (
    FOLLOWERS,
    LEADER,
    REFERENCE,
    components,
    ends,
    label,
    picture,
)

_PAIRS = (
    ("leader to follower 1", FOLLOWERS[0]),
    ("leader to follower 2", FOLLOWERS[1]),
    ("follower 1 to follower 2", LEADER),
)


def _plan_view(ax: Any, title: str) -> None:
    ax.set_aspect("equal", "datalim")
    ax.set_xlabel("x, north (m)")
    label(ax, "y, east (m)", title, time=False)


def _figure_2(m: Planar, path: Path) -> None:
    with picture(path, 9.0, 4.0) as figure:
        left, right = figure.subplots(1, 2)
        left.plot(*m.leader.T, color=LEADER, label="leader")
        ends(left, m.leader[:, 0], m.leader[:, 1], LEADER)
        for i, colour in enumerate(FOLLOWERS):
            left.plot(*m.p[:, i].T, "--", color=colour, label=f"virtual follower {i + 1}")
            ends(left, m.p[:, i, 0], m.p[:, i, 1], colour)
        _plan_view(left, "Position")
        left.legend(loc="upper left")
        gaps = (m.leader - m.p[:, 0], m.leader - m.p[:, 1], m.p[:, 0] - m.p[:, 1])
        for gap, (name, colour) in zip(gaps, _PAIRS, strict=True):
            right.plot(m.t, np.linalg.norm(gap, axis=1), color=colour, label=name)
        for level, name in ((hypot(*OFFSETS[0]), "|d|"), (0.7, "0.7 m")):
            right.axhline(level, color=REFERENCE, linestyle=":", linewidth=1.0)
            right.text(m.t[-1], level + 0.02, name, ha="right", va="bottom", color="#666666")
        right.set_ylim(bottom=0.0)
        label(right, "distance (m)", "Distance between vehicles")
        right.legend(loc="upper right")


def _figure_3(m: Planar, path: Path) -> None:
    states = (("u (m/s)", m.u), (r"$\omega$ (rad/s)", m.omega), (r"$\theta$ (rad)", m.theta))
    with picture(path, 9.0, 5.4) as figure:
        top, bottom = figure.subfigures(2, 1)
        for ax, (name, x) in zip(top.subplots(1, 3), states, strict=True):
            for i, colour in enumerate(FOLLOWERS):
                style = "-" if i == 0 else "--"
                ax.plot(m.t, x[:, i], style, color=colour, label=f"follower {i + 1}")
            label(ax, name)
        top.axes[0].legend(loc="lower right")
        errors = (("e1", m.e1, 0), ("e1", m.e1, 1), ("e2", m.e2, 0), ("e2", m.e2, 1))
        for ax, (name, e, k) in zip(bottom.subplots(1, 4), errors, strict=True):
            for i, colour in enumerate(FOLLOWERS):
                ax.plot(m.t, e[:, i, k], "-" if i == 0 else "--", color=colour)
            label(ax, f"{name}, {'xy'[k]} (m)")


def _figure_4(m: Flight, path: Path) -> None:
    with picture(path, 7.2, 6.2) as figure:
        flight_in_space(figure, m)


def _figure_5(m: Flight, path: Path) -> None:
    errors = (
        ("e1, position (m)", m.e1),
        ("e2, velocity (m/s)", m.e2),
        ("e3, thrust direction", m.e3),
        ("e4, angular velocity (rad/s)", m.e4),
    )
    with picture(path, 9.0, 6.6) as figure:
        axes = figure.subplots(3, 2, sharex=True).ravel()
        for ax, (name, e) in zip(axes, errors, strict=False):
            components(ax, m.t, e)
            label(ax, name, time=False)
        axes[0].legend(loc="upper right", ncols=3)
        axes[4].semilogy(m.t, m.lyapunov, color=LEADER)
        label(axes[4], "Lyapunov function V4")
        axes[5].plot(m.t, m.thrust, color=LEADER)
        axes[5].axhline(0.0, color=REFERENCE, linewidth=1.0)
        label(axes[5], "thrust (N)")
        axes[0].set_xlim(m.t[0], m.t[-1])


# -- figures 6 to 9 and 11 to 14 ----------------------------------------------------------------------


def _started(axes: Any, run: Run) -> None:
    """Shade the time before the trigger."""
    for ax in np.ravel(axes):
        ax.axvspan(0.0, run.trigger(0), color="#f1f1f1", zorder=0)
        ax.set_xlim(run.t[0], run.t[-1])


def _positions(run: Run, path: Path) -> None:
    begun = run.clock[:, 0] > 0.0
    tracks = [(run.p[:, 0, 0], LEADER, "-", "leader")]
    for i, colour in enumerate(FOLLOWERS):
        tracks.append((run.p[:, 0, 1 + i], colour, "-", f"follower {i + 1}"))
        tracks.append((run.virtual_p[:, 0, i], colour, "--", f"virtual follower {i + 1}"))
    with picture(path, 10.0, 4.8) as figure:
        left, right = figure.subplots(1, 2)
        aim = {"color": REFERENCE, "linestyle": ":", "label": "leader's reference"}
        left.plot(*run.reference[begun, :2].T, **aim)
        right.plot(run.t[begun], -run.reference[begun, 2], **aim)
        for p, colour, style, name in tracks:
            line = {"color": colour, "linewidth": 1.0, "linestyle": style}
            if style == "--":
                line |= {"linewidth": 1.8, "alpha": 0.5}
            left.plot(*p[~begun, :2].T, color=colour, linewidth=0.7, alpha=0.35)
            left.plot(*p[begun, :2].T, **line)
            right.plot(run.t, -p[:, 2], label=name, **line)
            ends(left, p[:, 0], p[:, 1], colour)
        _plan_view(left, "Position in the plane (pale: before the trigger)")
        label(right, "height, -z (m)", "Height (grey: before the trigger)")
        _started(right, run)
        _height_limits(right, run)
        figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=6)


def _height_limits(ax: Any, run: Run) -> None:
    """The heights once flying; the climb from the floor would hide their variations."""
    heights = -run.p[run.clock[:, 0] > 0.0, 0, :, 2]
    ax.set_ylim(float(heights.min()) - 0.1, float(heights.max()) + 0.1)


def _tracker_errors(run: Run, path: Path) -> None:
    names = {"e1": "e1 (m)", "e2": "e2 (m/s)", "e3": "e3", "e4": "e4 (rad/s)"}
    speed = run.v[:, 0, 1:] - run.virtual_v[:, 0]
    truth = (run.tracking[:, 0], speed)
    with picture(path, 10.0, 7.6) as figure:
        axes = figure.subplots(4, 2, sharex=True, sharey="row")
        for i in range(2):
            for k, (error, name) in enumerate(names.items()):
                ax, e = axes[k, i], run.tracker[error][:, 0, i]
                if k < 2:
                    components(ax, run.t, e, linewidth=0.4, alpha=0.3)
                    components(ax, run.t, truth[k][:, i], linewidth=1.2)
                else:
                    components(ax, run.t, e, linewidth=0.5, alpha=0.6)
                _steady_limits(ax, run, e)
                title = f"follower {i + 1}" if k == 0 else ""
                label(ax, name if i == 0 else "", title, time=k == 3)
        handles, texts = axes[0, 0].get_legend_handles_labels()
        axes[0, 0].legend(handles[3:], texts[3:], loc="upper right", ncols=3)
        title = (
            "Errors of the trackers (e1, e2: pale as measured, full the truth; take-off cut off)"
        )
        figure.suptitle(title, size=9.5)
        _started(axes, run)


def _steady_limits(ax: Any, run: Run, e: Any) -> None:
    """Room for everything but what happens in the first seconds after take-off."""
    later = e[run.t > 0.5 * run.trigger(0)]
    low, high = ax.get_ylim() if ax.get_autoscaley_on() is False else (np.inf, -np.inf)
    room = 0.08 * float(np.ptp(later))
    ax.set_ylim(min(low, float(later.min()) - room), max(high, float(later.max()) + room))


def _planner_errors(run: Run, path: Path) -> None:
    """From the trigger on: before it the planner is stopped."""
    names = ("e1 (m)", "e2 (m)", r"$e_z$ (m)")
    on = run.clock[:, 0] > 0.0
    t = run.t[on]
    measured = [e[on, 0] for e in run.planner.values()]
    height = run.p[:, :, :1, 2] - run.virtual_p[..., 2] - np.array(run.config.offsets)[:, 2]
    truth = (*(e[on, 0] for e in run.planner_true.values()), height[on, 0, :, None])
    with picture(path, 10.0, 6.2) as figure:
        axes = figure.subplots(3, 2, sharex=True, sharey="row")
        for i in range(2):
            for k, name in enumerate(names):
                ax = axes[k, i]
                for e, width, shade in ((measured[k], 0.4, 0.3), (truth[k], 1.2, 1.0)):
                    if k < 2:
                        components(ax, t, e[:, i], "xy", linewidth=width, alpha=shade)
                    else:
                        ax.plot(t, e[:, i, 0], color=LEADER, linewidth=width, alpha=shade)
                label(ax, name if i == 0 else "", _virtual_title(i, k), time=k == 2)
        handles, texts = axes[0, 0].get_legend_handles_labels()
        axes[0, 0].legend(handles[2:], texts[2:], loc="upper right", ncols=2)
        figure.suptitle("Errors of the planner (pale as measured, full the truth)", size=9.5)
        _started(axes, run)


def _virtual_title(follower: int, row: int) -> str:
    return f"virtual follower {follower + 1}" if row == 0 else ""


def _distances(run: Run, path: Path) -> None:
    steady = run.steady(0)
    bounds = (LEADER_FOLLOWER, LEADER_FOLLOWER, FOLLOWER_FOLLOWER)
    with picture(path, 9.0, 5.4) as figure:
        axes = figure.subplots(3, 1, sharex=True)
        for k, (name, colour) in enumerate(_PAIRS):
            d = run.distances[:, 0, k]
            mean = float(d[steady].mean())
            axes[k].plot(run.t, d, color=colour)
            axes[k].fill_between(
                run.t[steady], mean - bounds[k], mean + bounds[k], color=colour, alpha=0.12, lw=0
            )
            axes[k].set_ylim(mean - 3.0 * bounds[k], mean + 3.0 * bounds[k])
            text = f"{name}: steady average {mean:.3f} m, band \u00b1{bounds[k]:g} m"
            label(axes[k], "distance (m)", text, time=k == 2)
        _started(axes, run)
        axes[0].annotate(
            f"steady state from {TRANSIENT:g} s after the trigger",
            (run.t[steady][0], axes[0].get_ylim()[0]),
            xytext=(3, 4),
            textcoords="offset points",
            color="#666666",
        )


def _velocities(run: Run, path: Path) -> None:
    with picture(path, 10.0, 5.8) as figure:
        axes = figure.subplots(3, 2, sharex=True, sharey="row")
        for i, colour in enumerate(FOLLOWERS):
            for k in range(3):
                ax = axes[k, i]
                ax.plot(run.t, run.v[:, 0, 1 + i, k], color=colour, linewidth=1.0, label="vehicle")
                virtual = run.virtual_v[:, 0, i, k]
                ax.plot(run.t, virtual, "--", color=LEADER, linewidth=0.9, label="virtual follower")
                name = f"v, {'xyz'[k]} (m/s)" if i == 0 else ""
                label(ax, name, f"follower {i + 1}" if k == 0 else "", time=k == 2)
        axes[0, 0].legend(loc="upper right", ncols=2)
        _started(axes, run)


PICTURES: dict[int, Callable[[Any, Path], None]] = {
    2: _figure_2,
    3: _figure_3,
    4: _figure_4,
    5: _figure_5,
    6: _positions,
    7: _tracker_errors,
    8: _planner_errors,
    9: _distances,
    11: _positions,
    12: _velocities,
    13: _tracker_errors,
    14: _planner_errors,
}


def draw(number: int, motion: Any, path: Path) -> None:
    """Write the picture of figure `number` from the motion that belongs to it."""
    PICTURES[number](motion, path)
