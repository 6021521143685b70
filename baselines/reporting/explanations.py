"""Why the expert is not first everywhere: what the figures of an evaluation say about it, each once."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np

from baselines.scoring.results import Report, Result, above_expert
from formation_env import FormationConfig
from formation_env.physics.quadrotor import RATES

Reason = Callable[[Result, Result], bool]  # of a policy's result and the expert's

AHEAD = "These score above the expert"
CLIMB = (
    "The return counts the whole time limit, and before the trigger (40) fires every follower is far from "
    "its slot, so a policy that climbs to the start faster is paid earlier"
)
SLOWER = (
    "Once the formation flies, the expert earns more per tick than these policies, so they score above it "
    "by the faster climb alone"
)
POLES = "The expert's gains are cautious. For small errors the slowest poles of its loops are at"


def explanations(report: Report) -> list[str]:
    """Paragraphs: which policies score above the expert and what makes the difference, where scores mean
    nothing, and which policies cannot fly where."""
    better = {
        name: above_expert(scenario.results) if "expert" in scenario.results else []
        for name, scenario in report.scenarios.items()
    }
    better = {name: policies for name, policies in better.items() if policies}
    return [
        *_shared(report, better, AHEAD, lambda own, best: True),
        *_shared(report, better, CLIMB, _climbs_faster),
        *_shared(report, better, SLOWER, _earns_less),
        *_measured(report, better),
        *_poles(report, better),
        *_meaningless(report),
        *_absences(report),
    ]


def _listed(names: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _shared(report: Report, better: dict[str, list[str]], text: str, holds: Reason) -> list[str]:
    """A sentence, once, with the scenarios and policies that it holds for."""
    where = []
    for name, policies in better.items():
        results = report.scenarios[name].results
        found = [p for p in policies if holds(results[p], results["expert"])]
        if found:
            where.append(f"on `{name}` {_listed(found)}")
    return [f"{text}: {'; '.join(where)}."] if where else []


def _climbs_faster(own: Result, best: Result) -> bool:
    return own.summary["trigger_time"].value < 0.95 * best.summary["trigger_time"].value


def _earns_less(own: Result, best: Result) -> bool:
    name = "reward_since_trigger"
    return own.summary[name].value < best.summary[name].value


def _measured(report: Report, better: dict[str, list[str]]) -> list[str]:
    """What differencing positions costs the expert, a paragraph for each scenario."""
    text = []
    for name in better:
        scenario = report.scenarios[name]
        if scenario.measuring is None:
            continue
        best = scenario.results["expert"].summary
        now, then = best["slot_error_rms"].value, scenario.measuring["slot_error_rms"].value
        late = 0.5 * scenario.config.window * _sample_period(scenario.config)
        text.append(
            f"On `{name}` the planner relies on the leader's acceleration, a double difference of "
            f"positions averaged over {late * 2:g} s, so {late:g} s late. Where velocity and acceleration "
            f"are measured instead, the expert's slot error is {then:.3f} m and not {now:.3f} m, its "
            f"return {scenario.measuring['return'].value:.3f} and not {best['return'].value:.3f}."
        )
    return text


def _poles(report: Report, better: dict[str, list[str]]) -> list[str]:
    """The expert's poles, once for all scenarios that have the same."""
    where: dict[str, list[str]] = {}
    for name in better:
        where.setdefault(_poles_of(report.scenarios[name].config), []).append(name)
    each = [f"{poles} on {_listed(names)}" for poles, names in where.items()]
    return [f"{POLES} {'; '.join(each)}."] if each else []


def _poles_of(config: FormationConfig) -> str:
    p = config.planner
    t = config.rates_tracker if config.follower_actuation == RATES else config.tracker
    slope = t.sigma_max / sqrt(t.c)
    plane = min(p.k1, _slowest(p.k1 * p.k2, p.k3))
    return (
        f"-{plane:.2f} 1/s (planner, plane), -{_slowest(p.kz2, p.kz1):.2f} 1/s (planner, height) and "
        f"-{_slowest(slope * t.k2, slope * t.k1):.2f} 1/s (tracker's position loop)"
    )


def _meaningless(report: Report) -> list[str]:
    """A warning of the scenarios on which the score has no sense."""
    names = [name for name, scenario in report.scenarios.items() if not scenario.span > 0.0]
    where = _listed(names)
    return [f"On {where} the expert is no better than hover: scores there mean nothing."] * bool(
        names
    )


def _absences(report: Report) -> list[str]:
    """Where policies could not fly, and why: policies and scenarios that share a reason together."""
    scenarios: dict[tuple[str, str], list[str]] = {}
    for name, scenario in report.scenarios.items():
        for policy, reason in scenario.absent.items():
            scenarios.setdefault((policy, reason), []).append(name)
    policies: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for (policy, reason), names in scenarios.items():
        policies.setdefault((reason, tuple(names)), []).append(policy)
    return [
        f"Not flown on {_listed(list(names))}: {_listed(found)} ({reason})."
        for (reason, names), found in policies.items()
    ]


def _sample_period(config: FormationConfig) -> float:
    period = config.measurement_period
    return config.control_period if period is None else period


def _slowest(damping: float, stiffness: float) -> float:
    """Decay rate of the slowest mode of `s^2 + damping s + stiffness`, 1/s; a zero root is no mode."""
    roots = np.roots([1.0, damping, stiffness]) if stiffness > 0.0 else np.array([-damping])
    return float(-roots.real.max())
