"""Files that are complete or absent."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fixel.errors import InvalidInput


def refuse_unwritable(path: str | Path) -> None:
    """Raise `InvalidInput` if a file cannot be written, before a long computation for it."""
    path = Path(path)
    folder = path.parent
    try:
        if path.is_dir():
            raise InvalidInput(str(path), found="a folder", expected="the name of a file")
        if not folder.is_dir():
            raise InvalidInput(
                str(path), found=f"no folder {folder}", expected="an existing folder"
            )
        writable = os.access(folder, os.W_OK | os.X_OK)
    except OSError as problem:
        raise _unwritable(path, problem) from None
    if not writable:
        raise InvalidInput(
            str(path), found="no write permission", expected="a folder with write permission"
        )


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path with the suffix of `path`, which replaces it when the block ends.

    If the block is interrupted, also by Ctrl-C, the unfinished file is removed; the old one stays.

    Raises
    ------
    InvalidInput
        The folder cannot be written to, or the disk is full.
    """
    path = Path(path)
    refuse_unwritable(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as problem:
        raise _unwritable(path, problem) from None
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _unwritable(path: Path, problem: OSError) -> InvalidInput:
    return InvalidInput(str(path), found=problem, expected="a file that can be written")
