"""Figures 6 to 9 and 11 to 14: the environment's own sampled loop, flown by the expert.

One run is several worlds of one configuration that differ in their seeds only: the first is the one
that is drawn, all of them are what the claims are measured on.

Lengths in metres, times in seconds, angles in radians; inertial frame north-east-down.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.policies.expert import Expert
from baselines.reproduction.continuous import fields_of, vector
from formation_env import FormationConfig
from formation_env._jit import kernel
from formation_env.core.results import Results
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.laws.planner import PlanarErrors, PlannerLaw, Virtual, plane
from formation_env.laws.planner import errors as planner_errors
from formation_env.memory.records import line_storer, size
from formation_env.paths.references import Floats
from formation_env.scenarios import configure
from formation_env.task import COLUMNS

AFTER_TRIGGER = 80.0  # s, what the figures show once the trigger (40) has fired
TRANSIENT = 15.0  # s after the trigger, not part of the steady state
PATIENCE = 120.0  # s, for the trigger


Errors = dict[str, Floats]  # by name, (T, W, n, components) each
# What the expert is shown instead of rows `(W, n, entries)` that are observed.
Filter = Callable[[NDArray[np.float32]], NDArray[np.float32]]


class Run(NamedTuple):
    """T instants just before a decision, W worlds, n followers."""

    config: FormationConfig
    seed: int  # of world 0; world w has `seed + w`
    t: Floats  # (T,) s since the reset
    clock: Floats  # (T, W) s since the trigger; 0 before it
    reference: Floats  # (T, 3) m, of the leader in world 0
    p: Floats  # (T, W, n+1, 3) m, true, leader first
    v: Floats  # (T, W, n+1, 3) m/s
    estimate: Floats  # (T, W, 3) leader's acceleration as follower 1 observes it, m/s^2
    slot_error: Floats  # (T, W, n, 3) m, slot minus position, both true
    virtual_p: Floats  # (T, W, n, 3) m
    virtual_v: Floats  # (T, W, n, 3) m/s
    planner: Errors  # e1 (2), e2 (2), ez (1) as the planner measures them, m
    planner_true: Errors  # e1 (2), e2 (2) with the leader's true motion, m
    tracker: Errors  # e1 to e4 (3 each) as the tracker measures them

    @property
    def tracking(self) -> Floats:
        """True `p - p_d` of every follower, `(T, W, n, 3)`, m."""
        return self.p[:, :, 1:] - self.virtual_p

    @property
    def distances(self) -> Floats:
        """Leader to follower 1, leader to follower 2, follower 1 to follower 2, `(T, W, 3)`, m."""
        a, b, c = (self.p[:, :, i] for i in range(3))
        return np.stack([np.linalg.norm(x - y, axis=-1) for x, y in ((a, b), (a, c), (b, c))], -1)

    def window(self, world: int, begin: float, end: float = AFTER_TRIGGER) -> NDArray[np.bool_]:
        """Which instants lie from `begin` to `end` seconds after that world's trigger."""
        clock = self.clock[:, world]
        return (clock > 0.0) & (clock >= begin) & (clock <= end)

    def steady(self, world: int) -> NDArray[np.bool_]:
        """Which instants belong to the steady state."""
        return self.window(world, TRANSIENT)

    def trigger(self, world: int) -> float:
        """When the trigger (40) fired, s since the reset."""
        return float(self.t[np.argmax(self.clock[:, world] > 0.0)] - self.config.control_period)


