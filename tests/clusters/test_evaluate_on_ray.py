"""`baselines.evaluate --ray`: the numbers of a local run, and errors instead of waiting."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

ray = pytest.importorskip("ray")

from baselines import evaluate as command
from baselines import files
from baselines.registry import recipe
from baselines.scoring import cluster, rollout
from baselines.scoring.evaluation import Flight
from formation_env import configure

OPTIONS = ["--scenarios", "nominal,paper", "--episodes", "7", "--duration", "1"]


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    """A policy of a file, so that numbers have to travel."""
    config, rng = configure("nominal"), np.random.default_rng(0)
    entries, actions = config.layout.size, config.action_size
    card = files.Card("wrench", entries, actions, scenario="nominal", method="drawn")
    weight = rng.normal(0.0, 0.01, (actions, entries)).astype(np.float32)
    network = files.Network((weight,), (weight[:, 0],), weight[0], 1.0 + 0.0 * weight[0])
    files.save(tmp_path / "drawn.safetensors", card, network)
    return tmp_path / "drawn.safetensors"


@pytest.fixture(autouse=True)
def _small_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three worlds fly together, so that seven episodes are three flights."""
    monkeypatch.setattr(rollout.chunks, "__defaults__", (9,))


def test_results_are_those_of_a_local_run(
    cluster_address: str, policy: Path, tmp_path: Path
) -> None:
    options = [*OPTIONS, "--policies", f"expert,random,{policy}"]
    assert command.main([*options, "--output", str(tmp_path / "here")]) == 0
    there = ["--ray", "--address", cluster_address, "--output", str(tmp_path / "there")]
    assert command.main([*options, *there]) == 0
    assert not ray.is_initialized(), "the command should have left the cluster"
    for name in ("results.json", "results.md"):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()


def test_many_flights(cluster_address: str, tmp_path: Path) -> None:
    """More than there is room for at once; and again, from a process that had left the cluster."""
    options = ["--scenarios", "nominal", "--policies", "hover", "--episodes", "200", "--duration"]
    options += ["0.1", "--output", str(tmp_path), "--ray", "--address"]
    for _ in range(2):
        assert command.main([*options, cluster_address]) == 0


def test_flights_go_to_both_nodes_and_come_back_in_order(cluster_address: str) -> None:

    def node() -> str:
        time.sleep(0.5)
        name: str = ray.get_runtime_context().get_node_id()
        return name

    config = configure("nominal", duration=2.0)
    hover = recipe("hover", config)
    flights = [Flight(config, hover, range(i, i + 3)) for i in range(8)]
    told: list[int] = []
    with cluster.joined(cluster_address) as joined:
        parts = cluster.fly_all(joined, flights, told.append)
        nodes = {node["NodeID"] for node in joined.nodes() if node["Alive"]}
        where = joined.remote(num_cpus=1, scheduling_strategy="SPREAD")(node)
        assert set(joined.get([where.remote() for _ in range(8)])) == nodes
    assert len(nodes) == 2
    assert told == [config.max_steps * 3] * 8
    for flight, part in zip(flights, parts, strict=True):
        alone = rollout.fly(hover.make(config), flight.seeds)
        assert part["return"].tolist() == alone["return"].tolist()


def test_a_cluster_of_its_own_by_default(tmp_path: Path) -> None:
    """As a user types it. Interrupted or not, nothing of it stays behind."""
    words = [sys.executable, "-m", "baselines.evaluate", "--ray", "--policies", "hover"]
    run = subprocess.run(
        [*words, *OPTIONS, "--threads", "2", "--output", str(tmp_path / "ray")],
        capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert command.main([*OPTIONS, "--policies", "hover", "--output", str(tmp_path / "here")]) == 0
    results = [json.loads((tmp_path / x / "results.json").read_text()) for x in ("ray", "here")]
    assert results[0] == results[1]


def test_a_flight_that_fails_is_an_error(
    cluster_address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr("formation_env.__version__", "0.0.0")
    options = [*OPTIONS, "--ray", "--address", cluster_address, "--output", str(tmp_path / "out")]
    assert command.main(options) == 1
    error = capsys.readouterr().err
    assert "expected 0.0.0" in error and "nothing was written" in error
    assert list((tmp_path / "out").iterdir()) == []


@pytest.fixture
def stranger() -> Iterator[str]:
    """The address of something that listens and is not Ray."""
    with socket.create_server(("0.0.0.0", 0)) as server:
        yield f"127.0.0.1:{server.getsockname()[1]}"


def test_nobody_at_the_address(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    for address, message in (
        (f"127.0.0.1:{port}", "nobody answers there"),
        ("nowhere", "expected HOST:PORT"),
    ):
        begun = time.monotonic()
        with pytest.raises(SystemExit) as stop:
            command.main(["--ray", "--address", address, "--output", str(tmp_path)])
        assert stop.value.code == 2
        error = capsys.readouterr().err.splitlines()
        assert address in error[-1] and message in error[-1]
        assert time.monotonic() - begun < 60.0


def test_something_else_at_the_address(
    stranger: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Ray itself would try for two minutes and then end the process."""
    monkeypatch.setattr(cluster, "PATIENCE", 10.0)
    begun = time.monotonic()
    with pytest.raises(SystemExit) as stop:
        command.main(["--ray", "--address", stranger, "--output", str(tmp_path)])
    assert stop.value.code == 2
    assert "no Ray cluster answered within 10 s" in capsys.readouterr().err
    assert time.monotonic() - begun < 30.0
