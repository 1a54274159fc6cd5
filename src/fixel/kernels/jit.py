"""Decorators of the kernels and their flags.

`entry` compiles a function that Python calls and caches the machine code on disk; all others
compile helpers, which Python cannot call: without `NUMBA_DISABLE_JIT` it would crash. No fastmath
anywhere, since it changes results. `code_cache` stores machine code.

Helpers are compiled to intermediate code only, which their callers link. Numba compiles each
function to machine code, in case Python calls it, and optimises callees again at every level above.
Our helpers are called by kernels only. They stop at unoptimised intermediate code, and the entry
that contains them is optimised once. The first simulation after installation takes 35 s instead of
47 s, with the same speed afterwards and results equal bit for bit. This uses internals of Numba: a
pass of our own installs a code library of our own before code is generated. docs/decisions/0009
gives the reasons.

Environment: ``NUMBA_DISABLE_JIT=1`` runs every kernel as plain Python.
"""

import contextlib
import gc
import math
import os
import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar, cast

import llvmlite.binding
import numba
from numba import types
from numba.core import cgutils, codegen, compiler, compiler_machinery, typed_passes
from numba.extending import intrinsic
from numba.np import arrayobj

from fixel.kernels.code_cache import (
    BEAT_S,
    CodeCache,
    cache_folder,
    entry_name,
    print_once,
    remove_sign,
    shown,
    sign_path,
)

Function = TypeVar("Function", bound=Callable[..., Any])

KNOWN_NUMBA = ((0, 68),)  # versions with which `KernelCompiler` is tested

# Numba's type information is incomplete.
_njit: Any = numba.njit
_config: Any = numba.config
_codegen: Any = codegen
_compiler: Any = compiler
_machinery: Any = compiler_machinery
_passes: Any = typed_passes
_linkage: Any = llvmlite.binding.Linkage


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


class _EntryLibrary(_codegen.JITCodeLibrary):  # type: ignore[misc]
    """Code library of an entry, whose helpers no other code calls: LLVM may drop their unused
    arguments. A helper has hundreds, since every array is seven or nine numbers."""

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == _linkage.linkonce_odr:
                function.linkage = _linkage.internal
        super()._optimize_final_module()


@_machinery.register_pass(mutates_CFG=False, analysis_only=True)
class _TakeLibrary(_machinery.FunctionPass):  # type: ignore[misc]
    """Pass that installs the library before the code generation would create an ordinary one."""

    _name = "fixel_take_library"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        library = _Intermediate if state.flags.no_cpython_wrapper else _EntryLibrary
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return True


COMPILING = "Compiling numerical code; this can take a minute"
ONCE = ", but only once for this version. `fixel compile` does all of it in advance"
PATIENCE_S = 1.0  # time that this process compiles before it prints a line
OPTIMISED = 1.4  # duration of a compilation, in those of its functions before they are optimised
compiled_s = 0.0  # time that this process has compiled
_watch: "_Watch | None" = None  # progress of the entry that is compiled now

# Numba creates millions of objects that remain until the entry is compiled. Python's collector
# would visit them repeatedly, in a tenth of the time.
_RARELY = (100_000, 50, 1000)  # thresholds of the collector during a compilation


class _Flags(_compiler.Flags):  # type: ignore[misc]
    """Flags of Numba that compare the options that are set, not all forty of them.

    Numba compares flags whenever it types a call of its own library: a tenth of the time.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return self._values == getattr(other, "_values", None) or bool(super().__eq__(other))

    def __hash__(self) -> int:
        return _FLAGS_HASH


# Numba's own hash is that of the names of the options, thus the same for all flags.
_FLAGS_HASH = hash(_compiler.Flags())


class _Watch(threading.Thread):
    """Progress of the compilation of an entry: a line, a bar, and a file for other processes."""

    def __init__(self, function: Any) -> None:
        super().__init__(daemon=True, name="fixel-compiling")
        self._entry = entry_name(function)
        self._path = sign_path(self._entry, cache_folder(function.__code__.co_filename))
        self._functions = len(_functions_below(function, set()))
        self._began = time.monotonic()
        self._ended = threading.Event()
        self.done = 0  # functions that are compiled, but not optimised

    def run(self) -> None:
        while self.seconds + compiled_s < PATIENCE_S:
            self._share()
            if self._ended.wait(BEAT_S):
                return
        print_once(f"{COMPILING}{ONCE if os.path.exists(self._path) else ''}.")
        stage = f"compiling {self._entry}, {self._functions} functions"
        with shown(stage) as report:
            while not self._ended.wait(BEAT_S):
                report(int(1000 * self._share()), 1000)

    def _share(self) -> float:
        """Compute the share that is done, and write it for other processes."""
        share = min(1.0, self.done / max(1, self._functions)) / OPTIMISED
        with contextlib.suppress(OSError), open(self._path, "w") as file:
            file.write(f"{share:.3f}")
        return share

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._began

    def end(self, failed: bool) -> None:
        """Stop. The sign of code that `CodeCache` stores next remains until it is stored."""
        self._ended.set()
        self.join()
        if failed:
            remove_sign(self._path)


def _functions_below(function: Any, found: set[Any]) -> set[Any]:
    """Add the helpers that a function calls by their names, directly or not, to `found`."""
    for name in function.__code__.co_names:
        helper = getattr(function.__globals__.get(name), "py_func", None)
        if helper is not None and helper not in found:
            found.add(helper)
            _functions_below(helper, found)
    return found


class KernelCompiler(_compiler.CompilerBase):  # type: ignore[misc]
    """Compiler pipeline of Numba with our libraries and fast bookkeeping."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.flags = _Flags(self.state.flags)

    def compile_extra(self, function: Any) -> Any:
        # Entries compile their helpers inside this call, which Numba's lock lets no other thread
        # enter.
        global _watch, compiled_s
        if _watch is not None:
            try:
                return super().compile_extra(function)
            finally:
                _watch.done += 1
        watch = _watch = _Watch(function)
        watch.start()
        thresholds = gc.get_threshold()
        gc.set_threshold(*_RARELY)
        code = None
        try:
            code = super().compile_extra(function)
            return code
        finally:
            gc.set_threshold(*thresholds)
            _watch = None
            watch.end(failed=code is None)
            compiled_s += watch.seconds

    def define_pipelines(self) -> list[Any]:
        passes = _compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_TakeLibrary, _passes.NopythonTypeInference)
        passes.finalize()
        return [passes]


