"""Pages of the table of experiments, and counts of their values."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final, NamedTuple

import sqlalchemy as sa
from pydantic import TypeAdapter

from fixel.database import query as queries
from fixel.database.tables import experiment, flag, note
from fixel.errors import StoreRefused
from fixel.io.damaged_files import INVALID_CONTENT
from fixel.model import Flag
from fixel.model.selection import ExperimentDetails, ExperimentQuery, ExperimentRow


class ExperimentPage(NamedTuple):
    """Page of the table of experiments, with counts."""

    rows: list[ExperimentRow]
    total: int  # matching experiments on all pages
    faulty: int  # experiments with a fault, on all pages or left out
    left_out: int  # experiments that match but are left out for a fault
    details: list[ExperimentDetails]  # of each row; empty unless requested


class ConditionValues(NamedTuple):
    """Values of one condition among all experiments."""

    texts: dict[str, int]  # text -> number of experiments
    low: float | None
    high: float | None
    numbers: int  # number of experiments where it is a number


MAX_IDS: Final = 5000  # in one statement; databases limit the number of its values

# Conditions stay text until requested, since few lines of a long listing are read.
_ROW: Final = [
    sa.cast(experiment.c.conditions, sa.Text) if name == "conditions_json" else experiment.c[name]
    for name in ExperimentRow._fields
]
_CHECK: Final = TypeAdapter(ExperimentRow)
_DETAILS: Final = [
    experiment.c.content_sha256,
    experiment.c.deleted_at_utc,
    queries.BEFORE.c.error_mm2.label("before_mm2"),
    queries.AFTER.c.error_mm2.label("after_mm2"),
    experiment.c.scene.is_not(None).label("has_scene"),
]


def _checked(values: Sequence[Any]) -> ExperimentRow:
    """Return a row; raise `StoreRefused` if a value is not of its column's type."""
    with suppress(*INVALID_CONTENT):
        row = _CHECK.validate_python(values, strict=True)
        if isinstance(row.conditions, dict):
            return row
    raise StoreRefused(f"experiment {values[0]} is damaged", hint="list all errors: fixel db check")


def browse(
    connection: sa.Connection, query: ExperimentQuery | None = None, *, details: bool = False
) -> ExperimentPage:
    """Return one page of the experiments that match; `details` are their results and marks."""
    query = query or ExperimentQuery()
    dialect = connection.dialect.name
    everything = replace(query, include_faulty=True, sort="id")
    count = sa.select(sa.func.count()).select_from(queries.sources(everything))
    count = count.where(*queries.clauses(everything, dialect))
    total = int(connection.scalar(count) or 0)
    faulty = int(connection.scalar(count.where(experiment.c.id.in_(queries.FAULTY))) or 0)
    left_out = faulty if query.omits_faulty else 0
    wanted = (
        sa.select(*_ROW, *(_DETAILS if details else ()))
        .select_from(queries.WITH_ERRORS if details else queries.sources(query))
        .where(*queries.clauses(query, dialect))
        .order_by(*queries.order(query, dialect))
        .limit(query.limit)
        .offset(query.offset)
    )
    found = list(connection.execute(wanted))
    rows = [_checked(row[: len(_ROW)]) for row in found]
    more = []
    if details:
        ids = [row.id for row in rows]
        marked = _by(connection, ids, flag, flag.c.name, flag.c.detail, flag.c.is_fault)
        notes = _by(connection, ids, note, note.c.text)
        more = [
            ExperimentDetails(
                content_sha256=row.content_sha256,
                deleted_at_utc=row.deleted_at_utc,
                before_mm2=row.before_mm2,
                after_mm2=row.after_mm2,
                has_scene=row.has_scene,
                flags=[Flag(*own) for own in marked.get(row.id, ())],
                notes=[text for (text,) in notes.get(row.id, ())],
            )
            for row in found
        ]
    return ExperimentPage(rows, total - left_out, faulty, left_out, more)


def ids(
    connection: sa.Connection, query: ExperimentQuery, *more: sa.ColumnElement[bool]
) -> list[int]:
    """Ids of the matching experiments on all pages, in the order of the query."""
    dialect = connection.dialect.name
    wanted = (
        sa.select(experiment.c.id)
        .select_from(queries.sources(query))
        .where(*queries.clauses(query, dialect), *more)
        .order_by(*queries.order(query, dialect))
    )
    return list(connection.scalars(wanted))


def unsimulated(connection: sa.Connection, query: ExperimentQuery) -> list[int]:
    """Ids of matching experiments with a scene but no simulation with nominal parameters."""
    return ids(
        connection,
        query,
        experiment.c.deleted_at_utc.is_(None),
        experiment.c.scene.is_not(None),
        experiment.c.id.not_in(sa.select(queries.NEWEST_NOMINAL.c.experiment_id)),
    )


