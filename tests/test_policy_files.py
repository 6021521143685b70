"""Policies as files: what is written is what flies, whatever is amiss is refused, nothing is executed."""

from __future__ import annotations

import json
import os
import pickle
import struct
import warnings
from contextlib import suppress
from dataclasses import asdict, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors.numpy import save as serialise

from baselines import evaluate as command
from baselines import files, make_policy, registry
from baselines.files import Card, Network, load, save
from baselines.policies.base import Policy
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned, Misfit
from baselines.policies.transfer import TransferWarning
from baselines.policies.tuned import read
from baselines.reporting.board import BEGIN, END
from baselines.scoring.evaluation import evaluate, find_flyable
from baselines.scoring.results import Source
from baselines.scoring.runs import USUAL_TEACHER, find_runs, teacher_of
from formation_env import FeasibilityWarning, FormationConfig, configure
from formation_env.physics.vehicle import Vehicle
from formation_env.scenarios import PAPER_NOISE
from formation_env.trajectories import hover
from formation_env.validation.checks import LONGEST

NOMINAL = configure("nominal")
ENTRIES = NOMINAL.layout.size


def card(config: FormationConfig = NOMINAL, **changed: Any) -> Card:
    usual: dict[str, Any] = {
        "action": config.action,
        "entries": config.layout.size,
        "action_size": config.action_size,
        "scenario": "nominal",
        "method": "ppo",
        "command": "python -m train.ppo --seed 3",
        "seed": 3,
        "steps": 1_000_000,
        "minutes": 12.5,
        "package": "0.1.0",
        "score": {"nominal": [0.9, 0.88, 0.92]},
    }
    return Card(**{**usual, **changed})


def network(own: Card, hidden: tuple[int, ...] = (37, 51), seed: int = 0) -> Network:
    """Numbers drawn at random, so that outputs lie on both sides of the clipping."""
    rng = np.random.default_rng(seed)
    sizes = [own.history * own.entries, *hidden, own.action_size]

    def draw(*shape: int) -> NDArray[np.float32]:
        return np.asarray(rng.normal(size=shape) / np.sqrt(shape[-1]), dtype=np.float32)

    return Network(
        tuple(draw(b, a) for a, b in pairwise(sizes)),
        tuple(draw(b) for b in sizes[1:]),
        draw(own.entries),
        rng.uniform(0.3, 2.0, own.entries).astype(np.float32),
    )