# error_model="numpy": division by zero follows IEEE without a test; the kernels have their own
# guards.
_FLAGS: dict[str, Any] = {"error_model": "numpy", "fastmath": False}

# The code that unpacks NamedTuples for calls from Python is longer than most helpers: without it
# the first simulation after installation takes 46 s instead of 64 s.
_INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **_FLAGS}
_ENTRY = dict(_FLAGS)
# With other versions of Numba than this compiler was written for, it compiles as usual.
if numba.version_info.short in KNOWN_NUMBA:
    _INNER["pipeline_class"] = _ENTRY["pipeline_class"] = KernelCompiler


def _inner(function: Function, **flags: Any) -> Function:
    """Compile a helper once for each combination of types.

    Numba would by default compile again for every constant argument. Inlining uses constants
    equally well, and the first simulation after installation takes 35 s instead of 46 s.
    """
    compiled = _njit(**flags, **_INNER)(function)
    if not _config.DISABLE_JIT:
        template = compiled.get_call_template
        compiled.get_call_template = lambda args, kws: template(
            [types.unliteral(a) for a in args], {k: types.unliteral(a) for k, a in kws.items()}
        )
    return cast(Function, compiled)


def kernel(function: Function) -> Function:
    """Compile a helper that allocates nothing; its machine code is part of the entries that call
    it.

    Without Numba's run time (`_nrt=False`) arrays are passed without reference counts, and with
    inlining NamedTuples are never copied: one step of a grasp takes 0.7 us instead of 10 us
    (measured 2026-11, two-core AMD EPYC).
    """
    return _inner(function, _nrt=False, forceinline=True)


def large_kernel(function: Function) -> Function:
    """Compile a helper like `kernel`, for long functions that are called at most once per step.

    Numba inlines it where the helper compiled around it is inlined. Never to do so makes steps 6 to
    9 % slower, since all arrays are passed, and the compilation no shorter.
    """
    return _inner(function, _nrt=False)


def allocating_kernel(function: Function) -> Function:
    """Compile a helper that allocates arrays: once per rollout, never in a step."""
    return _inner(function)


def spliced_kernel(function: Function) -> Function:
    """Mark a helper that becomes part of its caller before compilation.

    Only for the few levels between an entry and the loop of steps: Numba takes longer for a long
    function than for the short ones it consists of.
    """
    return _inner(function, _nrt=False, inline="always")


def _cached(function: Function, **flags: Any) -> Function:
    compiled = _njit(**_ENTRY, **flags)(function)
    if not _config.DISABLE_JIT and function.__closure__ is None:
        compiled._cache = CodeCache(function)
    return cast(Function, compiled)


def entry(function: Function) -> Function:
    """Compile a function that Python calls, and cache its machine code on disk.

    It releases Python's lock while it runs, so that ordinary threads can share a batch. This needs
    no threading layer, works in forked processes, and allows Ctrl-C between ranges.
    """
    return _cached(function, nogil=True)


def _view(typing_context: Any, buffer: Any, start: Any, shape: Any) -> Any:
    """Create a view of shape `shape` from entry `start` of `buffer`, in the order of its memory,
    which must outlive it."""
    result = types.Array(buffer.dtype, shape.count, "C")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = arrayobj.make_array(buffer)(context, builder, arguments[0]).data
        item = context.get_abi_sizeof(context.get_data_type(buffer.dtype))
        word = context.get_value_type(types.intp)
        lengths = cgutils.unpack_tuple(builder, arguments[2])
        strides = [word(item)]
        for length in reversed(lengths[1:]):
            strides.insert(0, builder.mul(strides[0], length))
        array = arrayobj.make_array(result)(context, builder)
        arrayobj.populate_array(
            array,
            data=builder.gep(data, [arguments[1]]),
            shape=lengths,
            strides=strides,
            itemsize=word(item),
            meminfo=None,
        )
        return array._getvalue()

    return result(buffer, types.intp, types.UniTuple(types.intp, shape.count)), generate


def _view_in_python(buffer: Any, start: int, shape: tuple[int, ...]) -> Any:
    return buffer.reshape(-1)[start : start + math.prod(shape)].reshape(shape)


view: Any = _view_in_python if _config.DISABLE_JIT else intrinsic(_view)


@allocating_kernel
def take(buffer: Any, shape: Any) -> Any:
    """Return the next array in a buffer, whose first entry counts those that are taken."""
    start = int(buffer[0]) + 1
    size = 1
    for n in shape:
        size *= n
    buffer[0] += size
    return view(buffer, start, shape)
