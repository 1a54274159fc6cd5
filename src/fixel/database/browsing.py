"""Pages of the table of experiments, and counts of their values."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import sqlalchemy as sa

from fixel.database.query import (
    AFTER,
    BEFORE,
    FAULTY,
    NEWEST_NOMINAL,
    SQUARES,
    WITH_ERRORS,
    ExperimentQuery,
    clauses,
    expressions,
    order,
    sources,
)
from fixel.database.tables import experiment, flag, note
from fixel.model import Flag
from fixel.model.trajectory import turned


class ExperimentRow(NamedTuple):
    """Row of the table of experiments: one experiment without its series."""

    id: int
    dataset: str
    name: str
    is_real: bool
    n_frame: int
    duration_s: float
    start_x_m: float
    start_y_m: float
    start_theta_rad: float
    end_x_m: float
    end_y_m: float
    end_theta_rad: float
    contact_mode: str
    conditions_json: str
    created_at_utc: str

    @property
    def conditions(self) -> dict[str, str | float]:
        """Further recorded conditions, by name."""
        found: dict[str, str | float] = json.loads(self.conditions_json)
        return found

    @property
    def key(self) -> str:
        """Dataset and name, joined by a slash."""
        return f"{self.dataset}/{self.name}"

    @property
    def moved_m(self) -> float:
        """Distance between the positions at the start and at the end [m]."""
        dx, dy = self.end_x_m - self.start_x_m, self.end_y_m - self.start_y_m
        return float((dx * dx + dy * dy) ** 0.5)

    @property
    def turned_rad(self) -> float:
        """Rotation from the start to the end [rad]."""
        return turned(self.start_theta_rad, self.end_theta_rad, self.n_frame)


class ExperimentDetails(NamedTuple):
    """Results and marks of an experiment on a page."""

    content_sha256: str
    deleted_at_utc: str | None
    before_mm2: float | None  # error of the newest simulation with nominal values
    after_mm2: float | None  # error of the newest calibration that it is a member of
    flags: list[Flag]
    notes: int


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


# Conditions stay text until requested, since few lines of a long listing are read.
_ROW: Final = [
    sa.cast(experiment.c.conditions, sa.Text) if name == "conditions_json" else experiment.c[name]
    for name in ExperimentRow._fields
]
_DETAILS: Final = [
    experiment.c.content_sha256,
    experiment.c.deleted_at_utc,
    BEFORE.c.error_mm2.label("before_mm2"),
    AFTER.c.error_mm2.label("after_mm2"),
]


def browse(
    connection: sa.Connection, query: ExperimentQuery, *, details: bool = False
) -> ExperimentPage:
    """Return one page of the table, with the numbers of matching and of faulty experiments."""
    dialect = connection.dialect.name
    everything = replace(query, include_faulty=True, sort="id")
    count = sa.select(sa.func.count()).select_from(sources(everything))
    count = count.where(*clauses(everything, dialect))
    total = int(connection.scalar(count) or 0)
    faulty = int(connection.scalar(count.where(experiment.c.id.in_(FAULTY))) or 0)
    left_out = faulty if query.omits_faulty else 0
    wanted = (
        sa.select(*_ROW, *(_DETAILS if details else ()))
        .select_from(WITH_ERRORS if details else sources(query))
        .where(*clauses(query, dialect))
        .order_by(*order(query, dialect))
        .limit(query.limit)
        .offset(query.offset)
    )
    found = list(connection.execute(wanted))
    rows = [ExperimentRow._make(row[: len(_ROW)]) for row in found]
    more = []
    if details:
        ids = [row.id for row in rows]
        flags, notes = _flags(connection, ids), _n_notes(connection, ids)
        more = [
            ExperimentDetails(
                content_sha256=row.content_sha256,
                deleted_at_utc=row.deleted_at_utc,
                before_mm2=row.before_mm2,
                after_mm2=row.after_mm2,
                flags=flags.get(row.id, []),
                notes=notes.get(row.id, 0),
            )
            for row in found
        ]
    return ExperimentPage(rows, total - left_out, faulty, left_out, more)


def ids(connection: sa.Connection, query: ExperimentQuery) -> list[int]:
    """Ids of the matching experiments on all pages, in the order of the query."""
    wanted = (
        sa.select(experiment.c.id)
        .select_from(sources(query))
        .where(*clauses(query, connection.dialect.name))
        .order_by(*order(query, connection.dialect.name))
    )
    return list(connection.scalars(wanted))


def unsimulated(connection: sa.Connection, query: ExperimentQuery) -> list[int]:
    """Ids of matching experiments with a scene but no simulation with nominal parameters yet."""
    wanted = (
        sa.select(experiment.c.id)
        .select_from(WITH_ERRORS)
        .where(
            *clauses(query, connection.dialect.name),
            experiment.c.deleted_at_utc.is_(None),
            experiment.c.scene.is_not(None),
            experiment.c.id.not_in(sa.select(NEWEST_NOMINAL.c.experiment_id)),
        )
        .order_by(*order(query, connection.dialect.name))
    )
    return list(connection.scalars(wanted))


def tally(
    connection: sa.Connection, query: ExperimentQuery, names: Sequence[str]
) -> list[tuple[Any, ...]]:
    """Count distinct combinations of values: one text, number or None per name, then the count."""
    dialect = connection.dialect.name
    chosen = [expressions(dialect, name) for name in names]
    every = (
        sa.select(*(e.label(f"c{k}") for k, e in enumerate(e for some in chosen for e in some)))
        .select_from(sources(query, names))
        .where(*clauses(query, dialect))
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
    return [None if v is None else v**0.5 for v in values] if name in SQUARES else values


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


def _flags(connection: sa.Connection, experiment_ids: list[int]) -> dict[int, list[Flag]]:
    wanted = (
        sa.select(flag.c.experiment_id, flag.c.name, flag.c.detail, flag.c.is_fault)
        .where(flag.c.experiment_id.in_(experiment_ids), flag.c.deleted_at_utc.is_(None))
        .order_by(flag.c.id)
    )
    found: dict[int, list[Flag]] = {}
    for experiment_id, *one in connection.execute(wanted):
        found.setdefault(experiment_id, []).append(Flag(*one))
    return found


def _n_notes(connection: sa.Connection, experiment_ids: list[int]) -> dict[int, int]:
    wanted = (
        sa.select(note.c.experiment_id, sa.func.count())
        .where(note.c.experiment_id.in_(experiment_ids), note.c.deleted_at_utc.is_(None))
        .group_by(note.c.experiment_id)
    )
    return {experiment_id: n for experiment_id, n in connection.execute(wanted)}
