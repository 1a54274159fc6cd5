"""Queries for experiments, and the summaries that a listing shows."""

from __future__ import annotations

import json
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple, final

import sqlalchemy as sa

from fixel.database.tables import experiment, flag
from fixel.errors import InvalidInput

Relation = Literal["=", "!=", "<", "<=", ">", ">="]

RELATIONS: Final[Mapping[str, Callable[[Any, Any], Any]]] = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


class Bound(NamedTuple):
    """Comparison of a column or a condition with a value."""

    name: str
    relation: Relation
    value: str | float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """Criteria that select experiments.

    Parameters
    ----------
    dataset : str, optional
    name : str, optional
        Name; `*` matches any text.
    real : bool, optional
        Select only real (True) or only simulated (False) experiments.
    contact_mode : str, optional
    conditions : mapping of str to str or float
        Required values of conditions.
    bounds : tuple of Bound
        Comparisons of conditions with values.
    flag : str, optional
        Select only experiments with this flag; faulty ones are then included.
    flagged : bool
        Include experiments with a flag that marks a fault.
    deleted : bool
        Select only deleted experiments.
    replaced : bool
        Include experiments that a correction has replaced.
    """

    dataset: str | None = None
    name: str | None = None
    real: bool | None = None
    contact_mode: str | None = None
    conditions: Mapping[str, str | float] = field(default_factory=dict)
    bounds: tuple[Bound, ...] = ()
    flag: str | None = None
    flagged: bool = False
    deleted: bool = False
    replaced: bool = False


class Summary(NamedTuple):
    """Line of a listing: one experiment without its series."""

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


# Conditions stay text until requested, since few lines of a long listing are read.
COLUMNS = [
    sa.cast(experiment.c.conditions, sa.Text) if name == "conditions_json" else experiment.c[name]
    for name in Summary._fields
]

# Subqueries of ids instead of one lookup per row: a server without table statistics would scan
# whole tables for each row.
_FLAGGED = sa.select(flag.c.experiment_id).where(flag.c.deleted_at_utc.is_(None))
_REPLACED = sa.select(experiment.c.replaces_id).where(
    experiment.c.replaces_id.is_not(None), experiment.c.deleted_at_utc.is_(None)
)


def condition_of(dialect: str, name: str) -> tuple[Any, Any]:
    """SQL expressions of a condition as text and as number; null if missing or not a number."""
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


def condition_holds(dialect: str, bound: Bound) -> Any:
    """SQL clause that compares a condition with a value."""
    relate, (text, number) = RELATIONS[bound.relation], condition_of(dialect, bound.name)
    if not isinstance(bound.value, str):
        return relate(number, bound.value)
    if bound.relation == "!=":
        return sa.or_(text != bound.value, text.is_(None))
    return relate(text, bound.value)


def conditions_of(query: Query, dialect: str) -> list[sa.ColumnElement[bool]]:
    """SQL clauses of a query, except for `flagged`."""
    found: list[sa.ColumnElement[bool]] = []
    gone = experiment.c.deleted_at_utc
    found.append(gone.is_not(None) if query.deleted else gone.is_(None))
    if not query.replaced:
        found.append(experiment.c.id.not_in(_REPLACED))
    if query.dataset is not None:
        found.append(experiment.c.dataset == query.dataset)
    if query.name is not None:
        found.append(experiment.c.name.like(_pattern(query.name), escape="\\"))
    if query.real is not None:
        found.append(experiment.c.is_real.is_(query.real))
    if query.contact_mode is not None:
        found.append(experiment.c.contact_mode == query.contact_mode)
    for name, value in query.conditions.items():
        entry = experiment.c.conditions[name]
        found.append(
            entry.as_string() == value if isinstance(value, str) else entry.as_float() == value
        )
    found += [condition_holds(dialect, bound) for bound in query.bounds]
    if query.flag is not None:
        found.append(experiment.c.id.in_(_FLAGGED.where(flag.c.name == query.flag)))
    return found


def only_clean(query: Query) -> list[sa.ColumnElement[bool]]:
    """SQL clauses that exclude faulty experiments, unless the query includes them."""
    if query.flagged or query.flag is not None or query.deleted:
        return []
    return [experiment.c.id.not_in(_FLAGGED.where(flag.c.is_fault))]


def _pattern(name: str) -> str:
    escaped = name.replace("\\", "\\\\").replace("%", "\\%").replace("_", "\\_")
    return escaped.replace("*", "%")
