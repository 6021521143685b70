"""Robustness on the board, in the mean over tasks, and its page with every cell."""

from __future__ import annotations

from math import isnan

from baselines.reporting.cells import listed, markdown_table
from baselines.scoring.robustness import Cell, Robustness


def table(found: Robustness) -> str:
    """A row for each policy: its mean score, and what each change adds to it."""
    names = [change.name for change in found.changes]
    rows = []
    for policy in found.policies:
        mean, tasks = found.mean(policy)
        plain = f"{mean:.3f}" + (
            f", {tasks} of {len(found.tasks)}" if tasks < len(found.tasks) else ""
        )
        rows.append([f"`{policy}`", plain, *(_added(found, policy, name) for name in names)])
    return markdown_table(["policy", "as it is", *names], rows)


def _added(found: Robustness, policy: str, change: str) -> str:
    x = found.difference(policy, change)
    return "-" if isnan(x) else f"{round(x, 2) + 0.0:+.2f}"  # no negative zero


def caption(found: Robustness) -> str:
    """What the table shows."""
    told = [f"*{c.name}*" for c in found.changes if c.told]
    untold = any(not c.told for c in found.changes)
    parts = [
        f"Mean score over {listed(found.tasks)}, of a learned policy over those that it was trained for, on "
        f"{len(found.seeds)} seeds, and what a change adds to it."
    ]
    knows = f"Policies are told of {', '.join(told) or 'none of them'}"
    parts.append(f"{knows}{', and not of the others' if told and untold else ''}.")
    return " ".join([*parts, *gaps(found)])


def meanings(found: Robustness) -> str:
    """What each change is."""
    rows = [[f"`{c.name}`", c.meaning, "yes" if c.told else "no"] for c in found.changes]
    return markdown_table(["change", "meaning", "told"], rows, 3)


def gaps(found: Robustness) -> list[str]:
    """Cells that are left out of every row, and why: changes and tasks that share a reason together."""
    reasons: dict[str, dict[str, list[str]]] = {}
    for (task, change), reason in found.void.items():
        reasons.setdefault(reason, {}).setdefault(change, []).append(task)
    each = [
        f"{', '.join(f'*{change}* on {listed(tasks)}' for change, tasks in cells.items())} ({reason})"
        for reason, cells in reasons.items()
    ]
    return [f"Left out: {'; '.join(each)}."] if each else []


def parts(found: Robustness) -> list[str]:
    """The page's paragraphs: the means, what the changes are, and a table for each task."""
    told = [
        caption(found),
        table(found),
        meanings(found),
        "A change that is told makes the policy anew, for the changed task: it is of what is wanted. Of the "
        "others it knows nothing: they are of the vehicles, the leader's as well, and of what is measured. "
        "Cells are the score and the episodes that failed.",
        *_margin(found),
    ]
    for task in found.tasks:
        rows = [
            [f"`{policy}`", _cell(found.plain[policy, task]), *_cells(found, policy, task)]
            for policy in found.policies
            if (policy, task) in found.plain
        ]
        if rows:
            head = ["policy", "as it is", *(change.name for change in found.changes)]
            told += [f"## {task}", markdown_table(head, rows)]
    refused = {(policy, reason) for (policy, _, _), reason in found.refused.items()}
    return told + [
        f"`{policy}` does not take a change: {reason}." for policy, reason in sorted(refused)
    ]


def _margin(found: Robustness) -> list[str]:
    """Which changes were met in a search or in training."""
    names = [f"*{change.name}*" for change in found.changes if change.margin]
    text = (
        f"{' and '.join(names)}: where a task's sensors are exact, gains are searched with these, and policy "
        "files whose card says `margin` were trained with them."
    )
    return [text] if names else []


def _cells(found: Robustness, policy: str, task: str) -> list[str]:
    each = (found.cells.get((policy, task, change.name)) for change in found.changes)
    return ["-" if cell is None else _cell(cell) for cell in each]


def _cell(cell: Cell) -> str:
    failed = f", {100.0 * cell.failed:.0f} %" if cell.failed else ""
    return f"{cell.score:.3f}{failed}"
