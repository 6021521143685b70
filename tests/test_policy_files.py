"""Policies as files: what is written is what flies, whatever is amiss is refused, nothing is executed."""

from __future__ import annotations

import json
import os
import pickle
import struct
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from networks import ENTRIES, card, network, tensors, written
from safetensors.numpy import save as serialise

from baselines import files
from baselines.files import load, save
from baselines.policies.tuned import read
from formation_env.validation.checks import LONGEST

# -- there and back -------------------------------------------------------------------------------


@pytest.mark.parametrize("hidden", [(), (5,), (64, 64, 8)])
def test_round_trip(tmp_path: Path, hidden: tuple[int, ...]) -> None:
    path = tmp_path / "policy.safetensors"
    own = card(history=3, activation="relu", residual=0.25, clip=5, minutes=7)
    numbers = network(own, hidden)
    save(path, own, numbers)
    back, read = load(path)
    assert back == own
    for a, b in zip(tensors(numbers).values(), tensors(read).values(), strict=True):
        assert a.dtype == b.dtype == np.float32 and np.array_equal(a, b)
    assert list(tmp_path.iterdir()) == [path]
    first = path.read_bytes()
    save(path, own, numbers)
    assert path.read_bytes() == first


def test_tensors_that_lie_otherwise_in_memory(tmp_path: Path) -> None:
    """Transposed views, as exporters make them, are written as what they say."""
    own, path = card(), tmp_path / "policy.safetensors"
    numbers = network(own)
    turned = numbers._replace(weights=tuple(np.asfortranarray(W) for W in numbers.weights))
    save(path, own, turned)
    assert all(
        np.array_equal(a, b) for a, b in zip(load(path)[1].weights, numbers.weights, strict=True)
    )


# -- files that are refused -----------------------------------------------------------------------


