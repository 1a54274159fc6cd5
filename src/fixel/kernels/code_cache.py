"""Machine code of entries on disk, sealed so that damaged files are never run.

Each entry has one file per combination of argument types, which begins with a digest of its name
and content. Numba's own cache checks neither: an empty file ends every command, a changed one
crashes, and two processes that compile at once can mix up their files. Here, a file that is not
exactly as it was written counts as missing. The entry is compiled again and the file replaced.

Numba checks only the file of the entry, and would run the old code of an edited callee. The names
of our folders contain a digest of all sources of this package and of the folder of the entry, so
compiled code may use functions and constants of these two folders only. The digest has the versions
of Python, Numba, LLVM's binding and NumPy, too; the name of a file has processor and types. Equal
installations share their code, wherever they are.

Machine code can do anything, so files that another user could have written are not read.

Environment: ``FIXEL_CACHE_DIR`` moves the cache.
"""

import contextlib
import errno
import functools
import hashlib
import os
import pickle
import shutil
import stat
import sys
import time
import uuid
from collections.abc import Callable
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import caching, compiler, serialize

MAX_BYTES = 1 << 28  # the largest entry has 4 MB
SEAL_BYTES = 32
SILENT_S = 10.0  # time without a sign after which a process that compiles counts as dead
BEAT_S = 0.2  # time between two signs of progress

# Numba's type information is incomplete.
_caching: Any = caching
_compiler: Any = compiler
_serialize: Any = serialize
_printed: set[str] = set()
show: Any = None  # `fixel.progress.show_progress`, where upper floors are in use


