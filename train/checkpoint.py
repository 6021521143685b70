"""Everything a run needs to go on, in one safetensors file: numbers and JSON, nothing to execute."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.writing import write_bytes

Arrays = dict[str, NDArray[Any]]

VERSION = 1
NAME = "checkpoint.safetensors"
_KEY = "run"


def write(path: Path, data: bytes) -> None:
    """Write a file whole or not at all. Raises `OSError` naming it; the earlier one is kept."""
    try:
        write_bytes(path, data)
    except OSError as problem:
        raise OSError(problem.errno, f"cannot write: {problem.strerror}", str(path)) from problem


def prepare_folder(folder: Path) -> None:
    """Make it if need be. Raises `OSError` where nothing can be written into it."""
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / ".writable"
    write(probe, b"")
    probe.unlink()


def save(path: Path, facts: dict[str, Any], arrays: Arrays) -> None:
    """Facts that JSON takes, and arrays by name."""
    from safetensors.numpy import save as serialise

    text = json.dumps({"version": VERSION, **facts})
    whole = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    write(path, serialise(whole, {_KEY: text}))


def load(path: Path) -> tuple[dict[str, Any], Arrays]:
    """What `save` wrote. Raises `ValueError` naming the file and what is amiss."""
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="np") as file:
            text = (file.metadata() or {}).get(_KEY)
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as problem:
        raise ValueError(f"{path}: not a checkpoint that can be read ({problem})") from None
    try:
        facts = json.loads(text) if text is not None else None
    except ValueError:
        facts = None
    if not isinstance(facts, dict) or facts.get("version") != VERSION:
        found = facts.get("version") if isinstance(facts, dict) else None
        raise ValueError(f"{path}: not a checkpoint of version {VERSION} (found {found})")
    return facts, arrays


# -- what is in it --------------------------------------------------------------------------------


def optimiser_state(optimiser: torch.optim.Optimizer) -> Arrays:
    """Its moments, by parameter."""
    return {
        f"{index}.{name}": value.numpy().copy()
        for index, each in optimiser.state_dict()["state"].items()
        for name, value in each.items()
    }


def moments(arrays: Arrays) -> dict[int, Arrays]:
    """What `optimiser_state` gave, by the parameter's number."""
    numbered: dict[int, Arrays] = {}
    for key, array in arrays.items():
        index, name = key.split(".")
        numbered.setdefault(int(index), {})[name] = array
    return numbered


def restore_optimiser(optimiser: torch.optim.Optimizer, arrays: Arrays) -> None:
    """Take back what `optimiser_state` gave."""
    state = {
        index: {name: torch.from_numpy(array.copy()) for name, array in each.items()}
        for index, each in moments(arrays).items()
    }
    groups = optimiser.state_dict()["param_groups"]
    optimiser.load_state_dict({"state": state, "param_groups": groups})


def random_state() -> tuple[dict[str, Any], Arrays]:
    """The global generators that PPO draws from, PyTorch's and NumPy's."""
    _, keys, position, has_normal, normal = np.random.get_state()  # noqa: NPY002
    arrays = {"torch": torch.get_rng_state().numpy().copy(), "numpy": np.array(keys)}
    return {"position": int(position), "has_normal": has_normal, "normal": normal}, arrays


def restore_random(facts: dict[str, Any], arrays: Arrays) -> None:
    """Take back what `random_state` gave."""
    torch.set_rng_state(torch.from_numpy(arrays["torch"].copy()))
    np.random.set_state(  # noqa: NPY002
        ("MT19937", arrays["numpy"], facts["position"], facts["has_normal"], facts["normal"])
    )


def group(arrays: Arrays, name: str) -> Arrays:
    """Those whose names begin with `name/`, without it."""
    start = f"{name}/"
    return {key[len(start) :]: x for key, x in arrays.items() if key.startswith(start)}
