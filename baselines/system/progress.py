"""How far a long command is: what has to be compiled first, on a line of its own, and then a bar.

with compiling():            # the first use of every kernel, for a moment
    fly(policy, range(1), most=2)
bar = Bar(total, "flying")   # no rate and no remaining time counts compiling
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, final

from numba.core import event

from baselines.system.console import Lenient
from formation_env._compiling import status, untold

TEXT = "compiling the simulation (once per machine, about a minute) ..."
_ROOM = 79  # columns of a terminal that the line may take


@contextmanager
def compiling(quiet: bool = False) -> Iterator[None]:
    """Within, the first kernel that has to be compiled starts a line on the standard error, which on a
    terminal says what is compiled and how much of it is left, and ends with `done in 48 s`. No line where all
    comes from the cache."""
    line = _Line(quiet)
    event.register("numba:compile", line)
    how = "stopped after"
    try:
        with untold():
            yield
        how = "done in"
    finally:
        event.unregister("numba:compile", line)
        line.end(how)


@final
class _Line(event.Listener):  # type: ignore[misc]
    """The line, begun when compiling begins."""

    def __init__(self, quiet: bool) -> None:
        self._stream, self._quiet = Lenient(), quiet
        self._began: float | None = None
        self._over = threading.Event()
        self._clock: threading.Thread | None = None

    def on_start(self, event: Any) -> None:
        # Small functions that Python calls directly are compiled in every process, in a moment.
        kernel = event.data["dispatcher"].targetoptions.get("nogil", False)
        if self._quiet or self._began is not None or not kernel:
            return
        self._began = time.monotonic()
        self._stream.write(TEXT)
        self._stream.flush()
        if sys.stderr.isatty():
            self._clock = threading.Thread(target=self._tick, daemon=True)
            self._clock.start()

    def on_end(self, event: Any) -> None:
        pass

    def _seconds(self) -> str:
        return f"{time.monotonic() - (self._began or 0.0):.0f} s"

    def _tick(self) -> None:
        while not self._over.wait(1.0):
            now = status()
            text = f"compiling once: {now}" if now else f"{TEXT} {self._seconds()}"
            self._stream.write("\r" + text[:_ROOM].ljust(_ROOM))
            self._stream.flush()

    def end(self, how: str) -> None:
        """Say `how` it ended and how long it took, if anything was compiled."""
        if self._began is None:
            return
        self._over.set()
        if self._clock is not None:
            self._clock.join()
            self._stream.write(f"\r{' ' * _ROOM}\r{TEXT}")
        self._stream.write(f" {how} {self._seconds()}\n")
        self._stream.flush()


@final
class Bar:
    """A progress bar that many threads advance; once stopped, it stops them at their next advance."""

    def __init__(self, total: int, description: str, quiet: bool = False) -> None:
        from tqdm import tqdm

        self._lock = threading.Lock()
        self.stopped = False
        self._bar: Any = tqdm(
            total=total,
            disable=quiet,
            file=Lenient(),
            unit=" ticks",
            unit_scale=True,
            desc=description,
            mininterval=0.2,
            smoothing=0.05,
            dynamic_ncols=True,
        )

    def advance(self, ticks: int) -> None:
        """Move on. Raises `RuntimeError` once stopped."""
        if self.stopped:
            raise RuntimeError("the evaluation was stopped")
        with self._lock:
            self._bar.update(ticks)

    def stop(self) -> None:
        """Have the threads stop at their next `advance`."""
        self.stopped = True

    def close(self) -> None:
        """Leave the bar as it is."""
        with self._lock:
            self._bar.close()
