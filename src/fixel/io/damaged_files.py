"""Errors for truncated or overwritten files of a project, with the name of the file."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TypeVar

from fixel.errors import FixelError, StoreRefused

A = TypeVar("A")
T = TypeVar("T")

# Exceptions of parsers, archives and records for invalid content.
DAMAGE: Final = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


@contextmanager
def readable(path: Path, hint: str = "") -> Iterator[None]:
    """Raise `StoreRefused` with the name of a file if reading it in the block fails.

    Parameters
    ----------
    path : Path
    hint : str
        Advice on how to create it again; by default to restore or delete it.

    Raises
    ------
    StoreRefused
        The file is missing, truncated or of another kind.
    """
    try:
        yield
    except FixelError:
        raise
    except DAMAGE as problem:
        raise StoreRefused(
            f"{path} cannot be read: it is damaged, truncated or not a file of fixel",
            hint=hint or f"restore it from a copy, or delete the folder {path.parent}",
        ) from problem


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
