"""Your own policies on the board: `module:Name`, `path/to/file.py:Name`, classes and objects.

A policy is anything with

    reset(seed)          an episode begins; `seed` is a whole number, for what is drawn at random
    act(observation)     the actions, float in [-1, 1]

made by calling a class or function with the configuration (a `FormationConfig`), `MyPolicy(config)`; one
whose constructor takes nothing is called without. It sees one world: `observation` is `(followers,
entries)`, laid out as `config.layout` says, and `act` returns `(followers, config.action_size)`. One object
is made for each world. Faster: where `reset(seed, worlds)` takes the number of worlds, one object flies them
all; world i has the seed `seed + i`, and both arrays have the number of worlds in front. A subclass of
`baselines.Policy` is flown as it is. An object instead of a class is copied for each use.

A constructor that raises `ValueError` says that it cannot fly this configuration: the results then hold the
reason. Naming a file or module runs its code, with your rights; naming a policy file (`.safetensors`) never
runs anything.
"""

from __future__ import annotations

import copy
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from baselines.policies.base import Policy, Rows
from baselines.policies.learned import Misfit
from baselines.system.reading import require_regular
from formation_env import FormationConfig
from formation_env.interface.faces import read_action
from formation_env.validation.checks import shown

Source = str | Callable[..., Any] | object  # `module:Name`, a class or function, or an object


class PolicyError(RuntimeError):
    """Your own policy failed in flight; the cause is what it raised."""


def is_source(name: object) -> bool:
    """Whether a text names code: `module:Name` or `path/to/file.py:Name`."""
    if not isinstance(name, str):
        return False
    place, _, attribute = name.rpartition(":")
    return bool(place.strip()) and attribute.isidentifier()


def make(config: FormationConfig, source: Source) -> Policy:
    """Your own policy for a configuration.

    Raises `Misfit` where its constructor says that it cannot fly it, and `ValueError` naming the source
    and what is amiss: it cannot be loaded, made or copied, or has no `reset` or `act`.
    """
    found = _load(source) if isinstance(source, str) else source
    name = label(source)
    build = partial(_build, name, found, config)
    first = build()
    if isinstance(first, Policy):
        return first
    for method in ("reset", "act"):
        if not callable(getattr(first, method, None)):
            raise ValueError(f"policy {name}: {type(first).__name__} has no method {method}")
    return Own(config, name, build, first)


def label(source: Source) -> str:
    """What a policy is called in the results: its text, or its own or its class's name."""
    if isinstance(source, str):
        return source
    name = getattr(source, "name", None)
    if isinstance(name, str) and name:
        return name
    name = getattr(source, "__name__", None)
    return name if isinstance(name, str) else type(source).__name__


@final
class Own(Policy):
    """Flies objects with `reset` and `act`: one for all worlds if it can, else one for each."""

    name = "own"

    def __init__(
        self, config: FormationConfig, name: str, build: Callable[[], Any], first: Any
    ) -> None:
        super().__init__(config)
        self._name, self._build = name, build
        self._objects = [first]
        self._together = _takes_worlds(first)
        self._seeds = np.zeros(0, dtype=np.uint64)
        self._episodes = np.zeros(0, dtype=np.int64)  # begun in each world since then

    def begin(self, seeds: NDArray[np.uint64]) -> None:
        self._seeds, self._episodes = seeds.copy(), np.zeros(len(seeds), dtype=np.int64)
        if self._together:
            self._objects[0].reset(int(seeds[0]), worlds=len(seeds))
            return
        while len(self._objects) < len(seeds):
            self._objects.append(self._build())
        for each, seed in zip(self._objects, seeds, strict=False):
            each.reset(int(seed))

    def begin_again(self, mask: NDArray[np.bool_]) -> None:
        if self._together:
            restart = getattr(self._objects[0], "restart", None)
            if restart is not None:
                restart(mask)
            return
        self._episodes[mask] += 1
        for world in np.flatnonzero(mask):
            # Another seed for each episode, or one that draws at random would repeat itself.
            entropy = (int(self._seeds[world]), int(self._episodes[world]))
            (seed,) = np.random.SeedSequence(entropy).generate_state(1, np.uint64)
            self._objects[world].reset(int(seed))

    def decide(self, rows: Rows) -> Rows:
        shape = (*rows.shape[:2], self.config.action_size)
        # Copies both ways: what a policy keeps or changes is its own.
        if self._together:
            return self._read(self._objects[0].act(rows.copy()), shape).copy()
        actions = np.empty(shape, dtype=np.float32)
        for world, row in enumerate(rows):
            actions[world] = self._read(self._objects[world].act(row.copy()), shape[1:])
        return actions

    def _read(self, actions: Any, shape: tuple[int, ...]) -> Rows:
        return read_action(actions, shape, f"what {self._name}.act returned")


