"""`train.rllib`: on two nodes, its files, going on after an interruption."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

ray = pytest.importorskip("ray")
torch = pytest.importorskip("torch")

from baselines import files
from baselines.policies.learned import Learned
from baselines.scoring import cluster
from train import checkpoint, rllib
from train.checkpoint_contents import group
from train.rllib.module import FollowerModule
from train.rllib.options import Options
from train.rllib.rows import FollowerRows
from train.rllib.run import Run, model_config, prepare

SMALL = ["--worlds", "4", "--rollout", "16", "--batch", "64", "--epochs", "1", "--episodes", "2",
         "--hidden", "16", "8", "--quiet"]  # fmt: skip


@pytest.fixture(scope="module")
def trained(cluster_address: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with a runner on each node and a critic that sees the state."""
    output = tmp_path_factory.mktemp("run")
    words = [*SMALL, "--output", str(output), "--steps", "600", "--critic", "central"]
    assert rllib.main([*words, "--runners", "2", "--address", cluster_address]) == 0
    assert not ray.is_initialized()
    return output


def test_files_of_a_run(trained: Path) -> None:
    names = {path.name for path in trained.iterdir()}
    assert names == {
        "best.safetensors",
        "last.safetensors",
        "log.csv",
        "checkpoint.safetensors",
    }
    rows = (trained / "log.csv").read_text().splitlines()
    assert len(rows) == 3, "a heading, the beginning and the end"
    card, _ = files.load(trained / "last.safetensors")
    assert card.steps >= 600
    assert card.command == (
        "formation-train-rllib --hidden 16 8 --episodes 2 --steps 600 --critic central --worlds 4 "
        "--rollout 16 --batch 64 --epochs 1 --runners 2"
    )


def test_numpy_flies_what_torch_learned(trained: Path) -> None:
    facts, arrays = checkpoint.load(trained / "checkpoint.safetensors")
    options = Options(**{**facts["options"], "hidden": (16, 8), "output": trained})
    config = options.config()
    rows = FollowerRows(config, 8, central=True)
    module = FollowerModule(
        observation_space=rows.single_observation_space,
        action_space=rows.single_action_space,
        model_config=model_config(options),
    )
    weights = {k: torch.tensor(v) for k, v in group(arrays, "module").items()}
    module.load_state_dict(weights)
    policy = Learned(config, trained / "last.safetensors")
    seen, _ = rows.reset(seed=3)
    largest = 0.0
    for _ in range(50):
        batch = {"obs": {name: torch.from_numpy(x) for name, x in seen.items()}}
        mean = module.forward_inference(batch)["action_dist_inputs"][
            :, : config.action_size
        ].numpy()
        assert module.compute_values(batch).shape == (8,)
        actions = policy.act(seen["obs"].reshape(4, 2, -1)).reshape(8, -1)
        np.testing.assert_allclose(actions, np.clip(mean, -1.0, 1.0), rtol=0.0, atol=1e-5)
        largest = max(largest, float(np.abs(actions).max()))
        seen, *_ = rows.step(actions)
    assert largest > 1e-4, "an actor that does nothing shows nothing"


def test_training_moves_the_actor(trained: Path) -> None:
    _, first = files.load(trained / "best.safetensors")
    card, last = files.load(trained / "last.safetensors")
    if files.load(trained / "best.safetensors")[0].steps == card.steps:
        pytest.skip("the last one is the best one")
    assert np.abs(first.weights[0] - last.weights[0]).max() > 1e-4


def test_a_run_goes_on(trained: Path) -> None:
    """With the numbers it was left with, the optimiser's too, and in new worlds."""
    saved_facts, saved_arrays = checkpoint.load(trained / "checkpoint.safetensors")
    given = Options(output=trained, resume=True, steps=900, quiet=True)
    options, saved, folder = prepare(given)
    folder.release()
    assert options.critic == "central" and options.runners == 0 and options.hidden == (16, 8)
    with cluster.joined(None, 1):
        run = Run(options, saved)
        weights = run.weights()
        for name, array in group(saved_arrays, "module").items():
            assert np.array_equal(weights[name], array), name
        flying = run._algorithm.env_runner_group.local_env_runner.module.state_dict()
        assert all(np.array_equal(flying[k].numpy(), weights[k]) for k in flying)
        assert run.steps == saved_facts["steps"]
        run._save()
        _, again = checkpoint.load(trained / "checkpoint.safetensors")
        assert again.keys() == saved_arrays.keys()
        assert any(name.startswith("optimiser/") for name in again)
        assert all(np.array_equal(again[name], saved_arrays[name]) for name in again)
        run.train()
        run.close()
    assert run.steps >= 900
    rows = (trained / "log.csv").read_text().splitlines()
    assert len(rows) == 4
    facts, arrays = checkpoint.load(trained / "checkpoint.safetensors")
    assert facts["steps"] == run.steps and json.dumps(facts["rows"])
    assert not np.array_equal(
        arrays["module/actor.0.weight"], saved_arrays["module/actor.0.weight"]
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--resume"], "checkpoint.safetensors: not a checkpoint that can be read"),
        (["--address", "127.0.0.1:9"], "--address 127.0.0.1:9: nobody answers there"),
    ],
)
def test_what_cannot_be_run(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rllib.main([*arguments, "--output", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scenario", "windy"], "--scenario windy: expected one of nominal"),
        (["--worlds", "0"], "--worlds 0: expected a whole number from 1"),
        (["--gamma", "1"], "--gamma 1.0: expected a number from 0 to"),
        (["--critic", "both"], "invalid choice 'both'"),
    ],
)
def test_wrong_option(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        rllib.main([*arguments, "--output", str(tmp_path)])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_other_options_on_going_on(trained: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in (
        (["--resume", "--gamma", "0.5"], "--gamma 0.5: the run was started with 0.98"),
        ([], "exists: go on with --resume"),
    ):
        assert rllib.main(["--output", str(trained), *words]) == 2
        assert message in capsys.readouterr().err


def test_a_full_disk_leaves_the_earlier_files(
    trained: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    before = {path.name: path.read_bytes() for path in trained.iterdir()}
    monkeypatch.setattr("train.rllib.run.checkpoint.save", full)
    monkeypatch.setattr("train.rllib.run.files.save", full)
    assert rllib.main(["--output", str(trained), "--resume", "--steps", "1", "--quiet"]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.endswith("No space left on device; earlier files are intact")
    assert before == {path.name: path.read_bytes() for path in trained.iterdir()}


def test_a_checkpoint_of_another_network(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    facts, arrays = checkpoint.load(trained / "checkpoint.safetensors")
    arrays["module/mean"] = arrays["module/mean"][1:]
    checkpoint.save(tmp_path / "checkpoint.safetensors", facts, arrays)
    assert rllib.main(["--output", str(tmp_path), "--resume", "--quiet"]) == 2
    assert "module/mean is float32" in capsys.readouterr().err


def test_more_runners_than_cores(
    cluster_address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """RLlib would wait for the third core forever."""
    words = ["--output", str(tmp_path), "--runners", "3", "--address", cluster_address]
    assert rllib.main(words) == 2
    assert "--runners 3: the cluster has 2 cores" in capsys.readouterr().err