def looks(*shape: int, seed: int = 1) -> NDArray[np.float32]:
    """Observations `(*shape, followers, entries)`."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(*shape, 2, ENTRIES)).astype(np.float32)


def tensors(own: Network) -> dict[str, NDArray[np.float32]]:
    named = {"mean": own.mean, "scale": own.scale}
    for i, (weight, bias) in enumerate(zip(own.weights, own.biases, strict=True)):
        named |= {f"layers.{i}.weight": weight, f"layers.{i}.bias": bias}
    return named


def written(
    path: Path, named: dict[str, Any] | None = None, text: str | None = None, key: str = "formation"
) -> Path:
    """A file made without `save`, from tensors and the text of a card."""
    named = tensors(network(card())) if named is None else named
    text = json.dumps(asdict(card())) if text is None else text
    path.write_bytes(serialise(named, {key: text}))
    return path


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
    ],
    ids=range(8),
)
def test_metadata_that_is_no_card(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path / "policy.safetensors", text=text)
    with pytest.raises(ValueError, match=r"policy\.safetensors") as refusal:
        load(path)
    assert message in str(refusal.value)


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


# -- a full disk ----------------------------------------------------------------------------------


@pytest.mark.parametrize("call", ["fsync", "replace", "fdopen"])
def test_a_full_disk_leaves_the_earlier_file(
    call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, own = tmp_path / "policy.safetensors", card()
    save(path, own, network(own))
    before = path.read_bytes()

    def full(handle: Any, *_: object) -> None:
        if call == "fdopen":
            os.close(handle)
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(files.os, call, full)
        with pytest.raises(OSError, match=r"No space left on device.*policy\.safetensors"):
            save(path, own, network(own, seed=1))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_disk_that_fills_while_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of it is written before the disk is full."""
    path, own = tmp_path / "policy.safetensors", card()
    save(path, own, network(own))
    before, real = path.read_bytes(), os.fdopen

    def fdopen(*arguments: Any, **options: Any) -> Any:
        file = real(*arguments, **options, buffering=0)

        class Full:
            def __enter__(self) -> Full:
                return self

            def __exit__(self, *_: object) -> None:
                file.close()

            def write(self, data: bytes) -> None:
                file.write(data[: len(data) // 2])
                raise OSError(28, "No space left on device")

        return Full()

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fdopen", fdopen)
        with pytest.raises(OSError, match="No space left on device"):
            save(path, own, network(own, seed=1))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_pipe_or_device_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "pipe.safetensors"
    os.mkfifo(path)
    for special in (path, Path("/dev/zero")):
        with pytest.raises(ValueError, match=r"cannot be read: a .*, not a regular file"):
            load(special)
    with pytest.raises(ValueError, match=r"pipe\.safetensors: cannot be read: a pipe"):
        make_policy(str(path), NOMINAL)


def test_a_written_file_has_the_mode_of_the_umask(tmp_path: Path) -> None:
    for mask in (0o027, 0o077):
        path, before = tmp_path / f"{mask}.safetensors", os.umask(mask)
        try:
            save(path, card(), network(card()))
        finally:
            os.umask(before)
        assert path.stat().st_mode & 0o777 == 0o666 & ~mask


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


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"cannot write the policy: No such file.*gone"):
        save(tmp_path / "gone" / "policy.safetensors", card(), network(card()))


# -- what flies -----------------------------------------------------------------------------------


def plainly(own: Card, numbers: Network, observation: NDArray[Any]) -> NDArray[Any]:
    """The network in double precision, one row `(history, entries)`."""
    scaled = (observation.astype(float) - numbers.mean.astype(float)) / numbers.scale.astype(float)
    x = np.clip(scaled, -own.clip, own.clip).ravel()
    last = len(numbers.weights) - 1
    for i, (weight, bias) in enumerate(zip(numbers.weights, numbers.biases, strict=True)):
        x = weight.astype(float) @ x + bias.astype(float)
        if i < last:
            x = np.tanh(x) if own.activation == "tanh" else np.maximum(x, 0.0)
    return np.clip(x, -1.0, 1.0)


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("hidden", [(), (37, 51), (128, 128)])
def test_forward_pass(activation: str, hidden: tuple[int, ...]) -> None:
    own = card(activation=activation, clip=1.5)
    numbers = network(own, hidden)
    rows = looks(50)
    actions = Learned(NOMINAL, (own, numbers)).act(rows)
    expected = [plainly(own, numbers, row) for row in rows.reshape(-1, ENTRIES)]
    assert actions.dtype == np.float32
    assert actions.reshape(-1, 4) == pytest.approx(np.array(expected), abs=3e-6)
    assert (np.abs(actions) < 1.0).any() and np.ptp(actions) > 1.0


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
@pytest.mark.parametrize("hidden", [(), (37, 51), (128, 128)])
@pytest.mark.parametrize("history", [1, 3])
def test_a_row_is_independent_of_the_others(hidden: tuple[int, ...], history: int) -> None:
    """Bit for bit, however many are decided together and wherever among them it stands."""
    solo = configure("nominal", followers=1, neighbours=NOMINAL.neighbours)
    own = card(history=history)
    source = own, network(own, hidden)
    rows = looks(2, 600).reshape(2, 1200, 1, ENTRIES)

    def flown(which: slice) -> NDArray[np.float32]:
        policy = Learned(solo, source)
        return np.stack([policy.act(each[which]) for each in rows])

    whole = flown(slice(0, 1200))
    for count in (1, 7, 31, 32, 33, 64, 65, 1000, 1025):
        for start in (0, 1, 5, 17, 70):
            part = slice(start, start + count)
            assert np.array_equal(flown(part), whole[:, part]), (count, start)
    assert len(np.unique(whole)) > 1200


def test_history_is_stacked_newest_last_and_begins_anew() -> None:
    own = card(history=3)
    numbers = network(own)
    policy = Learned(NOMINAL, (own, numbers))
    seen = looks(5, 4)  # ticks, worlds
    mask = np.array([False, True, False, True])
    actions = []
    for tick, rows in enumerate(seen):
        if tick == 3:
            policy.restart(mask)
        actions.append(policy.act(rows))
    for world in range(4):
        for tick in range(5):
            first = 3 if tick >= 3 and mask[world] else 0
            ticks = [max(first, t) for t in (tick - 2, tick - 1, tick)]
            for i in range(2):
                expected = plainly(own, numbers, seen[ticks, world, i])
                assert actions[tick][world, i] == pytest.approx(expected, abs=3e-6)
    policy.reset(worlds=4)
    assert np.array_equal(policy.act(seen[0]), actions[0])


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
@pytest.mark.parametrize("level", ["wrench", "rates", "reference"])
def test_residual_policies_add_to_the_expert(level: str) -> None:
    config = configure("paper", action=level)
    own = card(config, residual=0.2)
    numbers = network(own)
    nothing = numbers._replace(
        weights=tuple(np.zeros_like(W) for W in numbers.weights),
        biases=tuple(np.zeros_like(b) for b in numbers.biases),
    )
    alone, still = Expert(config), Learned(config, (own, nothing))
    learned, output = (
        Learned(config, (own, numbers)),
        Learned(config, (replace(own, residual=0), numbers)),
    )
    rng = np.random.default_rng(3)
    for tick in range(6):
        rows = rng.normal(size=(5, 2, config.layout.size)).astype(np.float32)
        if tick == 3:
            for policy in (alone, still, learned):
                policy.restart(np.array([True, False, False, True, False]))
        expert = alone.act(rows)
        assert np.array_equal(still.act(rows), expert)
        expected = np.clip(expert + 0.2 * output.act(rows).astype(float), -1.0, 1.0)
        assert learned.act(rows) == pytest.approx(expected, abs=1e-6)


def test_a_policy_that_does_not_fit(tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    save(path, card(), network(card()))
    with pytest.raises(Misfit, match=r"mine.*action level 'wrench'.*has 'rates'"):
        make_policy(str(path), configure("nominal", action="rates"))
    with pytest.raises(Misfit, match="entries 48: the configuration has 55"):
        make_policy(str(path), configure("nominal", neighbours=3))
    spoilt = network(card())._replace(mean=np.full(ENTRIES, np.nan, np.float32))
    with pytest.raises(ValueError, match="tensor mean"):
        Learned(NOMINAL, (card(), spoilt))


# -- another task than it was trained for ---------------------------------------------------------


@pytest.mark.parametrize(
    ("scenario", "given", "expected"),
    [
        ("nominal", {"followers": 3}, "flies another task: 3 followers"),
        ("nominal", {"followers": 1, "gust": 1.0}, "flies another task: 1 follower, gust"),
        ("nominal", {"followers": 64}, "64 followers"),
        ("agile", {}, "flies another task: scenario 'agile' with 2 followers"),
        ("swarm", {}, "scenario 'swarm' with 16 followers"),
        ("nominal", {"trajectory": hover((0.0, 0.0, -2.0))}, "another task: trajectory"),
        ("nominal", {"noise": PAPER_NOISE, "gust": 0.1}, "another task: noise, gust"),
        ("nominal", {"offsets": ((0.4, 0.4, 0.0), (0.4, -0.4, 0.0))}, "another task: offsets"),
        ("nominal", {"vehicle": Vehicle(mass=0.2)}, "another task: vehicle"),
    ],
)
def test_a_policy_on_a_task_it_was_not_trained_for(
    scenario: str, given: dict[str, Any], expected: str
) -> None:
    """The file of `nominal`, flown by two followers there, says in what another task differs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FeasibilityWarning)
        config = configure(scenario, neighbours=2, **given)
    with pytest.warns(TransferWarning) as told:
        make_policy(str(registry.SHIPPED / "dagger-nominal-wrench.safetensors"), config)
    (message,) = {str(one.message) for one in told}
    said = "(dagger) trained on scenario 'nominal' at action level 'wrench' with 2 followers"
    assert message.startswith("policy ") and said in message
    assert expected in message and len(message) <= LONGEST


def test_what_a_policy_does_not_feel_is_no_other_task() -> None:
    """Starts, lengths, rewards and limits of episodes; and a scenario of one's own is what its card says."""
    rewards = NOMINAL.reward._replace(failure=1.0)
    limits = NOMINAL.limits._replace(lost=5.0)
    make_policy("dagger", configure("nominal", duration=3.0, reward=rewards, limits=limits))
    make_policy("dagger", configure("nominal", start="ground", start_offset=0.1))
    mine = replace(configure("agile"), scenario="mine")
    Learned(mine, (card(mine, scenario="mine"), network(card(mine))))
    with pytest.warns(TransferWarning, match=r"trained on scenario 'mine' .* scenario 'agile'"):
        Learned(configure("agile"), (card(mine, scenario="mine"), network(card(mine))))


def test_python_shows_the_warning_once() -> None:
    config = configure("nominal", followers=3)
    with warnings.catch_warnings(record=True) as told:
        warnings.resetwarnings()
        for _ in range(5):
            make_policy("dagger", config)
    assert len(told) == 1


# -- restarting some worlds -----------------------------------------------------------------------


@pytest.mark.parametrize("level", ["wrench", "rates", "reference"])
@pytest.mark.parametrize("record", [False, True])
def test_the_expert_restarts_worlds_one_by_one(level: str, record: bool) -> None:
    """A restarted world is one that begins; the others do not notice. Some tiles hold both."""
    config = configure("swarm", action=level, followers=5)
    worlds, ticks, again = 9, 7, 3
    mask = np.arange(worlds) % 3 == 1
    rng = np.random.default_rng(5)
    shape = (ticks, worlds, 5, config.layout.size)
    seen = rng.normal(size=shape).astype(np.float32)
    mixed, going = (Expert(config, keep_record=record) for _ in range(2))
    begun = Expert(config)
    begun.reset(worlds=worlds)
    mixed.reset(worlds=worlds)
    for tick, rows in enumerate(seen):
        if tick == again:
            mixed.restart(mask)
        actions, others = mixed.act(rows), going.act(rows)
        expected = (
            np.where(mask[:, None, None], begun.act(rows), others) if tick >= again else others
        )
        assert np.array_equal(actions, expected)
    assert not np.array_equal(mixed.act(seen[0])[mask], going.act(seen[0])[mask])


@pytest.mark.parametrize(
    "mask", [np.ones(3, bool), np.ones((2, 1), bool), np.array([0, 1]), True, [[1, 2], [3]]]
)
def test_a_mask_that_is_none(mask: Any) -> None:
    policy = make_policy("expert", NOMINAL)
    policy.reset(worlds=2)
    with pytest.raises(ValueError, match=r"^mask .*expected (bool \(2,\)|a bool array)"):
        policy.restart(mask)


@pytest.mark.parametrize("name", ["ff", "hover", "random"])
def test_policies_without_memory_go_on(name: str) -> None:
    restarted, going = make_policy(name, NOMINAL), make_policy(name, NOMINAL)
    rows = looks(3)
    for policy in (restarted, going):
        policy.reset(seed=4, worlds=3)
        policy.act(rows)
    restarted.restart(np.array([True, False, True]))
    assert np.array_equal(restarted.act(rows), going.act(rows))


# -- scoring --------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
def test_a_file_is_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the command line, also where it has no place on a scenario; threads change nothing."""
    path = tmp_path / "my policy.safetensors"
    own = card(history=2, residual=0.05)
    save(path, own, network(own))
    arguments = ["--policies", f"expert,{path}", "--scenarios", "nominal,swarm,experiment"]
    arguments += ["--episodes", "6", "--duration", "0.5"]
    texts = []
    for threads in (1, 2, 3):
        out = tmp_path / str(threads)
        assert command.main([*arguments, "--output", str(out), "--threads", str(threads)]) == 0
        texts.append((out / "results.json").read_text(encoding="utf-8"))
    assert texts[0] == texts[1] == texts[2]
    document = json.loads(texts[0])["scenarios"]
    assert document["nominal"]["policies"][str(path)]["metrics"]["score"][0] is not None
    assert document["nominal"]["files"] == {
        str(path): {
            "file": "my policy.safetensors",
            "method": "ppo",
            "scenario": "nominal",
            "action": "wrench",
            "differs": False,
        }
    }
    assert document["swarm"]["files"][str(path)]["differs"]
    assert list(document["experiment"]["policies"]) == ["expert"]
    assert "has 'rates'" in document["experiment"]["absent"][str(path)]
    text = (tmp_path / "1" / "results.md").read_text(encoding="utf-8")
    grid = next(line for line in text.splitlines() if line.startswith(f"| `{path}`"))
    assert grid.endswith("| - |") and grid.count("-") >= 1
    where = "| `my policy.safetensors` | `ppo` | `nominal` | `wrench` | `nominal`, `swarm` |"
    assert f"| `{path}` {where}" in text
    assert f"Not flown on `experiment`: `{path}` (" in text
    assert "* trained for another task" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["broken", "misfit", "missing"])
def test_a_file_that_cannot_fly_is_one_error(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Status 2, one line that names it, before anything is flown or written."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.safetensors"
    if kind == "broken":
        path.write_bytes(b"broken")
    if kind == "misfit":
        config = configure("nominal", action="reference")
        save(path, card(config), network(card(config)))
    with pytest.raises(SystemExit) as stop:
        command.main(["--policies", str(path), "--scenarios", "nominal,experiment"])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert "mine.safetensors" in error and error.count("\n") == 1
    assert not (tmp_path / "results").exists()


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """`ppo` for `nominal` and for `paper`, and nothing else."""
    folder = tmp_path / "policies"
    folder.mkdir()
    for i, scenario in enumerate(("nominal", "paper")):
        own = card(scenario=scenario)
        save(folder / f"ppo-{scenario}-wrench.safetensors", own, network(own, seed=i))
    monkeypatch.setattr(registry, "SHIPPED", folder)
    return folder


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
def test_methods_fly_their_scenarios_file_or_that_of_nominal(shipped: Path) -> None:
    rows = looks(3)
    for scenario, used in (("nominal", "nominal"), ("paper", "paper"), ("agile", "nominal")):
        config = configure(scenario)
        made = registry.recipe("ppo", config)
        assert made.file == f"ppo-{used}-wrench.safetensors"
        file = make_policy(str(shipped / made.file), config)
        assert np.array_equal(make_policy("ppo", config).act(rows), file.act(rows))
    with pytest.raises(Misfit, match="'ppo': no file for action level 'rates' is shipped"):
        make_policy("ppo", configure("experiment"))
    with pytest.raises(Misfit, match="'bc': no file for action level 'wrench'"):
        make_policy("bc", NOMINAL)


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
@pytest.mark.usefixtures("shipped")
def test_shipped_methods_are_scored_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(f"{BEGIN}\n{END}\n", encoding="utf-8")
    arguments = ["--scenarios", "paper,agile,experiment", "--episodes", "2", "--duration", "0.1"]
    arguments += ["--output", str(tmp_path / "out"), "--leaderboard", str(tmp_path)]
    assert command.main(arguments) == 0
    board = (tmp_path / "LEADERBOARD.md").read_text(encoding="utf-8")
    assert "evaluate --policies" not in board.split("## How")[0]
    files = (tmp_path / "docs/board/files.md").read_text(encoding="utf-8")
    assert "| `ppo` | `ppo-nominal-wrench.safetensors` | `ppo` | `nominal` | `wrench` |" in files
    assert "| `ppo` | `ppo-paper-wrench.safetensors` | `ppo` | `paper` | `wrench` |" in files
    (row,) = (line for line in readme.read_text(encoding="utf-8").splitlines() if "ppo" in line)
    assert row.endswith(" - |")
    assert "`bc`" not in board + files
    capsys.readouterr()
    with pytest.raises(SystemExit):
        command.main([*arguments, "--policies", "bc"])
    assert "'bc': no file for action level" in capsys.readouterr().err


def test_a_run_that_ships_is_named_by_its_shipped_file(shipped: Path, tmp_path: Path) -> None:
    """Whichever of the runs it is, and whatever score was written into its card; else by its own file."""
    runs = []
    for seed in (0, 1):
        folder = tmp_path / f"run{seed}"
        folder.mkdir()
        own = replace(
            card(), seed=seed, command=f"formation-train-imitate --seed {seed} --teacher lqr"
        )
        save(folder / "best.safetensors", own, network(own, seed=seed))
        runs.append(folder)

    def source() -> Source:
        policies = find_runs(runs)
        report = evaluate({"nominal": configure("nominal", duration=0.1)}, policies, episodes=2)
        return report.scenarios["nominal"].sources["ppo"]

    assert source().file == "best.safetensors", "of other runs than that which ships"
    second, numbers = load(runs[1] / "best.safetensors")
    save(
        shipped / "ppo-nominal-wrench.safetensors",
        replace(second, score={"nominal": [0.5] * 3}),
        numbers,
    )
    found = source()
    assert found.file == "ppo-nominal-wrench.safetensors"
    hidden = tuple(len(bias) for bias in numbers.biases[:-1])
    assert (found.teacher, found.history, found.hidden) == ("lqr", second.history, hidden)
    assert hidden


@pytest.mark.parametrize(
    ("words", "teacher"),
    [
        ("formation-train-imitate --teacher lqr --rounds 3", "lqr"),
        ("formation-train-imitate --rounds 3 --teacher=ff", "ff"),
        ("formation-train-imitate --rounds 3", "expert"),
        ("formation-train-ppo --steps 3", ""),
        ("", ""),
    ],
)
def test_the_teacher_is_that_of_the_command(words: str, teacher: str) -> None:
    assert teacher_of(replace(card(), command=words)) == teacher


def test_the_teacher_of_a_command_without_one_is_the_options_default() -> None:
    pytest.importorskip("tyro")
    from train.command_line import SCRIPTS
    from train.imitate.options import Options

    defaults = {f.name: f.default for f in fields(Options)}
    assert defaults["teacher"] == USUAL_TEACHER
    assert teacher_of(replace(card(), command=SCRIPTS["train.imitate"])) == USUAL_TEACHER


@pytest.mark.usefixtures("shipped")
def test_reports_of_policies_that_fly_here_and_there() -> None:
    configs = {name: configure(name, duration=0.1) for name in ("experiment", "nominal")}
    flyable = find_flyable(configs, ["ppo", "hover"])
    assert list(flyable["experiment"].recipes) == ["hover"]
    assert list(flyable["experiment"].absent) == ["ppo"]
    report = evaluate(configs, ["ppo", "hover"], episodes=2)
    assert list(report.scenarios["experiment"].results) == ["hover"]
    assert list(report.scenarios["nominal"].results) == ["ppo", "hover"]
    score = f"{report.scenarios['nominal'].results['ppo'].score.value:.3f}"
    assert str(report).count(score) >= 2


def test_policy_is_the_interface() -> None:
    assert isinstance(Learned(NOMINAL, (card(), network(card()))), Policy)
