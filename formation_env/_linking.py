"""How Numba compiles what kernels link: without the machine code that it makes of every function.

Numba makes machine code of each function by itself, together with all that it calls, and again of each of
its callers; kernels use only what LLVM is given. This is most of the time of a first compilation. What
is used here of Numba is its pipeline class, which `njit` takes, and its class for the code of one function.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.typed_passes import DumpParforDiagnostics, NopythonRewrites
from numba.core.untyped_passes import (
    FindLiterallyCalls,
    InlineClosureLikes,
    InlineInlinables,
    LiteralPropagationSubPipelinePass,
    LiteralUnroll,
    MakeFunctionToJitFunction,
)


class _NoMachineCode:
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

    def add_ir_module(self, module: Any) -> None:
        for function in module.functions:
            if not function.is_declaration:
                for attribute in self.attributes:
                    function.attributes.add(attribute)
        super().add_ir_module(module)

    @property
    def codegen(self) -> Any:
        return _NoMachineCode(self._codegen)

    def _optimize_functions(self, module: Any) -> None:
        # Numba runs a first, cheap set of passes on every function. Where the module's passes follow they do
        # the same again; code of steps has none of its own, and would make the kernel's slower without these.
        if self.optimised:
            module.data_layout = self._codegen._data_layout
        else:
            super()._optimize_functions(module)

    def _optimize_final_module(self) -> None:
        # Numba runs a cheaper set of the same passes first, to prune reference counts in inlined code; the
        # kernel has it.
        if self.optimised:
            passes, builder = self._codegen._module_pass_manager()
            passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0


class _LinkedLate(_Linked):
    """The same, optimised with the kernel alone."""

    optimised = False


class _LinkedCold(_LinkedLate):
    """The same, called and not inlined, and optimised for size."""

    attributes = ("noinline", "optsize", "cold")


# Passes for what kernels do not contain: closures and comprehensions, inlining of Numba's own,
# loops over literals, and expressions of whole arrays.
_NOT_NEEDED = (
    InlineClosureLikes,
    InlineInlinables,
    FindLiterallyCalls,
    LiteralUnroll,
    MakeFunctionToJitFunction,
    LiteralPropagationSubPipelinePass,
    NopythonRewrites,
    DumpParforDiagnostics,
)


class LinkedCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler, for functions that are linked and never called from Python."""

    library: Any = _Linked

    def define_pipelines(self) -> Any:
        pipelines = super().define_pipelines()
        for pipeline in pipelines:
            pipeline.passes = [one for one in pipeline.passes if one[0] not in _NOT_NEEDED]
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        return pipelines


class LateCompiler(LinkedCompiler):
    library = _LinkedLate


class ColdCompiler(LinkedCompiler):
    library = _LinkedCold
