"""How this package hands functions to Numba: one place, so that every function is compiled alike.

Three decorators. `device` marks the mathematics: small functions on scalars, tuples and complex
numbers that are inlined where they are called. `loop` marks the loops that the compiler vectorises.
`kernel` marks the few entry points that Python calls: they hold the loops over memory, release the GIL
and are cached on disk.

All use the same restricted fast-math set. `contract` (fused multiply-add), `nsz` and `arcp` give
most of the speed and keep the meaning of NaN and infinity, on which the input checks rely.

Setting `NUMBA_DISABLE_JIT=1` turns all of it back into Python, for coverage and the debugger.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from llvmlite.binding import Linkage
from numba import njit
from numba.core import event, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.typed_passes import NopythonRewrites
from numba.extending import lower_builtin, type_callable

_types: Any = types

F = TypeVar("F", bound=Callable[..., Any])

FASTMATH = {"contract", "nsz", "arcp"}


@cache
def _source_stamp(folder: Path) -> str | None:
    """Hash of all sources a kernel in `folder` may have been compiled from, if they are in files."""
    digest = hashlib.sha256()
    for directory in sorted({Path(__file__).parent, folder}):
        sources = sorted(directory.glob("*.py"))
        if not sources:  # in an archive, or compiled files alone
            return None
        for path in sources:
            digest.update(path.read_bytes())
    return digest.hexdigest()


class _NoMachine:
    """A code generator that does not look for machine code: of a function that is linked there is none."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, env: Any) -> None:
        pass


class _Linked(JITCodeLibrary):  # type: ignore[misc]
    """Code that kernels link. No machine code is made of it: that is made once, of the whole kernel."""

    optimised = True
    attributes: tuple[str, ...] = ()  # of the function

    def finalize(self) -> None:
        super().finalize()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                for attribute in self.attributes:
                    function.add_function_attribute(attribute)

    @property
    def codegen(self) -> Any:
        return _NoMachine(self._codegen)

    def _optimize_final_module(self) -> None:
        if self.optimised:
            super()._optimize_final_module()

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0


class _LinkedLoop(_Linked):
    """The same, called and not inlined: one piece of machine code for all callers."""

    attributes = ("noinline",)


class _LinkedLate(_Linked):
    """The same, optimised with the kernel alone."""

    optimised = False


class _LinkedCold(_LinkedLate):
    """The same, called and not inlined, and optimised for size."""

    attributes = ("noinline", "optsize", "cold")


class _LinkedCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler, for functions that are linked and never called from Python."""

    library: Any = _Linked

    def define_pipelines(self) -> Any:
        pipelines = super().define_pipelines()
        for pipeline in pipelines:
            # Expressions of whole arrays, which kernels do not contain.
            pipeline.passes = [one for one in pipeline.passes if one[0] is not NopythonRewrites]
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        return pipelines


class _LoopCompiler(_LinkedCompiler):
    library = _LinkedLoop


class _LateCompiler(_LinkedCompiler):
    library = _LinkedLate


class _ColdCompiler(_LinkedCompiler):
    library = _LinkedCold


def _apart(flags: Any) -> Any:
    """Have the compiler take it that no array a function writes overlaps another one it uses."""
    flags.noalias = True
    return flags


def _called_by_kernels(
    function: F,
    apart: bool = False,
    compiler: Any = _LinkedCompiler,
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
    called: Any = njit(**options)(function)
    if hasattr(called, "get_call_template"):
        bare = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": compiler}
        linked: Any = njit(**bare, **options)(function)
        for one in (called, linked) if apart else ():
            # A flag of Numba's compiler that `njit` does not hand on.
            one._compiler._customize_flags = _apart
        called.get_call_template = linked.get_call_template
        if not literal:
            called.get_call_template = lambda args, kws: linked.get_call_template(
                tuple(_types.unliteral(one) for one in args), kws
            )
        called.get_overload = linked.get_overload
    return called  # type: ignore[no-any-return]


def device(function: F, literal: bool = True) -> F:
    """Compile `function` to be inlined into the kernels that call it; for `literal` see above."""
    return _called_by_kernels(function, literal=literal, forceinline=True)


def step(function: F) -> F:
    """Compile `function` as a part of the loop over tiles: inlined, and optimised with the kernel alone.

    For code that moves views and counters about; mathematics is a `device`, whose numbers then do not
    depend on where it is inlined.
    """
    return _called_by_kernels(function, compiler=_LateCompiler, forceinline=True)


def cold(function: F) -> F:
    """Compile `function` as a seldom used part of the loop over tiles: called, not inlined."""
    return _called_by_kernels(function, compiler=_ColdCompiler, forceinline=False)


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
    """Compile `function` as a loop of its own, called by kernels and not inlined by us.

    Small enough for the compiler to vectorise, and one piece of machine code for all its callers. What
    it writes in an array must not be read through another one: else it would compare all addresses in
    each call, and keep a scalar loop beside the vector one.
    """
    return _called_by_kernels(
        function, apart=True, compiler=_LoopCompiler, nogil=True, forceinline=False
    )


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
    return compiled  # type: ignore[no-any-return]


class _Announcement(event.Listener):  # type: ignore[misc]
    """Tells once per process that a slow kernel is being compiled, as that begins."""

    def __init__(self) -> None:
        self.slow: list[Any] = []
        self._told = False

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        if self._told or all(kernel is not one for one in self.slow):
            return
        self._told = True
        folder = kernel.stats.cache_path
        kept = f"it is kept in {folder}" if folder else "no folder to keep it in: NUMBA_CACHE_DIR"
        print(
            f"formation_env: compiling the simulation, which can take a minute ({kept})",
            file=sys.stderr,
            flush=True,
        )

    def on_end(self, event: Any) -> None:
        pass


_announcement = _Announcement()


@contextmanager
def untold() -> Iterator[None]:
    """Within, the notice that a slow kernel is compiled is not printed: the caller prints its own."""
    before, _announcement._told = _announcement._told, True
    try:
        yield
    finally:
        _announcement._told = before


def announced(kernel: F) -> F:
    """Have the user told when this kernel has to be compiled: not when it comes from the cache."""
    if not _announcement.slow:
        event.register("numba:compile", _announcement)
    _announcement.slow.append(kernel)
    return kernel
