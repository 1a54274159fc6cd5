"""Queries for experiments as SQL clauses; pages of the table of experiments, and counts."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final, NamedTuple

import sqlalchemy as sa
from pydantic import TypeAdapter

from fixel.database import rows
from fixel.database.schema import (
    calibration,
    calibration_member,
    experiment,
    flag,
    note,
    simulation,
    system_parameters,
)
from fixel.errors import InvalidInput, StoreRefused
from fixel.io.atomic import INVALID_CONTENT
from fixel.model import Flag, selection

ALL_EXPERIMENTS: Final = selection.ExperimentQuery(include_faulty=True, marks=("replaced",))

# --- columns ----------------------------------------------------------------------------------

# Errors of the newest simulation with nominal values, and of the newest calibration. Simulations by
# another motion model or engine are not among the first; those of earlier versions name none.
_NOMINAL: Final = rows.parameters_row({})["content_sha256"]
NEWEST_NOMINAL = (
    sa.select(simulation.c.experiment_id, sa.func.max(simulation.c.id).label("id"))
    .join(system_parameters, system_parameters.c.id == simulation.c.system_parameters_id)
    .where(
        simulation.c.deleted_at_utc.is_(None),
        system_parameters.c.content_sha256 == _NOMINAL,
        simulation.c.source_file == "",  # not by the publisher of the data
        sa.func.coalesce(simulation.c.method["motion"].as_string(), "dynamic") == "dynamic",
    )
    .group_by(simulation.c.experiment_id)
    .subquery("newest_nominal")
)
BEFORE = (
    sa.select(simulation.c.experiment_id, simulation.c.error_mm2)
    .join(NEWEST_NOMINAL, NEWEST_NOMINAL.c.id == simulation.c.id)
    .subquery("before")
)
_last = (
    sa.select(
        calibration_member.c.experiment_id,
        sa.func.max(calibration_member.c.calibration_id).label("calibration_id"),
    )
    .join(calibration, calibration.c.id == calibration_member.c.calibration_id)
    .where(calibration.c.deleted_at_utc.is_(None))
    .group_by(calibration_member.c.experiment_id)
    .subquery("newest_calibration")
)
AFTER = (
    sa.select(
        calibration_member.c.experiment_id,
        sa.func.max(calibration_member.c.error_mm2).label("error_mm2"),
    )
    .join(
        _last,
        sa.and_(
            _last.c.calibration_id == calibration_member.c.calibration_id,
            _last.c.experiment_id == calibration_member.c.experiment_id,
        ),
    )
    .group_by(calibration_member.c.experiment_id)
    .subquery("after")
)
WITH_ERRORS = experiment.outerjoin(BEFORE, BEFORE.c.experiment_id == experiment.c.id).outerjoin(
    AFTER, AFTER.c.experiment_id == experiment.c.id
)

# Subqueries of ids instead of one lookup per row: a server without table statistics would scan
# whole tables for each row.
_live_flag = flag.c.deleted_at_utc.is_(None)
_FLAGGED = sa.select(flag.c.experiment_id).where(_live_flag)
FAULTY = _FLAGGED.where(flag.c.is_fault)
_NOTED = sa.select(note.c.experiment_id).where(note.c.deleted_at_utc.is_(None))
_REPLACED = sa.select(experiment.c.replaces_id).where(
    experiment.c.replaces_id.is_not(None), experiment.c.deleted_at_utc.is_(None)
)
LIVE: Final = (experiment.c.deleted_at_utc.is_(None), experiment.c.id.not_in(_REPLACED))
_n_flag = (
    sa.select(sa.func.count())
    .where(flag.c.experiment_id == experiment.c.id, _live_flag)
    .scalar_subquery()
)
_n_note = (
    sa.select(sa.func.count())
    .where(note.c.experiment_id == experiment.c.id, note.c.deleted_at_utc.is_(None))
    .scalar_subquery()
)
_dx = experiment.c.end_x_m - experiment.c.start_x_m
_dy = experiment.c.end_y_m - experiment.c.start_y_m
# Same rule as `model.trajectory.turned`.
_angle: Final = experiment.c.end_theta_rad - experiment.c.start_theta_rad
_turned: Final = sa.case(
    (experiment.c.n_frame > 2, _angle),
    (_angle >= math.pi, _angle - 2.0 * math.pi),
    (_angle < -math.pi, _angle + 2.0 * math.pi),
    else_=_angle,
)

# Squares instead of roots: the order is the same, and not every database has a square root.
SQUARES: Final[dict[str, sa.ColumnElement[Any]]] = {
    "moved_m": _dx * _dx + _dy * _dy,
    "before_mm": BEFORE.c.error_mm2,
    "after_mm": AFTER.c.error_mm2,
    "error_mm": sa.func.coalesce(AFTER.c.error_mm2, BEFORE.c.error_mm2),
}
COLUMNS: Final = {
    **{name: experiment.c[own] for name, own in (selection.TEXTS | selection.NUMBERS).items()},
    **{"turned_rad": _turned, "flags": _n_flag, "notes": _n_note},
    **SQUARES,
}


def expressions(dialect: str, name: str) -> tuple[sa.ColumnElement[Any], ...]:
    """SQL expressions of a name: one of a column, or text and number (else null) of a condition."""
    if name in COLUMNS:
        return (COLUMNS[name],)
    if not re.fullmatch(r"\w[\w. -]{0,99}", name):
        raise InvalidInput(
            "column", found=repr(name), expected="a column or the name of a condition"
        )
    entry = experiment.c.conditions[name]
    kind = (
        sa.func.json_typeof(entry).in_(("number",))
        if dialect == "postgresql"
        else sa.func.json_type(experiment.c.conditions, f'$."{name}"').in_(("integer", "real"))
    )
    return entry.as_string(), sa.case((kind, entry.as_float()), else_=None)


# --- clauses ----------------------------------------------------------------------------------


def sources(query: selection.ExperimentQuery, names: Iterable[str] = ()) -> sa.FromClause:
    """Tables to select from; errors are joined only where the query or a name refers to them."""
    named = {query.sort, *names, *(bound.name for bound in query.bounds)}
    return WITH_ERRORS if named.intersection(selection.ERRORS) else experiment


def clauses(query: selection.ExperimentQuery, dialect: str) -> list[Any]:
    """SQL clauses that select the experiments of a query."""
    gone = experiment.c.deleted_at_utc
    found: list[Any] = [gone.is_not(None) if "deleted" in query.marks else gone.is_(None)]
    if "replaced" not in query.marks:
        found.append(experiment.c.id.not_in(_REPLACED))
    if query.dataset is not None:
        found.append(experiment.c.dataset == query.dataset)
    if query.name is not None:
        pattern = _escaped(query.name).replace("*", "%")
        found.append(experiment.c.name.like(pattern, escape="\\"))
    meaning: dict[str, Any] = {
        "clean": experiment.c.id.not_in(FAULTY),
        "faulty": experiment.c.id.in_(FAULTY),
        "flagged": experiment.c.id.in_(_FLAGGED),
        "noted": experiment.c.id.in_(_NOTED),
        "real": experiment.c.is_real,
        "simulated": ~experiment.c.is_real,
    }
    found += [meaning[mark] for mark in query.marks if mark in meaning]
    found += [meaning["clean"]] if query.omits_faulty else []
    found += [experiment.c.id.in_(_FLAGGED.where(flag.c.name == name)) for name in query.flags]
    found += [_bound_holds(dialect, bound) for bound in query.bounds]
    return found + [_has_word(word) for word in query.words]


def order(query: selection.ExperimentQuery, dialect: str) -> list[Any]:
    """Clauses of ORDER BY: nulls come last in both directions, ties are ordered by id."""
    found: list[Any] = []
    for key in reversed(expressions(dialect, query.sort)):  # numbers before texts
        found += [] if query.sort in ("id", "created", "frames") else [key.is_(None)]
        found.append(key.desc() if query.descending else key.asc())
    return [*found, experiment.c.id.desc() if query.descending else experiment.c.id.asc()]


def _bound_holds(dialect: str, bound: selection.Bound) -> Any:
    relate = selection.RELATIONS[bound.relation]
    if bound.name in selection.TEXTS:
        return relate(COLUMNS[bound.name], bound.typed)
    if bound.name not in COLUMNS:
        return _condition_holds(dialect, bound)
    return relate(COLUMNS[bound.name], bound.limit)


def _condition_holds(dialect: str, bound: selection.Bound) -> Any:
    """SQL clause for `fixel.model.selection._condition_holds`."""
    text, number = expressions(dialect, bound.name)
    if bound.relation not in ("=", "!="):
        return selection.RELATIONS[bound.relation](number, bound.limit)
    same: Any = sa.and_(number.is_(None), text.is_not(None), text == bound.typed)
    if not isinstance(bound.value, str):
        same = sa.or_(same, sa.and_(number.is_not(None), number == bound.value))
    return same if bound.relation == "=" else sa.not_(sa.func.coalesce(same, sa.false()))


def _has_word(word: str) -> Any:
    pattern = f"%{_escaped(word)}%"
    flags = _FLAGGED.where(
        sa.or_(flag.c.name.ilike(pattern, escape="\\"), flag.c.detail.ilike(pattern, escape="\\"))
    )
    return sa.or_(
        (experiment.c.dataset + "/" + experiment.c.name).ilike(pattern, escape="\\"),
        sa.cast(experiment.c.conditions, sa.Text).ilike(pattern, escape="\\"),
        experiment.c.id.in_(flags),
        experiment.c.id.in_(_NOTED.where(note.c.text.ilike(pattern, escape="\\"))),
    )


def _escaped(text: str) -> str:
    """Text for LIKE, in which no character stands for others."""
    return re.sub(r"([\\%_])", r"\\\1", text)


class ExperimentPage(NamedTuple):
    """Page of the table of experiments, with counts."""

    rows: list[selection.ExperimentRow]
    total: int  # matching experiments on all pages
    faulty: int  # experiments with a fault, on all pages or left out
    left_out: int  # experiments that match but are left out for a fault
    details: list[selection.ExperimentDetails]  # of each row; empty unless requested


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
    for name in selection.ExperimentRow._fields
]
_CHECK: Final = TypeAdapter(selection.ExperimentRow)
_DETAILS: Final = [
    experiment.c.content_sha256,
    experiment.c.deleted_at_utc,
    BEFORE.c.error_mm2.label("before_mm2"),
    AFTER.c.error_mm2.label("after_mm2"),
    experiment.c.scene.is_not(None).label("has_scene"),
]


def _checked(values: Sequence[Any]) -> selection.ExperimentRow:
    """Return a row; raise `StoreRefused` if a value is not of its column's type."""
    with suppress(*INVALID_CONTENT):
        row = _CHECK.validate_python(values, strict=True)
        if isinstance(row.conditions, dict):
            return row
    raise StoreRefused(f"experiment {values[0]} is damaged", hint="list all errors: fixel db check")


