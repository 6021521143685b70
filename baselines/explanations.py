"""Why the expert is not first everywhere: what the figures of an evaluation say about it."""

from __future__ import annotations

from math import isfinite, sqrt

import numpy as np

from baselines.cells import figure, scored, signed
from baselines.intervals import Estimate
from baselines.scoring import Report, Scenario, Source, above_expert
from formation_env import FormationConfig
from formation_env.quadrotor import RATES


def explanations(report: Report) -> list[str]:
    """One paragraph for each case in which a policy scores above the expert, from the figures, for
    each scenario on which the score has no sense, and for each policy from a file: what it was trained
    on, and where it cannot fly."""
    explained = []
    for name, scenario in report.scenarios.items():
        better = above_expert(scenario.results) if "expert" in scenario.results else []
        explained += [_explain(name, policy, scenario) for policy in better]
        if better:
            explained[-1] += " " + " ".join(_background(scenario))
    return [*explained, *_meaningless(report), *_origins(report), *_absences(report)]


def _origins(report: Report) -> list[str]:
    """Which file each policy that is one flew, and what that file was trained on."""
    flights: dict[tuple[str, Source], list[str]] = {}
    for name, scenario in report.scenarios.items():
        for policy, source in scenario.sources.items():
            flights.setdefault((policy, source), []).append(name)
    return [
        f"`{policy}` flew {_listed(names)} from the file `{source.file}` (method {source.method}, "
        f"trained on `{source.scenario}`)."
        for (policy, source), names in flights.items()
    ]


def _absences(report: Report) -> list[str]:
    """Where a policy could not fly, and why."""
    absent: dict[tuple[str, str], list[str]] = {}
    for name, scenario in report.scenarios.items():
        for policy, reason in scenario.absent.items():
            absent.setdefault((policy, reason), []).append(name)
    return [
        f"`{policy}` does not fly on {_listed(names)}. {reason}."
        for (policy, reason), names in absent.items()
    ]


def _listed(names: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _meaningless(report: Report) -> list[str]:
    """A warning for each scenario on which the score has no sense."""
    return [
        f"On `{name}` the expert is no better than hover, so the scores there mean nothing."
        for name, scenario in report.scenarios.items()
        if not scenario.span > 0.0
    ]


def _explain(name: str, policy: str, scenario: Scenario) -> str:
    result, best = scenario.results[policy], scenario.results["expert"]
    text = [
        f"On `{name}`, `{policy}` scores {scored(result.score)}; its return minus the expert's is "
        f"{signed(result.differences['return'])}."
    ]
    for key, label in _COMPARED.items():
        a, b = result.summary[key].value, best.summary[key].value
        if isfinite(a) and isfinite(b) and abs(a - b) > 0.02 * max(abs(a), abs(b)):
            text.append(f"{label}: {figure(key, a)} against the expert's {figure(key, b)}.")
    return " ".join([*text, *_reasons(result.summary, best.summary)])


_COMPARED = {
    "trigger_time": "Seconds until the trigger fires",
    "reward_since_trigger": "Reward per tick since then",
    "slot_error_rms": "Slot error since then (RMS), m",
    "failed": "Episodes that failed",
    "effort": "Effort",
}


def _reasons(own: dict[str, Estimate], best: dict[str, Estimate]) -> list[str]:
    """What the measured differences come from."""
    text = []
    if own["trigger_time"].value < 0.95 * best["trigger_time"].value:
        text.append(
            "The return counts the whole time limit, and before the trigger everybody is far from its "
            "slot, so whoever climbs to the start faster is paid earlier."
        )
    if own["reward_since_trigger"].value < best["reward_since_trigger"].value:
        text.append("Once the formation flies, the expert earns more: the climb alone is slower.")
    return text


def _background(scenario: Scenario) -> list[str]:
    """What limits the expert on this scenario, whoever flies beside it."""
    text, best = [], scenario.results["expert"].summary
    if scenario.measuring is not None:
        now, then = best["slot_error_rms"].value, scenario.measuring["slot_error_rms"].value
        late = 0.5 * scenario.config.window * _sample_period(scenario.config)
        text.append(
            "The planner relies on the leader's acceleration, which here is a double difference of "
            f"positions averaged over {late * 2:g} s, so {late:g} s late. Where velocity and acceleration "
            f"are measured instead, the expert's slot error is {then:.3f} m and not {now:.3f} m, its "
            f"return {scenario.measuring['return'].value:.3f} and not {best['return'].value:.3f}."
        )
    return [*text, _poles(scenario.config)]


def _poles(config: FormationConfig) -> str:
    p = config.planner
    t = config.rates_tracker if config.follower_actuation == RATES else config.tracker
    slope = t.sigma_max / sqrt(t.c)
    plane = min(p.k1, _slowest(p.k1 * p.k2, p.k3))
    return (
        "The expert's gains are cautious: for small errors the slowest poles of its loops are at "
        f"-{plane:.2f} 1/s (planner, plane), -{_slowest(p.kz2, p.kz1):.2f} 1/s (planner, height) and "
        f"-{_slowest(slope * t.k2, slope * t.k1):.2f} 1/s (tracker's position loop)."
    )


def _sample_period(config: FormationConfig) -> float:
    period = config.measurement_period
    return config.control_period if period is None else period


def _slowest(damping: float, stiffness: float) -> float:
    """Decay rate of the slowest mode of `s^2 + damping s + stiffness`, 1/s; a zero root is no mode."""
    roots = np.roots([1.0, damping, stiffness]) if stiffness > 0.0 else np.array([-damping])
    return float(-roots.real.max())
