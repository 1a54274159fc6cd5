"""File locks for one process at a time, which end with the process that owns them.

The lock is one of the operating system if possible (also on NFS, through its lock service). So the
lock of a dead process does not block others, and clocks do not matter. If the file system has no
locks, a file with the owner's name is used instead.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import sys
import time
from pathlib import Path
from typing import Final, NamedTuple, Self

from fixel.errors import JobRefused

# [s] `holder` takes the lock for a moment, so `FileLock` tries again for this time.
PATIENCE_S: Final = 0.5
_QUERY: Final = 0x1000  # PROCESS_QUERY_LIMITED_INFORMATION of Windows
_STILL_ACTIVE: Final = 259  # of Windows: the exit code of a process that has not ended
_UNSUPPORTED: Final = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)


class Owner(NamedTuple):
    """Process that owns a lock, or works for a job."""

    host: str
    pid: int

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}" if self.pid else "another process"


UNKNOWN: Final = Owner("", 0)


class FileLock:
    """Lock on a file of its own, until `release` or the end of the process.

    The file is created if necessary, and not removed by `release`. If a living process owns the
    lock, raise `JobRefused`, which names the protected file `what`.
    """

    def __init__(self, path: Path, what: str) -> None:
        self._path = path
        self._descriptor = -1
        self._substitute: Path | None = None
        deadline = time.monotonic() + PATIENCE_S
        while not self._take():
            if time.monotonic() > deadline:
                hint = "wait until it has finished, or stop it"
                raise JobRefused(f"{what} is in use by {_owner(path)}", hint=hint)
            time.sleep(0.02)

    def release(self) -> None:
        """Release the lock."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
        if self._substitute is not None:
            self._substitute.unlink(missing_ok=True)
            self._substitute = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _take(self) -> bool:
        """Try to take the lock; return whether no other process has it."""
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            locked = _lock(descriptor)
            if locked is None:
                self._substitute = _substitute(self._path)
            if locked or self._substitute:
                os.ftruncate(descriptor, 0)
                os.lseek(descriptor, 0, os.SEEK_SET)
                os.write(descriptor, _this_process())
                self._descriptor = descriptor
        finally:
            if self._descriptor != descriptor:
                os.close(descriptor)
        return self._descriptor == descriptor


def holder(path: Path) -> Owner | None:
    """Return the owner of a lock, or None if there is none."""
    try:
        # Also works with permission to read only.
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return None
    try:
        locked = _lock(descriptor, shared=True)
    finally:
        os.close(descriptor)
    if locked is None:
        owner = read_owner(_substitute_of(path))
        return owner if owner and not _gone(owner) else None
    return None if locked else _owner(path)


def _owner(path: Path) -> Owner:
    return read_owner(_substitute_of(path)) or read_owner(path) or UNKNOWN


def read_owner(path: Path) -> Owner | None:
    """Load the process that a file names; None without such a file."""
    try:
        content = json.loads(path.read_bytes())
        return Owner(str(content["host"]), int(content["pid"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _this_process() -> bytes:
    return json.dumps({"host": socket.gethostname(), "pid": os.getpid()}).encode()


def _lock(descriptor: int, shared: bool = False) -> bool | None:
    """Take the lock of the operating system; return None if the file system has no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, 1 << 30, os.SEEK_SET)  # beyond the owner's name
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError as problem:
        if sys.platform == "win32" or isinstance(problem, BlockingIOError):
            return False
        if problem.errno in _UNSUPPORTED:
            return None
        raise
    return True


def _substitute_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.held")


def _substitute(path: Path) -> Path | None:
    """Create a file with the name of this process, unless a living process has created one."""
    held = _substitute_of(path)
    owner = read_owner(held)
    if owner is not None and _gone(owner):
        held.unlink(missing_ok=True)
    try:
        with open(held, "xb") as stream:
            stream.write(_this_process())
    except FileExistsError:
        return None
    return held


def _gone(owner: Owner) -> bool:
    """Whether a process has certainly ended; False for processes of other hosts."""
    return owner.host == socket.gethostname() and not is_running(owner.pid)


def is_running(pid: int) -> bool:
    """Whether a process of this machine exists."""
    if pid <= 0:
        return False
    if sys.platform == "win32":  # os.kill would send it Ctrl-C there
        import ctypes

        kernel = ctypes.windll.kernel32
        handle = kernel.OpenProcess(_QUERY, False, pid)
        code = ctypes.c_ulong()
        kernel.GetExitCodeProcess(handle, ctypes.byref(code))
        kernel.CloseHandle(handle)
        return code.value == _STILL_ACTIVE
    try:
        os.kill(pid, 0)
    except OSError as problem:
        return isinstance(problem, PermissionError)
    return True
