"""The numbers behind each figure, as columns of a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from baselines.reproduction.continuous import Flight, Planar
from baselines.reproduction.sampled import Run
from baselines.system.writing import write_text
from formation_env.paths.references import Floats

_XYZ = ("x", "y", "z")


class Table(NamedTuple):
    """Named columns of equal length; the first is `t`, s."""

    names: tuple[str, ...]
    values: Floats  # (rows, columns)


def _named(prefix: str, parts: tuple[str, ...]) -> list[str]:
    return [f"{prefix}_{part}" for part in parts]


def figure_2(m: Planar) -> Table:
    """Paths and distances, m."""
    names = ["t", "leader_x", "leader_y", "f1_x", "f1_y", "f2_x", "f2_y"]
    names += ["dist_leader_f1", "dist_leader_f2", "dist_f1_f2"]
    f1, f2 = m.p[:, 0], m.p[:, 1]
    gaps = [m.leader - f1, m.leader - f2, f1 - f2]
    distances = [np.linalg.norm(gap, axis=1) for gap in gaps]
    return Table(tuple(names), np.column_stack([m.t, m.leader, f1, f2, *distances]))


def figure_3(m: Planar) -> Table:
    """States (m/s, rad/s, rad) and errors (m) of the virtual followers."""
    names, columns = ["t"], [m.t[:, None]]
    for i in range(m.u.shape[1]):
        states = ("u", "omega", "theta", "e1_x", "e1_y", "e2_x", "e2_y")
        names += _named(f"f{i + 1}", states)
        columns += [
            np.column_stack([m.u[:, i], m.omega[:, i], m.theta[:, i]]),
            m.e1[:, i],
            m.e2[:, i],
        ]
    return Table(tuple(names), np.hstack(columns))


def figure_4(m: Flight) -> Table:
    """Flight of the released vehicle: position (m), thrust (N), errors, `V4`. Also figure 5's."""
    names = ["t", "p_x", "p_y", "p_z", "thrust"]
    for k in (1, 2, 3, 4):
        names += _named(f"e{k}", _XYZ)
    columns = [m.t, m.p, m.thrust, m.e1, m.e2, m.e3, m.e4, m.lyapunov]
    return Table((*names, "lyapunov"), np.column_stack(columns))


def formation(run: Run) -> Table:
    """World 0 of a run; the same columns for figures 6 to 9 and 11 to 14.

    `vK` is virtual follower K, `fK` the vehicle that flies along it. Errors are those that the laws
    compute from their noisy measurements; a name that ends in `_true` is the same error without.
    `started` is 1 once the trigger (40) has fired; until then the planner is stopped and measures its
    errors from the waiting reference.
    """
    names = ["t", "started", *_named("reference", _XYZ), *_named("leader", _XYZ)]
    started = (run.clock[:, 0] > 0.0).astype(np.float64)
    columns = [run.t, started, run.reference, run.p[:, 0, 0]]
    n = run.config.followers
    for i in range(n):
        names += _named(f"v{i + 1}", _XYZ) + _named(f"f{i + 1}", _XYZ)
        names += _named(f"f{i + 1}_v", _XYZ)
        columns += [run.virtual_p[:, 0, i], run.p[:, 0, 1 + i], run.v[:, 0, 1 + i]]
    for i in range(n):
        for k in (1, 2, 3, 4):
            names += _named(f"f{i + 1}_e{k}", _XYZ)
        names += [f"f{i + 1}_e{k}_{a}_true" for k in (1, 2) for a in _XYZ]
        columns += [run.tracker[f"e{k}"][:, 0, i] for k in (1, 2, 3, 4)]
        columns += [run.tracking[:, 0, i], run.v[:, 0, 1 + i] - run.virtual_v[:, 0, i]]
    for i in range(n):
        names += _named(f"v{i + 1}", ("e1_x", "e1_y", "e2_x", "e2_y", "ez"))
        names += [f"v{i + 1}_{e}_true" for e in ("e1_x", "e1_y", "e2_x", "e2_y")]
        columns += [run.planner[name][:, 0, i] for name in ("e1", "e2", "ez")]
        columns += [run.planner_true[name][:, 0, i] for name in ("e1", "e2")]
    names += ["dist_leader_f1", "dist_leader_f2", "dist_f1_f2"]
    return Table(tuple(names), np.column_stack([*columns, run.distances[:, 0]]))


def write_csv(path: Path, table: Table, digits: int = 9) -> None:
    """Write a header line and one line per row, `digits` significant digits."""
    lines = "\n".join([",".join([f"%.{digits}g"] * len(table.names))] * len(table.values))
    text = lines % tuple(table.values.ravel().tolist())
    write_text(path, ",".join(table.names) + "\n" + text + "\n")
