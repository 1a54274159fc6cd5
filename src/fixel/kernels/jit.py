"""The decorators of the kernels, their flags, and where compiled code is kept.

`entry` compiles a function that Python calls and keeps the machine code on disk; all others
compile helpers, which Python cannot call: without `NUMBA_DISABLE_JIT` it would crash. No fastmath
anywhere: it moves results. The cache folder is named by a digest of all kernel sources, because
Numba looks only at the file of the entry function and would keep running an edited callee's old
code.

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

# Not all that is used of Numba is in its type information.
_njit: Any = numba.njit
_config: Any = numba.config

# error_model="numpy": division by zero follows IEEE and is never tested for; the kernels guard
# their own.
_FLAGS: dict[str, Any] = {"error_model": "numpy", "fastmath": False}

# The code that would unpack NamedTuples for calls from Python is longer than most helpers: without
# it the first simulation ever waits 46 s in place of 64 s.
_INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **_FLAGS}
# Where Numba is not the one that `linking` was written for, helpers compile as any function does.
if numba.version_info.short in KNOWN_NUMBA:
    _INNER["pipeline_class"] = HelperCompiler


def source_digest() -> str:
    """Digest of every source file of this package, twelve hexadecimal digits."""
    folder = os.path.dirname(os.path.abspath(__file__))
    digest = hashlib.sha256(numba.__version__.encode())
    for name in sorted(os.listdir(folder)):
        if name.endswith(".py"):
            with open(os.path.join(folder, name), "rb") as source:
                digest.update(source.read())
    return digest.hexdigest()[:12]


def cache_folder() -> str:
    """Folder that holds the compiled kernels of exactly these sources."""
    base = os.environ.get("FIXEL_CACHE_DIR") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache"), "fixel"
    )
    return os.path.join(base, "kernels-" + source_digest())


_CACHE_FOLDER = cache_folder()


def _inner(function: Function, **flags: Any) -> Function:
    """Compile once for each combination of types.

    Numba by itself would compile anew for every constant among the arguments; inlining makes as
    much of constants, and the first simulation ever waits 35 s in place of 46 s.
    """
    compiled = _njit(**flags, **_INNER)(function)
    if not _config.DISABLE_JIT:
        template = compiled.get_call_template
        compiled.get_call_template = lambda args, kws: template(
            [types.unliteral(a) for a in args], {k: types.unliteral(a) for k, a in kws.items()}
        )
    return cast(Function, compiled)


def kernel(function: Function) -> Function:
    """Compile a helper that allocates nothing; its machine code lives inside the entries that
    call it.

    Without Numba's run time (`_nrt=False`) arrays are passed without counting references, and
    always inlined the NamedTuples are never copied: one step of a grasp takes 0.7 us in place of
    10 us (measured 2026-11, two-core AMD EPYC).
    """
    return _inner(function, _nrt=False, forceinline=True)


def large_kernel(function: Function) -> Function:
    """As `kernel`, but called in place of inlined: for long functions, once a step at most."""
    return _inner(function, _nrt=False)


def allocating_kernel(function: Function) -> Function:
    """Compile a helper that allocates arrays: once a rollout, never in a step."""
    return _inner(function)


def spliced_kernel(function: Function) -> Function:
    """A helper that becomes part of its caller before anything is compiled.

    For the few levels between an entry and the loop of steps. Not for more than that: long
    functions take Numba longer than the short ones they are made of.
    """
    return _inner(function, _nrt=False, inline="always")


def _cached(function: Function, **flags: Any) -> Function:
    # Numba reads its cache folder once, while decorating, so it is set for that moment only.
    before = _config.CACHE_DIR
    _config.CACHE_DIR = _CACHE_FOLDER
    try:
        return cast(Function, _njit(cache=True, **_FLAGS, **flags)(function))
    finally:
        _config.CACHE_DIR = before


def entry(function: Function) -> Function:
    """Compile a function that Python calls, and keep its machine code on disk.

    It releases Python's lock while it runs, so that plain threads can share the work of a batch: no
    threading layer, nothing to break in a forked process, and Ctrl-C between ranges.
    """
    return _cached(function, nogil=True)
