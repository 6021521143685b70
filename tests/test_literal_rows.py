"""No number names a row or column of the package's arrays: `records` alone knows them, by names of fields."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

FOLDERS = ("formation_env", "baselines", "train", "tests")
KNOWS = ("formation_env/memory/records.py", "tests/test_literal_rows.py")

# Arrays whose numbers have names: how many places they have, and which of these runs over the numbers.
# Those in tiles have their rows in the last place, lane by lane; what a call returns has columns there.
ARRAYS = {
    **dict.fromkeys(("observations", "final_observations", "outputs", "final_outputs"), (3, 2)),
    "ends": (2, 0),  # `Verdict` row by row
    "vehicles": (3, 2),
    "samples": (4, 3),
    "followers": (3, 2),
    "counters": (2, 1),
}
# What trajectories are called: what they return has one row for each field of `TrajectoryPoint`, before the
# last place. Its places are as many as the times have, so that any number in an index counts.
CURVES = ("trajectory", "path", "curve", "drawn", "EIGHT")
# By themselves these words name other things too: they count as attributes, calls and keys.
COMMON = ("ends", "vehicles", "samples", "followers")


def name_of(node: ast.expr, aliases: dict[str, str]) -> str:
    """What an array is called where it is used: `outputs` of `results.outputs`, `views["outputs"]`.

    Or of `a` after `a = results.outputs`.
    """
    match node:
        case ast.Name(id=name):
            return aliases.get(name, "" if name in COMMON else name)
        case ast.Attribute(attr=name):
            return name
        case ast.Subscript(slice=ast.Constant(value=str(name))):
            return name
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name
    return ""


def is_flown(node: ast.expr) -> bool:
    """Whether it is what a trajectory returns for some times: `config.trajectory(t)`."""
    match node:
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name in CURVES
    return False


def flown_in(part: ast.stmt) -> set[str]:
    """Names of what trajectories returned anywhere in a function: `motion` after `motion = curve(t)`."""
    return {
        target.id
        for node in ast.walk(part)
        if isinstance(node, ast.Assign) and is_flown(node.value)
        for target in node.targets
        if isinstance(target, ast.Name)
    }


def aliases_of(part: ast.stmt) -> dict[str, str]:
    """Names given to arrays anywhere in a function, or another statement of a file."""
    return {
        target.id: name_of(node.value, {})
        for node in ast.walk(part)
        if isinstance(node, ast.Assign) and not isinstance(node.value, ast.Call)
        for target in node.targets
        if isinstance(target, ast.Name) and name_of(node.value, {}) in ARRAYS
    }


def is_row_of_lanes(node: ast.expr) -> bool:
    """Whether an index is a literal row of a tile: `3 * LANES + lane`."""
    return any(
        isinstance(one, ast.BinOp)
        and isinstance(one.op, ast.Mult)
        and any(isinstance(side, ast.Constant) for side in (one.left, one.right))
        and any(
            isinstance(side, ast.Name) and side.id.endswith("LANES")
            for side in (one.left, one.right)
        )
        for one in ast.walk(node)
    )


def is_of_rows(node: ast.expr) -> bool:
    """Whether it is a tile as its rows: `x.reshape(-1, LANES)`."""
    match node:
        case ast.Call(func=ast.Attribute(attr="reshape"), args=[*_, rows, ast.Name(id=lanes)]):
            return lanes.endswith("LANES") and ast.unparse(rows) == "-1"
    return False


def is_literal(node: ast.expr | None, constants: dict[str, ast.expr]) -> bool:
    """Whether a place is named by whole numbers: `5`, `-1`, `5:8`, `[0, 1]`, or a constant of the file."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int) and not isinstance(value, bool)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return is_literal(operand, constants)
        case ast.Slice(lower=lower, upper=upper):
            return is_literal(lower, constants) or is_literal(upper, constants)
        case ast.Call(func=ast.Name(id="slice"), args=bounds):
            return any(is_literal(bound, constants) for bound in bounds)
        case ast.List(elts=several) | ast.Tuple(elts=several):
            return any(is_literal(one, constants) for one in several)
        case ast.Name(id=name) if name in constants:
            return is_literal(constants[name], {})
    return False


def constants_of(tree: ast.Module) -> dict[str, ast.expr]:
    """Names that the file itself gives to values: `FAILED = 12`, `P, V = slice(0, 3), slice(3, 6)`."""
    found: dict[str, ast.expr] = {}
    for node in tree.body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                found[name] = value
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                pairs = zip(names, values, strict=False)
                found |= {name.id: value for name, value in pairs if isinstance(name, ast.Name)}
    return found


