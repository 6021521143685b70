"""How much was flown to find the gains of the `-tuned` laws, from the commands in the files of gains."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from baselines.policies.textbook_tuned import LAWS
from baselines.policies.tuned import FEEDFORWARDS, GAINS
from baselines.reporting.cells import listed
from baselines.reporting.rows import PAPER, TUNED
from baselines.scoring.results import Report
from baselines.scoring.runs import options_of
from baselines.system.reading import read_text


class Budget(NamedTuple):
    """Of one search. The defaults are those of `python -m train.tune_expert`."""

    candidates: int = 2000
    episodes: int = 64  # that each candidate flies
    feedforward: str = "both"  # of the expert, tried both ways or fixed


Budgets = Mapping[str, Mapping[tuple[str, str], Budget]]  # by policy; scenario and action level


def read() -> Budgets:
    """The budgets of all searches whose gains ship. Raises `ValueError` naming a file that cannot be read."""
    files = {PAPER + TUNED: GAINS, **{law + TUNED: known.file for law, known in LAWS.items()}}
    return {policy: _read(path) for policy, path in files.items()}


def _read(path: Path) -> dict[tuple[str, str], Budget]:
    gains = json.loads(read_text(path))["gains"]
    return {
        (scenario, action): budget_of(entry["made"]["command"])
        for scenario, actions in gains.items()
        for action, entry in actions.items()
        if "command" in entry["made"]
    }


def budget_of(command: str) -> Budget:
    """The budget of the search that a command line repeats."""
    _, given = options_of(command)
    usual = Budget()
    return Budget(
        int(given.get("--evaluations", usual.candidates)),
        int(given.get("--episodes", usual.episodes)),
        given.get("--feedforward", usual.feedforward),
    )


def sentence(report: Report, budgets: Budgets) -> str:
    """Candidates times episodes of every search whose gains have flown, the scenarios on which these differ
    from policy to policy, and what else differs between the searches; empty without any."""
    used = {
        policy: {
            name: budgets[policy][key]
            for name, s in report.scenarios.items()
            if policy in s.results
            and (key := (s.config.scenario, s.config.action)) in budgets[policy]
        }
        for policy in report.policies
        if policy in budgets
    }
    used = {policy: each for policy, each in used.items() if each}
    if not used:
        return ""
    kinds: dict[str, list[str]] = {}
    for policy, each in used.items():
        kinds.setdefault(_spent(each), []).append(policy)
    told = "; ".join(f"{listed(policies)} {spent}" for spent, policies in kinds.items())
    amounts: dict[str, set[tuple[int, int]]] = {}
    for each in used.values():
        for name, b in each.items():
            amounts.setdefault(name, set()).add((b.candidates, b.episodes))
    unequal = [name for name, found in amounts.items() if len(found) > 1]
    differ = f" Budgets differ on {listed(unequal)}." if unequal else ""
    return f"Candidates x episodes: {told}.{differ}{_feedforwards(used)}"


def _spent(each: Mapping[str, Budget]) -> str:
    """The most frequent budget, and the scenarios that had another one."""
    by_size: dict[str, list[str]] = {}
    for name, b in each.items():
        by_size.setdefault(f"{b.candidates} x {b.episodes}", []).append(name)
    usual, *others = sorted(by_size, key=lambda size: -len(by_size[size]))
    return ", ".join([usual, *(f"{size} on {listed(by_size[size])}" for size in others)])


def _feedforwards(used: Mapping[str, Mapping[str, Budget]]) -> str:
    """That a part of the expert's candidates went into a choice which the other laws do not have."""
    both = any(b.feedforward == "both" for b in used.get(PAPER + TUNED, {}).values())
    ways = f"{len(FEEDFORWARDS)} feedforwards"
    return f" That of `{PAPER}` also chose between {ways}." if both else ""