def checksum(connection: sa.Connection, experiment_ids: Iterable[int]) -> str:
    """SHA-256 of the content of experiments, independent of their order."""
    wanted = set(experiment_ids)
    listed = connection.execute(sa.select(experiment.c.id, experiment.c.content_sha256))
    sums = sorted(content for experiment_id, content in listed if experiment_id in wanted)
    return hashlib.sha256("".join(sums).encode()).hexdigest()


def datasets(connection: sa.Connection) -> dict[str, int]:
    """Number of experiments in each dataset, including flagged ones."""
    name = experiment.c.dataset
    counted = sa.select(name, sa.func.count()).where(*queries.LIVE).group_by(name).order_by(name)
    return {name: n for name, n in connection.execute(counted)}


def flags(connection: sa.Connection) -> dict[str, int]:
    """Number of experiments with each flag."""
    counted = (
        sa.select(flag.c.name, sa.func.count(sa.distinct(flag.c.experiment_id)))
        .join(experiment)
        .where(flag.c.deleted_at_utc.is_(None), *queries.LIVE)
        .group_by(flag.c.name)
        .order_by(flag.c.name)
    )
    return {name: n for name, n in connection.execute(counted)}


def tally(
    connection: sa.Connection, query: ExperimentQuery, names: Sequence[str]
) -> list[tuple[Any, ...]]:
    """Count distinct combinations of values: one text, number or None per name, then the count."""
    dialect = connection.dialect.name
    chosen = [queries.expressions(dialect, name) for name in names]
    every = (
        sa.select(*(e.label(f"c{k}") for k, e in enumerate(e for some in chosen for e in some)))
        .select_from(queries.sources(query, names))
        .where(*queries.clauses(query, dialect))
        .subquery()
    )
    grouped = sa.select(*every.c, sa.func.count()).group_by(*every.c)
    found = connection.execute(grouped).all()
    if not found:
        return []
    cells: Iterator[Sequence[Any]] = zip(*found, strict=True)
    columns = [
        _values(name, *(next(cells) for _ in some))
        for name, some in zip(names, chosen, strict=True)
    ]
    return list(zip(*columns, next(cells), strict=True))


def _values(
    name: str, values: Sequence[Any], numbers: Sequence[Any] | None = None
) -> Sequence[Any]:
    if numbers is not None:
        return [text if n is None else n for text, n in zip(values, numbers, strict=True)]
    return [None if v is None else v**0.5 for v in values] if name in queries.SQUARES else values


def conditions(connection: sa.Connection) -> dict[str, ConditionValues]:
    """Values of all conditions of experiments that are not deleted, by name."""
    every = _each_condition(connection)
    grouped = sa.select(
        every.c.name,
        every.c.text,
        sa.func.min(every.c.number),
        sa.func.max(every.c.number),
        sa.func.count(),
    ).group_by(every.c.name, every.c.text)
    texts: dict[str, dict[str, int]] = {}
    numbers: dict[str, tuple[float | None, float | None, int]] = {}
    for name, text, low, high, n in connection.execute(grouped):
        texts.setdefault(name, {})
        if text is None:
            numbers[name] = (low, high, n)
        else:
            texts[name][text] = n
    return {
        name: ConditionValues(own, *numbers.get(name, (None, None, 0)))
        for name, own in texts.items()
    }


def _each_condition(connection: sa.Connection) -> sa.Subquery:
    """Subquery with one row per condition of each experiment: name, number and text."""
    if connection.dialect.name == "postgresql":
        each = sa.func.json_each(experiment.c.conditions).table_valued("key", "value")
        text: Any = each.c.value.op("#>>")(sa.literal_column("'{}'"))
        is_number: Any = sa.func.json_typeof(each.c.value) == "number"
    else:
        each = sa.func.json_each(experiment.c.conditions).table_valued("key", "value", "type")
        text, is_number = each.c.value, each.c.type.in_(("integer", "real"))
    return (
        sa.select(
            each.c.key.label("name"),
            sa.case((is_number, sa.cast(text, sa.Float)), else_=None).label("number"),
            sa.case((~is_number, sa.cast(text, sa.Text)), else_=None).label("text"),
        )
        .select_from(experiment.join(each, sa.true()))
        .where(experiment.c.deleted_at_utc.is_(None))
        .subquery()
    )


def _by(
    connection: sa.Connection, ids: Sequence[int], table: sa.Table, *columns: sa.Column[Any]
) -> dict[int, list[Sequence[Any]]]:
    """Return the rows of a table that belong to experiments, by experiment, oldest first."""
    found: dict[int, list[Sequence[Any]]] = {}
    for first in range(0, len(ids), MAX_IDS):
        wanted = (
            sa.select(table.c.experiment_id, *columns)
            .where(table.c.experiment_id.in_(ids[first : first + MAX_IDS]))
            .where(table.c.deleted_at_utc.is_(None))
            .order_by(table.c.id)
        )
        for owner, *row in connection.execute(wanted):
            found.setdefault(owner, []).append(row)
    return found
