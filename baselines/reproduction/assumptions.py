"""How far from its slot the expert is in section IV, and which number of the paper or of ours makes it so.

`python -m baselines.reproduction.assumptions` flies scenario `experiment` with one change at a time and
prints the table of docs/experiment.md.
"""

from __future__ import annotations

import sys
import warnings
from collections import deque
from collections.abc import Callable
from functools import cache, partial
from math import pi
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from baselines.reproduction.sampled import Filter, Run, fly
from baselines.reproduction.statistics import rms
from baselines.scoring.metrics import WINDOW
from baselines.system import console
from formation_env import FormationConfig
from formation_env.config import NO_NOISE
from formation_env.laws.feasibility import FeasibilityWarning
from formation_env.paths.references import Floats
from formation_env.splines import from_samples
from formation_env.trajectories import Trajectory, lemniscate

SEEDS = 20
PATHS = ("as given", "drawn")
SCENARIO = "experiment"


class Change(NamedTuple):
    """A flight of the scenario with other fields, or with observations that are changed."""

    words: str
    fields: dict[str, Any] = {}  # noqa: RUF012
    shown: Callable[[FormationConfig], Filter] | None = None


class Errors(NamedTuple):
    """Medians over the episodes, m, and a share of them.

    RMS values are those of the second half of the window that is scored, distances of the whole.
    """

    slot: float  # RMS slot error of the vehicles
    seen: float  # RMS |e1| (7) of the virtual followers, as the planner measures it: figure 14
    tracking: float  # RMS |p - p_d| of the vehicles behind the virtual followers
    to_leader: float  # least distance between the leader and a follower
    between: float  # least distance between the followers
    above: float  # least height of the leader over a follower
    close: float  # share of episodes in which two centres come closer than `limits.collision`


# -- what is changed ------------------------------------------------------------------------------


@final
class Averaged:
    """Shows the leader's velocity, and if wanted its position, as the mean over the window of section IV."""

    def __init__(self, config: FormationConfig, position: bool) -> None:
        decisions = round(config.window / 50.0 / config.control_period)
        self._slices, self._position = config.layout.slices, position
        self._v: deque[Floats] = deque(maxlen=decisions)
        self._p: deque[Floats] = deque(maxlen=decisions)

    def __call__(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        rows, at = rows.copy(), self._slices
        cos, sin = np.moveaxis(rows[..., at["heading"]].astype(np.float64), -1, 0)
        zero, one = np.zeros_like(cos), np.ones_like(cos)
        R = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]])
        leader = {"_v": rows[..., at["leader_velocity"]]}
        if self._position:
            own = np.einsum("jiwn,wnj->wni", R, rows[..., at["position"]])
            leader["_p"] = rows[..., at["slot_error"]] + rows[..., at["offset"]] + own
        late = {}
        for name, values in leader.items():
            memory = getattr(self, name)
            memory.append(np.einsum("ijwn,wnj->wni", R, values))
            late[name] = np.einsum("jiwn,wnj->wni", R, np.mean(memory, axis=0)) - values
        rows[..., at["leader_velocity"]] += late["_v"]
        rows[..., at["relative_velocity"]] += late["_v"]
        if self._position:
            rows[..., at["slot_error"]] += late["_p"]
        return rows


@cache
def _as_printed() -> Trajectory:
    """(70) as it is printed, turned: speeds from 0.16 to 0.71 m/s."""
    t = np.arange(0.0, 200.0, 0.05)
    grown = solve_ivp(lambda _, g: np.sqrt(1.0 + np.sin(g) ** 2), (0.0, 200.0), [0.0],
                      t_eval=t, rtol=1e-9, atol=1e-9)  # fmt: skip
    g = grown.y[0] / 3.0
    z = 1.5 * np.sin(g) * (1.0 + 1j * np.cos(g)) / (1.0 + np.sin(g) ** 2) * np.exp(0.25j * pi)
    return from_samples(t, np.stack([z.real, z.imag, np.full(len(t), -1.6)], -1))


def changes() -> tuple[Change, ...]:
    """As it is; what is not printed; what may be read otherwise; what is printed."""
    low = ((0.35, 0.35, -0.6), (0.35, -0.35, -0.6))
    return (
        Change("none"),
        # Ours.
        Change("no gusts", {"gust": 0.0}),
        Change("no noise", {"noise": NO_NOISE}),
        Change("leader driven by moments, as in III-C", {"leader_actuation": "moment"}),
        Change("`rates_tracker.k3` 20 instead of 40", {"rates_tracker": {"k3": 20.0}}),
        # Read otherwise.
        Change("(70) as printed, 0.16 to 0.71 m/s", {"trajectory": _as_printed()}),
        Change("integral term `k1 k3`, as in (22)", {"planner": {"k3": 0.3 * 0.17}}),
        Change("velocity averaged too", {}, partial(Averaged, position=False)),
        Change("velocity and position averaged too", {}, partial(Averaged, position=True)),
        # As printed, but.
        Change("leader 0.6 m above instead of 0.3 m", {"offsets": low}),
        Change("window of 50 samples, 0.5 s late", {"window": 50}),
        Change("window of 20 samples, 0.2 s late", {"window": 20}),
        Change("no window", {"window": 1}),
        Change("no window, no noise", {"window": 1, "noise": NO_NOISE}),
        Change("leader at 0.25 m/s instead of 0.5", {"trajectory": lemniscate(speed=0.25)}),
        Change("planner's `k1` 3, `k3` 17: ten and a hundred times", {"planner": {"k1": 3.0, "k3": 17.0}}),
    )  # fmt: skip


_TO_LEADER = Errors._fields.index("to_leader")

# -- measuring ------------------------------------------------------------------------------------


def measure(change: Change, path: str, seeds: int = SEEDS) -> Errors:
    """Fly the scenario with a change, on the seeds from 0 on."""
    given = {"path": path, **change.fields}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FeasibilityWarning)  # (70) as printed inverts the followers
        run = fly(SCENARIO, worlds=seeds, after=WINDOW, shown=change.shown, **given)
    each = np.array([_world(run, w) for w in range(seeds)])
    close = each[:, _TO_LEADER : _TO_LEADER + 2].min(axis=1) < run.config.limits.collision
    return Errors._make([*np.median(each, axis=0).tolist(), float(close.mean())])


def _world(run: Run, w: int) -> tuple[float, ...]:
    """All but the last of `Errors` in one world."""
    late, whole = run.window(w, 0.5 * WINDOW, WINDOW), run.window(w, 0.0, WINDOW)
    far, up = run.distances[whole, w], run.p[whole, w, 1:, 2] - run.p[whole, w, :1, 2]
    return (
        rms(run.slot_error[late, w]),
        rms(run.planner["e1"][late, w]),
        rms(run.tracking[late, w]),
        float(far[:, :2].min()),
        float(far[:, 2].min()),
        float(up.min()),
    )


HEAD = (
    *("change", "slot error", "`e1` as measured", "tracking", "leader to follower"),
    *("follower to follower", "leader above", "below 0.353 m"),
)


def table(seeds: int = SEEDS) -> str:
    """A row for each change, in each cell the path as given and drawn; lengths in m."""
    lines = [HEAD, ("---", *["---:"] * (len(HEAD) - 1))]
    for change in changes():
        both = [measure(change, path, seeds) for path in PATHS]
        cells = [" / ".join(f"{e[k]:.3f}" for e in both) for k in range(len(Errors._fields) - 1)]
        lines.append((change.words, *cells, " / ".join(f"{100.0 * e.close:.0f} %" for e in both)))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    console.say(table())
    sys.exit(0)
