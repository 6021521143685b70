"""One thread at a time: a second one gets an error instead of waiting."""

from __future__ import annotations

import os
import threading
from typing import Any, final


@final
class Exclusive:
    """A context for one thread at a time, which may enter it again; raises `RuntimeError` in another.

    It does not wait for the other thread, which may never come back, and two threads that step the same
    worlds do not mean to. A process forked while another thread was inside is not held up by that
    thread, which it does not have. A copy is held by no thread.

    Where a tenth of a microsecond counts, instead of `with`: `exclusive.acquire(False) or
    exclusive.take_over()`, and `exclusive.release()` at last.
    """

    def __init__(self) -> None:
        lock = threading.RLock()
        self.acquire, self.release, self._process = lock.acquire, lock.release, os.getpid()

    def __enter__(self) -> None:
        if not self.acquire(False):
            self.take_over()

    def __exit__(self, *error: Any) -> None:
        self.release()

    def take_over(self) -> None:
        """Enter in a process forked since this was made; raises `RuntimeError` in another one."""
        if self._process == os.getpid():
            raise RuntimeError(
                "another thread is at work in this environment: one thread at a time, or an environment "
                "for each thread (workers of its own are asked for by threads=)"
            )
        lock = threading.RLock()
        lock.acquire()
        self.acquire, self.release, self._process = lock.acquire, lock.release, os.getpid()

    def __reduce__(self) -> tuple[Any, ...]:
        return (Exclusive, ())
