"""Policy files and the disk: one that is full, pipes, modes, folders that are not there."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from networks import NOMINAL, card, network

from baselines import files, make_policy
from baselines.files import load, save


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


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"cannot write the policy: No such file.*gone"):
        save(tmp_path / "gone" / "policy.safetensors", card(), network(card()))
