"""Episodes as files: one NumPy archive each, without pickled objects.

An archive `.npz` holds the arrays of `Episode` under their names and `header`, bytes of a JSON object with
`format`, `version`, `policy`, `seed`, `config` (`FormationConfig.to_dict`) and `metrics`, in which null
stands for what an episode does not have. Reading one runs nothing that is in it.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.replay.episode import Episode
from baselines.scoring.metrics import EPISODE
from baselines.system.reading import file_name, read_bytes
from baselines.system.writing import write_bytes
from formation_env import FormationConfig
from formation_env.task import FAILURES
from formation_env.validation.checks import shortened

SUFFIX = ".npz"
FORMAT, VERSION = "formation-env episode", 1
_MOST = 2**29  # bytes of all arrays together, of an archive that is read

# Number type and axes of each array; T ticks, n followers, k entries of an action, M points.
_ARRAYS: dict[str, tuple[Any, tuple[str | int, ...]]] = {
    "time": (np.float64, ("T+1",)),
    "started": (np.bool_, ("T+1",)),
    "positions": (np.float64, ("T+1", "1+n", 3)),
    "velocities": (np.float64, ("T+1", "1+n", 3)),
    "attitudes": (np.float64, ("T+1", "1+n", 4)),
    "angular_velocities": (np.float64, ("T+1", "1+n", 3)),
    "slots": (np.float64, ("T+1", "n", 3)),
    "actions": (np.float32, ("T", "n", "k")),
    "rewards": (np.float64, ("T", "n")),
    "failure": (np.int64, ("n",)),
    "path": (np.float64, ("M", 3)),
    "lyapunov": (np.float64, ("L", "n", 4)),
}
# What may hold numbers that are not finite at the last instant, of a flight that has failed.
_LAST = ("positions", "velocities", "attitudes", "angular_velocities", "slots", "rewards")


def write(episode: Episode, path: str | os.PathLike[str]) -> Path:
    """Write an episode; `.npz` is added to a name without it. Returns the file's path. Raises `OSError`."""
    file = Path(file_name(path))
    file = file if file.name.endswith(SUFFIX) else file.with_name(file.name + SUFFIX)
    metrics = {k: x if np.isfinite(x) else None for k, x in episode.metrics.items()}
    header = {
        "format": FORMAT,
        "version": VERSION,
        "policy": episode.policy,
        "seed": episode.seed,
        "config": episode.config.to_dict(),
        "metrics": metrics,
    }
    data = io.BytesIO()
    arrays: dict[str, Any] = {name: getattr(episode, name) for name in _ARRAYS}
    text = np.frombuffer(json.dumps(header, allow_nan=False).encode(), dtype=np.uint8)
    np.savez_compressed(data, header=text, **arrays)
    write_bytes(file, data.getvalue())
    return file


def read(path: str | os.PathLike[str]) -> Episode:
    """The episode in a file that `write` has written; nothing in it is executed.

    Raises `ValueError` naming the file and what in it is not as expected.
    """
    try:
        arrays = _arrays(read_bytes(file_name(path)))
        header = _header(arrays.pop("header"))
        config = FormationConfig.from_dict(header["config"])
        _check(arrays, config)
        known = header["metrics"]
        metrics = {
            k: np.nan if known[k] is None else float(known[k]) for k in (*EPISODE, "failure")
        }
        return Episode(header["policy"], header["seed"], config, metrics=metrics, **arrays)
    except OSError as problem:
        raise ValueError(f"{path}: cannot be read: {problem.strerror or problem}") from None
    except (ValueError, KeyError, TypeError) as problem:
        text = f"{problem.args[0]} is missing" if isinstance(problem, KeyError) else str(problem)
        message = f"{path}: no episode of baselines.replay: {text}"
        raise ValueError(shortened(message)) from None


def _arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """All that an archive should hold. Raises `ValueError`, `KeyError`."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            total = sum(entry.file_size for entry in archive.infolist())
    except (zipfile.BadZipFile, NotImplementedError):
        raise ValueError(f"expected a NumPy archive (*{SUFFIX})") from None
    if total > _MOST:
        raise ValueError(f"{total} bytes of arrays: expected at most {_MOST}")
    found = {}
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        for name in ("header", *_ARRAYS):
            try:
                found[name] = file[name]
            except KeyError:
                raise ValueError(f"array {name!r} is missing") from None
            except Exception:  # a damaged entry, or one that only unpickling would read
                raise ValueError(f"array {name!r} cannot be read without pickle") from None
    return found


def _header(text: NDArray[Any]) -> dict[str, Any]:
    """The JSON object. Raises `ValueError`."""
    expected = "expected the JSON object that baselines.replay writes"
    try:
        header = json.loads(bytes(text.astype(np.uint8)).decode("utf-8"))
    except (ValueError, RecursionError):
        raise ValueError(f"header: {expected}") from None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ValueError(f"header: {expected}")
    if header.get("version") != VERSION:
        raise ValueError(f"version = {header.get('version')!r}: expected {VERSION}")
    seed = header.get("seed")
    whole = seed is None or (isinstance(seed, int) and not isinstance(seed, bool) and seed >= 0)
    if not whole or not isinstance(header.get("policy"), str):
        raise ValueError("header: expected a policy's name and a seed of at least 0, or null")
    if not isinstance(header.get("metrics"), dict):
        raise ValueError("header: expected metrics by name")
    return header


def _check(arrays: dict[str, NDArray[Any]], config: FormationConfig) -> None:
    """Raises `ValueError` naming an array that is not one of an episode of the configuration."""
    n, ticks = config.followers, max(0, arrays["time"].size - 1)
    flown = ticks if len(arrays["lyapunov"]) else 0
    axes = {"T": ticks, "T+1": ticks + 1, "n": n, "1+n": n + 1, "k": config.action_size, "L": flown}
    axes["M"] = arrays["path"].size // 3
    if not ticks:
        raise ValueError("array 'time': expected at least two instants")
    for name, (kind, shape) in _ARRAYS.items():
        array, expected = arrays[name], tuple(axes.get(str(x), x) for x in shape)
        if array.dtype != kind or array.shape != expected:
            raise ValueError(
                f"array {name!r} is {array.dtype} {array.shape}: expected {np.dtype(kind)} {expected}"
            )
        failed = bool(arrays["failure"].any())
        rows = array[:-1] if failed and name in _LAST else array
        if not np.isfinite(rows).all():
            raise ValueError(f"array {name!r} holds numbers that are not finite")
    if not (np.diff(arrays["time"]) > 0.0).all():
        raise ValueError("array 'time': expected times that increase")
    bad = (arrays["failure"] < 0) | (arrays["failure"] >= len(FAILURES))
    if bad.any():
        raise ValueError(f"array 'failure': expected indices from 0 to {len(FAILURES) - 1}")
