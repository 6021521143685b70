"""What the figures say: the bars, the tables in Markdown, the plot."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import permutations
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

Figures = dict[str, Any]
Row = dict[str, Any]

# What another process on the machine may take from a ratio that should be 1.
NOISE = 0.05


class Bar(NamedTuple):
    """One requirement and what was measured; `value` is None where it could not be."""

    what: str
    value: float | None
    bar: float
    at_most: bool

    @property
    def reached(self) -> bool | None:
        """Whether the measured value is on the right side of the bar."""
        if self.value is None:
            return None
        return self.value <= self.bar if self.at_most else self.value >= self.bar


def _least(values: Iterable[float]) -> float | None:
    return min(values, default=None)


def _grid_bars(grid: list[Row]) -> list[Bar]:
    bars = []
    for scenario in ("nominal", "paper"):
        for threads in sorted({row["threads"] for row in grid}):
            shares = [
                row["share_of_floor"]
                for row in grid
                if (row["scenario"], row["threads"]) == (scenario, threads)
                and (row["worlds"], row["followers"], row["action"]) == (4096, 2, "wrench")
            ]
            what = f"share of the floor, {scenario}, 4096 worlds, 2 followers, threads {threads}"
            bars.append(Bar(what, _least(shares), 0.5, False))
    compared = {1, 2} <= {row["threads"] for row in grid}
    two = [row for row in grid if row["threads"] == 2 and compared]
    large = _least(row["speedup"] for row in two if row["worlds"] >= 4096)
    bars.append(Bar("two threads over one, least from 4096 worlds up", large, 1.8, False))
    anywhere = _least(row["speedup"] for row in two)
    what = f"two threads over one, least at any number (less {NOISE:.0%} for noise)"
    return [*bars, Bar(what, anywhere, 1.0 - NOISE, False)]


def _spread(rows: list[Row], same: tuple[str, ...]) -> float | None:
    """Largest ratio of costs per agent step among rows that agree in `same`."""
    groups: dict[tuple[Any, ...], list[float]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in same), []).append(row["ns_per_agent_step"])
    return max((max(c) / min(c) for c in groups.values() if len(c) > 1), default=None)


def _flatness(grid: list[Row]) -> list[Bar]:
    many = [row for row in grid if 256 <= row["worlds"] <= 65536]
    over_worlds = _spread(many, ("scenario", "action", "followers", "threads"))
    over_followers = _spread(many, ("scenario", "action", "worlds", "threads"))
    return [
        Bar(
            "cost per agent step, dearest over cheapest, 256 to 65536 worlds", over_worlds, 2, True
        ),
        Bar("the same over followers, from 256 worlds up", over_followers, 2, True),
    ]


def bars(figures: Figures) -> list[Bar]:
    """The requirements, in the order of the table of the documentation."""
    single, start = figures.get("one_world") or {}, figures.get("startup") or {}
    others = [p for p in figures.get("batches") or [] if p is not figures["batches"][0]]
    memory, experts = figures.get("memory") or [], figures.get("expert") or []
    cold = start.get("first_steps")
    return [
        Bar("gym.make step over CartPole-v1's", single.get("over_cartpole"), 2, True),
        Bar("MPE2 step over PettingZoo step, 3 agents", single.get("over_mpe2"), 20, False),
        *_grid_bars(figures.get("grid") or []),
        *(
            Bar(f"agent steps a second over {p['name']}", p["own_over_it"], 1, False)
            for p in others
        ),
        Bar(
            "bytes a vehicle in a step beyond the returned arrays",
            max((row["peak"] for row in memory), default=None),
            1024,
            True,
        ),
        Bar("growth over a long run, KiB", _over(start.get("growth"), 1024), 512, True),
        *_flatness(figures.get("grid") or []),
        Bar("picture of seven vehicles, ms", figures.get("frame_ms"), 10, True),
        Bar("import formation_env, s", start.get("import"), 1, True),
        Bar("first compile, s", None if cold is None else sum(cold["cold"].values()), 60, True),
        Bar(
            "expert in the loop, share of the environment alone",
            _least(row["share_vector"] for row in experts),
            0.5,
            False,
        ),
        Bar(
            "the same as `evaluate` flies and scores",
            _least(row["share_evaluate"] for row in experts),
            0.5,
            False,
        ),
    ]


def _over(value: float | None, unit: float) -> float | None:
    return None if value is None else value / unit


def table(head: list[str], rows: Iterable[Iterable[Any]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)


def _cell(value: Any) -> str:
    if value is None:
        return "not measured"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return str(value)


def bars_table(figures: Figures) -> str:
    """What was to be reached and what was."""
    rows = [
        (b.what, b.value, f"{'<=' if b.at_most else '>='} {b.bar:g}", b.reached)
        for b in bars(figures)
    ]
    return table(["what", "measured", "bar", "reached"], rows)


_COLUMNS: dict[str, Callable[[Row], Any]] = {
    "scenario": lambda r: r["scenario"],
    "action": lambda r: r["action"],
    "followers": lambda r: r["followers"],
    "worlds": lambda r: r["worlds"],
    "threads": lambda r: r["threads"],
    "step, us": lambda r: r["step_us"],
    "agent steps/s, million": lambda r: 1e-6 * r["agent_steps_per_s"],
    "vehicle substeps/s, million": lambda r: 1e-6 * r["vehicle_substeps_per_s"],
    "floor, million": lambda r: 1e-6 * r["floor_vehicle_substeps_per_s"],
    "share of floor": lambda r: r["share_of_floor"],
    "over first threads": lambda r: r["speedup"],
}


def markdown(figures: Figures) -> str:
    """The whole report."""
    machine = ", ".join(f"{key} {value}" for key, value in figures["machine"].items())
    rows: list[Any]
    parts = ["# Throughput", f"Repeat with `{figures['command']}`. {machine}.", bars_table(figures)]
    if single := figures.get("one_world"):
        parts += ["## One world", table(["", "us a step"], single["step_us"].items())]
    if batches := figures.get("batches"):
        head = ["", "worlds", "agent steps/s, million", "this package over it"]
        rows = [
            (b["name"], b["worlds"], 1e-6 * b["agent_steps_per_s"], b["own_over_it"])
            for b in batches
        ]
        parts += ["## Each at its best batch size", table(head, rows)]
    if memory := figures.get("memory"):
        rows = [(m["scenario"], m["followers"], m["held"], m["peak"], m["rss"]) for m in memory]
        head = ["scenario", "followers", "held", "peak beyond returned", "resident"]
        parts += ["## Memory, bytes a vehicle", table(head, rows)]
    if experts := figures.get("expert"):
        rows = [(e["scenario"], e["share_vector"], e["share_evaluate"]) for e in experts]
        head = ["scenario", "share through make_vec", "share as evaluate flies"]
        parts += ["## Expert in the loop", table(head, rows)]
    if grid := figures.get("grid"):
        rows = [[column(row) for column in _COLUMNS.values()] for row in grid]
        parts += ["## Vector steps", table(list(_COLUMNS), rows)]
    if figures["notes"]:
        parts += ["## Left out", "\n".join(f"- {note}" for note in figures["notes"])]
    return "\n\n".join(parts) + "\n"


_STYLES: dict[int, Literal["-", "--"]] = {1: "-", 2: "--"}  # by threads


def _counted(number: int, things: str) -> str:
    """`1 world`, `4,096 worlds`."""
    return f"{number:,} {things if number > 1 else things[:-1]}"


def _draw(ax: Any, rows: list[Row], along: str, held: str, shade: Any) -> None:
    """The lines, one for each number of threads, of rows that have the same number of `held`."""
    for threads, style in _STYLES.items():
        line = [row for row in rows if row["threads"] == threads]
        line.sort(key=lambda row: row[along])
        ax.loglog(
            [row[along] for row in line],
            [row["ns_per_agent_step"] for row in line],
            marker="o",
            markersize=3,
            color=shade,
            linestyle=style,
            label=_counted(rows[0][held], held) if threads == 1 else None,
        )


def plot(grid: list[Row], path: Path) -> bool:
    """Cost per agent step against worlds and against followers, a row of pictures for each scenario.

    Returns False without Matplotlib.
    """
    try:
        import matplotlib
    except ImportError:
        return False
    matplotlib.use("Agg")
    from matplotlib import colormaps, pyplot
    from matplotlib.lines import Line2D

    shown = [row for row in grid if row["action"] == "wrench"]
    scenarios = sorted({row["scenario"] for row in shown})
    figure, pictures = pyplot.subplots(
        len(scenarios),
        2,
        figsize=(10, 0.8 + 3.4 * len(scenarios)),
        sharex="col",
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for scenario, axes in zip(scenarios, pictures, strict=True):
        rows = [row for row in shown if row["scenario"] == scenario]
        for ax, (along, held) in zip(axes, permutations(("worlds", "followers")), strict=True):
            # Dark to light as the number grows; the lightest would not be seen on white.
            numbers = sorted({row[held] for row in rows})
            shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(numbers)))
            for number, shade in zip(numbers, shades, strict=True):
                _draw(ax, [row for row in rows if row[held] == number], along, held, shade)
            ax.set_title(f"{scenario}, against {along}", fontsize=10)
            if scenario == scenarios[-1]:
                ax.set_xlabel(along)
            ax.grid(visible=True, which="both", alpha=0.2)
            ax.legend(fontsize=7)
        axes[0].set_ylabel("cost per agent step, ns")
    threads_shown = [
        Line2D([], [], color="black", linestyle=style, label=_counted(threads, "threads"))
        for threads, style in _STYLES.items()
    ]
    figure.legend(handles=threads_shown, loc="outside upper center", ncols=2, fontsize=8)
    figure.savefig(path, dpi=130)
    pyplot.close(figure)
    return True
