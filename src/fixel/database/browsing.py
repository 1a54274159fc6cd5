"""Table of experiments, filtered and sorted by any column or condition, page by page."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, final

import sqlalchemy as sa

from fixel.database import rows
from fixel.database.query import RELATIONS, Bound, condition_holds, condition_of
from fixel.database.tables import (
    calibration,
    calibration_member,
    experiment,
    flag,
    note,
    simulation,
    system_parameters,
)
from fixel.errors import InvalidInput

MARKS: Final = ("clean", "faulty", "flagged", "noted", "real", "simulated", "deleted", "replaced")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentView:
    """Filter, order and page of a table of experiments.

    Parameters
    ----------
    words : tuple of str
        Words that must all occur in the name, a condition, a flag or a note.
    bounds : tuple of Bound
    flags : tuple of str
        Names of flags that each experiment must have.
    marks : tuple of str
        Marks out of `MARKS`. Deleted experiments are listed only with `deleted` (then no others),
        experiments replaced by a correction only with `replaced`.
    sort : str
        Column or condition to sort by.
    descending : bool
    limit : int, optional
    offset : int
    """

    words: tuple[str, ...] = ()
    bounds: tuple[Bound, ...] = ()
    flags: tuple[str, ...] = ()
    marks: tuple[str, ...] = ()
    sort: str = "id"
    descending: bool = False
    limit: int | None = None
    offset: int = 0


class ExperimentRow(NamedTuple):
    """Row of the table of experiments."""

    id: int
    dataset: str
    name: str
    real: bool
    frames: int
    duration_s: float
    start: tuple[float, float, float]  # [m, m, rad]
    end: tuple[float, float, float]
    contacts: str
    conditions: dict[str, str | float]
    created: str
    content: str  # checksum
    before_mm2: float | None
    after_mm2: float | None
    flags: list[tuple[str, str, bool]]  # name, detail, whether a fault
    notes: int
    deleted: bool


class Leaf(NamedTuple):
    """Page of the table of experiments, with counts."""

    rows: list[ExperimentRow]
    total: int  # matching experiments on all pages
    faulty: int  # matching experiments with a fault


class Conditions(NamedTuple):
    """Values of one condition among all experiments."""

    texts: dict[str, int]  # text -> number of experiments
    low: float | None
    high: float | None
    numbers: int  # number of experiments where it is a number


# --- columns ----------------------------------------------------------------------------------

# Errors of the newest simulation with nominal values, and of the newest calibration.
_NOMINAL: Final = rows.parameters_row({})["content_sha256"]
_newest = (
    sa.select(simulation.c.experiment_id, sa.func.max(simulation.c.id).label("id"))
    .join(system_parameters, system_parameters.c.id == simulation.c.system_parameters_id)
    .where(simulation.c.deleted_at_utc.is_(None), system_parameters.c.content_sha256 == _NOMINAL)
    .group_by(simulation.c.experiment_id)
    .subquery("newest_nominal")
)
_before = (
    sa.select(simulation.c.experiment_id, simulation.c.error_mm2)
    .join(_newest, _newest.c.id == simulation.c.id)
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
_after = (
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
_FROM = experiment.outerjoin(_before, _before.c.experiment_id == experiment.c.id).outerjoin(
    _after, _after.c.experiment_id == experiment.c.id
)

_live_flag = flag.c.deleted_at_utc.is_(None)
_FAULTY = sa.select(flag.c.experiment_id).where(_live_flag, flag.c.is_fault)
_FLAGGED = sa.select(flag.c.experiment_id).where(_live_flag)
_NOTED = sa.select(note.c.experiment_id).where(note.c.deleted_at_utc.is_(None))
_REPLACED = sa.select(experiment.c.replaces_id).where(
    experiment.c.replaces_id.is_not(None), experiment.c.deleted_at_utc.is_(None)
)
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

# Squares instead of roots: the order is the same, and not every database has a square root.
TEXTS: Final[dict[str, sa.ColumnElement[Any]]] = {
    "dataset": experiment.c.dataset,
    "name": experiment.c.name,
    "contacts": experiment.c.contact_mode,
    "created": experiment.c.created_at_utc,
}
# Same rule as `model.trajectory.turned`.
_angle: Final = experiment.c.end_theta_rad - experiment.c.start_theta_rad
_turned: Final = sa.case(
    (experiment.c.n_frame > 2, _angle),
    (_angle >= math.pi, _angle - 2.0 * math.pi),
    (_angle < -math.pi, _angle + 2.0 * math.pi),
    else_=_angle,
)
NUMBERS: Final[dict[str, sa.ColumnElement[Any]]] = {
    "id": experiment.c.id,
    "frames": experiment.c.n_frame,
    "duration_s": experiment.c.duration_s,
    "start_x_m": experiment.c.start_x_m,
    "start_y_m": experiment.c.start_y_m,
    "start_angle_rad": experiment.c.start_theta_rad,
    "end_x_m": experiment.c.end_x_m,
    "end_y_m": experiment.c.end_y_m,
    "end_angle_rad": experiment.c.end_theta_rad,
    "turned_rad": _turned,
    "flags": _n_flag,
    "notes": _n_note,
}
SQUARES: Final[dict[str, sa.ColumnElement[Any]]] = {
    "moved_m": _dx * _dx + _dy * _dy,
    "before_mm": _before.c.error_mm2,
    "after_mm": _after.c.error_mm2,
    "error_mm": sa.func.coalesce(_after.c.error_mm2, _before.c.error_mm2),
}


def _condition(connection: sa.Connection, name: str) -> tuple[Any, Any]:
    return condition_of(connection.dialect.name, name)


# --- queries ----------------------------------------------------------------------------------


def browse(connection: sa.Connection, view: ExperimentView) -> Leaf:
    """Return one page of the table, with the numbers of matching and of faulty experiments."""
    where = _where(connection, view)
    wanted = (
        sa.select(
            experiment.c.id,
            experiment.c.dataset,
            experiment.c.name,
            experiment.c.is_real,
            experiment.c.n_frame,
            experiment.c.duration_s,
            experiment.c.start_x_m,
            experiment.c.start_y_m,
            experiment.c.start_theta_rad,
            experiment.c.end_x_m,
            experiment.c.end_y_m,
            experiment.c.end_theta_rad,
            experiment.c.contact_mode,
            sa.cast(experiment.c.conditions, sa.Text).label("conditions"),
            experiment.c.created_at_utc,
            experiment.c.content_sha256,
            _before.c.error_mm2.label("before_mm2"),
            _after.c.error_mm2.label("after_mm2"),
            experiment.c.deleted_at_utc,
        )
        .select_from(_FROM)
        .where(*where)
        .order_by(*_order(connection, view))
        .limit(view.limit)
        .offset(view.offset)
    )
    found = list(connection.execute(wanted))
    numbers = [row.id for row in found]
    flags, notes = _flags_of(connection, numbers), _notes_of(connection, numbers)
    count = sa.select(sa.func.count()).select_from(_needed(replace(view, sort="id"))).where(*where)
    total = int(connection.scalar(count) or 0)
    faulty = int(connection.scalar(count.where(experiment.c.id.in_(_FAULTY))) or 0)
    return Leaf([_row(row, flags, notes) for row in found], total, faulty)


def ids(connection: sa.Connection, view: ExperimentView) -> list[int]:
    """Ids of all matching experiments, in the order of the view."""
    wanted = (
        sa.select(experiment.c.id)
        .select_from(_needed(view))
        .where(*_where(connection, view))
        .order_by(*_order(connection, view))
    )
    return list(connection.scalars(wanted))


def unsimulated(connection: sa.Connection, view: ExperimentView) -> list[int]:
    """Ids of matching experiments with a scene but no simulation with nominal parameters yet."""
    wanted = (
        sa.select(experiment.c.id)
        .select_from(_FROM)
        .where(
            *_where(connection, view),
            experiment.c.deleted_at_utc.is_(None),
            experiment.c.scene.is_not(None),
            experiment.c.id.not_in(sa.select(_newest.c.experiment_id)),
        )
        .order_by(*_order(connection, view))
    )
    return list(connection.scalars(wanted))


def tally(
    connection: sa.Connection, view: ExperimentView, names: Sequence[str]
) -> list[tuple[Any, ...]]:
    """Count distinct combinations of values: one text, number or None per name, then the count."""
    chosen = [_text_and_number(connection, name) for name in names]
    every = (
        sa.select(*(e.label(f"c{k}") for k, e in enumerate(e for some in chosen for e in some)))
        .select_from(_needed(view, names))
        .where(*_where(connection, view))
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


def _text_and_number(connection: sa.Connection, name: str) -> tuple[Any, ...]:
    """SQL expressions for a name: text and number of a condition (one is null), or one column."""
    known = (TEXTS | NUMBERS | SQUARES).get(name)
    return _condition(connection, name) if known is None else (known,)


def conditions(connection: sa.Connection) -> dict[str, Conditions]:
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
        name: Conditions(own, *numbers.get(name, (None, None, 0))) for name, own in texts.items()
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


def _needed(view: ExperimentView, names: Iterable[str] = ()) -> Any:
    """Tables to select from; errors are joined only where a view or name refers to them."""
    asked = {view.sort, *names, *(bound.name for bound in view.bounds)}
    return _FROM if asked & {"before_mm", "after_mm", "error_mm"} else experiment


def _where(connection: sa.Connection, view: ExperimentView) -> list[sa.ColumnElement[bool]]:
    gone = experiment.c.deleted_at_utc
    found: list[Any] = [gone.is_not(None) if "deleted" in view.marks else gone.is_(None)]
    if "replaced" not in view.marks:
        found.append(experiment.c.id.not_in(_REPLACED))
    meaning: dict[str, Any] = {
        "clean": experiment.c.id.not_in(_FAULTY),
        "faulty": experiment.c.id.in_(_FAULTY),
        "flagged": experiment.c.id.in_(_FLAGGED),
        "noted": experiment.c.id.in_(_NOTED),
        "real": experiment.c.is_real,
        "simulated": ~experiment.c.is_real,
    }
    found += [meaning[mark] for mark in view.marks if mark in meaning]
    found += [experiment.c.id.in_(_FLAGGED.where(flag.c.name == name)) for name in view.flags]
    found += [_held(connection, one) for one in view.bounds]
    found += [_has_word(word) for word in view.words]
    return found


def _held(connection: sa.Connection, bound: Bound) -> Any:
    relate = RELATIONS[bound.relation]
    name, value = bound.name, bound.value
    if name in TEXTS:
        return relate(TEXTS[name], str(value) if isinstance(value, str) else f"{value:g}")
    if name in NUMBERS or name in SQUARES:
        if isinstance(value, str):
            raise InvalidInput(f"filter: {name}", found=repr(value), expected="a number")
        if name in NUMBERS:
            return relate(NUMBERS[name], value)
        # The sign is retained: every error exceeds a negative bound.
        return relate(SQUARES[name], value * abs(value))
    return condition_holds(connection.dialect.name, bound)


def _has_word(word: str) -> Any:
    pattern = "%" + re.sub(r"([\\%_])", r"\\\1", word) + "%"
    flags = _FLAGGED.where(
        sa.or_(flag.c.name.ilike(pattern, escape="\\"), flag.c.detail.ilike(pattern, escape="\\"))
    )
    return sa.or_(
        (experiment.c.dataset + "/" + experiment.c.name).ilike(pattern, escape="\\"),
        sa.cast(experiment.c.conditions, sa.Text).ilike(pattern, escape="\\"),
        experiment.c.id.in_(flags),
        experiment.c.id.in_(_NOTED.where(note.c.text.ilike(pattern, escape="\\"))),
    )


def _order(connection: sa.Connection, view: ExperimentView) -> list[Any]:
    """Clauses of ORDER BY: nulls come last in both directions, ties are ordered by id."""
    keys: tuple[Any, ...]
    if view.sort in TEXTS or view.sort in NUMBERS or view.sort in SQUARES:
        keys = ((TEXTS | NUMBERS | SQUARES)[view.sort],)
    else:
        text, number = _condition(connection, view.sort)
        keys = (number, text)
    order: list[Any] = []
    for key in keys:
        order += [] if view.sort in ("id", "created", "frames") else [key.is_(None)]
        order.append(key.desc() if view.descending else key.asc())
    return [*order, experiment.c.id.desc() if view.descending else experiment.c.id.asc()]


def _flags_of(connection: sa.Connection, numbers: list[int]) -> dict[int, list[Any]]:
    wanted = (
        sa.select(flag.c.experiment_id, flag.c.name, flag.c.detail, flag.c.is_fault)
        .where(flag.c.experiment_id.in_(numbers), _live_flag)
        .order_by(flag.c.id)
    )
    found: dict[int, list[Any]] = {}
    for number, *one in connection.execute(wanted):
        found.setdefault(number, []).append(tuple(one))
    return found


def _notes_of(connection: sa.Connection, numbers: list[int]) -> dict[int, int]:
    wanted = (
        sa.select(note.c.experiment_id, sa.func.count())
        .where(note.c.experiment_id.in_(numbers), note.c.deleted_at_utc.is_(None))
        .group_by(note.c.experiment_id)
    )
    return {number: count for number, count in connection.execute(wanted)}


def _row(row: Any, flags: dict[int, list[Any]], notes: dict[int, int]) -> ExperimentRow:
    return ExperimentRow(
        id=row.id,
        dataset=row.dataset,
        name=row.name,
        real=row.is_real,
        frames=row.n_frame,
        duration_s=row.duration_s,
        start=(row.start_x_m, row.start_y_m, row.start_theta_rad),
        end=(row.end_x_m, row.end_y_m, row.end_theta_rad),
        contacts=row.contact_mode,
        conditions=json.loads(row.conditions),
        created=row.created_at_utc,
        content=row.content_sha256,
        before_mm2=row.before_mm2,
        after_mm2=row.after_mm2,
        flags=flags.get(row.id, []),
        notes=notes.get(row.id, 0),
        deleted=row.deleted_at_utc is not None,
    )
