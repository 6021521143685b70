"""The file with everything that a run needs to be resumed: safetensors with JSON, nothing to execute."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch

from baselines.system.reading import require_regular
from baselines.system.writing import write_bytes
from formation_env.validation.checks import integer, number, require, shown
from train.checkpoint_contents import Arrays, adam_moments, array_like, fact

VERSION = 1
NAME = "checkpoint.safetensors"
_KEY = "run"
_TORCH = tuple(torch.get_rng_state().shape)


def write(path: Path, data: bytes) -> None:
    """Write a file whole or not at all. Raises `OSError` naming it; the earlier one is kept."""
    try:
        write_bytes(path, data)
    except OSError as problem:
        raise OSError(problem.errno, f"cannot write: {problem.strerror}", str(path)) from problem


def require_there(path: Path) -> None:
    """Raises `ValueError` where there is no such file."""
    try:
        require_regular(path)
    except OSError as problem:
        reason = problem.strerror or problem
        raise ValueError(f"{path}: not a checkpoint that can be read ({reason})") from None


def save(path: Path, facts: dict[str, Any], arrays: Arrays) -> None:
    """Write facts that JSON takes, and arrays by name."""
    from safetensors.numpy import save as serialise

    text = json.dumps({"version": VERSION, **facts})
    whole = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    write(path, serialise(whole, {_KEY: text}))


def load(path: Path) -> tuple[dict[str, Any], Arrays]:
    """The facts and arrays of a file, which `train.checkpoint_contents` checks.

    Raises `ValueError` naming the file and what is wrong with it.
    """
    from safetensors import SafetensorError, safe_open

    require_there(path)
    try:
        with safe_open(path, framework="np") as file:
            run_text = (file.metadata() or {}).get(_KEY)
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, TypeError, AttributeError, KeyError) as problem:
        # The latter three for kinds of numbers that NumPy does not have.
        reason = problem.strerror if isinstance(problem, OSError) else None
        text = " ".join(str(reason or problem).split())[:200]
        raise ValueError(f"{path}: not a checkpoint that can be read ({text})") from None
    try:
        facts = json.loads(run_text) if run_text is not None else None
    except (ValueError, RecursionError):  # the latter of a thousand brackets
        facts = None
    if not isinstance(facts, dict) or facts.get("version") != VERSION:
        found = shown(facts.get("version")) if isinstance(facts, dict) else "none"
        raise ValueError(f"{path}: not a checkpoint of version {VERSION} (found {found})")
    return facts, arrays


# -- what is in it --------------------------------------------------------------------------------


def optimiser_state(optimiser: torch.optim.Optimizer) -> Arrays:
    """Adam's moments as arrays, named by the parameter's number and the moment's name."""
    return {
        f"{index}.{name}": value.numpy().copy()
        for index, each in optimiser.state_dict()["state"].items()
        for name, value in each.items()
    }


def restore_optimiser(optimiser: torch.optim.Optimizer, arrays: Arrays) -> None:
    """Take back what `optimiser_state` gave, from the group `optimiser`."""
    shapes = [tuple(p.shape) for part in optimiser.param_groups for p in part["params"]]
    state = {
        index: {name: torch.from_numpy(array.copy()) for name, array in each.items()}
        for index, each in adam_moments(arrays, shapes).items()
    }
    groups = optimiser.state_dict()["param_groups"]
    optimiser.load_state_dict({"state": state, "param_groups": groups})


def random_state() -> tuple[dict[str, Any], Arrays]:
    """The state of the global generators that PPO draws from, PyTorch's and NumPy's: facts and arrays."""
    _, keys, position, has_normal, normal = np.random.get_state()  # noqa: NPY002
    arrays = {"torch": torch.get_rng_state().numpy().copy(), "numpy": np.array(keys)}
    return {"position": int(position), "has_normal": has_normal, "normal": normal}, arrays


def restore_random(facts: Any, arrays: Arrays) -> None:
    """Take back what `random_state` gave, arrays from the group `random`.

    The position is checked here, since NumPy reads at any that it is given.
    """
    require(isinstance(facts, dict), "random", facts, "an object")
    keys = array_like(arrays, "random/numpy", (624,), np.uint32)
    position = integer("random.position", fact(facts, "position"), 0, 624)
    has_normal = integer("random.has_normal", fact(facts, "has_normal"), 0, 1)
    normal = number("random.normal", fact(facts, "normal"), -100.0, 100.0)
    state = torch.from_numpy(array_like(arrays, "random/torch", _TORCH, np.uint8).copy())
    trial = torch.Generator()
    try:
        trial.set_state(state)
    except RuntimeError as problem:
        raise ValueError(f"random/torch: {problem}") from None
    # One normal number may lie ready in it.
    drawn = torch.empty(2, dtype=torch.float64).normal_(generator=trial)
    require(bool(drawn.abs().max() < 100.0), "random/torch", drawn.tolist(), "a generator's state")
    torch.set_rng_state(state)
    np.random.set_state(("MT19937", keys, position, has_normal, normal))  # noqa: NPY002
