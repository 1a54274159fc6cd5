"""Compilation of helpers to intermediate code only, which their callers link.

Numba compiles each function to machine code, in case Python calls it, and optimises callees again
at every level above. Our helpers are called by kernels only. They stop at unoptimised intermediate
code, and the entry that contains them is optimised once. The first simulation after installation
takes 35 s instead of 47 s, with the same speed afterwards and results equal bit for bit.

This uses internals of Numba: a pass of our own installs a code library of our own before code is
generated. docs/decisions/0009 gives the reasons.
"""

from typing import Any

from numba.core import codegen, compiler, compiler_machinery, typed_passes

KNOWN_NUMBA = ((0, 68),)  # tested versions

# Numba's type information is incomplete.
_codegen: Any = codegen
_compiler: Any = compiler
_machinery: Any = compiler_machinery
_passes: Any = typed_passes


class _NoEnvironment:
    """Proxy of the code generator that ignores `set_env`, since no code has an environment."""

    def __init__(self, generator: Any) -> None:
        self._generator = generator

    def __getattr__(self, name: str) -> Any:
        return getattr(self._generator, name)

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: only code that calls Python needs an environment."""


class _Intermediate(_codegen.JITCodeLibrary):  # type: ignore[misc]
    """Code library that is linked into others; its functions have no addresses."""

    @property
    def codegen(self) -> _NoEnvironment:
        return _NoEnvironment(self._codegen)

    def _optimize_final_module(self) -> None:
        """Do nothing: the library that links this one is optimised."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0


@_machinery.register_pass(mutates_CFG=False, analysis_only=True)
class _TakeIntermediate(_machinery.FunctionPass):  # type: ignore[misc]
    """Pass that installs the library before the code generation would create an ordinary one."""

    _name = "fixel_take_intermediate"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        state.library = _Intermediate(state.targetctx.codegen(), state.func_id.func_qualname)
        return True


class HelperCompiler(_compiler.CompilerBase):  # type: ignore[misc]
    """Compiler pipeline of Numba for functions that only compiled code calls."""

    def define_pipelines(self) -> list[Any]:
        passes = _compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_TakeIntermediate, _passes.NopythonTypeInference)
        passes.finalize()
        return [passes]
