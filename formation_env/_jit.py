"""How this package hands functions to Numba: one place, so that every function is compiled alike.

`device` marks the mathematics: small functions on scalars, tuples and complex numbers that are inlined where
they are called. `loop` marks the loops that the compiler vectorises. `step` and `cold` mark the code
around them, which moves views and counters about; `cold` is seldom gone through and therefore called.
`builtin` gives kernels what no Python expresses. `kernel` marks the few entry points that Python calls: they
hold the loops over memory, release the GIL and are cached on disk.

All use the same restricted fast-math set. `contract` (fused multiply-add), `nsz` and `arcp` give
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
from numba.core import types
from numba.core.compiler import Compiler
from numba.extending import lower_builtin, type_callable

from formation_env._linking import ColdCompiler, LateCompiler, LinkedCompiler

_types: Any = types

F = TypeVar("F", bound=Callable[..., Any])

FASTMATH = {"contract", "nsz", "arcp"}

KERNELS: list[Any] = []  # all that `kernel` has made in this process


@cache
def _source_stamp(folder: Path) -> str | None:
    """Hash of all sources a kernel in `folder` may have been compiled from, if they are in files."""
    package = Path(__file__).parent
    if package in folder.parents:
        return _source_stamp(package)
    whole = "" if folder == package else _source_stamp(package)
    sources = sorted(package.rglob("*.py") if folder == package else folder.glob("*.py"))
    if not sources or whole is None:  # in an archive, or compiled files alone
        return None
    digest = hashlib.sha256(whole.encode())
    for path in sources:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _apart(flags: Any) -> Any:
    """Have the compiler take it that no array a function writes overlaps another one it uses."""
    flags.noalias = True
    return flags


def _called_by_kernels(
    function: F,
    apart: bool = False,
    compiler: Any = LinkedCompiler,
    literal: bool = False,
    **options: Any,
) -> F:
    """Compile `function` for kernels and, apart from that, for calls from Python.

    Numba compiles two wrappers along with every function, for Python and for C, and makes machine code of
    each, which takes as long as all the rest. Kernels need neither, so what they link is another
    compilation of the function; the one with them is made when a test or the debugger calls the function
    from Python. With `literal` a whole number or truth value that stands in a call is compiled for by
    itself, so that branches on it are gone before anything is optimised.
    """
    options = {"fastmath": FASTMATH, "error_model": "numpy", **options}

    def made(**more: Any) -> Any:
        one: Any = njit(**options, **more)(function)
        if apart and hasattr(one, "_compiler"):
            # A flag of Numba's compiler that `njit` does not hand on.
            one._compiler._customize_flags = _apart
        return one

    @cache
    def linked() -> Any:
        """Made when a kernel is compiled: those from the cache need none."""
        return made(no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=compiler)

    def template(args: Any, kws: Any) -> Any:
        given = args if literal else tuple(_types.unliteral(one) for one in args)
        return linked().get_call_template(given, kws)

    called = made()
    if hasattr(called, "get_call_template"):
        called.get_call_template = template
        called.get_overload = lambda signature: linked().get_overload(signature)
        called.linked = linked
    return called  # type: ignore[no-any-return]


def device(function: F, literal: bool = True) -> F:
    """Compile `function` to be inlined into the kernels that call it; for `literal` see above."""
    return _called_by_kernels(function, literal=literal, forceinline=True)


def step(function: F) -> F:
    """Compile `function` as a part of the loop over tiles: inlined, and optimised with the kernel alone.

    For code that moves views and counters about; mathematics is a `device`, whose numbers then do not
    depend on where it is inlined.
    """
    return _called_by_kernels(function, compiler=LateCompiler, forceinline=True)


def cold(function: F) -> F:
    """Compile `function` as a seldom used part of the loop over tiles: called, not inlined."""
    return _called_by_kernels(function, compiler=ColdCompiler, forceinline=False)


def builtin(result: Callable[..., Any], build: Callable[..., Any]) -> Callable[[F], F]:
    """Give kernels a function that no Python expresses: `build` writes what LLVM is to do.

    `result` has the function's arguments, as types, and returns the type of what comes out. Called from
    Python it is the function itself.
    """

    def give(function: F) -> F:
        type_callable(function)(lambda context: result)
        lower_builtin(function, _types.VarArg(_types.Any))(build)
        return function

    return give


def device_as_generated(function: F) -> F:
    """A `device` that kernels link in the form that making machine code of it left it in.

    LLVM's code generator rewrites a function before it writes machine code. Where last bits of results that
    are to stay what they are depend on that, it has to be run.
    """
    return _called_by_kernels(function, compiler=Compiler, forceinline=True)


def plain(function: F) -> F:
    """The Python function behind a compiled one, for calls that are not worth compiling for."""
    return getattr(function, "py_func", function)


def loop(function: F) -> F:
    """Compile `function` as a loop, vectorised before it is inlined where it is called.

    What it writes in an array must not be read through another one: else it would compare all addresses in
    each call, and keep a scalar loop beside the vector one.
    """
    return _called_by_kernels(function, apart=True, nogil=True, forceinline=True)


def kernel(function: F) -> F:
    """Compile `function` as an entry point: cached on disk, GIL released.

    Numba's cache is keyed on the file of the entry point alone; a change in a law that the kernel
    inlines would leave a stale kernel behind. So the stamp covers every source of the package, and where
    there are no source files, or no folder that can be written, nothing is kept.
    """
    compiled: Any = njit(fastmath=FASTMATH, error_model="numpy", nogil=True)(function)
    stamp = _source_stamp(Path(function.__code__.co_filename).parent)
    if stamp is not None and hasattr(compiled, "enable_caching"):
        try:
            compiled.enable_caching()
            compiled._cache._cache_file._source_stamp = stamp
        except (RuntimeError, OSError):  # no folder of those Numba tries can be written
            pass
    KERNELS.append(compiled)
    return compiled  # type: ignore[no-any-return]