def fly(
    scenario: str,
    seed: int = 0,
    worlds: int = 1,
    after: float = AFTER_TRIGGER,
    feedforward: str = "zero",
    shown: Callable[[FormationConfig], Filter] | None = None,
    **overrides: Any,
) -> Run:
    """Fly a scenario with the expert until `after` seconds past every world's trigger.

    The leader and followers 1 and 2 as in the paper. `shown` makes what changes the observations. Raises
    `RuntimeError` if the trigger of some world has not fired after two minutes.
    """
    config = configure(scenario, **{"path": "as given", "duration": after + PATIENCE, **overrides})
    simulation = Simulation(config, worlds)
    for world in range(worlds):
        simulation.seed(world, seeded_key(seed + world))
    expert = Expert(config, feedforward, keep_record=True)
    expert.reset(seed, worlds)
    look = shown(config) if shown else None
    results = simulation.reset()
    rows: list[dict[str, Floats]] = []
    while float(simulation.clock.min()) <= after:
        if float(simulation.time[0]) > PATIENCE and not bool(simulation.started.all()):
            late = int(np.argmin(simulation.started))
            raise RuntimeError(f"seed {seed + late}: no trigger (40) within {PATIENCE:g} s")
        row = _truth(simulation, results)
        observations = results.observations
        actions = expert.act(look(observations) if look else observations)
        rows.append({**row, **expert.record})
        # A step goes on after a failure: the figures show what the laws do, not what the task judges.
        results = simulation.step(actions)
    return _collect(config, simulation, seed, rows)


def _truth(simulation: Simulation, results: Results) -> dict[str, Floats]:
    """What is true now, and the leader's acceleration as the first follower's row has it."""
    parts = simulation.layout.unpack(results.observations[:, 0].astype(np.float64))
    a, R = parts["leader_acceleration"], parts["heading"]
    plane = (a[:, 0] + 1j * a[:, 1]) * (R[:, 0] + 1j * R[:, 1])
    return {
        "t": simulation.time[:1],
        "clock": simulation.clock,
        "p": simulation.positions,
        "v": simulation.velocities,
        "estimate": np.stack([plane.real, plane.imag, a[:, 2]], -1),
        "slot_error": results.outputs[..., COLUMNS["slot_error"]],
    }


def _collect(
    config: FormationConfig, simulation: Simulation, seed: int, rows: list[dict[str, Floats]]
) -> Run:
    x = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    true_errors = _planner_errors(
        x["p"],
        x["v"],
        x["virtual_p"],
        x["heading"][..., 0],
        x["speed"][..., 0],
        x["turn_rate"][..., 0],
        np.array(config.offsets),
        config.planner.law(),
    )
    return Run(
        config,
        seed,
        x["t"][:, 0],
        x["clock"],
        simulation.reference(x["clock"][:, 0]),
        x["p"],
        x["v"],
        x["estimate"],
        x["slot_error"],
        x["virtual_p"],
        x["virtual_v"],
        {name: x[f"planner_{name}"] for name in ("e1", "e2", "ez")},
        fields_of(PlanarErrors, true_errors),
        {name: x[f"tracker_{name}"] for name in ("e1", "e2", "e3", "e4")},
    )


_store_errors, _ERRORS = line_storer(PlanarErrors), size(PlanarErrors)


@kernel
def _planner_errors(
    p: Any,
    v: Any,
    virtual_p: Any,
    heading: Any,
    speed: Any,
    turn_rate: Any,
    offsets: Any,
    law: PlannerLaw,
) -> Floats:
    """`PlanarErrors` (7), (11) of virtual followers behind the true leader, `(T, W, n, 4)`.

    Of the vehicles `p` and `v` `(T, W, n + 1, 3)` the leader comes first; of the virtual followers
    `virtual_p` is `(T, W, n, 3)`, the others `(T, W, n)`.
    """
    out = np.empty((*heading.shape, _ERRORS))
    for k, w, i in np.ndindex(heading.shape):
        p_L, v_L = plane(vector(p[k, w, 0])), plane(vector(v[k, w, 0]))
        theta, u, omega = heading[k, w, i], speed[k, w, i], turn_rate[k, w, i]
        f = Virtual(plane(vector(virtual_p[k, w, i])), theta, u, omega, 0j, 0.0, 0.0)
        e = planner_errors(f, p_L, v_L, plane(vector(offsets[i])), law)
        _store_errors(out[k, w, i], e)
    return out
