"""Errors for truncated or overwritten files of a project, with the name of the file."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TypeVar

from fixel.errors import FixelError, InvalidInput, StoreRefused, machine_failure

A = TypeVar("A")
T = TypeVar("T")

# Exceptions of parsers and records for invalid content. Errors of files and locks are others.
INVALID_CONTENT: Final = (
    *(ArithmeticError, AttributeError, LookupError, RecursionError, StopIteration),
    *(TypeError, ValueError),
)
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
def parsed(path: Path, hint: str | None = None) -> Iterator[None]:
    """Raise `InvalidInput` for whatever the parser of another package raises on a damaged file."""
    try:
        yield
    except FixelError:
        raise
    except Exception as problem:
        found = ": ".join(filter(None, (type(problem).__name__, str(problem))))[:200]
        expected = f"a readable {path.suffix[1:].upper()} file"
        raise InvalidInput(path.name, found=found, expected=expected, hint=hint) from problem


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
