"""The results of an evaluation as Markdown and as JSON.

The JSON document, `results.json` (no NaN: a figure that no episode has is null):

    {"schema": 1, "environment": "Formation-v0", "package": version, "layout": observation layout version,
     "command": that repeats it or null, "seed": first seed,
     "episodes": number per scenario (seeds seed ... seed + episodes - 1),
     "interval": {"level", "method", "resamples"},
     "metrics": {name: {"unit", "better", "meaning"}},
     "scenarios": {name: {
         "action": level, "followers": n, "duration": s,
         "policies": {name: {
             "score": estimate, "metrics": {name: estimate},
             "difference_to_expert": {"return": estimate, "slot_error_rms": estimate},
             "failures": {kind: episodes}}},
         "expert_measuring": null or {name: estimate},
         "files": {policy: {"file": name, "method": word, "scenario": trained on, "action": level,
                           "differs": whether it flies another task than it was trained for}},
         "absent": {policy: why it does not fly here}}}}

with `estimate = {"value", "low", "high", "episodes"}`: the mean over so many episodes (of `settling_time`
the median) and its 95 % interval. `difference_to_expert` is the mean of policy minus expert on equal seeds.
`difference_to_tuned`, the same to `expert-tuned`, is there if that has flown.
`expert_measuring` is the expert where velocities and accelerations are measured instead of differenced
from positions; it is flown only where that may explain why another policy scores above the expert.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from math import isfinite
from typing import Any

import formation_env
from baselines.reporting.cells import interval, scored, signed
from baselines.reporting.explanations import explanations
from baselines.scoring.intervals import LEVEL, RESAMPLES, Estimate
from baselines.scoring.metrics import EPISODE
from baselines.scoring.results import COMPARED, Report, Result, Scenario, Source
from formation_env import FormationConfig

SCORE = "normalised score: mean return, 0 as hover's and 1 as the expert's on the same seeds"

# -- JSON -----------------------------------------------------------------------------------------


def to_json(report: Report, command: str | None = None) -> str:
    """The document described above."""
    document = {
        "schema": 1,
        "environment": "Formation-v0",
        "package": formation_env.__version__,
        "layout": next(iter(report.scenarios.values())).config.layout.version,
        "command": command,
        "seed": report.seed,
        "episodes": report.episodes,
        "interval": {
            "level": LEVEL,
            "method": "percentile bootstrap",
            "resamples": RESAMPLES,
        },
        "metrics": {name: metric._asdict() for name, metric in EPISODE.items()},
        "scenarios": {name: _scenario(each) for name, each in report.scenarios.items()},
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _scenario(scenario: Scenario) -> dict[str, Any]:
    config = scenario.config
    return {
        "action": config.action,
        "followers": config.followers,
        "duration": config.duration,
        "policies": {name: _result(result) for name, result in scenario.results.items()},
        "expert_measuring": _estimates(scenario.measuring) if scenario.measuring else None,
        "files": {name: source._asdict() for name, source in scenario.sources.items()},
        "absent": scenario.absent,
    }


def _result(result: Result) -> dict[str, Any]:
    return {
        "score": _estimate(result.score),
        "metrics": _estimates(result.summary),
        "difference_to_expert": _estimates(result.differences),
        "failures": result.failures,
        **({"difference_to_tuned": _estimates(result.to_tuned)} if result.to_tuned else {}),
    }


def _estimates(each: dict[str, Estimate]) -> dict[str, Any]:
    return {name: _estimate(e) for name, e in each.items()}


def _estimate(e: Estimate) -> dict[str, float | int | None]:
    return {k: x if isfinite(x) else None for k, x in e._asdict().items()}


# -- Markdown -------------------------------------------------------------------------------------


def grid(report: Report, cell: Callable[[Estimate], str]) -> str:
    """A row for each policy, a column for each scenario; in italics what was trained for another task."""
    rows = [
        ["policy", *(f"`{name}`" for name in report.scenarios)],
        ["---", *("---:" for _ in report.scenarios)],
    ]
    for policy in report.policies:
        row = [f"`{policy}`"]
        for scenario in report.scenarios.values():
            result = scenario.results.get(policy)
            text = cell(result.score) if result else "-"
            row.append(f"*{text}*" if scenario.untrained(policy) else text)
        rows.append(row)
    return _markdown(rows)


def markdown(report: Report, legend: str = "") -> str:
    """Scores with intervals, remarks, files flown, and one table a scenario, every figure with its
    interval."""
    parts = ["## Scores", f"The {SCORE}.", grid(report, scored)]
    parts += [legend] if legend else []
    remarks = explanations(report)
    if remarks:
        parts += ["## Remarks", *remarks]
    files = _files(report)
    if files:
        parts += ["## Policy files", files]
    for name, scenario in report.scenarios.items():
        parts += [f"## {name}", _conditions(scenario.config), _details(scenario)]
    parts += ["## What the figures mean", _meanings()]
    return "\n\n".join(parts) + "\n"


def _files(report: Report) -> str:
    """Which file each policy that is one was flown from, or nothing."""
    flights: dict[tuple[str, Source], list[str]] = {}
    for name, scenario in report.scenarios.items():
        for policy, source in scenario.sources.items():
            file = (policy, source._replace(differs=False))  # of one file, whatever it flies
            flights.setdefault(file, []).append(f"`{name}`")
    rows = [["policy", "file", "method", "trained on", "at level", "flown on"], ["---"] * 6]
    for (policy, source), names in flights.items():
        known = [
            f"`{x}`" for x in (policy, source.file, source.method, source.scenario, source.action)
        ]
        rows.append([*known, ", ".join(names)])
    return _markdown(rows) if flights else ""


def _conditions(config: FormationConfig) -> str:
    number = "1 follower" if config.followers == 1 else f"{config.followers} followers"
    return f"Action level `{config.action}`, {number}, {config.duration:g} s."


def _details(scenario: Scenario) -> str:
    results = scenario.results
    rows = [["", *(f"`{p}`" for p in results)], ["---", *("---:" for _ in results)]]
    rows.append(["score", *(scored(r.score) for r in results.values())])
    for name, metric in EPISODE.items():
        unit = "" if metric.unit == "1" else f", {metric.unit}"
        cells = [interval(name, r.summary[name]) for r in results.values()]
        rows.append([f"{name}{unit}", *cells])
    for name in COMPARED:
        cells = [signed(r.differences[name]) for r in results.values()]
        rows.append([f"{name} minus expert's", *cells])
    if all(r.to_tuned for r in results.values()):
        for name in COMPARED:
            cells = [signed(r.to_tuned[name]) for r in results.values()]
            rows.append([f"{name} minus expert-tuned's", *cells])
    rows.append(["failures", *(_failures(r.failures) for r in results.values())])
    return _markdown(rows)


def _failures(counts: dict[str, int]) -> str:
    return ", ".join(f"{n} {kind}" for kind, n in counts.items() if n) or "none"


def _meanings() -> str:
    rows = [["figure", "unit", "better", "meaning"], ["---"] * 4]
    rows += [[f"`{name}`", m.unit, m.better, m.meaning] for name, m in EPISODE.items()]
    lines = _markdown(rows)
    note = (
        "Values are means over the episodes that have one (`settling_time`: the median), in brackets the "
        f"{100 * LEVEL:.0f} % percentile bootstrap interval ({RESAMPLES} resamples of "
        "episodes). Differences are taken seed by seed."
    )
    return f"{lines}\n\n{note}"


def _markdown(rows: list[list[str]]) -> str:
    # A `|` would end the cell.
    return "\n".join("| " + " | ".join(x.replace("|", "\\|") for x in row) + " |" for row in rows)
