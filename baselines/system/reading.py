"""Files that a user names, read whole: only regular ones, up to a size, and never waited for."""

from __future__ import annotations

import errno
import json
import os
import stat
from typing import Any, NoReturn

from formation_env.validation.checks import require

LARGEST = 64 * 2**20  # bytes

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def file_name(path: Any) -> str | os.PathLike[str]:
    """`path`, if it is a path: raises `ValueError` for a number, which would be an open file's."""
    require(isinstance(path, (str, os.PathLike)), "path", path, "the name of a file")
    return path  # type: ignore[no-any-return]


def require_regular(path: str | os.PathLike[str]) -> None:
    """Raises `OSError` saying what the path is, if it is no regular file or there is none.

    For files that are opened by other means: opening a pipe would block until a writer opens it.
    """
    _refuse_kind(os.stat(path).st_mode, path)


def read_bytes(path: str | os.PathLike[str], most: int = LARGEST) -> bytes:
    """What a file holds. Raises `OSError` where it is no regular file, cannot be read or is larger than
    `most` bytes; `strerror` says which."""
    # An ordinary `open` of a pipe without a writer would block; fstat because the path may change.
    flags = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
    if os.name == "nt":  # where a folder cannot be opened, with another reason
        require_regular(path)
    with os.fdopen(os.open(path, flags), "rb", closefd=True) as file:
        _refuse_kind(os.fstat(file.fileno()).st_mode, path)
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"more than {most} bytes", os.fspath(path))
    return data


def read_text(path: str | os.PathLike[str], most: int = LARGEST) -> str:
    """The same as text in UTF-8. Raises `ValueError` naming the file and what is amiss, in one line."""
    try:
        return read_bytes(path, most).decode("utf-8")
    except OSError as problem:
        raise ValueError(f"{path}: cannot be read: {problem.strerror or problem}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not text in UTF-8") from None


def read_json(path: str | os.PathLike[str], most: int = LARGEST) -> Any:
    """What a JSON file holds; NaN and infinity are not JSON. Raises `ValueError` as `read_text` does."""
    text = read_text(path, most)
    try:
        return json.loads(text, parse_constant=_refuse_constant)
    except RecursionError:
        raise ValueError(f"{path}: not JSON that can be read (nested too deep)") from None
    except ValueError as problem:
        raise ValueError(f"{path}: not JSON ({problem})") from None


def _refuse_constant(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number")


def _refuse_kind(mode: int, path: str | os.PathLike[str]) -> None:
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "something else")
        raise OSError(errno.EINVAL, f"{kind}, not a regular file", os.fspath(path))
