"""Files of a project that something has cut short or written over: named, not guessed at."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TypeVar

from fixel.errors import FixelError, StoreRefused

A = TypeVar("A")
T = TypeVar("T")

# What parsers, archives and the building of records raise at content that cannot be.
_DAMAGE: Final = (
    AttributeError,
    EOFError,
    LookupError,
    OSError,
    TypeError,
    ValueError,
    zipfile.BadZipFile,
)


@contextmanager
def readable(path: Path, hint: str = "") -> Iterator[None]:
    """What is read in the block comes from this file or folder: a refusal where it cannot be.

    Parameters
    ----------
    path : Path
    hint : str
        What makes it again; restoring or deleting it where left out.

    Raises
    ------
    StoreRefused
        The file is gone, cut short or something else.
    """
    try:
        yield
    except FixelError:
        raise
    except _DAMAGE as problem:
        raise StoreRefused(
            f"{path} cannot be read: it is damaged, cut short or of another program",
            hint=hint or f"restore it from a copy, or delete the folder {path.parent}",
        ) from problem


def each_readable(read: Callable[[A], T], every: Iterable[A]) -> tuple[list[T], list[FixelError]]:
    """What can be read of several, and why the others cannot."""
    found: list[T] = []
    unreadable: list[FixelError] = []
    for one in every:
        try:
            found.append(read(one))
        except FixelError as problem:
            unreadable.append(problem)
    return found, unreadable
