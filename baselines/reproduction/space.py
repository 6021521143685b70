"""Figure 4 in space: the path, and the vehicle's attitude and thrust at each of the first seconds."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from baselines.reproduction.continuous import Flight
from baselines.reproduction.style import AXES, FOLLOWERS, LEADER, REFERENCE
from formation_env.maths.so3 import rotation
from formation_env.paths.references import Floats

SNAPSHOTS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)  # s
_ARM = 1.1  # m, drawn length of a body axis
_FORCE = 2.2  # m per N


def _shown(a: Floats) -> Floats:
    """North, east, up: `z` points down in the package, up in a picture."""
    return np.asarray(a * np.array([1.0, 1.0, -1.0]))


def _arrow(ax: Any, start: Floats, along: Floats, colour: str, width: float) -> None:
    ax.quiver(
        *_shown(start), *_shown(along), color=colour, linewidth=width, arrow_length_ratio=0.25
    )


def _snapshot(ax: Any, m: Flight, t: float) -> None:
    """Body axes r1, r2, r3 and the thrust `-T r3` at time `t`."""
    k = int(np.searchsorted(m.t, t - 1e-9))
    q = (float(m.q[k, 0]), float(m.q[k, 1]), float(m.q[k, 2]), float(m.q[k, 3]))
    R = np.array(rotation(q))
    for axis, colour in zip(R, AXES, strict=True):
        ends = _shown(np.array([m.p[k], m.p[k] + _ARM * axis]))
        ax.plot(*ends.T, color=colour, linewidth=2.0)
    _arrow(ax, m.p[k], -_FORCE * m.thrust[k] * R[2], FOLLOWERS[1], 1.4)
    beside = _shown(m.p[k]) + np.array([0.5, 0.0, -0.8])
    ax.text(*beside, f"{t:g} s", color="#444444", size=8)


def flight_in_space(figure: Figure, m: Flight) -> None:
    """Draw figure 4."""
    ax: Any = figure.add_subplot(projection="3d")
    ax.plot(*_shown(m.reference).T, color=REFERENCE, linewidth=1.2, label="reference")
    ax.plot(*_shown(m.p).T, color=FOLLOWERS[0], linewidth=1.6, label="vehicle")
    for t in SNAPSHOTS:
        if t <= m.t[-1]:
            _snapshot(ax, m, t)
    for name, colour in (*zip(("r1", "r2", "r3"), AXES, strict=True), ("thrust", FOLLOWERS[1])):
        ax.plot([], [], [], color=colour, linewidth=2.0, label=name)
    ax.plot(*_shown(m.p[:1]).T, ">", color=LEADER, markersize=7)
    ax.plot(*_shown(m.p[-1:]).T, "s", color=LEADER, markersize=6)
    ax.set_xlabel("x, north (m)")
    ax.set_ylabel("y, east (m)")
    ax.set_zlabel("height, -z (m)")
    ax.set_box_aspect(
        (np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim()), np.ptp(ax.get_zlim())), zoom=1.1
    )
    ax.set_xticks(range(-6, 3, 2))
    # North, east, up is left-handed; with east growing towards the reader it looks as it is.
    ax.invert_yaxis()
    ax.view_init(elev=18.0, azim=-55.0)
    ax.legend(loc="upper left", ncols=2)