def browse(
    connection: sa.Connection,
    query: selection.ExperimentQuery | None = None,
    *,
    details: bool = False,
) -> ExperimentPage:
    """Return one page of the experiments that match; `details` are their results and marks."""
    query = query or selection.ExperimentQuery()
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
    rows = [_checked(row[: len(_ROW)]) for row in found]
    more = []
    if details:
        ids = [row.id for row in rows]
        marked = _by(connection, ids, flag, flag.c.name, flag.c.detail, flag.c.is_fault)
        notes = _by(connection, ids, note, note.c.text)
        more = [
            selection.ExperimentDetails(
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
    connection: sa.Connection, query: selection.ExperimentQuery, *more: sa.ColumnElement[bool]
) -> list[int]:
    """Ids of the matching experiments on all pages, in the order of the query."""
    dialect = connection.dialect.name
    wanted = (
        sa.select(experiment.c.id)
        .select_from(sources(query))
        .where(*clauses(query, dialect), *more)
        .order_by(*order(query, dialect))
    )
    return list(connection.scalars(wanted))


def unsimulated(connection: sa.Connection, query: selection.ExperimentQuery) -> list[int]:
    """Ids of matching experiments with a scene but no simulation with nominal parameters."""
    return ids(
        connection,
        query,
        experiment.c.deleted_at_utc.is_(None),
        experiment.c.scene.is_not(None),
        experiment.c.id.not_in(sa.select(NEWEST_NOMINAL.c.experiment_id)),
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
    counted = sa.select(name, sa.func.count()).where(*LIVE).group_by(name).order_by(name)
    return {name: n for name, n in connection.execute(counted)}


def flags(connection: sa.Connection) -> dict[str, int]:
    """Number of experiments with each flag."""
    counted = (
        sa.select(flag.c.name, sa.func.count(sa.distinct(flag.c.experiment_id)))
        .join(experiment)
        .where(flag.c.deleted_at_utc.is_(None), *LIVE)
        .group_by(flag.c.name)
        .order_by(flag.c.name)
    )
    return {name: n for name, n in connection.execute(counted)}


def tally(
    connection: sa.Connection, query: selection.ExperimentQuery, names: Sequence[str]
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
