"""The results of an evaluation as Markdown and as JSON.

The JSON document, `results.json` (no NaN: a figure that no episode has is null):

    {"schema": 2, "environment": "Formation-v0", "package": version, "layout": observation layout version,
     "command": that repeats it or null, "seed": first seed,
     "episodes": number per scenario (seeds seed ... seed + episodes - 1),
     "interval": {"level", "method", "resamples"},
     "metrics": {name: {"unit", "better", "meaning"}},
     "scenarios": {name: {
         "action": level, "followers": n, "duration": s, "window": s that are scored,
         "policies": {name: {
             "metrics": {name: estimate},
             "differences": {policy: {"score": estimate, "slot_error": estimate}},
             "failures": {kind: episodes of all runs together},
             "runs": {name: its mean score}, "median": name of the median run}},
         "files": {policy: {"file": name, "method": word, "scenario": trained on, "action": level,
                           "differs": whether it flies another task than it was trained for,
                           "teacher": the policy that it is a clone of or "", "history": observations seen,
                           "hidden": [widths of the hidden layers]}},
         "absent": {policy: why it does not fly here}}},
     "sweeps": [{"scenario": name, "field": name, "unit": of the values, "values": [value, ...],
                 "scenarios": [name in "scenarios" of each value]}]}

with `estimate = [value, low, high, episodes]`: the mean over so many episodes (of `settling_time` the median)
and its 95 % interval; of several training runs the median run's, with an interval over runs and episodes.
`differences` are means of policy minus another one on equal seeds, to those of `results.REFERENCES` that fly.
Numbers have six digits.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from math import isfinite
from typing import Any

import formation_env
from baselines.reporting.cells import figure, interval, listed, markdown_table, scored, signed
from baselines.reporting.rows import unseparated
from baselines.scoring.intervals import LEVEL, RESAMPLES, Estimate
from baselines.scoring.metrics import EPISODE, window_ticks
from baselines.scoring.results import Report, Result, Scenario, Source, Sweep
from formation_env import FormationConfig

# -- JSON -----------------------------------------------------------------------------------------


def to_json(report: Report, command: str | None = None) -> str:
    """The document described above."""
    document = {
        "schema": 2,
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
        "sweeps": [_sweep(each) for each in report.sweeps],
    }
    return _lines(document, 4) + "\n"


def _lines(value: Any, depth: int) -> str:
    """JSON with a line for each entry of objects down to a depth."""
    if depth == 0 or not isinstance(value, dict) or not value:
        return json.dumps(value, allow_nan=False)
    each = (f"{json.dumps(key)}: {_lines(x, depth - 1)}" for key, x in value.items())
    return "{\n" + ",\n".join(each) + "\n}"


def _sweep(sweep: Sweep) -> dict[str, Any]:
    return {name: value for name, value in sweep._asdict().items() if name != "texts"}


def _scenario(scenario: Scenario) -> dict[str, Any]:
    config = scenario.config
    return {
        "action": config.action,
        "followers": config.followers,
        "duration": config.duration,
        "window": _digits(window(config)),
        "policies": {name: _result(result) for name, result in scenario.results.items()},
        "files": {name: source._asdict() for name, source in scenario.sources.items()},
        "absent": scenario.absent,
    }


def _result(result: Result) -> dict[str, Any]:
    return {
        "metrics": _estimates(result.summary),
        "differences": {name: _estimates(each) for name, each in result.differences.items()},
        "failures": result.failures,
        "runs": {name: _digits(score) for name, score in result.scores.items()},
        "median": result.median,
    }


def _estimates(each: dict[str, Estimate]) -> dict[str, Any]:
    return {name: [_digits(x) for x in e[:3]] + [e.episodes] for name, e in each.items()}


def _digits(x: float) -> float | None:
    return float(f"{x:.6g}") if isfinite(x) else None


# -- Markdown -------------------------------------------------------------------------------------


def score(report: Report) -> str:
    """What the score is, with the window of the scenarios that were flown."""
    named: dict[str, list[str]] = {}
    for name, scenario in report.scenarios.items():
        named.setdefault(f"{window(scenario.config):g} s", []).append(name)
    usual = max(named, key=lambda length: len(named[length]))
    others = "".join(
        f", {length} on {listed(names)}" for length, names in named.items() if length != usual
    )
    return (
        f"The score is the followers' mean reward over the last {usual} of a flight{others}; what is "
        "missing of it, crashed or not started, counts zero: 0 to 1, 1 is exact."
    )


def window(config: FormationConfig) -> float:
    """How much of a flight is scored, s."""
    return window_ticks(config) * config.control_period


def grid(
    report: Report,
    cell: Callable[[Scenario, str], str],
    head: Callable[[str], str] = "`{}`".format,
) -> str:
    """A row for each policy, a column for each scenario with the `head` that is made of its name; in italics
    what was trained for another task."""

    def text(scenario: Scenario, policy: str) -> str:
        if policy not in scenario.results:
            return "-"
        found = cell(scenario, policy)
        return f"*{found}*" if scenario.untrained(policy) else found

    rows = [
        [f"`{policy}`", *(text(scenario, policy) for scenario in report.scenarios.values())]
        for policy in report.policies
    ]
    return markdown_table(["policy", *map(head, report.scenarios)], rows)


def markdown(report: Report) -> str:
    """Scores with intervals, files flown, what did not fly, and one part a scenario."""
    parts = [
        "## Scores",
        score(report),
        grid(report, lambda s, policy: scored(s.results[policy].score)),
    ]
    parts += absences(report)
    files = files_table(report)
    if files:
        parts += ["## Policy files", files]
    for name, scenario in report.scenarios.items():
        parts += [f"## {name}", *details(scenario)]
    parts += ["## Figures", meanings()]
    return "\n\n".join(parts) + "\n"


def files_table(report: Report) -> str:
    """Where policies come from that are files, and what each has flown; empty without any."""
    flights: dict[tuple[str, Source], list[str]] = {}
    for name, scenario in report.scenarios.items():
        for policy, source in scenario.sources.items():
            file = (policy, source._replace(differs=False))  # of one file, whatever it flies
            flights.setdefault(file, []).append(name)
    rows = [
        [
            *(f"`{x}`" for x in (policy, source.file, source.method)),
            *(f"`{x}`" for x in (source.scenario, source.action)),
            f"`{source.teacher}`" if source.teacher else "-",
            str(source.history),
            " ".join(map(str, source.hidden)) or "-",
            listed(names),
        ]
        for (policy, source), names in flights.items()
    ]
    head = [
        "policy",
        "file",
        "method",
        "trained on",
        "at level",
        "teacher",
        "observations",
        "hidden",
        "flown on",
    ]
    return markdown_table(head, rows, len(head)) if flights else ""


def absences(report: Report) -> list[str]:
    """Where policies could not fly, and why: policies and scenarios that share a reason together."""
    scenarios: dict[tuple[str, str], list[str]] = {}
    for name, scenario in report.scenarios.items():
        for policy, reason in scenario.absent.items():
            scenarios.setdefault((policy, reason), []).append(name)
    policies: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for (policy, reason), names in scenarios.items():
        policies.setdefault((reason, tuple(names)), []).append(policy)
    return [
        f"Not flown on {listed(names)}: {listed(found)} ({reason})."
        for (reason, names), found in policies.items()
    ]


def details(scenario: Scenario) -> list[str]:
    """One scenario: conditions, differences, all metrics and the training runs, a row for each policy."""
    parts = [_conditions(scenario.config), _telling(scenario), *_highest(scenario)]
    runs = _training_runs(scenario)
    return [*parts, _metrics(scenario), *([runs] if runs else [])]


def _conditions(config: FormationConfig) -> str:
    number = "1 follower" if config.followers == 1 else f"{config.followers} followers"
    return (
        f"Action level `{config.action}`, {number}, {config.duration:g} s, of which {window(config):g} s are "
        "scored."
    )


_TELLING = ("score", "slot_error", "slot_error_late", "failed", "trigger_time")


def _heading(name: str) -> str:
    unit = EPISODE[name].unit
    return name if unit == "1" else f"{name}, {unit}"


def _telling(scenario: Scenario) -> str:
    """The most telling metrics, kinds of failures, and the differences to other policies."""
    others = next(iter(scenario.results.values())).differences if scenario.results else {}
    head = ["policy", *map(_heading, _TELLING), "failures, all runs"]
    head += [f"score minus `{name}`'s" for name in others]
    rows = [
        [
            f"`{policy}`",
            *(interval(name, r.summary[name]) for name in _TELLING),
            _failures(r.failures),
            *(signed(each["score"]) for each in r.differences.values()),
        ]
        for policy, r in scenario.results.items()
    ]
    return markdown_table(head, rows)


def _highest(scenario: Scenario) -> list[str]:
    """Whose score is the highest, and whose are not told apart from it."""
    if len(scenario.results) < 2:
        return []
    near = unseparated(scenario)
    rest = (
        f"not separated from it are {listed(near)}" if near else "it is separated from all others"
    )
    return [
        f"The highest score is that of `{scenario.best}`; by intervals ({100 * LEVEL:.0f} %) of the "
        f"differences, seed by seed and run by run, {rest}."
    ]


def _metrics(scenario: Scenario) -> str:
    names = [name for name in EPISODE if name not in _TELLING]
    rows = [
        [f"`{policy}`", *(figure(name, r.summary[name].value) for name in names)]
        for policy, r in scenario.results.items()
    ]
    return markdown_table(["policy", *map(_heading, names)], rows)


def _training_runs(scenario: Scenario) -> str:
    """The scores of methods of several runs, the median in bold; empty without any."""
    rows = []
    for policy, result in scenario.results.items():
        if len(result.runs) > 1:
            each = (
                f"**{name} {score:.3f}**" if name == result.median else f"{name} {score:.3f}"
                for name, score in result.scores.items()
            )
            rows.append([f"`{policy}`", ", ".join(each)])
    return markdown_table(["policy", "training runs, the median in bold"], rows, 2) if rows else ""


def _failures(counts: dict[str, int]) -> str:
    return ", ".join(f"{n} {kind}" for kind, n in counts.items() if n) or "none"


def meanings() -> str:
    """What the metrics and their intervals are."""
    rows = [[f"`{name}`", m.unit, m.better, m.meaning] for name, m in EPISODE.items()]
    note = (
        "Values are means over the episodes that have one (`settling_time`: the median), in brackets the "
        f"{100 * LEVEL:.0f} % percentile bootstrap interval ({RESAMPLES} resamples of "
        "episodes). Of several training runs they are the median of the runs' values, with an interval over "
        "runs and episodes. Differences are taken seed by seed."
    )
    return f"{markdown_table(['figure', 'unit', 'better', 'meaning'], rows, 4)}\n\n{note}"
