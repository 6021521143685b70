"""The pictures of an evaluation: scores with intervals, slot errors against time, scores by a swept field.

Each is a PNG, 800 pixels wide, and the same as SVG. Which policy is which is told by labels, marks and line
styles, colours only help. Needs the `plot` extra.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from baselines.scoring.curves import COLUMN, HIGH, LOW, Curve, curve
from baselines.scoring.metrics import CAP, deadline, skipped_ticks, window_ticks
from baselines.scoring.results import ELSEWHERE, Report, Result, Scenario, Sweep
from baselines.system import pictures
from baselines.system.pictures import COLOURS, DARK, GREY, MARKS, SHADE, labelled
from baselines.system.text import shortened
from baselines.system.writing import write_bytes
from formation_env import FormationConfig

_NAME = 18  # characters of a name above a panel
SCORES, ERRORS = "scores", "errors"  # what the names of files end in
_WIDTH = 8.0  # inches
_LONGEST = 100  # characters of a scenario in a file's name
_COLUMNS = 3  # of panels
_LEGEND = 5  # entries side by side
# Of the lines of a sweep: where two lie on each other both are seen. Not a divisor of the number of colours.
_LINES = ("-", (0, (4, 2)), (0, (1, 1.5)))
_TICKS = 6  # values of a sweep that each have a tick
_FLOOR = 1e-4  # m, least error that is shown


# -- files ----------------------------------------------------------------------------------------


def plot(report: Report, folder: str | Path) -> list[Path]:
    """Write the pictures of a report into a folder, which is made if need be; returns their paths.

    Of every scenario `NAME-scores`, and `NAME-errors` if it was flown by `evaluate(..., plot=...)`, which
    alone gathers errors against time; of every sweep `NAME-FIELD`; each as `.png` and `.svg`. Raises
    `ValueError` where Matplotlib is missing, and `OSError`.
    """
    if not pictures.installed():
        raise ValueError(pictures.MISSING)
    folder, written = Path(folder), []
    folder.mkdir(parents=True, exist_ok=True)
    seeds = f"seeds {report.seed} to {report.seed + report.episodes - 1}"
    for name, figure in figures(report):
        written += [folder / f"{name}.png", folder / f"{name}.svg"]
        with pictures.style():
            figure.canvas.draw()
            write_bytes(written[-2], pictures.png(figure.canvas, f"{name}, {seeds}"))
            text = io.BytesIO()
            figure.savefig(text, format="svg", metadata={"Date": None})
            write_bytes(written[-1], text.getvalue())
    return written


def names(scenarios: Sequence[str], sweeps: Sequence[Sweep]) -> dict[tuple[str, str], str]:
    """The files' names, without what follows the dot, of a scenario and what is shown of it: `SCORES`,
    `ERRORS` or the field of a sweep. Numbers tell apart what would be alike."""
    swept = {name for each in sweeps for name in each.scenarios}
    single = [name for name in scenarios if name not in swept]
    pairs = [(name, what) for name in single for what in (SCORES, ERRORS)]
    found: dict[tuple[str, str], str] = {}
    taken: set[str] = set()
    for pair in [*pairs, *((each.scenario, each.field) for each in sweeps)]:
        plain = re.sub(r"[^A-Za-z0-9_.=+-]+", "-", pair[0])[:_LONGEST] + f"-{pair[1]}"
        tried = (f"{plain}-{k}" if k > 1 else plain for k in count(1))
        found[pair] = next(name for name in tried if name.casefold() not in taken)
        taken.add(found[pair].casefold())
    return found


def figures(report: Report) -> Iterator[tuple[str, Any]]:
    """Every picture as a Matplotlib figure, by the name of its file."""
    files = names(list(report.scenarios), report.sweeps)
    for name, scenario in report.single.items():
        if scenario.results:
            yield files[name, SCORES], draw_scores(name, scenario, report.episodes)
            if all(COLUMN in r.runs[r.median] for r in scenario.results.values()):
                yield files[name, ERRORS], draw_errors(name, scenario, report.episodes)
    for sweep in report.sweeps:
        if any(report.scenarios[name].results for name in sweep.scenarios):
            yield files[sweep.scenario, sweep.field], draw_sweep(sweep, report)


def _figure(height: float) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, height), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _over(episodes: int) -> str:
    return f"{episodes} episode{'s' if episodes > 1 else ''}"


def _score_axis(ax: Any, axis: str) -> None:
    """An axis of scores, stretched where good ones lie."""
    getattr(ax, f"set_{axis}scale")("function", functions=(pictures.stretch, pictures.unstretch))
    getattr(ax, f"set_{axis}ticks")(pictures.TICKS, [f"{x:g}" for x in pictures.TICKS], minor=False)
    getattr(ax, f"set_{axis}lim")(0.0, 1.003)


# -- scores ---------------------------------------------------------------------------------------

_KINDS = (  # label, colour, mark, and whether it is filled
    ("programmed", COLOURS[0], MARKS[0], True),
    ("learned for this task", COLOURS[4], MARKS[1], True),
    (f"learned for another task{ELSEWHERE}", COLOURS[4], MARKS[1], False),
)


def _kind(scenario: Scenario, policy: str) -> int:
    return 0 if policy not in scenario.sources else 2 if scenario.untrained(policy) else 1


def draw_scores(name: str, scenario: Scenario, episodes: int) -> Any:
    """The scores of one scenario with their intervals, from above in the order of the table."""
    with pictures.style():
        policies = list(scenario.results)
        figure = _figure(1.25 + 0.27 * len(policies))
        ax = figure.subplots()
        for kind, (label, colour, mark, filled) in enumerate(_KINDS):
            rows = [k for k, p in enumerate(policies) if _kind(scenario, p) == kind]
            if rows:
                scores = np.array([scenario.results[policies[k]].score[:3] for k in rows]).T
                bar = _intervals(ax, scores, rows, colour, mark, filled)
                bar.set_label(label)
        for k, policy in enumerate(policies):
            _beside(ax, k, scenario, policy)
        ax.set_yticks(range(len(policies)), policies)
        ax.set_ylim(len(policies) - 0.4, -0.6)
        _score_axis(ax, "x")
        ax.set_xlabel(
            "score: mean reward in the window, 1 is exact; the axis is stretched above 0.8"
        )
        ax.set_title(f"{name}: score with its 95 % interval, {_over(episodes)}", loc="left")
        if scenario.sources:
            figure.legend(loc="outside lower center", ncols=len(_KINDS))
    return figure


def _intervals(ax: Any, scores: Any, rows: Any, colour: str, mark: str, filled: bool) -> Any:
    value, low, high = scores
    return ax.errorbar(
        value, rows, xerr=(value - low, high - value), fmt=mark, color=colour, markersize=4.5,
        markerfacecolor=colour if filled else "white", elinewidth=1.6, capsize=5.0, clip_on=False,
        zorder=3,
    )  # fmt: skip


def _beside(ax: Any, row: int, scenario: Scenario, policy: str) -> None:
    """What stands to the right of a row: the score, and of a policy file what it was trained for."""
    text = f"{scenario.results[policy].score.value:.3f}"
    source = scenario.sources.get(policy)
    if source is not None:
        text += f"  trained for {source.scenario}, {source.action}"
        text += ELSEWHERE if scenario.untrained(policy) else ""
    ax.annotate(
        text, (1.0, row), (6, 0), xycoords=ax.get_yaxis_transform(), textcoords="offset points",
        va="center", color=GREY, fontsize=8.5,
    )  # fmt: skip


# -- errors against time --------------------------------------------------------------------------


def draw_errors(name: str, scenario: Scenario, episodes: int) -> Any:
    """Slot error against time, a panel for each policy: the median, from `LOW` to `HIGH` per cent shaded.

    Logarithmic, since policies differ by factors: millimetres beside decimetres. In every panel stands the
    median of the policy with the best score.
    """
    policies, config = list(scenario.results), scenario.config
    columns = min(_COLUMNS, len(policies))
    rows = -(-len(policies) // columns)
    curves = {
        policy: curve(r.runs[r.median][COLUMN], config) for policy, r in scenario.results.items()
    }
    with pictures.style():
        figure = _figure(1.35 + (1.55 if rows > 1 else 2.2) * rows)
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        best = curves[scenario.best]
        for ax, policy in zip(axes, policies, strict=False):
            _errors(ax, curves[policy], best if policy != scenario.best else None)
            ax.set_title(_titled(scenario, policy), loc="left")
            _trigger(ax, scenario.results[policy], curves[policy], config)
        _finish_errors(axes, len(policies), columns, curves, config.duration)
        figure.suptitle(
            f"{name}: slot error over {_over(episodes)} and followers; at most {CAP:g} m, which also "
            "stands after a failure",
            x=0.01, ha="left", fontsize=9.5,
        )  # fmt: skip
        handles = {
            text: line
            for ax in axes[: len(policies)]
            for line, text in zip(*ax.get_legend_handles_labels(), strict=True)
        }
        figure.legend(handles.values(), handles, loc="outside lower center", ncols=len(handles))
    return figure


def _titled(scenario: Scenario, policy: str) -> str:
    mark = ELSEWHERE if scenario.untrained(policy) else ""
    return f"{shortened(policy, _NAME)}{mark}, score {scenario.results[policy].score.value:.3f}"


def _errors(ax: Any, own: Curve, best: Curve | None) -> None:
    shown = [np.maximum(x, _FLOOR) for x in (own.low, own.median, own.high)]
    ax.fill_between(
        own.time, shown[0], shown[2], color=COLOURS[0], alpha=0.25, linewidth=0,
        label=f"{LOW:g} to {HIGH:g} %",
    )  # fmt: skip
    ax.plot(own.time, shown[1], color=COLOURS[0], label="median")
    if best is not None:
        ax.plot(best.time, np.maximum(best.median, _FLOOR), color=DARK, linewidth=1.0,
                linestyle=(0, (3, 2)), label="median of the best policy")  # fmt: skip


def _trigger(ax: Any, result: Result, own: Curve, config: FormationConfig) -> None:
    """A mark on the median where the trigger (40) fires and a shade where the flight is then scored, in the
    median of the episodes in which it does before its deadline; at reset it needs no mark."""
    columns, limit = result.runs[result.median], deadline(config)
    fired = columns["trigger_time"][columns["trigger_time"] < limit] if limit else np.zeros(1)
    if len(fired) == 0:
        return
    time = float(np.median(fired))
    begin = time + skipped_ticks(config) * config.control_period
    end = begin + window_ticks(config) * config.control_period
    ax.axvspan(begin, end, color=SHADE, linewidth=0, zorder=0, label="scored")
    if limit:
        error = np.interp(time, own.time, own.median)
        ax.plot([time], [error], MARKS[4], color=COLOURS[4], markersize=7.0, markeredgecolor="white",
                linestyle="none", label="trigger (40), median", zorder=4)  # fmt: skip


def _finish_errors(
    axes: Any, panels: int, columns: int, curves: dict[str, Curve], duration: float
) -> None:
    least = min(float(each.low.min()) for each in curves.values())
    axes[0].set_yscale("log")
    axes[0].set_ylim(max(_FLOOR, 0.8 * least), 1.3 * CAP)
    axes[0].yaxis.set_major_formatter("{x:g}")
    axes[0].set_xlim(0.0, duration)
    for k, ax in enumerate(axes):
        ax.set_visible(k < panels)
        ax.tick_params(labelbottom=k + columns >= panels)
        if k % columns == 0:
            ax.set_ylabel(labelled("slot error", "m"))
        if k + columns >= panels:
            ax.set_xlabel(labelled("time", "s"))


# -- sweeps ---------------------------------------------------------------------------------------


def draw_sweep(sweep: Sweep, report: Report) -> Any:
    """Scores against the values of a swept field, with their intervals: programmed and learned policies in a
    panel each. Values that are no numbers stand side by side."""
    flown = [
        policy
        for policy in report.policies
        if any(policy in report.scenarios[name].results for name in sweep.scenarios)
    ]
    groups = {
        "programmed": [p for p in flown if not _learned(p, sweep, report)],
        "learned": [p for p in flown if _learned(p, sweep, report)],
    }
    groups = {kind: group for kind, group in groups.items() if group}
    with pictures.style():
        figure = _figure(4.0 + 0.2 * -(-len(flown) // _LEGEND))
        axes = figure.subplots(1, max(1, len(groups)), sharey=True, squeeze=False)[0]
        for ax, (kind, group) in zip(axes, groups.items(), strict=False):
            for policy in group:
                _swept(ax, flown.index(policy), policy, sweep, report)
            ax.set_title(kind, loc="left")
            _field_axis(ax, sweep)
        figure.legend(loc="outside lower center", ncols=_LEGEND)
        _score_axis(axes[0], "y")
        axes[0].set_ylabel("score; 1 is exact, stretched above 0.8")
        figure.suptitle(
            f"{sweep.scenario}: score by {sweep.field} with its 95 % interval, "
            f"{_over(report.episodes)} each",
            x=0.01, ha="left", fontsize=9.5,
        )  # fmt: skip
    return figure


def _learned(policy: str, sweep: Sweep, report: Report) -> bool:
    return any(policy in report.scenarios[name].sources for name in sweep.scenarios)


def _places(sweep: Sweep) -> Any:
    return np.array(sweep.values if sweep.numeric else range(len(sweep.values)), dtype=np.float64)


def _swept(ax: Any, k: int, policy: str, sweep: Sweep, report: Report) -> None:
    """One policy, `k` of them; with hollow marks where it was trained for another task."""
    each = [report.scenarios[name] for name in sweep.scenarios]
    there = np.array([policy in scenario.results for scenario in each])
    scores = np.array([s.results[policy].score[:3] for s in each if policy in s.results])
    hollow = np.array([s.untrained(policy) for s in each if policy in s.results])
    order = np.argsort(_places(sweep)[there])
    x, (value, low, high) = _places(sweep)[there][order], scores[order].T
    mark, size = MARKS[k % len(MARKS)], 8.0 if MARKS[k % len(MARKS)] == "*" else 5.0
    above = 2.0 + 0.1 * (k % len(_LINES))  # solid lines, which would hide others
    look = {"color": COLOURS[k % len(COLOURS)], "markersize": size, "zorder": above}
    if sweep.numeric:
        ax.fill_between(x, low, high, color=look["color"], alpha=0.12, linewidth=0)
        ax.plot(x, value, marker=mark, linestyle=_LINES[k % len(_LINES)], label=policy,
                clip_on=False, **look)  # fmt: skip
    else:  # nothing lies between two values
        ax.errorbar(
            x, value, (value - low, high - value), fmt=mark, capsize=5.0, label=policy, **look
        )
    elsewhere = hollow[order]
    if elsewhere.any():
        ax.plot(x[elsewhere], value[elsewhere], mark, markerfacecolor="white",
                label=f"{policy}{ELSEWHERE} (another task)", clip_on=False, **look)  # fmt: skip


def _field_axis(ax: Any, sweep: Sweep) -> None:
    ax.set_xlabel(labelled(sweep.field, sweep.unit))
    if not sweep.numeric:
        ax.set_xticks(_places(sweep), sweep.texts)
        ax.set_xlim(-0.5, len(sweep.values) - 0.5)
        return
    if len(sweep.values) <= _TICKS:
        ax.set_xticks(sorted(_places(sweep)))
    ax.xaxis.set_major_formatter("{x:g}")
