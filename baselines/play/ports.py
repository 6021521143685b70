"""The port of this machine on which the page is served."""

from __future__ import annotations

import errno
import socket

HOST = "127.0.0.1"  # reached from this machine alone
PORT = 8765
_MORE = 20  # ports after it that are tried


def bound(port: int | None) -> socket.socket:
    """A socket on `port` of this machine; on the usual one or the next that is free where it is None.

    Raises `OSError` naming the port where it is in use or may not be used.
    """
    ports = range(PORT, PORT + _MORE) if port is None else (port,)
    for each in ports:
        found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):  # Windows, where REUSEADDR would share it
            found.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind((HOST, each))
            found.listen(128)
        except OSError as problem:
            found.close()
            if problem.errno == errno.EADDRINUSE and each != ports[-1]:
                continue
            reason = (
                "is in use"
                if problem.errno == errno.EADDRINUSE
                else f"{problem.strerror or problem}"
            )
            raise OSError(problem.errno, f"port {each} {reason}: try another --port") from None
        return found
    raise AssertionError
