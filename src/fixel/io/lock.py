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
from typing import Final, NamedTuple, Self, final

from fixel.errors import JobRefused

# [s] `holder` takes the lock for a moment, so `FileLock` tries again for this time.
PATIENCE_S: Final = 0.5
_UNSUPPORTED: Final = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)


class Owner(NamedTuple):
    """Process that owns a lock."""

    host: str
    pid: int

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}" if self.pid else "another process"


UNKNOWN: Final = Owner("", 0)


class _LockTaken(Exception):
    """Exception raised when another process owns the lock."""


@final
class FileLock:
    """Lock on a file of its own, until `release` or the end of the process.

    Parameters
    ----------
    path : Path
        File of the lock; created if necessary, and not removed by `release`.
    what : str
        Name of the protected file in the error: `"the journal jobs/one/journal"`.

    Raises
    ------
    JobRefused
        A living process owns the lock.
    """

    def __init__(self, path: Path, what: str) -> None:
        self._path = path
        self._substitute: Path | None = None
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                self._descriptor = self._take()
                return
            except _LockTaken:
                if time.monotonic() > deadline:
                    raise JobRefused(
                        f"{what} is in use by {_owner(path)}", hint="wait for it, or end it"
                    ) from None
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

    def _take(self) -> int:
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            if not _locked(descriptor):
                self._substitute = _substitute(self._path)
            text = json.dumps({"host": socket.gethostname(), "pid": os.getpid()}).encode()
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, text, 0)
        except BaseException:
            os.close(descriptor)
            raise
        return descriptor


def holder(path: Path) -> Owner | None:
    """Return the owner of a lock, or None if there is none."""
    try:
        # Also works with permission to read only.
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return None
    try:
        if _locked(descriptor, shared=True):
            return None
        substitute = _read_owner(_substitute_of(path))
        return substitute if substitute and not _gone(substitute) else None
    except _LockTaken:
        return _owner(path)
    finally:
        os.close(descriptor)


def _owner(path: Path) -> Owner:
    return _read_owner(_substitute_of(path)) or _read_owner(path) or UNKNOWN


def _read_owner(path: Path) -> Owner | None:
    try:
        content = json.loads(path.read_bytes())
        return Owner(str(content["host"]), int(content["pid"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


if sys.platform == "win32":
    import msvcrt

    def _locked(descriptor: int, shared: bool = False) -> bool:
        """Take the lock of the operating system; return False if there is none."""
        os.lseek(descriptor, 1 << 30, os.SEEK_SET)  # beyond the owner's name, which stays readable
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            raise _LockTaken from None
        return True

else:
    import fcntl

    def _locked(descriptor: int, shared: bool = False) -> bool:
        """Take the lock of the operating system; return False if there is none."""
        try:
            fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _LockTaken from None
        except OSError as problem:
            if problem.errno in _UNSUPPORTED:
                return False
            raise
        return True


def _substitute_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.held")


def _substitute(path: Path) -> Path:
    """Create a file with the name of this process, unless a living process has created one."""
    held = _substitute_of(path)
    owner = _read_owner(held)
    if owner is not None and _gone(owner):
        held.unlink(missing_ok=True)
    try:
        descriptor = os.open(held, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
    except FileExistsError:
        raise _LockTaken from None
    with os.fdopen(descriptor, "w") as stream:
        json.dump({"host": socket.gethostname(), "pid": os.getpid()}, stream)
    return held


def _gone(owner: Owner) -> bool:
    """Whether a process has certainly ended; False for processes of other hosts."""
    if owner.host != socket.gethostname():
        return False
    try:
        os.kill(owner.pid, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False
