"""Query for experiments: which ones, in which order, and which page; as SQL clauses."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Any, Final

import sqlalchemy as sa

from fixel.database import rows
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
from fixel.model.selection import ERRORS, NUMBERS, RELATIONS, TEXTS, Bound, ExperimentQuery

ALL_EXPERIMENTS: Final = ExperimentQuery(include_faulty=True, marks=("replaced",))

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
    **{name: experiment.c[own] for name, own in (TEXTS | NUMBERS).items()},
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


def sources(query: ExperimentQuery, names: Iterable[str] = ()) -> sa.FromClause:
    """Tables to select from; errors are joined only where the query or a name refers to them."""
    named = {query.sort, *names, *(bound.name for bound in query.bounds)}
    return WITH_ERRORS if named.intersection(ERRORS) else experiment


def clauses(query: ExperimentQuery, dialect: str) -> list[Any]:
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


def order(query: ExperimentQuery, dialect: str) -> list[Any]:
    """Clauses of ORDER BY: nulls come last in both directions, ties are ordered by id."""
    found: list[Any] = []
    for key in reversed(expressions(dialect, query.sort)):  # numbers before texts
        found += [] if query.sort in ("id", "created", "frames") else [key.is_(None)]
        found.append(key.desc() if query.descending else key.asc())
    return [*found, experiment.c.id.desc() if query.descending else experiment.c.id.asc()]


def _bound_holds(dialect: str, bound: Bound) -> Any:
    relate = RELATIONS[bound.relation]
    if bound.name in TEXTS:
        return relate(COLUMNS[bound.name], bound.typed)
    if bound.name not in COLUMNS:
        return _condition_holds(dialect, bound)
    return relate(COLUMNS[bound.name], bound.limit)


def _condition_holds(dialect: str, bound: Bound) -> Any:
    """SQL clause for `fixel.model.selection._condition_holds`."""
    text, number = expressions(dialect, bound.name)
    if bound.relation not in ("=", "!="):
        return RELATIONS[bound.relation](number, bound.limit)
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
