"""Compile helpers into intermediate code that others link, and no further.

Numba takes each function it meets all the way to machine code, in case Python calls it, and
optimises what it calls once more at every level above. Our helpers are called by kernels only. They
stop at unoptimised intermediate code; the entry that contains them is optimised once and becomes
machine code: the first simulation ever waits 35 s in place of 47 s, and runs the same bits as fast.

This reaches into Numba: a code library of our own, put in place by a pass of our own before the
code is generated. docs/decisions/0009 says why.
"""

from typing import Any

from numba.core import codegen, compiler, compiler_machinery, typed_passes

KNOWN_NUMBA = ((0, 68),)  # versions this was tried with

# Not all that is used of Numba is in its type information.
_codegen: Any = codegen
_compiler: Any = compiler
_machinery: Any = compiler_machinery
_passes: Any = typed_passes


class _NoEnvironment:
    """The code generator, but for one thing: there is no code whose environment could be set."""

    def __init__(self, generator: Any) -> None:
        self._generator = generator

    def __getattr__(self, name: str) -> Any:
        return getattr(self._generator, name)

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing to do: only code that calls back into Python needs one."""


class _Intermediate(_codegen.JITCodeLibrary):  # type: ignore[misc]
    """A code library to be linked into others; nothing in it has an address."""

    @property
    def codegen(self) -> _NoEnvironment:
        return _NoEnvironment(self._codegen)

    def _optimize_final_module(self) -> None:
        """Leave that to whoever links it."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0


@_machinery.register_pass(mutates_CFG=False, analysis_only=True)
class _TakeIntermediate(_machinery.FunctionPass):  # type: ignore[misc]
    """Put the library in place; the pass that generates code would make an ordinary one."""

    _name = "fixel_take_intermediate"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        state.library = _Intermediate(state.targetctx.codegen(), state.func_id.func_qualname)
        return True


class HelperCompiler(_compiler.CompilerBase):  # type: ignore[misc]
    """Numba's compiler for functions that only compiled code calls."""

    def define_pipelines(self) -> list[Any]:
        passes = _compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_TakeIntermediate, _passes.NopythonTypeInference)
        passes.finalize()
        return [passes]