class CodeCache(_caching.NullCache):  # type: ignore[misc]
    """Stored machine code of one entry, through which Numba loads and stores.

    Parameters
    ----------
    function : callable
        Function that is compiled; no closure, whose values the sources do not contain.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        code = function.__code__
        self._name = entry_name(function)
        self._line = code.co_firstlineno
        self._folder = cache_folder(code.co_filename)
        self._sign = sign_path(self._name, self._folder)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Load the code for these types, if need be once another process has compiled it.

        None if there is none that can be used, with a sign that this process compiles.
        """
        target.refresh()
        path = self._path(signature, target.codegen())
        content = read_sealed(path) or self._wait_or_sign(path)
        if content is None:
            return None
        try:
            return _compiler.CompileResult._rebuild(target, *pickle.loads(content))
        except Exception:  # whatever it is, the entry can be compiled again
            return None

    def _wait_or_sign(self, path: str) -> bytes | None:
        """Return the code that another process stores; None with the sign of this process."""
        if not self._set_sign():
            with shown(f"compiling {self._name} in another process") as report:
                while not self._set_sign():
                    report(int(1000 * (share_compiled(self._name, self._folder) or 0.0)), 1000)
                    time.sleep(BEAT_S)
        content = read_sealed(path)  # stored by another process
        if content is not None:
            remove_sign(self._sign)
        return content

    def _set_sign(self) -> bool:
        """Set the sign, unless another process gives it; return whether to compile."""
        try:
            if share_compiled(self._name, self._folder) is None:
                remove_sign(self._sign)
            os.makedirs(self._folder, exist_ok=True)
            os.close(os.open(self._sign, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644))
            return True
        except OSError:  # it is there, or code cannot be stored either
            return share_compiled(self._name, self._folder) is None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store the code for these types, or print why that failed."""
        try:
            if not result.library.has_dynamic_globals:  # addresses of this process
                path = self._path(signature, result.codegen)
                write_sealed(path, _serialize.dumps(result._reduce()))
                if read_sealed(path) is None:  # as on file systems without owners
                    raise OSError(errno.EPERM, "files there are not trusted")
        except OSError as problem:
            print_once(
                f"Compiled code cannot be stored in {self._folder} ({problem.strerror}), so every "
                "process compiles it again. Set FIXEL_CACHE_DIR to a folder with write permission."
            )
        finally:  # not earlier: processes that wait for the code would compile it again
            remove_sign(self._sign)

    def _path(self, signature: Any, codegen: Any) -> str:
        svml = getattr(numba.config, "USING_SVML", None)
        key = (self._line, str(signature), codegen.magic_tuple(), svml)
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        return os.path.join(self._folder, f"{self._name}-{digest}")


def entry_name(function: Callable[..., Any]) -> str:
    """Name of an entry in the cache: module and function."""
    module = os.path.splitext(os.path.basename(function.__code__.co_filename))[0]
    return f"{module}.{function.__qualname__}".replace("<", "").replace(">", "")


def is_stored(entry: str) -> bool:
    """Whether usable machine code of an entry of the kernels is stored, for any types."""
    folder = cache_folder()
    try:
        names = [name for name in os.listdir(folder) if name.startswith(f"{entry}-")]
    except OSError:
        return False
    return any(read_sealed(os.path.join(folder, name)) is not None for name in names)


def share_compiled(entry: str, folder: str = "") -> float | None:
    """Share of an entry, by default of the kernels, that is compiled so far; None if none does."""
    path = sign_path(entry, folder or cache_folder())
    try:
        if abs(time.time() - os.stat(path).st_mtime) > SILENT_S:
            return None
        with open(path) as file:
            return float(file.read() or 0.0)
    except (OSError, ValueError):
        return None


def remove_sign(sign: str) -> None:
    """Remove the sign of a process that compiles no more."""
    with contextlib.suppress(OSError):
        os.unlink(sign)


def sign_path(entry: str, folder: str) -> str:
    """Path of the file with which a process that compiles an entry gives signs to others."""
    return os.path.join(folder, f"{entry}.compiling")


def cache_folder(source: str = __file__) -> str:
    """Path of the folder with the machine code of the entries in the folder of `source`.

    Parameters
    ----------
    source : str
        Path of a Python file; by default, one of the kernels.
    """
    base = os.environ.get("FIXEL_CACHE_DIR") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache"), "fixel"
    )
    folder = os.path.dirname(os.path.abspath(source))
    return os.path.join(base, f"{os.path.basename(folder)}-{_source_digest(folder)}")


@functools.cache
def _source_digest(folder: str) -> str:
    tag, flags = sys.implementation.cache_tag, getattr(sys, "abiflags", "")
    versions = (tag, flags, numba.__version__, llvmlite.__version__, np.__version__)
    digest = hashlib.sha256(repr(versions).encode())
    for place in (os.path.dirname(os.path.abspath(__file__)), folder):
        for name in sorted(os.listdir(place)):
            if name.endswith(".py"):
                with open(os.path.join(place, name), "rb") as source:
                    digest.update(hashlib.sha256(source.read()).digest())
    return digest.hexdigest()[:12]


def read_sealed(path: str) -> bytes | None:
    """Read the content of a sealed file; None if it is missing, damaged, or not of this user."""
    try:
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode) or status.st_size > MAX_BYTES or _is_foreign(status):
            return None
        with open(path, "rb") as file:
            seal, content = file.read(SEAL_BYTES), file.read()
    except OSError:
        return None
    return content if seal == _seal(path, content) else None


def write_sealed(path: str, content: bytes) -> None:
    """Write a sealed file whole; readers see the old one or the new one.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    folder, name = os.path.split(path)
    os.makedirs(folder, exist_ok=True)
    unfinished = os.path.join(folder, f".{name}.{uuid.uuid4().hex[:16]}")
    try:
        # Writable for this user only, else `read_sealed` would not trust it.
        with open(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644), "wb") as file:
            file.write(_seal(path, content) + content)
        if os.path.isdir(path):
            shutil.rmtree(path)
        os.replace(unfinished, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(unfinished)
        raise


def _seal(path: str, content: bytes) -> bytes:
    return hashlib.sha256(os.path.basename(path).encode() + b"\0" + content).digest()


def _is_foreign(status: os.stat_result) -> bool:
    """Whether another user than this one or root can have written a file."""
    if not hasattr(os, "geteuid"):
        return False
    return status.st_uid not in (os.geteuid(), 0) or bool(status.st_mode & 0o022)


def print_once(sentence: str) -> None:
    """Print a sentence on standard error, once in this process."""
    if sentence not in _printed:
        _printed.add(sentence)
        with contextlib.suppress(OSError, ValueError, AttributeError):  # it may be closed or None
            print(sentence, file=sys.stderr, flush=True)


def shown(stage: str) -> Any:
    """Return a context that shows progress, if upper floors are in use, and gives its callback."""
    return show(stage=stage) if show else contextlib.nullcontext(lambda *_: None)
