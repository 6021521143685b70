"""Damages a checkpoint in many ways and tries to go on from each: `checkpoint_fuzz.py FOLDER SEED COUNT`.

A program of its own, since what is tested is that it does not die. Prints one line for each damage that
is met otherwise than by a refusal of one line that names the file, or by a run that flies on; at the end,
a count.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

warnings.simplefilter("ignore")

from train import checkpoint  # noqa: E402
from train.ppo.options import Options  # noqa: E402
from train.ppo.start import prepare  # noqa: E402

VALUES: tuple[Any, ...] = (
    None, "x", "", -1, 0, 1, 10**6, 10**9, 2**63, 10**30, 1.5, 1e300, float("nan"), float("inf"),
    True, [], [1], {}, {"a": 1}, [[]], ["x"], "nominal", "../../x", "\0",
)  # fmt: skip
NUMBERS = (np.nan, np.inf, -np.inf, 1e30, -1.0, 0.0, 10.0**6, 10.0**9, -(2.0**40))


def at_random(rng: np.random.Generator, facts: dict[str, Any], arrays: dict[str, Any]) -> str:
    """Damage one thing in place; says what."""
    kind = rng.integers(6)
    if kind == 0:
        part = rng.choice(["", "options", "options", "random"])
        where = facts[part] if part else facts
        name = str(rng.choice(sorted(where)))
        where[name] = VALUES[rng.integers(len(VALUES))]
        return f"{part}.{name} = {where[name]!r}"
    if kind == 1:
        part = rng.choice(["", "options", "random"])
        where = facts[part] if part else facts
        name = str(rng.choice(sorted(where)))
        del where[name]
        return f"{part}.{name} dropped"
    if kind == 2 and facts["rows"]:
        row = rng.integers(len(facts["rows"]))
        entry = rng.integers(len(facts["rows"][row]))
        facts["rows"][row][entry] = VALUES[rng.integers(len(VALUES))]
        return f"rows[{row}][{entry}] = {facts['rows'][row][entry]!r}"
    name = str(rng.choice(sorted(arrays)))
    x = arrays[name] = arrays[name].copy()
    if kind == 3:
        change = rng.integers(5)
        arrays[name] = (
            x[..., :0], x.astype(np.float64), x.astype(np.int32), x.ravel()[:-1], x[None]
        )[change]  # fmt: skip
        return f"{name} is {arrays[name].dtype} {arrays[name].shape}, was {x.dtype} {x.shape}"
    if kind == 4:
        if rng.random() < 0.5:
            del arrays[name]
            return f"{name} dropped"
        arrays[f"{name}x"] = arrays.pop(name)
        return f"{name} renamed"
    if x.size == 0:
        return "nothing"
    value = NUMBERS[rng.integers(len(NUMBERS))]
    at = np.unravel_index(rng.integers(x.size), x.shape)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        x[at] = np.array(value).astype(x.dtype)
    return f"{name}{[int(i) for i in at]} = {x[at]!r}"


def tried(folder: Path) -> str:
    """What going on comes to: "" for a refusal as it should be or a run that flies."""
    path = folder / checkpoint.NAME
    try:
        run = prepare(Options(output=folder, resume=True, quiet=True))
    except ValueError as problem:
        text = str(problem)
        good = text.startswith(f"{path}: ") and "\n" not in text and len(text) < 700
        return "" if good else f"refused with {text!r}"
    run.release()
    rows = run.env.num_envs
    for _ in range(3):
        run.env.step(np.zeros((rows, run.env.config.action_size), dtype=np.float32))
        seen = run.model.predict(run.model._last_obs)[0]
        if not np.isfinite(seen).all():
            return "accepted, and the policy gives NaN"
    run.env.close()
    return ""


def main(folder: Path, seed: int, count: int) -> None:
    """Damage and try `count` times."""
    bad = 0
    for number in range(count):
        facts, arrays = checkpoint.load(folder / "whole" / checkpoint.NAME)
        what = at_random(np.random.default_rng((seed, number)), facts, arrays)
        print(f"{number} {what}", file=sys.stderr, flush=True)
        part = folder / "part"
        part.mkdir(exist_ok=True)
        checkpoint.save(part / checkpoint.NAME, {**facts}, arrays)
        try:
            found = tried(part)
        except BaseException as problem:
            found = f"{type(problem).__name__}: {problem}"
        if found:
            bad += 1
            print(f"{number} {what}: {found}", flush=True)
    print(f"{count} damages, {bad} bad")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
