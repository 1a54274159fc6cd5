"""Files that are complete or absent, and errors that name the files that are damaged."""

from __future__ import annotations

import os
import secrets
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, TypeVar

from fixel.errors import DAMAGED, FixelError, InvalidInput, StoreRefused, machine_failure, reason_of

WRITABLE: Final = "a file that can be written"


@contextmanager
def usable(
    path: str | Path, expected: str, errors: type[Exception] | tuple[type[Exception], ...] = OSError
) -> Iterator[None]:
    """Raise `InvalidInput` with the path for one of these errors in the block."""
    try:
        yield
    except errors as problem:
        raise InvalidInput(str(path), found=problem, expected=expected) from None


def refuse_unwritable(path: str | Path) -> None:
    """Raise `InvalidInput` if a file cannot be written, before a long computation for it."""
    path = Path(path)
    folder = path.parent
    with usable(path, WRITABLE):
        if path.exists() and not path.is_file():
            found = "a folder" if path.is_dir() else "a device or a pipe"
            raise InvalidInput(str(path), found=found, expected="the name of a file")
        if not folder.is_dir():
            found = f"no folder {folder}"
            raise InvalidInput(str(path), found=found, expected="an existing folder")
        writable = os.access(folder, os.W_OK | os.X_OK)
    if not writable:
        raise InvalidInput(
            str(path), found="no write permission", expected="a folder with write permission"
        )


def refuse_ending(path: str | Path, endings: Sequence[str], what: str) -> None:
    """Raise `InvalidInput` for a file name whose ending is not one of `endings`."""
    ending = Path(path).suffix
    if ending.lower() not in endings:
        found = f"the ending {ending!r}" if ending else "a name without an ending"
        expected = f"a{'n' * (what[0] in 'aeiou')} {what} file: " + ", ".join(endings)
        raise InvalidInput(str(path), found=found, expected=expected)


def unfinished_path(path: Path) -> Path:
    """Return a hidden path next to a file or folder, of a name that others cannot guess."""
    return path.with_name(f".{path.stem}.{secrets.token_hex(6)}{path.suffix}")


@contextmanager
def written_whole(path: str | Path, *, durable: bool = False) -> Iterator[Path]:
    """Yield a temporary path with the suffix of `path`, which replaces it when the block ends.

    If the block is interrupted, also by Ctrl-C, the unfinished file is removed; the old one stays.
    A folder that cannot be written to, or a full disk, raises `InvalidInput`. The content of a
    `durable` file survives a power cut.
    """
    path = Path(path)
    refuse_unwritable(path)
    temporary = unfinished_path(path)
    try:
        with usable(path, WRITABLE):
            yield temporary
            if durable:
                with temporary.open("rb+") as stream:
                    os.fsync(stream.fileno())
            os.replace(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_whole(path: str | Path, content: str | bytes, *, durable: bool = False) -> None:
    """Write a file, whole or not at all; see `written_whole`."""
    with written_whole(path, durable=durable) as unfinished:
        unfinished.write_bytes(content.encode() if isinstance(content, str) else content)


def refuse_device(path: Path, expected: str) -> None:
    """Raise `InvalidInput` for a pipe or a device, whose content may never come or end."""
    with usable(path, expected):  # a name may be too long
        is_device = path.exists() and not (path.is_file() or path.is_dir())
    if is_device:
        raise InvalidInput(str(path), found="a pipe or a device", expected=expected)


def read_bounded(path: Path, kind: str, most: int, hint: str | None = None) -> bytes:
    """Load a file of at most `most` bytes; errors describe it as `kind`, such as "a plan file".

    `hint` is for a larger file.
    """
    with usable(path, kind, (OSError, ValueError)):
        size, is_file = path.stat().st_size, path.is_file()
    if not is_file:
        raise InvalidInput(str(path), found="a folder or a device", expected=kind)
    with usable(path, kind), path.open("rb") as stream:
        data = stream.read(most + 1) if size <= most else None
    if data is None or len(data) > most:
        found, expected = f"more than {most // 1_000_000} MB", f"{kind} of at most that size"
        raise InvalidInput(str(path), found=found, expected=expected, hint=hint)
    return data


def sync_folder(folder: Path) -> None:
    """Make the names of new files durable, so that they survive a power cut; POSIX only."""
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


A = TypeVar("A")
T = TypeVar("T")

# Exceptions of parsers and records for invalid content. Errors of files and locks are others.
INVALID_CONTENT: Final = (
    *(ArithmeticError, AttributeError, LookupError, RecursionError, StopIteration),
    *(TypeError, ValueError),
)
_KINDS: Final = {b"<": "a web page", b"version https://git-lfs": "a pointer of Git LFS"}
# Exceptions while a file is read: of its content, its archive, or the file itself.
_DAMAGE: Final = (
    *(*INVALID_CONTENT, EOFError, MemoryError, OSError, RuntimeError),
    *(struct.error, zipfile.BadZipFile, zlib.error),
)


@contextmanager
def readable(path: Path, hint: str = "") -> Iterator[None]:
    """Raise `StoreRefused` with the name of a file if reading it in the block fails.

    `hint` advises how to create it again; by default to restore or delete it.
    """
    try:
        yield
    except FixelError:
        raise
    except _DAMAGE as problem:
        failure = machine_failure(problem) if isinstance(problem, OSError) else None
        if failure is not None:  # the file may be whole: no advice to delete it
            raise failure from problem
        raise StoreRefused(
            f"{path} cannot be read: it is damaged, truncated or not a file of fixel",
            hint=hint or f"restore it from a copy, or delete the folder {path.parent}",
        ) from problem


@contextmanager
def parsed(path: Path, hint: str = "") -> Iterator[None]:
    """Raise `InvalidInput` for whatever the parser of another package raises on a damaged file."""
    try:
        yield
    except FixelError:
        raise
    except Exception as problem:
        expected = f"a readable {path.suffix[1:].upper()} file"
        raise unreadable(path, problem, expected, hint).at(path.name) from problem


def unreadable(path: Path, problem: Exception, expected: str, hint: str = "") -> InvalidInput:
    """Return the error for a file whose parser failed: another kind of file, or damage."""
    reason, advice = reason_of(problem), "copy or download it again"
    if reason == DAMAGED:
        with suppress(OSError), path.open("rb") as stream:
            size, start = os.fstat(stream.fileno()).st_size, stream.read(40)
            kinds = (what for front, what in _KINDS.items() if start.lstrip().startswith(front))
            reason = next(kinds, reason if start else "an empty file")
            advice += f", and compare its size of {size:,} bytes with that of the source"
    hint = (hint if reason == DAMAGED else "") or advice
    return InvalidInput(str(path), found=reason, expected=expected, hint=hint)


def one_line(problem: Exception, most: int = 200) -> str:
    """Return the text of an error on one line, or else its type."""
    return " ".join(str(problem).split())[:most] or type(problem).__name__


def each_readable(read: Callable[[A], T], every: Iterable[A]) -> tuple[list[T], list[FixelError]]:
    """Load all items that can be read, and return them with the errors of the others."""
    found: list[T] = []
    unreadable: list[FixelError] = []
    for one in every:
        try:
            found.append(read(one))
        except FixelError as problem:
            unreadable.append(problem)
    return found, unreadable
