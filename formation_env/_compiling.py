"""What the standard error says while kernels are compiled: that it happens once, what, how much is left.

Functions are compiled one after the other, a kernel's last, and take about alike long. How many there are
is counted beforehand, in the code: see `linked_functions`. Nothing here is gone through by a kernel that
comes from the cache, nor in a step.

There is no setting that silences it: what is compiled ahead (`python -m formation_env.warm`) says nothing
later, and a command that has a line of its own takes `untold`.
"""

from __future__ import annotations

import gc
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import CodeType, ModuleType
from typing import Any, TypeVar, final

from numba.core import event

F = TypeVar("F", bound=Callable[..., Any])

# Of a kernel's time, after all functions: passes over the whole and its machine code.
_LAST_SHARE = 0.2
_REDRAWN = 0.1  # s between two states of the line on a terminal
_WRITTEN = 4.0  # s between two lines where there is none
_QUARTERS = 4  # after each of which but the last such a line is due


def _names(code: CodeType) -> set[str]:
    """All names of globals and attributes in a function's code and in the functions within."""
    inner = (_names(one) for one in code.co_consts if isinstance(one, CodeType))
    return set(code.co_names).union(*inner)


def _called(function: Any) -> Iterator[Any]:
    """The Python functions behind those compiled ones that a function's code names."""
    names = _names(function.__code__)
    found = [function.__globals__.get(name) for name in names]
    found += [cell.cell_contents for cell in function.__closure__ or ()]
    modules: set[str] = set()
    while found:
        one = found.pop()
        if isinstance(one, ModuleType):
            if one.__name__ not in modules:
                modules.add(one.__name__)
                found += [getattr(one, name, None) for name in names]
        elif hasattr(one, "py_func"):
            yield one.py_func


def linked_functions(kernel: Any) -> set[Any]:
    """The Python functions that compiling `kernel` compiles: its own, those it calls, those they call, ...

    Found in the code, so that they are known before anything is compiled: functions of this package are
    named where they are called, as globals, attributes of modules or variables of an outer function.
    """
    found: set[Any] = set()
    new = [kernel.py_func]
    while new:
        function = new.pop()
        if function not in found:
            found.add(function)
            new += _called(function)
    return found


@final
class _Compiling(event.Listener):  # type: ignore[misc]
    """Listens to Numba's compiler, which tells of one function after another under its lock."""

    def __init__(self) -> None:
        self.titles: dict[int, tuple[Any, str]] = {}  # kernels and what users know them as, by id
        self.told = False  # the first message, once per process
        self.shown = True
        self._thresholds: list[tuple[int, int, int]] = []  # of kernels that compile others
        self._depth = 0
        self._linked: set[Any] = set()  # functions that have been compiled for kernels
        self._title = ""  # of the outermost kernel that is compiled; empty where there is none
        self._left: set[Any] = set()
        self._total = self._quarter = 0
        self._began = self._last = 0.0
        self._erase = ""

    def on_start(self, event: Any) -> None:
        """Begin the story of a kernel, and collect garbage less often meanwhile.

        The compiler holds some millions of objects until it is done; looking through them for garbage at the
        usual pace is a tenth of its time.
        """
        self._depth += 1
        kernel = event.data["dispatcher"]
        if id(kernel) not in self.titles:
            return
        self._thresholds.append(gc.get_threshold())
        if gc.get_threshold()[0]:
            gc.set_threshold(100_000, 50, 100)
        if not self._title:
            self._begin(kernel)

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        kernel = event.data["dispatcher"]
        if self._depth > 0:
            self._linked.add(kernel.py_func)
        if self._title and kernel.py_func in self._left:
            self._left.remove(kernel.py_func)
            self._show()
        if id(kernel) in self.titles:
            gc.set_threshold(*self._thresholds.pop())
            if not self._thresholds:
                self._title = ""
                self._write(self._erase)
                self._erase = ""

    def _begin(self, kernel: Any) -> None:
        self._left = linked_functions(kernel) - self._linked
        self._total, self._quarter = len(self._left), 0
        self._began = self._last = time.monotonic()
        self._title = self.titles[id(kernel)][1]  # the last, for threads that ask for `status`
        if self.shown and not self.told:
            self.told = True
            folder = kernel.stats.cache_path
            kept = f"kept in {folder}" if folder else "no folder to keep it in: NUMBA_CACHE_DIR"
            self._write(f"formation_env: compiling, once, which can take a minute ({kept})\n")

    def status(self) -> str:
        """What is being compiled and how much of it is left; empty where nothing is."""
        title, total, done = self._title, self._total, self._total - len(self._left)
        if not title:
            return ""
        text = f"{title}, {done} of {total} functions"
        if done == total:
            text = f"{title}, machine code of {total} functions"
        part = (1.0 - _LAST_SHARE) * done / max(total, 1)
        seconds = time.monotonic() - self._began
        if part < 0.03 or seconds < 0.5:  # too early for an estimate
            return text
        return f"{text}, about {max(1.0, seconds / part - seconds):.0f} s left"

    def _show(self) -> None:
        if not self.shown:
            return
        now = time.monotonic()
        if _is_terminal():
            if now - self._last >= _REDRAWN:
                self._last = now
                room = shutil.get_terminal_size().columns - 1
                line = f"formation_env: {self.status()}"[:room]
                self._write("\r" + line.ljust(len(self._erase) - 2))
                self._erase = f"\r{' ' * len(line)}\r"
            return
        quarter = _QUARTERS * (self._total - len(self._left)) // self._total
        if self._quarter < quarter < _QUARTERS:
            self._quarter = quarter
            if now - self._last >= _WRITTEN:
                self._last = now
                self._write(f"formation_env: {self.status()}\n")

    def _write(self, text: str) -> None:
        """One call, so that lines of other processes are not mixed in; no error where the pipe is closed."""
        if text and sys.stderr is not None:
            with suppress(OSError, ValueError):
                sys.stderr.write(text)
                sys.stderr.flush()


def _is_terminal() -> bool:
    with suppress(AttributeError, ValueError):
        return sys.stderr.isatty()
    return False


_compiling = _Compiling()


def status() -> str:
    """What is being compiled and how much of it is left, of announced kernels; empty where nothing is."""
    return _compiling.status()


@contextmanager
def untold() -> Iterator[None]:
    """Within, nothing is printed when kernels are compiled: the caller prints what it wants of `status`."""
    before, _compiling.shown = _compiling.shown, False
    try:
        yield
    finally:
        _compiling.shown = before


def announced(title: str) -> Callable[[F], F]:
    """Have the user told when this kernel, known as `title`, has to be compiled: not when it comes from the
    cache."""

    def listed(kernel: F) -> F:
        if not _compiling.titles:
            event.register("numba:compile", _compiling)
        _compiling.titles[id(kernel)] = (kernel, title)
        return kernel

    return listed
