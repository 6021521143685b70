"""How this package hands functions to Numba: one place, so that every function is compiled alike.

Two decorators. `device` marks the mathematics: small functions on scalars, tuples and complex
numbers that are inlined where they are called. `kernel` marks the few entry points that Python
calls: they hold the loops over memory, release the GIL and are cached on disk.

Both use the same restricted fast-math set. `contract` (fused multiply-add), `nsz` and `arcp` give
most of the speed and keep the meaning of NaN and infinity, on which the input checks rely.

Setting `NUMBA_DISABLE_JIT=1` turns all of it back into Python, for coverage and the debugger.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])

FASTMATH = {"contract", "nsz", "arcp"}


@cache
def _source_stamp(folder: Path) -> str:
    """Hash of all sources a kernel in `folder` may have been compiled from."""
    digest = hashlib.sha256()
    for directory in sorted({Path(__file__).parent, folder}):
        for path in sorted(directory.glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def device(function: F) -> F:
    """Compile `function` to be inlined into the kernels that call it."""
    return _for_kernels(function, forceinline=True)


def _for_kernels(function: F, **options: Any) -> F:
    options = {"fastmath": FASTMATH, "error_model": "numpy", **options}
    called: Any = njit(**options)(function)
    if hasattr(called, "get_call_template"):
        linked: Any = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)(function)
        called.get_call_template = linked.get_call_template
        called.get_overload = linked.get_overload
    return called  # type: ignore[no-any-return]


def plain(function: F) -> F:
    """The Python function behind a compiled one, for calls that are not worth compiling for."""
    return getattr(function, "py_func", function)


def loop(function: F) -> F:
    """Compile `function` as a loop of its own, called by kernels and not inlined by us.

    Small enough for the compiler to vectorise, and one piece of machine code for all its callers.
    """
    return _for_kernels(function, nogil=True)


def kernel(function: F) -> F:
    """Compile `function` as an entry point: cached on disk, GIL released.

    Numba's cache is keyed on the file of the entry point alone; a change in a law that the kernel
    inlines would leave a stale kernel behind. So the stamp covers every source of the package.
    """
    compiled = njit(fastmath=FASTMATH, error_model="numpy", nogil=True, cache=True)(function)
    store = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if store is not None:
        store._source_stamp = _source_stamp(Path(function.__code__.co_filename).parent)
    return compiled  # type: ignore[no-any-return]