class Trap:
    """Pickled, it leaves a file behind when it is loaded."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.mark),)


def test_nothing_in_a_file_is_executed(tmp_path: Path) -> None:
    mark, path = tmp_path / "executed", tmp_path / "policy.safetensors"
    trap = pickle.dumps(Trap(mark))
    for data in (trap, struct.pack("<Q", len(trap)) + trap):
        path.write_bytes(data)
        with pytest.raises(ValueError, match="not a whole safetensors file"):
            load(path)
    written(path, text=trap.decode("latin-1"))
    with pytest.raises(ValueError, match="not JSON"):
        load(path)
    written(path, text="__import__('os').mkdir('executed')")
    with pytest.raises(ValueError, match="not JSON"):
        load(path)
    assert not mark.exists()
    pickle.loads(trap)
    assert mark.exists(), "the trap would have worked"


def test_truncated_at_every_length(tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    save(path, card(), network(card(), (2,)))
    data = path.read_bytes()
    cut = tmp_path / "cut.safetensors"
    for length in range(len(data)):
        cut.write_bytes(data[:length])
        with pytest.raises(ValueError, match=r"cut\.safetensors: not a whole safetensors file"):
            load(cut)
    cut.write_bytes(data + b"\0")
    with pytest.raises(ValueError, match="not a whole safetensors file"):
        load(cut)


def test_any_flipped_byte_of_the_header_is_harmless(tmp_path: Path) -> None:
    """It is refused or read as something whole; no other exception."""
    path = tmp_path / "policy.safetensors"
    save(path, card(), network(card(), (2,)))
    data = bytearray(path.read_bytes())
    header = 8 + struct.unpack("<Q", data[:8])[0]
    for at in range(header):
        broken = bytearray(data)
        broken[at] ^= 0x11
        path.write_bytes(broken)
        with suppress(ValueError):
            files.check(*load(path))


def test_files_that_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "policy.safetensors"
    with pytest.raises(ValueError, match=r"policy\.safetensors: cannot be read: No such file"):
        load(path)
    with pytest.raises(ValueError, match="cannot be read"):
        load(tmp_path)
    for text in ("", "hello", "PK\x03\x04", '{"version": 1}' * 100):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match="not a whole safetensors file"):
            load(path)
    save(path, card(), network(card()))
    monkeypatch.setattr(files, "LARGEST", 1000)
    with pytest.raises(ValueError, match="more than 1000 bytes"):
        load(path)
    with pytest.raises(ValueError, match="expected at most 1000"):
        save(tmp_path / "other.safetensors", card(), network(card()))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("version", 2, "version = 2: expected 1"),
        ("layout", 7, "layout = 7: expected 1"),
        ("action", "thrust", "action = 'thrust': expected one of wrench, rates, reference"),
        ("action", ["wrench"], "action = "),
        ("action", "reference", "action_size = 4: expected 3 at reference"),
        ("activation", "gelu", "activation = 'gelu': expected one of tanh, relu"),
        ("entries", 0, "entries = 0"),
        ("entries", 47, "tensor mean"),
        ("entries", 48.0, "entries = 48.0: expected a whole number"),
        ("history", 0, "history = 0"),
        ("history", True, "history = True"),
        ("history", 2, "tensor layers.0.weight"),
        ("residual", -0.1, "residual = -0.1"),
        ("residual", "big", "residual = 'big': expected a number"),
        ("clip", 0, "clip = 0"),
        ("version", True, "version = True: expected 1"),
        ("layout", True, "layout = True: expected 1"),
        ("seed", -1, "seed = -1"),
        ("steps", None, "steps = None"),
        ("minutes", [], "minutes = "),
        ("scenario", "a|b", "scenario = 'a|b': expected a word"),
        ("method", "", "method = ''"),
        ("command", 5, "command = 5: expected a text"),
        ("command", "\ud800", "command = "),
        ("package", "x" * 20_000, "package = "),
        ("score", [1], "score = "),
        ("score", {"nominal": [1.0]}, "expected mean, low and high"),
        ("score", {"nominal": [1.0, 0.9, "x"]}, "'x': expected a number"),
    ],
)
def test_card_with_a_wrong_field(tmp_path: Path, field: str, value: Any, message: str) -> None:
    text = json.dumps({**asdict(card()), field: value})
    path = written(tmp_path / "policy.safetensors", text=text)
    with pytest.raises(ValueError, match=r"policy\.safetensors") as refusal:
        load(path)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 400


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not json", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[1, 2]", "expected a JSON object"),
        ("{}", "version = None: expected 1"),
        (json.dumps(asdict(card())).replace("12.5", "NaN"), "not JSON"),
        (json.dumps(asdict(card())).replace("12.5", "1e999"), "minutes = inf"),
        (json.dumps({**asdict(card()), "extra": 1}), "['extra'] missing or unknown"),
        (json.dumps({"version": 1, "layout": 1}), "missing or unknown"),
        (json.dumps({**asdict(card()), "margin": 1}), "margin = 1: expected true or false"),
    ],
    ids=range(9),
)
def test_metadata_that_is_no_card(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path / "policy.safetensors", text=text)
    with pytest.raises(ValueError, match=r"policy\.safetensors") as refusal:
        load(path)
    assert message in str(refusal.value)


def test_a_card_from_before_there_was_a_margin_is_read(tmp_path: Path) -> None:
    named = asdict(card(margin=True))
    assert load(written(tmp_path / "a.safetensors", text=json.dumps(named)))[0].margin
    del named["margin"]
    assert not load(written(tmp_path / "b.safetensors", text=json.dumps(named)))[0].margin


def test_file_without_a_card(tmp_path: Path) -> None:
    for key in ("other", "Formation"):
        path = written(tmp_path / "policy.safetensors", key=key)
        with pytest.raises(ValueError, match="expected a JSON object in the metadata"):
            load(path)
    path.write_bytes(serialise(tensors(network(card()))))
    with pytest.raises(ValueError, match="expected a JSON object in the metadata"):
        load(path)


def _numbers() -> dict[str, Any]:
    return {name: x.copy() for name, x in tensors(network(card())).items()}


def _without(name: str) -> dict[str, Any]:
    return {k: x for k, x in _numbers().items() if k != name}


def _with(name: str, x: Any) -> dict[str, Any]:
    return {**_numbers(), name: x}


def _spoilt(name: str, value: float) -> dict[str, Any]:
    named = _numbers()
    named[name].flat[-1] = value
    return named


@pytest.mark.parametrize(
    ("named", "message"),
    [
        (_spoilt("layers.1.weight", np.nan), "tensor layers.1.weight: NaN or infinity"),
        (_spoilt("layers.2.bias", np.inf), "tensor layers.2.bias: NaN or infinity"),
        (_spoilt("mean", -np.inf), "tensor mean: NaN"),
        (_spoilt("scale", 0.0), "tensor scale: expected numbers above 0"),
        (_spoilt("scale", -1.0), "tensor scale: expected numbers above 0"),
        (_spoilt("layers.1.weight", 3e38), "tensor layers.1.weight: so large"),
        (_without("mean"), "['mean'] missing or unknown"),
        (_without("layers.0.weight"), "missing or unknown"),
        (_without("layers.1.bias"), "['layers.1.bias'] missing or unknown"),
        (_with("log_std", np.zeros(4, np.float32)), "['log_std'] missing or unknown"),
        (_with("layers.7.weight", np.zeros((4, 4), np.float32)), "missing or unknown"),
        (_with("mean", np.zeros(ENTRIES + 1, np.float32)), "expected float32 (48,)"),
        (_with("scale", np.ones((ENTRIES, 1), np.float32)), "tensor scale: float32 (48, 1)"),
        (_with("layers.1.weight", np.zeros((51, 36), np.float32)), "expected float32 (51, 37)"),
        (_with("layers.2.bias", np.zeros(5, np.float32)), "expected float32 (4,)"),
        (_with("mean", np.zeros(ENTRIES)), "tensor 'mean': type F64, expected F32"),
        (_with("mean", np.zeros(ENTRIES, np.float16)), "type F16, expected F32"),
        (_with("layers.0.bias", np.zeros(0, np.float32)), "tensor layers.0"),
        ({"mean": _numbers()["mean"]}, "0 layers: expected 1 to 32"),
    ],
    ids=range(19),
)
def test_wrong_tensors(tmp_path: Path, named: dict[str, Any], message: str) -> None:
    path = written(tmp_path / "policy.safetensors", named)
    with pytest.raises(ValueError, match=r"policy\.safetensors") as refusal:
        load(path)
    assert message in str(refusal.value)


def test_save_refuses_what_load_would(tmp_path: Path) -> None:
    path, own = tmp_path / "policy.safetensors", card()
    good = network(own)
    spoilt = good._replace(mean=np.full(ENTRIES, np.nan, np.float32))
    double = good._replace(scale=np.ones(ENTRIES))
    with pytest.raises(ValueError, match="tensor mean: NaN"):
        save(path, own, spoilt)
    with pytest.raises(ValueError, match="tensor scale: float64"):
        save(path, own, double)
    with pytest.raises(ValueError, match=r"layers\.0\.weight"):
        save(path, replace(own, history=2), good)
    with pytest.raises(ValueError, match=r"ends in \.safetensors"):
        save(tmp_path / "policy.zip", own, good)
    bad: Any
    for bad in (None, 5, {}, asdict(own), "x" * 9999):
        with pytest.raises(ValueError, match=r"^card = .*: expected a Card$"):
            save(path, bad, good)
        with pytest.raises(ValueError, match=r"^network = .*: expected a Network$"):
            save(path, own, bad)
    for bad in (None, 5, True, b"x", [path]):
        for use in (load, read, lambda name: save(name, own, good)):
            with pytest.raises(ValueError, match=r"^path = .*: expected the name of a file$"):
                use(bad)
    for name in ("weights", "biases"):
        for bad in (None, 5, np.zeros(()), {}):
            with pytest.raises(ValueError, match=rf"^network\.{name} = .*: expected a tuple of"):
                save(path, own, good._replace(**{name: bad}))
    assert list(tmp_path.iterdir()) == []


def test_no_message_is_long(tmp_path: Path) -> None:
    deep = tmp_path / "/".join(["x" * 200] * 5) / "policy.safetensors"
    with pytest.raises(ValueError, match="cannot be read: No such file") as refusal:
        load(deep)
    assert len(str(refusal.value)) <= LONGEST
    for named in (
        {"mean": np.zeros((1,) * 64, np.float32)},
        {"y" * 5000: np.zeros(3, np.float32)},
        {**_numbers(), "mean": np.zeros((1,) * 60, np.float32)},
    ):
        with pytest.raises(ValueError, match=r"policy\.safetensors") as refusal:
            load(written(tmp_path / "policy.safetensors", named))
        assert len(str(refusal.value)) <= LONGEST
