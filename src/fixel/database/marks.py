"""Flags, notes and deletions of many experiments in one transaction.

Experiments that already have a mark are left unchanged. Functions return the ids that changed, so
that an undo changes those only.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import sqlalchemy as sa

from fixel.database import rows, schema
from fixel.database.engine import insert_one
from fixel.errors import LIST_EXPERIMENTS, InvalidInput, NotStored
from fixel.model import Flag

MAX_TEXT = 10_000  # characters of a note


class Note(NamedTuple):
    """Note that a user attached to an experiment."""

    id: int
    text: str
    created: str  # as ISO 8601 in UTC


def flag(connection: sa.Connection, experiment_ids: Iterable[int], flag: Flag) -> list[int]:
    """Add a flag to experiments that do not have it; return their ids."""
    wanted = _known(connection, schema.experiment, experiment_ids)
    new = sorted({*wanted}.difference(_carrying(connection, wanted, flag.name)))
    if new:
        connection.execute(sa.insert(schema.flag), [flag_row(one, flag) for one in new])
    return new


def flag_row(experiment_id: int, flag: Flag) -> dict[str, Any]:
    """Columns of a flag."""
    return {
        "experiment_id": experiment_id,
        "name": flag.name,
        "detail": flag.detail,
        "is_fault": flag.fault,
        "created_at_utc": rows.now(),
    }


def unflag(connection: sa.Connection, experiment_ids: Iterable[int], name: str) -> list[int]:
    """Remove a flag from experiments; return the ids of those that had it."""
    wanted = _known(connection, schema.experiment, experiment_ids)
    had = _carrying(connection, wanted, name)
    flag = schema.flag
    connection.execute(
        sa.update(flag)
        .where(flag.c.experiment_id.in_(had), flag.c.name == name, flag.c.deleted_at_utc.is_(None))
        .values(deleted_at_utc=rows.now())
    )
    return had


def delete(
    connection: sa.Connection, experiment_ids: Iterable[int], *, back: bool = False
) -> list[int]:
    """Delete experiments, or restore them; return the changed ids."""
    return _mark(connection, schema.experiment, experiment_ids, back)


def annotate(connection: sa.Connection, experiment_ids: Iterable[int], text: str) -> list[int]:
    """Attach a note to each experiment; return the ids of the notes."""
    text = text.strip()
    if not text or len(text) > MAX_TEXT:
        raise InvalidInput(
            "note.text", found=f"{len(text)} characters", expected=f"1 to {MAX_TEXT} characters"
        )
    wanted = _known(connection, schema.experiment, experiment_ids)
    row = {"text": text, "created_at_utc": rows.now()}
    return [insert_one(connection, schema.note, row | {"experiment_id": one}) for one in wanted]


def delete_notes(
    connection: sa.Connection, notes: Iterable[int], *, back: bool = False
) -> list[int]:
    """Delete notes by their ids, or restore them; return the changed ids."""
    return _mark(connection, schema.note, notes, back)


def notes_of(connection: sa.Connection, experiment_id: int) -> list[Note]:
    """Notes of an experiment, oldest first."""
    note = schema.note
    wanted = (
        sa.select(note.c.id, note.c.text, note.c.created_at_utc)
        .where(note.c.experiment_id == experiment_id, note.c.deleted_at_utc.is_(None))
        .order_by(note.c.id)
    )
    return [Note(*row) for row in connection.execute(wanted)]


def _mark(
    connection: sa.Connection, table: sa.Table, numbers: Iterable[int], back: bool
) -> list[int]:
    wanted = _known(connection, table, numbers)
    gone = table.c.deleted_at_utc
    other = gone.is_not(None) if back else gone.is_(None)
    found = connection.scalars(sa.select(table.c.id).where(table.c.id.in_(wanted), other))
    changed = sorted(found)
    connection.execute(
        sa.update(table)
        .where(table.c.id.in_(changed))
        .values(deleted_at_utc=None if back else rows.now())
    )
    return changed


def _carrying(connection: sa.Connection, experiment_ids: list[int], name: str) -> list[int]:
    flag = schema.flag
    found = connection.scalars(
        sa.select(flag.c.experiment_id)
        .where(
            flag.c.experiment_id.in_(experiment_ids),
            flag.c.name == name,
            flag.c.deleted_at_utc.is_(None),
        )
        .distinct()
    )
    return sorted(found)


def _known(connection: sa.Connection, table: sa.Table, numbers: Iterable[int]) -> list[int]:
    """Return the ids sorted and without duplicates; raise `NotStored` for the first missing one."""
    wanted = sorted(set(numbers))
    found = set(connection.scalars(sa.select(table.c.id).where(table.c.id.in_(wanted))))
    if missing := [number for number in wanted if number not in found]:
        raise NotStored(f"{table.name} {missing[0]}", hint=LIST_EXPERIMENTS)
    return wanted
