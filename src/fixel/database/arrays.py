"""Numeric tables as rows of `series`: in the database, or as files above a size limit."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from string import hexdigits
from typing import Any

import numpy as np
import sqlalchemy as sa

from fixel.database.tables import MEDIA_BYTES, series
from fixel.errors import InvalidInput, StoreRefused, os_reason
from fixel.io.atomic import sync_folder, write_whole
from fixel.typing import FloatArray


def bytes_of(values: FloatArray) -> bytes:
    """Return (n, k) numbers as bytes: float64, row by row, little-endian."""
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def array_of(data: bytes, n_row: int, n_column: int) -> FloatArray:
    """Inverse of `bytes_of`."""
    return np.frombuffer(data, dtype="<f8").reshape(n_row, n_column).astype(np.float64)


def rows_of(
    owner: str, several: Iterable[tuple[str, tuple[str, ...], FloatArray]], media: Path
) -> list[dict[str, Any]]:
    """Rows of `series` without their owner's id; data above `MEDIA_BYTES` are written to files.

    Each series has a name, columns and values (n, n_column).
    """
    found = []
    for place, (name, columns, values) in enumerate(several):
        data = bytes_of(values)
        is_long = len(data) > MEDIA_BYTES
        row = {"owner": owner, "place": place, "name": name, "columns": list(columns)}
        row |= {"n_row": len(values), "data": None if is_long else data}
        found.append(row | {"media_sha256": keep(data, media) if is_long else None})
    return found


def read_all(
    connection: sa.Connection, owner: str, owner_id: int, media: Path
) -> list[tuple[str, tuple[str, ...], FloatArray]]:
    """Name, columns and (n, k) values of all series of a record, in order."""
    return [
        (
            row["name"],
            tuple(row["columns"]),
            array_of(
                fetch(row["media_sha256"], media) if row["data"] is None else row["data"],
                row["n_row"],
                len(row["columns"]),
            ),
        )
        for row in stored_rows(connection, owner, owner_id)
    ]


def stored_rows(connection: sa.Connection, owner: str, owner_id: int) -> list[dict[str, Any]]:
    """Return the rows of a record's series as `rows_of` does; no media file is read."""
    shown = [column for column in series.c if column.name not in ("id", "owner_id")]
    own = (series.c.owner == owner, series.c.owner_id == owner_id)
    wanted = sa.select(*shown).where(*own).order_by(series.c.place)
    return [row._asdict() for row in connection.execute(wanted)]


def keep(data: bytes, media: Path) -> str:
    """Write bytes to the media folder under their SHA-256, unless already there; return it."""
    digest = hashlib.sha256(data).hexdigest()
    path = media_path(digest, media)
    if path.exists():
        return digest
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, data, durable=True)
        sync_folder(path.parent)
    except (OSError, InvalidInput) as problem:
        why = problem.found if isinstance(problem, InvalidInput) else os_reason(problem)
        refused = f"{media} cannot be written to: {why}"
        hint = "make the folder writable, or free disk space"
        raise StoreRefused(refused, hint) from None
    return digest


def fetch(digest: str, media: Path) -> bytes:
    """Load the media file of a checksum; raise `StoreRefused` if it is missing or has changed."""
    path = media_path(digest, media)
    try:
        data = path.read_bytes()
    except OSError:
        raise lost(path, "is missing") from None
    if hashlib.sha256(data).hexdigest() != digest:
        raise lost(path, "has changed")
    return data


def lost(path: Path, how: str) -> StoreRefused:
    """Return the error for a media file that `is missing` or `has changed`."""
    return StoreRefused(
        f"the file {path} {how}", hint="restore it from a backup of the media folder"
    )


def media_path(digest: str, media: Path) -> Path:
    """Path of the media file with a checksum; raise `StoreRefused` for what is none."""
    if len(digest) != 64 or set(digest) - set(hexdigits):
        raise lost(media / digest[:2], f"is named {digest[:80]!r}, which is no checksum")
    return media / digest[:2] / digest
