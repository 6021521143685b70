"""Output folders: one run at a time writes into one, and a file there is written whole or not at all.

`claim` locks a folder with the operating system's file lock on `.formation.lock` in it, which a process
loses when it dies, however it dies: a lock file that is left behind blocks no run. The file's text names
the process that holds it. Where only a file of the folder is claimed, the lock's name begins with the
file's. While a file is written it has a name of its own that ends in `.part`; those of killed processes are
removed by the next run that claims the folder or a file in it.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import socket
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import final

LOCK = ".formation.lock"
_WINDOWS = sys.platform == "win32"  # where an open file can be neither renamed nor removed
_MARK = "formation: process "  # what the text of a lock begins with
_PART = re.compile(r"\..+\.[0-9a-f]{16}\.part")


# -- files ----------------------------------------------------------------------------------------


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, or raise `OSError` and keep the one that is there. Its mode is the umask's."""
    handle, part = _open_part(path)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            if not _WINDOWS:  # still locked, so no other run removes it first
                _replace(part, path)
        if _WINDOWS:
            _replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """The same for text, as UTF-8 with the line ends it has."""
    write_bytes(path, text.encode("utf-8"))


def _replace(part: Path, path: Path) -> None:
    try:
        os.replace(part, path)
    except OSError as problem:  # which names `part`
        raise OSError(problem.errno, problem.strerror, str(path)) from None


def _open_part(path: Path) -> tuple[int, Path]:
    """A new file beside `path`, open and locked, so that no other process takes it for a dead one's."""
    while True:
        part = path.parent / f".{path.name}.{secrets.token_hex(8)}.part"
        try:
            handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY, 0o666)
        except OSError as problem:
            raise OSError(problem.errno, problem.strerror, str(path)) from None
        _lock(handle)
        if os.fstat(handle).st_nlink > 0:  # not removed between the two calls
            return handle, part
        os.close(handle)


def _remove_parts(folder: Path) -> None:
    """Remove the `.part` files in `folder` that no process has locked: killed processes left them."""
    for part in folder.iterdir():
        if not (_PART.fullmatch(part.name) and part.is_file()):
            continue
        with suppress(OSError):
            handle = os.open(part, os.O_RDWR | _BINARY)
            try:
                free = _lock(handle)
                if free and not _WINDOWS:
                    part.unlink()
            finally:
                os.close(handle)
            if free and _WINDOWS:
                part.unlink()


# -- folders --------------------------------------------------------------------------------------


class FolderTaken(OSError):
    """Another run writes there; `strerror` names its process, `filename` the folder, or the file in it."""


@final
class Claim:
    """A folder or file that only this run writes, until `release` or the end of a `with` block."""

    def __init__(self, lock: Path, handle: int) -> None:
        self._lock = lock
        self._handle: int | None = handle

    def release(self) -> None:
        """Let others write there. A second call does nothing."""
        handle, self._handle = self._handle, None
        if handle is None:
            return
        if _WINDOWS:
            os.close(handle)
        with suppress(OSError):
            self._lock.unlink()
        if not _WINDOWS:
            os.close(handle)

    def __enter__(self) -> Claim:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()


def claim(folder: Path, file: str = "", wait: float = 0.0) -> Claim:
    """Make the folder if need be, lock it for this run and remove what killed runs left half-written.

    Or lock the `file` of that name in it alone, so that runs with other files may write beside. Nothing else
    is touched. Raises `FolderTaken` where another run, of this process or another one, holds it and has not
    let go within `wait` seconds, and `OSError` where the folder cannot be made or nothing can be written
    into it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.absolute()  # the working directory may change
    lock, until = folder / (f".{file}{LOCK}" if file else LOCK), time.monotonic() + wait
    while True:
        try:
            handle = _locked(lock, folder / file)
            break
        except FolderTaken:
            if time.monotonic() >= until:
                raise
        time.sleep(0.02)
    try:
        os.ftruncate(handle, 0)
        os.write(handle, f"{_MARK}{os.getpid()} on {socket.gethostname()}: {_command()}\n".encode())
        _remove_parts(folder)
    except BaseException:
        Claim(lock, handle).release()
        raise
    return Claim(lock, handle)


def _locked(path: Path, claimed: Path) -> int:
    """The lock file, open and locked, of what is claimed. Raises `FolderTaken`, `OSError`."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | _BINARY | _NONBLOCK, 0o666)
        try:
            holder = os.read(handle, 1000).decode("utf-8", "replace").strip()
            if not _lock(handle):
                raise FolderTaken(errno.EBUSY, _taken(holder), str(claimed))
            if holder and not holder.startswith(_MARK):
                reason = f"it holds a file {path.name} that this package has not written"
                raise OSError(errno.EEXIST, reason, str(path.parent))
            if _same_file(handle, path):
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)  # its holder has removed it between the two calls


def _taken(holder: str) -> str:
    process = holder.removeprefix("formation: ") if holder.startswith(_MARK) else "another process"
    return f"a run that is not finished writes there ({process}); end it or choose another folder"


def _same_file(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False


def _command() -> str:
    """What this process runs, on one line that is not too long."""
    text = " ".join(" ".join(sys.orig_argv).split())
    return text if len(text) <= 200 else f"{text[:197]}..."


# -- the operating system's locks -------------------------------------------------------------------

_BINARY = getattr(os, "O_BINARY", 0)
_NONBLOCK = getattr(os, "O_NONBLOCK", 0)  # a pipe of the lock's name must not hold us up

if sys.platform == "win32":
    import msvcrt

    def _lock(handle: int) -> bool:
        """Lock an open file for this process, without waiting. False where another one has."""
        at = os.lseek(handle, 0, os.SEEK_CUR)
        os.lseek(handle, 2**30, os.SEEK_SET)  # past the text, which others may then read
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            os.lseek(handle, at, os.SEEK_SET)
        return True

else:
    import fcntl

    def _lock(handle: int) -> bool:
        """Lock an open file for this process, without waiting. False where another one has.

        True also on a file system without locks: there two runs in one folder are not noticed.
        """
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            return True
        return True
