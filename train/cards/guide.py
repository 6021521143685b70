"""The text of `docs/trained.md`: the template, with tables of the policies and curves that are checked in."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from baselines import files
from baselines.files import Card, Network
from baselines.policies.tuned import GAINS, read
from baselines.registry import USUAL
from baselines.reporting.board import JSON, PAGES
from formation_env import SCENARIOS
from formation_env.laws.levels import NAMES as LEVEL_NAMES
from train.cards.curves import Curve, Key, order, read_curve
from train.cards.pictures import picture_name
from train.cards.shipping import (
    COMPARED,
    CURVES,
    GENERALISATION,
    Transfer,
    file_digest,
    read_transfers,
    shipped,
)

BOARD = PAGES / JSON
PAGE, TEMPLATE = Path("docs/trained.md"), Path("train/trained.template.md")
TUNED = Path("baselines") / GAINS.name

_NOTICE = (
    "<!-- Written by `python -m train.cards` from train/trained.template.md, train/curves and the policies "
    "that ship. Do not edit. -->\n"
)


class Shipped(NamedTuple):
    """A policy that is checked in."""

    path: Path
    card: Card
    network: Network


Task = tuple[str, str]  # scenario and action level
SHOWN = ("expert", "ff")  # programmed policies that are drawn beside the learning curves


class Facts(NamedTuple):
    """Everything in a checkout that the text and the tables are made of."""

    template: str
    policies: dict[Key, Shipped]
    curves: list[Curve]  # by scenario, level, method and seed
    transfers: list[Transfer]
    stale: list[str]  # policies whose transfers are of an earlier file, or missing
    board: dict[
        Task, dict[str, float]
    ]  # scores of `SHOWN` on the leaderboard, by scenario and level
    tuned: dict[str, Any]  # scenario: level: entry


def gather(checkout: Path) -> Facts:
    """Read the facts of a checkout. Raises `ValueError` naming a broken file, `OSError`."""
    template = (checkout / TEMPLATE).read_text(encoding="utf-8")
    policies = {key: Shipped(path, *files.load(path)) for key, path in shipped(checkout)}
    paths = sorted((checkout / CURVES).glob("*.csv"))
    curves = [read_curve(path) for path in paths if path.name != GENERALISATION.name]
    transfers = read_transfers(checkout / GENERALISATION)
    valid = {"-", *(file_digest(each.path) for each in policies.values())}
    kept = [each for each in transfers if each.digest in valid]
    measured = {(each.policy, each.action) for each in kept}
    stale = [
        each.path.name
        for key, each in policies.items()
        if key.scenario == USUAL and (key.method, key.action) not in measured
    ]
    curves.sort(key=lambda c: (order(c.key), c.seed))
    board = _board(checkout / BOARD)
    return Facts(template, policies, curves, kept, stale, board, _tuned(checkout / TUNED))


def _board(path: Path) -> dict[Task, dict[str, float]]:
    """Scores of `SHOWN` from the leaderboard's figures; none without them. Raises `ValueError`."""
    if not path.exists():
        return {}
    try:
        scenarios = json.loads(path.read_text(encoding="utf-8"))["scenarios"]
        return {
            (name.partition(":")[0], each["action"]): {
                shown: float(each["policies"][shown]["metrics"]["score"][0])
                for shown in SHOWN
                if shown in each["policies"]
            }
            for name, each in scenarios.items()
        }
    except (KeyError, TypeError, IndexError, ValueError):
        raise ValueError(f"{path}: not what baselines.evaluate --leaderboard writes") from None