def _takes_worlds(policy: Any) -> bool:
    try:
        parameters = inspect.signature(policy.reset).parameters
    except (TypeError, ValueError):  # of a compiled function
        return False
    return "worlds" in parameters


# -- making ---------------------------------------------------------------------------------------


def _build(name: str, found: Any, config: FormationConfig) -> Any:
    """One object. Raises `Misfit`, `ValueError`."""
    if not inspect.isclass(found) and hasattr(found, "act"):
        try:
            return copy.deepcopy(found)
        except Exception as problem:
            raise ValueError(
                f"policy {name}: cannot be copied ({_short(problem)}): give its class instead"
            ) from problem
    if not callable(found):
        raise ValueError(
            f"policy {name}: {shown(found)}: expected a class, a function that makes a policy, or an "
            "object with reset and act"
        )
    try:
        return found(config) if _takes_config(found) else found()
    except ValueError as problem:
        raise Misfit(f"policy {name}: {problem}") from problem
    except Exception as problem:
        raise ValueError(f"policy {name}: making it raised {_short(problem)}") from problem


def _takes_config(maker: Callable[..., Any]) -> bool:
    try:
        inspect.signature(maker).bind(None)
    except TypeError:
        return False
    except ValueError:  # no signature
        return True
    return True


# -- loading --------------------------------------------------------------------------------------


def _load(source: str) -> Any:
    """What `module:Name` or `file.py:Name` names. Raises `ValueError` naming it."""
    place, _, attribute = source.rpartition(":")
    try:
        module = _file(Path(place)) if place.endswith(".py") else _module(place)
    except OSError as problem:
        reason = problem.strerror or problem
        raise ValueError(f"policy {source}: {place} cannot be read: {reason}") from None
    except ModuleNotFoundError as problem:
        raise ValueError(f"policy {source}: there is no module {problem.name!r}") from problem
    except Exception as problem:
        raise ValueError(
            f"policy {source}: importing {place} raised {_short(problem)}{_where(problem)}"
        ) from problem
    if not hasattr(module, attribute):
        raise ValueError(f"policy {source}: {place} has no {attribute!r}")
    return getattr(module, attribute)


def _module(name: str) -> ModuleType:
    # As `python -m` has it; a console script has not.
    _find_in(Path.cwd())
    return importlib.import_module(name)


@lru_cache(maxsize=64)
def _file(path: Path) -> ModuleType:
    """The module of a file, which may import its neighbours."""
    path = path.resolve()
    require_regular(path)
    name = f"_policy_of_{path.stem}_{abs(hash(path)):x}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    _find_in(path.parent)
    sys.modules[name] = module  # dataclasses look there for it
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _find_in(folder: Path) -> None:
    """Let imports look into a folder, after all others: nothing there hides an installed package."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _short(problem: BaseException) -> str:
    text = " ".join(f"{type(problem).__name__}: {problem}".split())
    return text if len(text) <= 200 else f"{text[:197]}..."


def _where(problem: BaseException) -> str:
    """File and line of the user's own code that an exception came from."""
    trace = problem.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if isinstance(problem, SyntaxError) or trace is None:
        return ""
    return f" ({Path(trace.tb_frame.f_code.co_filename).name}, line {trace.tb_lineno})"
