"""A checkpoint that was damaged or made up: one line that names the file and what is amiss, no death."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # their own, at import
    for module in ("torch", "stable_baselines3", "tensorboard", "tyro"):
        pytest.importorskip(module)
    from train.ppo.start import prepare

from baselines.system.writing import claim, write_bytes
from train import checkpoint, ppo
from train.ppo.options import Options

ROOT = Path(__file__).resolve().parent.parent
Change = Callable[[dict[str, Any], dict[str, Any]], object]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of seconds, with an expert underneath, which remembers."""
    folder = tmp_path_factory.mktemp("run") / "whole"
    options = Options(
        output=folder, action="reference", steps=512, worlds=8, rollout=8, batch=64, epochs=2,
        hidden=(8,), evaluate_every=256, episodes=2, quiet=True, residual=0.2,
        scenario_duration=0.4,
    )  # fmt: skip
    prepare(options).train()
    return folder


def put(name: str, value: Any, *path: Any) -> Change:
    """Put a value in place of a fact, or of what the path leads to within it."""

    def change(facts: dict[str, Any], arrays: dict[str, Any]) -> None:
        *within, last = (name, *path)
        where: Any = facts
        for key in within:
            where = where[key]
        where[last] = value

    return change


def entry(name: str, value: float) -> Change:
    """Put a number at the beginning of an array."""

    def change(facts: dict[str, Any], arrays: dict[str, Any]) -> None:
        arrays[name] = arrays[name].copy()
        arrays[name].flat[0] = value

    return change


def became(name: str, how: Callable[[Any], Any]) -> Change:
    return lambda facts, arrays: arrays.update({name: how(arrays[name])})


BAD: dict[str, tuple[Change, str]] = {
    "no options": (put("options", None), "options = None"),
    "options that are a list": (put("options", [1]), "options = [1]"),
    "an option missing": (lambda f, a: f["options"].pop("gamma"), "options: saved by another"),
    "an option of another kind": (put("options", "x", "batch"), "options.batch = 'x'"),
    "an option that is a truth": (put("options", True, "epochs"), "options.epochs = True"),
    "an option out of range": (put("options", 2.0, "gamma"), "--gamma 2.0"),
    "an option unheard of": (put("options", "psychic", "critic"), "options.critic = 'psychic'"),
    "no scenario": (put("options", "nowhere", "scenario"), "--scenario nowhere"),
    "widths that are texts": (put("options", ["8"], "hidden"), "options.hidden[0] = '8'"),
    "more worlds than were saved": (put("options", 2**20, "worlds"), "options.worlds"),
    "wider than was saved": (put("options", [4096] * 8, "hidden"), "options.hidden"),
    "steps that are a text": (put("steps", "x"), "steps = 'x'"),
    "steps below zero": (put("steps", -1), "steps = -1"),
    "no steps": (lambda f, a: f.pop("steps"), "steps is missing"),
    "minutes without end": (put("minutes", float("inf")), "minutes = inf"),
    "rows that are none": (put("rows", 3), "rows = 3"),
    "a short row": (put("rows", [1, 2], 0), "rows[0] = [1, 2]"),
    "a score that is a text": (put("rows", "x", 0, 2), "rows[0].score = 'x'"),
    "a method that is a path": (put("method", "../ppo"), "method = '../ppo'"),
    "an actor's rate of NaN": (put("actor_rate", float("nan")), "actor_rate = nan"),
    "no generators": (put("random", None), "random = None"),
    "a position beyond the keys": (put("random", 10**6, "position"), "random.position = 1000000"),
    "keys of another number": (became("random/numpy", lambda x: x[:600]), "random/numpy is uint32"),
    "a torn generator": (became("random/torch", np.zeros_like), "random/torch"),
    "NaN in the weights": (entry("policy/log_std", np.nan), "policy/log_std[0] = nan"),
    "a scale of zero": (entry("policy/mlp_extractor.scale", 0.0), "tensor scale"),
    "weights of another width": (
        became("policy/action_net.weight", lambda x: x[:, 1:]),
        "policy/action_net.weight is float32",
    ),
    "weights of another kind": (
        became("policy/value_net.bias", lambda x: x.astype(np.float64)),
        "policy/value_net.bias is float64",
    ),
    "weights missing": (lambda f, a: a.pop("policy/log_std"), "policy/log_std is missing"),
    "one too many": (lambda f, a: a.update({"policy/x": np.zeros(1)}), "'policy/x'"),
    "squares below zero": (entry("optimiser/0.exp_avg_sq", -1.0), "optimiser/0.exp_avg_sq"),
    "no step yet": (entry("optimiser/0.step", 0.0), "optimiser/0.step"),
    "moments of nothing": (
        lambda f, a: a.update({"optimiser/99.step": np.ones(1, np.float32)}),
        "parameter of a moment = 99",
    ),
    "observations of infinity": (entry("last/obs", np.inf), "last/obs[0][0] = inf"),
    "worlds of NaN": (entry("environment/world.vehicles", np.nan), "environment/world.vehicles"),
    "a counter beyond its table": (
        became("environment/world.counters", lambda x: np.full_like(x, 10**6)),
        "counters",
    ),
    "a memory of another kind": (
        became("environment/expert.memory", lambda x: np.zeros(x.shape, np.int32)),
        "environment/expert.memory is int32",
    ),
    "no worlds": (
        lambda f, a: a.pop("environment/world.counters"),
        "environment/world.counters is missing",
    ),
}


def refused(path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The line that going on from a file ends with."""
    assert ppo.main(["--output", str(path.parent), "--resume", "--quiet"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and len(told) < 700, told
    assert str(path) in told and "Traceback" not in told
    return told


@pytest.mark.parametrize("case", BAD)
def test_what_is_amiss_is_named(
    case: str, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, named = BAD[case]
    facts, arrays = checkpoint.load(whole / checkpoint.NAME)
    change(facts, arrays)
    checkpoint.save(tmp_path / checkpoint.NAME, facts, arrays)
    assert named in refused(tmp_path / checkpoint.NAME, capsys)
    claim(tmp_path).release()  # which is free again


def test_brackets_a_thousand_deep(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = (whole / checkpoint.NAME).read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    for text in ("[" * 1000 + "]" * 1000, "{" * 10, "1" * 5000, '"\\ud800"', "[1, 2]", "null"):
        header["__metadata__"]["run"] = text
        new = json.dumps(header).encode()
        path = tmp_path / checkpoint.NAME
        write_bytes(path, len(new).to_bytes(8, "little") + new + data[8 + length :])
        assert "not a checkpoint of version" in refused(path, capsys)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_not_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / checkpoint.NAME)
    assert "a pipe" in refused(tmp_path / checkpoint.NAME, capsys)


def test_damage_at_random_never_kills(whole: Path) -> None:
    """Each is refused in one line, or flies on; in a process of its own, which has to live."""
    words = [sys.executable, "tests/checkpoint_fuzz.py", str(whole.parent), "0", "150"]
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        words, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths}
    )
    last = run.stderr.splitlines()[-1:]
    assert run.returncode == 0, f"died of {last}"
    assert run.stdout.splitlines() == ["150 damages, 0 bad"], run.stdout
