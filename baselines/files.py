"""Policies as files: a network's numbers, and a card that says what they are for.

A file is a safetensors file. Its tensors, float32:

    layers.{i}.weight (out, in), layers.{i}.bias (out,)    the layers in order, from 0
    mean (entries,), scale (entries,)                      the network sees (observation - mean) / scale

Its metadata has one key, `formation`: the JSON object of a `Card`. Reading one runs nothing that it
holds: numbers are taken as numbers and the card as text, and whatever is amiss is a `ValueError`.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from baselines.system.reading import file_name, read_bytes
from baselines.system.writing import write_bytes
from formation_env.laws import levels
from formation_env.laws.levels import NAMES as LEVEL_NAMES
from formation_env.task import Layout
from formation_env.validation.checks import require, shortened, shown

VERSION = 1  # of the format
SUFFIX = ".safetensors"
LARGEST = 64 * 2**20  # bytes
ACTIVATIONS = ("tanh", "relu")
_KEY = "formation"
_DEEPEST = 32  # layers
_LONGEST_PATH = 200  # characters of it in a message
# Sums in the network stay below this whatever it sees: far from where float32 ends, 3.4e38.
_MOST = 1e30

Singles = NDArray[np.float32]


class Network(NamedTuple):
    """The numbers, float32."""

    weights: tuple[Singles, ...]  # (out, in) each
    biases: tuple[Singles, ...]  # (out,)
    mean: Singles  # (entries,), units of the observation
    scale: Singles  # (entries,), above 0


# -- the card -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Card:
    """What a network is for, how it is to be run and where it comes from.

    It sees the last `history` observations, newest last (at an episode's start the first one repeated),
    each as `clip((observation - mean) / scale, -clip, clip)`. Its output is linear, and clipped to
    [-1, 1] it is the action; with `residual > 0` the action is `clip(expert's action + residual *
    clip(output, -1, 1), -1, 1)`. Raises `ValueError` naming the field.
    """

    action: str  # level
    entries: int  # of one observation
    action_size: int
    scenario: str  # trained on
    method: str  # "ppo", "bc", ...
    activation: str = "tanh"  # of the hidden layers
    history: int = 1
    residual: float = 0.0  # 0: no expert underneath
    clip: float = 10.0
    margin: bool = (
        False  # trained with later and noisier measurements than the scenario's exact ones
    )
    command: str = ""  # that trained it
    seed: int = 0
    steps: int = 0  # agent steps or samples learned from
    minutes: float = 0.0  # of training
    package: str = ""  # version that it was trained with
    score: Mapping[str, list[float]] = field(default_factory=dict)  # scenario: mean, low, high
    layout: int = Layout.version  # of observations
    version: int = VERSION

    def __post_init__(self) -> None:
        same = type(self.version) is int and self.version == VERSION
        _require(same, "version", self.version, str(VERSION))
        fits = type(self.layout) is int and self.layout == Layout.version
        _require(fits, "layout", self.layout, f"{Layout.version}, of this package")
        for name, known in (("action", LEVEL_NAMES), ("activation", ACTIVATIONS)):
            value = getattr(self, name)
            good = isinstance(value, str) and value in known
            _require(good, name, value, f"one of {', '.join(known)}")
        for name in ("scenario", "method"):
            _check_word(name, getattr(self, name))
        for name in ("command", "package"):
            _check_text(name, getattr(self, name))
        for name, (least, most) in _WHOLE.items():
            _check_whole(name, getattr(self, name), least, most)
        _require(isinstance(self.margin, bool), "margin", self.margin, "true or false")
        for name, (low, high) in _REAL.items():
            object.__setattr__(self, name, _real(name, getattr(self, name), low, high))
        object.__setattr__(self, "score", _scores(self.score))
        size = levels.LEVELS[levels.numbered(self.action)].size
        _require(
            self.action_size == size, "action_size", self.action_size, f"{size} at {self.action}"
        )


# Least and largest.
_WHOLE = {
    "entries": (1, 10_000),
    "action_size": (1, 4),
    "history": (1, 1_000),
    "seed": (0, 2**64 - 1),
    "steps": (0, 2**63 - 1),
}
_REAL = {"residual": (0.0, 2.0), "clip": (1e-3, 1e6), "minutes": (0.0, 1e9)}


def _require(good: bool, name: str, value: object, expected: str) -> None:
    if not good:
        raise ValueError(f"card: {name} = {_shown(value)}: expected {expected}")


def _shown(value: object) -> str:
    text = shown(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _check_word(name: str, value: object) -> None:
    """A name that may stand in a table or in a file's name."""
    good = isinstance(value, str) and re.fullmatch(r"[A-Za-z0-9][\w.+-]{0,63}", value, re.ASCII)
    _require(bool(good), name, value, "a word of letters, digits and . _ + -")


def _check_text(name: str, value: object) -> None:
    good = isinstance(value, str) and len(value) <= 10_000
    _require(good, name, value, "a text of at most 10000 characters")
    try:
        str(value).encode()
    except UnicodeEncodeError:
        _require(False, name, value, "a text")


def _check_whole(name: str, value: object, low: int, high: int) -> None:
    good = isinstance(value, int) and not isinstance(value, bool) and low <= value <= high
    _require(good, name, value, f"a whole number from {low} to {high}")


def _real(name: str, value: object, low: float, high: float) -> float:
    good = isinstance(value, (int, float)) and not isinstance(value, bool) and low <= value <= high
    _require(good, name, value, f"a number from {low:g} to {high:g}")
    return float(value)  # type: ignore[arg-type]


def _scores(value: object) -> dict[str, list[float]]:
    """A copy, checked."""
    _require(isinstance(value, Mapping), "score", value, "scores by scenario")
    scores: dict[str, list[float]] = {}
    for name, each in value.items():  # type: ignore[attr-defined]
        _check_word("score", name)
        three = isinstance(each, (list, tuple)) and len(each) == 3
        _require(three, f"score[{name!r}]", each, "mean, low and high")
        scores[name] = [_real(f"score[{name!r}]", x, -1e9, 1e9) for x in each]
    return scores


def _read_card(text: object) -> Card:
    """The card from its JSON. Raises `ValueError`."""
    try:
        named = json.loads(text, parse_constant=_refuse) if isinstance(text, str) else None
    except (ValueError, RecursionError) as problem:
        raise ValueError(f"card: not JSON ({type(problem).__name__})") from None
    if not isinstance(named, dict):
        raise ValueError(f"card: expected a JSON object in the metadata under {_KEY!r}")
    # First, because the fields of another version may be others.
    _require(named.get("version") == VERSION, "version", named.get("version"), str(VERSION))
    known = {f.name for f in fields(Card)}
    named.setdefault("margin", False)  # of files that were written before there was one
    odd = sorted(map(str, known ^ set(named)))
    if odd:
        raise ValueError(f"card: fields {_shown(odd)} missing or unknown")
    return Card(**named)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(constant)


# -- the numbers ----------------------------------------------------------------------------------


def _shapes(card: Card, widths: list[int]) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the tensors, from the widths of the layers."""
    inputs = [card.history * card.entries, *widths[:-1]]
    shapes: dict[str, tuple[int, ...]] = {"mean": (card.entries,), "scale": (card.entries,)}
    for i, (before, after) in enumerate(zip(inputs, widths, strict=True)):
        shapes[f"layers.{i}.weight"], shapes[f"layers.{i}.bias"] = (after, before), (after,)
    return shapes


def _check_tensors(card: Card, tensors: Mapping[str, Singles]) -> Network:
    """The network from its tensors by name. Raises `ValueError` naming a tensor."""
    depth = sum(name.endswith(".weight") for name in tensors)
    if not 1 <= depth <= _DEEPEST:
        raise ValueError(f"{depth} layers: expected 1 to {_DEEPEST}")
    widths = [tensors.get(f"layers.{i}.bias", np.zeros(0)).size for i in range(depth)]
    shapes = _shapes(card, [*widths[:-1], card.action_size])
    odd = sorted(shapes.keys() ^ tensors.keys())
    if odd:
        raise ValueError(f"tensors {_shown(odd)} missing or unknown")
    for name, shape in shapes.items():
        x = tensors[name]
        if x.dtype != np.float32 or x.shape != shape or x.size == 0:
            raise ValueError(f"tensor {name}: {x.dtype} {x.shape}, expected float32 {shape}")
        if not np.isfinite(x).all():
            raise ValueError(f"tensor {name}: NaN or infinity, expected finite numbers")
    if not (tensors["scale"] > 0.0).all():
        raise ValueError("tensor scale: expected numbers above 0")
    weights = tuple(tensors[f"layers.{i}.weight"] for i in range(depth))
    biases = tuple(tensors[f"layers.{i}.bias"] for i in range(depth))
    _check_size(card, weights, biases)
    return Network(weights, biases, tensors["mean"], tensors["scale"])


def _check_size(card: Card, weights: tuple[Singles, ...], biases: tuple[Singles, ...]) -> None:
    """Make sure that no sum overflows, whatever the network sees: that would end in a NaN."""
    bound = card.clip
    for i, (W, b) in enumerate(zip(weights, biases, strict=True)):
        rows = np.abs(W.astype(np.float64)).sum(axis=1)
        bound = float((rows * bound + np.abs(b.astype(np.float64))).max())
        if bound > _MOST:
            raise ValueError(f"tensor layers.{i}.weight: so large that float32 may overflow")
        if card.activation == "tanh":
            bound = min(bound, 1.0)


def _named(network: Network) -> dict[str, Singles]:
    tensors = {"mean": network.mean, "scale": network.scale}
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        tensors[f"layers.{i}.weight"], tensors[f"layers.{i}.bias"] = weight, bias
    return {name: np.asarray(x) for name, x in tensors.items()}


# -- files ----------------------------------------------------------------------------------------


def check(card: Card, network: Network) -> None:
    """Raises `ValueError` naming a tensor that is wrong for the card, or not finite."""
    _check_tensors(card, _named(network))


def save(path: str | os.PathLike[str], card: Card, network: Network) -> None:
    """Write a policy whole or not at all: whoever is interrupted leaves the earlier file.

    Raises `ValueError` for a card or network that `load` would refuse, and `OSError` naming the file
    where it cannot be written.
    """
    from safetensors.numpy import save as serialise

    path = Path(file_name(path))
    require(isinstance(card, Card), "card", card, "a Card")
    require(isinstance(network, Network), "network", network, "a Network")
    for name in ("weights", "biases"):
        layers = getattr(network, name)
        listed = isinstance(layers, (tuple, list))
        require(listed, f"network.{name}", layers, "a tuple of arrays, one for each layer")
    try:
        if path.suffix != SUFFIX:
            raise ValueError(f"expected a name that ends in {SUFFIX}")
        tensors = {name: np.ascontiguousarray(x) for name, x in _named(network).items()}
        _check_tensors(card, tensors)
        data = serialise(tensors, {_KEY: json.dumps(asdict(card), allow_nan=False)})
        if len(data) > LARGEST:
            raise ValueError(f"{len(data)} bytes: expected at most {LARGEST}")
    except ValueError as problem:
        raise ValueError(located(path, problem)) from None
    try:
        write_bytes(path, data)
    except OSError as problem:
        reason = problem.strerror or problem
        raise OSError(problem.errno, f"cannot write the policy: {reason}", str(path)) from problem


def load(path: str | os.PathLike[str]) -> tuple[Card, Network]:
    """A policy's card and numbers.

    Raises `ValueError` naming the file, what was found and what was expected: no such file, not a file
    of this format, cut short, of another version or observation layout, or with wrong numbers.
    """
    path = file_name(path)
    try:
        metadata, tensors = _parse(_read(path))
        card = _read_card(metadata.get(_KEY))
        return card, _check_tensors(card, tensors)
    except ValueError as problem:
        raise ValueError(located(path, problem)) from None


def located(path: str | os.PathLike[str], problem: object) -> str:
    """What is amiss with a file, in a message that is `shortened`; of a long path its end."""
    text = os.fspath(path)
    place = text if len(text) <= _LONGEST_PATH else f"... {text[-_LONGEST_PATH:]}"
    return shortened(f"{place}: {problem}")


def _read(path: str | os.PathLike[str]) -> bytes:
    try:
        return read_bytes(path, LARGEST)
    except OSError as problem:
        raise ValueError(f"cannot be read: {problem.strerror or problem}") from None


def _parse(data: bytes) -> tuple[dict[str, Any], dict[str, Singles]]:
    """Metadata and tensors. The library checks that lengths, types and shapes agree."""
    from safetensors import SafetensorError, deserialize

    try:
        parts = deserialize(data)  # type: ignore[no-untyped-call]
    except SafetensorError as problem:
        raise ValueError(f"not a whole safetensors file ({problem})") from None
    tensors = {}
    for name, part in parts:
        if part["dtype"] != "F32":
            raise ValueError(f"tensor {_shown(name)}: type {part['dtype']}, expected F32")
        numbers = np.frombuffer(part["data"], dtype="<f4").astype(np.float32)
        tensors[name] = numbers.reshape(part["shape"])
    # The library does not hand out the metadata of bytes; the header is JSON after its own length.
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    return header.get("__metadata__") or {}, tensors