def place(index: ast.expr, rank: int, axis: int) -> ast.expr | None:
    """What stands in a place of an index of an array of so many places, or nothing."""
    places = list(index.elts) if isinstance(index, ast.Tuple) else [index]
    dots = [k for k, one in enumerate(places) if isinstance(one, ast.Constant) and one.value is ...]
    if dots:
        behind = len(places) - dots[0] - 1
        if axis >= rank - behind:
            return places[axis - rank]
        return places[axis] if axis < dots[0] else None
    return places[axis] if axis < len(places) else None


def literals(text: str) -> Iterator[tuple[int, str]]:
    """Lines in which a number names a row or column, and the subscripts."""
    tree = ast.parse(text)
    constants = constants_of(tree)
    for part in tree.body:
        yield from _literals_in(part, constants, aliases_of(part))


def _literals_in(
    part: ast.stmt, constants: dict[str, ast.expr], aliases: dict[str, str]
) -> Iterator[tuple[int, str]]:
    flown = flown_in(part)
    for node in ast.walk(part):
        if not isinstance(node, ast.Subscript):
            continue
        found = None
        if is_flown(node.value) or (isinstance(node.value, ast.Name) and node.value.id in flown):
            found = node.slice
        elif name_of(node.value, aliases) in ARRAYS:
            found = place(node.slice, *ARRAYS[name_of(node.value, aliases)])
        elif is_of_rows(node.value):
            found = place(node.slice, 2, 0)
        if is_literal(found, constants) or is_row_of_lanes(node.slice):
            yield node.lineno, ast.unparse(node)


@pytest.mark.parametrize("folder", FOLDERS)
def test_no_number_names_a_row_or_column(folder: str, root: Path) -> None:
    found = []
    for path in sorted((root / folder).rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if name not in KNOWS:
            lines = literals(path.read_text(encoding="utf-8"))
            found += [f"{name}:{line}: {text}" for line, text in lines]
    assert not found, "rows or columns by number:\n" + "\n".join(found)


@pytest.mark.parametrize(
    "text",
    [
        "a = results.outputs[0, :, 5:8]",
        "a = results.outputs[..., 12]",
        "a = results.outputs[..., :5]",
        "a = env.look().outputs[0, 1, -1]",
        "state['vehicles'][0, 1, 3] = 2",
        "FAILED = 12\na = outputs[..., FAILED]",
        "P, V = slice(0, 3), slice(3, 6)\na = vehicles(flight)[:, 0, V]",
        "a = results.ends[1]",
        "a = results.ends[1, :3].any()",
        "a = state.counters[0, 5]",
        "a = observations[..., [3, 4]]",
        "def f():\n    a = flight._state.samples\n    return a[0, 0, 0, 9]",
        "x[3 * LANES + lane] = 0.0",
        "a = x.reshape(-1, LANES)[2:5, lane]",
        "v = config.trajectory(t)[:, 1]",
        "p = path(0.0)[0]",
        "def f():\n    motion = curve(t)\n    return motion[..., 2, :]",
    ],
)
def test_a_number_is_noticed(text: str) -> None:
    assert len(list(literals(text))) == 1


@pytest.mark.parametrize(
    "text",
    [
        "a = results.outputs[0]",
        "a = results.outputs[0, 1]",
        "a = results.outputs[..., COLUMNS['slot']]",
        "a = results.outputs[0, :, REWARD]",
        "a = vehicles(flight)['p'][0, 1, 2, 5]",
        "a = results.outputs[:5, ..., where]",
        "a = results.ends[:, 1]",
        "a = results.ends[k, 1]",
        "a = views['counters']",
        "def f():\n    a = flight._state.samples\n\ndef g(a):\n    return a[0, 0, 0, 9]",
        "ends = bonds[0]\na = ends[1]",
        "x[row * LANES + lane] = 0.0",
        "a = x.reshape(-1, LANES)[:, 3]",
        "a = rows(state.counters, Counters)['tick'][0, 0, 3]",
        "v = by_name(config.trajectory(t))['v'][:, 0]",
        "def f():\n    motion = curve(t)\n\ndef g(motion):\n    return motion[0]",
        "FAILED = COLUMNS['failed'].start\na = outputs[..., FAILED]",
    ],
)
def test_other_numbers_are_left_alone(text: str) -> None:
    assert not list(literals(text))
