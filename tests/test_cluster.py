"""What commands that use Ray say where it is not installed. With it: `tests/clusters`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from baselines import evaluate as command
from baselines.scoring import cluster
from train import rllib


def test_missing_ray_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SystemExit) as stop:
        command.main(["--ray", "--output", str(tmp_path)])
    assert stop.value.code == 2
    assert rllib.main(["--output", str(tmp_path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert all('pip install "formation-env[ray]"' in line for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_address_needs_ray(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        command.main(["--address", "10.0.0.1:6379", "--output", str(tmp_path)])
    assert stop.value.code == 2
    assert "argument --address: only with --ray" in capsys.readouterr().err


@pytest.mark.parametrize("address", ["nowhere", "nowhere:", ":6379", "nowhere:x", "nowhere:99999"])
def test_addresses_that_cannot_be(address: str) -> None:
    with pytest.raises(cluster.Unreachable, match="expected HOST:PORT"):
        cluster._check(address)


def test_no_folder_is_taken_for_ray() -> None:
    """A folder `ray` beside the tests would be, where Ray is not installed."""
    here = Path(__file__).parent
    code = f"import sys; sys.path.insert(0, {str(here)!r}); import ray; print(ray.__file__)"
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=False
    )
    assert run.returncode != 0 or run.stdout.strip() != "None"
