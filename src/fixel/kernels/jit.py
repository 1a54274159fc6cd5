"""Decorators of the kernels, their flags, and the cache of compiled code.

`entry` compiles a function that Python calls and caches the machine code on disk; all others
compile helpers, which Python cannot call: without `NUMBA_DISABLE_JIT` it would crash. No fastmath
anywhere, since it changes results. The name of the cache folder contains a digest of all kernel
sources, because Numba checks only the file of the entry function and would run the old code of an
edited callee.

Environment: ``FIXEL_CACHE_DIR`` moves the cache; ``NUMBA_DISABLE_JIT=1`` runs every kernel as
plain Python.
"""

import hashlib
import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba import types

from fixel.kernels.linking import KNOWN_NUMBA, HelperCompiler

Function = TypeVar("Function", bound=Callable[..., Any])

# Numba's type information is incomplete.
_njit: Any = numba.njit
_config: Any = numba.config

# error_model="numpy": division by zero follows IEEE without a test; the kernels have their own
# guards.
_FLAGS: dict[str, Any] = {"error_model": "numpy", "fastmath": False}

# The code that unpacks NamedTuples for calls from Python is longer than most helpers: without it
# the first simulation after installation takes 46 s instead of 64 s.
_INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **_FLAGS}
# With other versions of Numba than `linking` was written for, helpers are compiled as usual.
if numba.version_info.short in KNOWN_NUMBA:
    _INNER["pipeline_class"] = HelperCompiler


def source_digest() -> str:
    """Compute the digest of all source files of this package, twelve hexadecimal digits."""
    folder = os.path.dirname(os.path.abspath(__file__))
    digest = hashlib.sha256(numba.__version__.encode())
    for name in sorted(os.listdir(folder)):
        if name.endswith(".py"):
            with open(os.path.join(folder, name), "rb") as source:
                digest.update(source.read())
    return digest.hexdigest()[:12]


def cache_folder() -> str:
    """Path of the folder with the compiled kernels of exactly these sources."""
    base = os.environ.get("FIXEL_CACHE_DIR") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache"), "fixel"
    )
    return os.path.join(base, "kernels-" + source_digest())


_CACHE_FOLDER = cache_folder()


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
    """Compile a helper like `kernel`, not inlined: for long functions, at most once per step."""
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
    # Numba reads its cache folder only while decorating, so it is set for that time only.
    before = _config.CACHE_DIR
    _config.CACHE_DIR = _CACHE_FOLDER
    try:
        return cast(Function, _njit(cache=True, **_FLAGS, **flags)(function))
    finally:
        _config.CACHE_DIR = before


def entry(function: Function) -> Function:
    """Compile a function that Python calls, and cache its machine code on disk.

    It releases Python's lock while it runs, so that ordinary threads can share a batch. This needs
    no threading layer, works in forked processes, and allows Ctrl-C between ranges.
    """
    return _cached(function, nogil=True)
