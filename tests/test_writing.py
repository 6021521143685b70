"""Output folders and the files that are read: locks, killed runs, permissions, pipes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from baselines.system import reading
from baselines.system.writing import LOCK, FolderTaken, claim, write_bytes, write_text

posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and modes of Unix")

HOLD = """
import sys, time
from pathlib import Path
from baselines.system.writing import claim
held = claim(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(60)
"""
# Is killed when the file is written and not yet renamed.
HALF = """
import os, signal, sys
from pathlib import Path
from baselines.system import writing
writing.os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
writing.write_bytes(Path(sys.argv[1]) / "results.json", b"new")
"""


def start(code: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, str(folder)], stdout=subprocess.PIPE, text=True
    )


@posix
def test_a_folder_has_one_run_and_a_dead_one_does_not_count(tmp_path: Path) -> None:
    """The refusal names folder and process; after a kill -9 the folder is taken over."""
    with start(HOLD, tmp_path) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(FolderTaken) as refusal:
            claim(tmp_path)
        assert f"process {other.pid} on " in str(refusal.value.strerror)
        assert refusal.value.filename == str(tmp_path)
        assert len(str(refusal.value)) < 500
        os.kill(other.pid, signal.SIGKILL)
        other.wait(10)
    assert (tmp_path / LOCK).exists()
    with claim(tmp_path):
        assert f"process {os.getpid()} on " in (tmp_path / LOCK).read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == []


def test_two_runs_of_one_process_do_not_share_a_folder(tmp_path: Path) -> None:
    first = claim(tmp_path / "new" / "folder")
    with pytest.raises(FolderTaken, match=f"process {os.getpid()} "):
        claim(tmp_path / "new" / "folder")
    first.release()
    first.release()
    with claim(tmp_path / "new" / "folder"):
        pass


def test_runs_with_files_of_their_own_share_a_folder(tmp_path: Path) -> None:
    """A file has one run at a time, which the refusal names with the file."""
    with claim(tmp_path, "a.json"), claim(tmp_path, "b.json"), claim(tmp_path):
        with pytest.raises(FolderTaken, match=f"process {os.getpid()} ") as refusal:
            claim(tmp_path, "a.json")
        assert refusal.value.filename == str(tmp_path / "a.json")
    claim(tmp_path, "a.json").release()
    assert list(tmp_path.iterdir()) == []


def test_another_run_is_waited_for_as_long_as_is_said(tmp_path: Path) -> None:
    first = claim(tmp_path)
    with pytest.raises(FolderTaken):
        claim(tmp_path, wait=0.1)
    timer = threading.Timer(0.2, first.release)
    timer.start()
    with claim(tmp_path, wait=30.0):
        timer.join()


def test_claims_of_many_turns_exclude_each_other(tmp_path: Path) -> None:
    """Many processes that claim and release in a hurry: never two at a time, also while the lock file
    is being removed and made anew."""
    code = """
import sys
from pathlib import Path
from baselines.system.writing import FolderTaken, claim
folder, turns = Path(sys.argv[1]), 0
while turns < 60:
    try:
        held = claim(folder)
    except FolderTaken:
        continue
    (folder / "inside").mkdir()
    (folder / "inside").rmdir()
    held.release()
    turns += 1
"""
    runs = [start(code, tmp_path) for _ in range(3)]
    assert [run.wait(60) for run in runs] == [0, 0, 0]
    for run in runs:
        assert run.stdout is not None
        run.stdout.close()
    assert list(tmp_path.iterdir()) == []


@posix
def test_what_killed_runs_were_writing_is_removed_and_nothing_else(tmp_path: Path) -> None:
    mine = [".writable", ".results.json.part", ".results.json.0123456789abcdef", "results.json"]
    for name in mine:
        (tmp_path / name).write_text(name, encoding="utf-8")
    with start(HALF, tmp_path) as killed:
        killed.wait(20)
    assert killed.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == len(mine) + 1
    with claim(tmp_path):
        pass
    assert {p.name: p.read_text(encoding="utf-8") for p in tmp_path.iterdir()} == {
        name: name for name in mine
    }


@posix
def test_a_file_that_is_being_written_is_not_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By somebody who has not claimed the folder: a policy saved beside a run."""
    replace = os.replace

    def claim_first(part: Path, path: Path) -> None:
        with claim(tmp_path):
            replace(part, path)

    monkeypatch.setattr(os, "replace", claim_first)
    write_text(tmp_path / "policy", "numbers")
    assert [p.name for p in tmp_path.iterdir()] == ["policy"]


@posix
@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_files_have_the_mode_that_the_user_asks_for(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        write_bytes(tmp_path / "file", b"")
    finally:
        os.umask(before)
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o666 & ~mask


def test_a_strangers_file_of_the_locks_name_is_kept(tmp_path: Path) -> None:
    (tmp_path / LOCK).write_text("my notes", encoding="utf-8")
    with pytest.raises(OSError, match="has not written"):
        claim(tmp_path)
    assert (tmp_path / LOCK).read_text(encoding="utf-8") == "my notes"


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    with pytest.raises(OSError):  # noqa: PT011 (its kind differs between systems)
        claim(tmp_path / "file")


# -- reading --------------------------------------------------------------------------------------


@posix
def test_a_pipe_does_not_block(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for read in (reading.read_bytes, reading.require_regular):
        with pytest.raises(OSError, match="a pipe, not a regular file"):
            read(pipe)
    with pytest.raises(ValueError, match=r"pipe: cannot be read: a pipe, not a regular file"):
        reading.read_json(pipe)
    with pytest.raises(OSError, match="a device, not a regular file"):
        reading.read_bytes("/dev/zero")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"{", "not JSON"),
        (b'{"a": NaN}', "NaN is not a number"),
        (b"[" * 100_000, "nested too deep"),
        (b"\xff", "not text in UTF-8"),
    ],
)
def test_what_is_no_json_is_named(tmp_path: Path, text: bytes, message: str) -> None:
    path = tmp_path / "config.json"
    path.write_bytes(text)
    with pytest.raises(ValueError, match=message) as refusal:
        reading.read_json(path)
    assert str(path) in str(refusal.value) and "\n" not in str(refusal.value)


def test_size_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "large"
    path.write_bytes(b"12345")
    assert reading.read_bytes(path, 5) == b"12345"
    with pytest.raises(OSError, match="more than 4 bytes"):
        reading.read_bytes(path, 4)
    with pytest.raises(OSError):  # noqa: PT011 (its kind differs between systems)
        reading.read_bytes(tmp_path)


@pytest.mark.parametrize("path", ["missing/a.html", "folder"])
def test_what_cannot_be_written_is_named_as_it_was_given(path: str, tmp_path: Path) -> None:
    """Not by the name that a file has while it is written."""
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="Errno") as caught:
        write_bytes(tmp_path / path, b"x")
    assert caught.value.filename == str(tmp_path / path) and caught.value.filename2 is None