def _tuned(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    read(path)  # which checks it
    return dict(json.loads(path.read_text(encoding="utf-8"))["gains"])


def pictures(curves: Sequence[Curve]) -> dict[str, list[Curve]]:
    """The curves of each picture, by its name."""
    shown: dict[str, list[Curve]] = {}
    for curve in curves:
        shown.setdefault(picture_name(curve.key), []).append(curve)
    return shown


def page(facts: Facts) -> str:
    """The whole text. Raises `ValueError` if the template lacks the comment that a table replaces."""
    parts = {
        "reached": _reached(facts),
        "tuned": _tuned_table(facts.tuned),
        "curves": _curves(facts.curves),
        "generalisation": _generalisation(facts.transfers),
        "cards": _cards(facts.policies),
    }
    text = facts.template
    for name, part in parts.items():
        place = f"<!-- {name} -->"
        if text.count(place) != 1:
            raise ValueError(f"{TEMPLATE}: expected the line {place} once")
        text = text.replace(place, part)
    return _NOTICE + text


# -- tables ---------------------------------------------------------------------------------------


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> str:
    """A table in Markdown; its first `left` columns and commands are aligned left, the others right."""
    rules = ["---" if i < left or x == "command" else "---:" for i, x in enumerate(head)]
    every = [head, rules, *rows]
    # A `|` would end the cell.
    return "\n".join("| " + " | ".join(x.replace("|", "\\|") for x in row) + " |" for row in every)


def _interval(value: float, low: float, high: float) -> str:
    return f"{value:.3f}" if low == high else f"{value:.3f} ({low:.3f} .. {high:.3f})"


def _figures(three: Sequence[float | None] | None) -> str:
    """Value, low and high as text, or `-` where one of them is not known."""
    known = [x for x in three or () if x is not None]
    return _interval(*known) if len(known) == 3 else "-"


def _code(command: str) -> str:
    return f"`{' '.join(command.split())}`" if command.strip() else "-"


def _reached(facts: Facts) -> str:
    """A row for each method, scenario and level that has a policy or a curve."""
    keys = sorted({*facts.policies, *(c.key for c in facts.curves)}, key=order)
    if not keys:
        return "Nothing is checked in yet."
    head = ["scenario", "level", "method", "score, seeds 0-99", "best while training", "steps",
            "minutes", "command"]  # fmt: skip
    rows = []
    for key in keys:
        runs = [c for c in facts.curves if c.key == key]
        each = facts.policies.get(key)
        rows.append([key.scenario, key.action, f"`{key.method}`", _score(key, each), _best(runs),
                     *_effort(each, runs)])  # fmt: skip
    return _table(head, rows, 3)


def _score(key: Key, each: Shipped | None) -> str:
    three = each.card.score.get(key.scenario) if each else None
    if three is None:
        return "-"
    return _interval(*three)


def _best(runs: Sequence[Curve]) -> str:
    """Mean over the seeds of the best evaluation, and the worst and the best seed's."""
    if not runs:
        return "-"
    scores = [run.best.score for run in runs]
    seeds = "1 seed" if len(runs) == 1 else f"{len(runs)} seeds"
    return f"{_interval(sum(scores) / len(scores), min(scores), max(scores))}, {seeds}"


def _effort(each: Shipped | None, runs: Sequence[Curve]) -> list[str]:
    """Steps, minutes and command: of the policy that ships, or of the best run."""
    if each is not None:
        card = each.card
        return [f"{card.steps:,}", f"{card.minutes:.1f}", _code(card.command)]
    best = max(runs, key=lambda run: run.best.score)
    last = best.rows[-1]
    return [f"{last.steps:,}", f"{last.minutes:.1f}", _code(best.command)]


def _tuned_table(tuned: dict[str, Any]) -> str:
    rows = []
    for scenario in (name for name in SCENARIOS if name in tuned):
        for action in (level for level in LEVEL_NAMES if level in tuned[scenario]):
            entry = tuned[scenario][action]
            made = entry.get("made", {})
            seeds = "-".join(map(str, made.get("validation", ())))
            score = _figures(made.get("score"))
            rows.append([scenario, action, seeds, score, _code(made.get("command", ""))])
    if not rows:
        return "No gains are checked in yet."
    return _table(["scenario", "level", "seeds", "score", "command"], rows, 3)


def _curves(curves: Sequence[Curve]) -> str:
    if not curves:
        return "No curve is checked in yet."
    shown = []
    for name, group in pictures(curves).items():
        key = group[0].key
        methods = ", ".join(dict.fromkeys(c.key.method for c in group))
        words = f"Score of {methods} on {key.scenario} at level {key.action}"
        shown.append(
            f"![{words}, against agent steps and against minutes](../{CURVES.as_posix()}/{name})"
        )
    return "\n\n".join(shown)


def _generalisation(transfers: Sequence[Transfer]) -> str:
    """A table for each action level: rows are tasks, columns policies."""
    tables = []
    for action in LEVEL_NAMES:
        here = {(t.task, t.policy): t for t in transfers if t.action == action}
        policies = list(dict.fromkeys(policy for _, policy in here))
        if all(policy in COMPARED for policy in policies):
            continue
        rows = [
            [task, *(_transfer(here.get((task, policy))) for policy in policies)]
            for task in dict.fromkeys(task for task, _ in here)
        ]
        head = [f"at level `{action}`", *(f"`{policy}`" for policy in policies)]
        tables.append(_table(head, rows, 1))
    return "\n\n".join(tables) or "Nothing is measured yet."


def _transfer(t: Transfer | None) -> str:
    if t is None:
        return "-"
    text = _interval(t.score, t.low, t.high)
    return text if t.failed == 0.0 else f"{text}; {100.0 * t.failed:.0f} % failed"


def _cards(policies: dict[Key, Shipped]) -> str:
    if not policies:
        return "No policy is checked in yet."
    head = ["file", "made by", "network", "history", "residual", "seed", "package", "bytes"]
    rows = []
    for path, card, network in policies.values():
        widths = [network.weights[0].shape[1], *(len(b) for b in network.biases)]
        rows.append(
            [
                f"`{path.name}`",
                card.method,
                f"{'-'.join(map(str, widths))} {card.activation}",
                str(card.history),
                f"{card.residual:g}",
                str(card.seed),
                card.package or "-",
                f"{path.stat().st_size:,}",
            ]
        )
    return _table(head, rows, 3)
