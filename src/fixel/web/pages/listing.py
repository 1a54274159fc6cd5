"""Table of experiments, with what selects from it and the coverage of their configurations."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from urllib.parse import urlencode

from fastapi import Request

from fixel.errors import InvalidInput
from fixel.web import values
from fixel.web.api.experiments import TablePage, TableRow, table
from fixel.workflows.project import filters

if TYPE_CHECKING:
    from fixel.web.context import ProjectContext

ROWS: Final = 100  # on one page
KEPT: Final = ("filter", "sort", "descending", "offset", "coverage", "x", "y")
STATES: Final = ("clean", "faulty", "flagged", "noted", "real", "simulated", "deleted")
HALF_DIGIT: Final = 1e-9  # bounds are widened by it, as they are written with few digits
PLANE: Final = (46.0, 6.0, 248.0, 254.0)  # left, top, width, height of the coverage [px]
MAX_TICKS: Final = 6
# Conditions that are shown elsewhere, or do not tell experiments apart.
_UNTOLD: Final = re.compile(r"shape|layout|axis|step|repetition|truth_.*")
_TOKEN: Final = re.compile(r'(?:"[^"]*"?|[^\s"])+')
_SUBJECT: Final = re.compile(r"([\w.-]+)(?:[<>!]?=|[<>:])")


class ListColumn(NamedTuple):
    """Column of the table of experiments."""

    key: str
    label: str
    sort: str = ""
    unit: str = ""
    title: str = ""


COLUMNS: Final = (
    ListColumn("run", "Run"),
    ListColumn("name", "Experiment", "name"),
    ListColumn("shape", "Shape", "shape"),
    ListColumn("contacts", "Contacts", "contacts",
               title="Fixels that the object touches at the end"),
    ListColumn("moved", "Moved", "moved", "mm"),
    ListColumn("turned", "Turned", "turned", "deg"),
    ListColumn("duration", "Time", "duration", "s"),
    ListColumn("before", "Error", "before", "mm",
               "Error before calibration, of the newest stored simulation with nominal values"),
    ListColumn("after", "Calibrated", "after", "mm",
               "Error after calibration, of the newest calibration of this experiment"),
    ListColumn("marks", "Flags", "flags"),
)  # fmt: skip


def experiments_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/experiments?filter=&sort=&descending=&offset=&coverage=&x=&y=`."""
    given = {name: request.query_params.get(name, "") for name in KEPT}
    link = _linker(given)
    filter, offset = given["filter"][:1000], int("0" + re.sub(r"\D", "", given["offset"])[:9])
    found = TablePage(experiments=[], total=0, faulty=0, meant=None)
    problem, without_simulation, sort = "", [], given["sort"] or "id"
    try:
        found = table(context, filter, sort, bool(given["descending"]), ROWS, offset)
        if offset >= found.total > 0:  # experiments of the last page have been deleted
            offset = (found.total - 1) // ROWS * ROWS
            found = table(context, filter, sort, bool(given["descending"]), ROWS, offset)
        missing = context.store.unsimulated_ids(filters.view_of(filter))
        without_simulation = [one for one in missing if one not in context.comparison.refused]
    except InvalidInput as error:
        problem = str(error)
    return {
        **given,
        "status": 422 if problem else 200,
        "problem": problem,
        "found": found,
        "summary": conditions_text,
        "degrees": math.degrees(1.0),
        "columns": COLUMNS,
        "link": link,
        "sorted_link": lambda name: _sorted_link(name, given, link),
        "first": offset,
        "rows": ROWS,
        "picks": picks(filters.vocabulary(context.store), filter),
        "flag_names": list(context.store.flags()),
        "deleted": "is:deleted" in tokens(filter),
        "unsimulated": without_simulation,
        "covered": None if problem or not given["coverage"] else covered(context, given, link),
    }


def _linker(given: Mapping[str, str]) -> Callable[..., str]:
    """Return the function that makes links to the same page with some changes."""

    def link(**changed: object) -> str:
        query = {**given, "offset": "", **changed}
        known = {name: value for name, value in query.items() if value not in ("", 0)}
        return f"?{urlencode(known)}"

    return link


def _sorted_link(name: str, given: Mapping[str, str], link: Callable[..., str]) -> str:
    """Return the link that sorts by a column: first up, then down, then as they were."""
    if given["sort"] != name:
        return link(sort=name, descending="")
    return link(sort="", descending="") if given["descending"] else link(descending="true")


def conditions_text(row: TableRow) -> str:
    """Describe the conditions of an experiment in a few values."""
    shown = [
        values.condition(name, value)
        for name, value in row.conditions.items()
        if not _UNTOLD.fullmatch(name) and value not in (0, "")
    ]
    texts = [" ".join(part for part in one if part) for one in shown]
    return " \u00b7 ".join([row.dataset, *texts])


# --- the filter as it is typed --------------------------------------------------------------------


def tokens(filter: str) -> list[str]:
    """Split a filter into its terms, without quotes."""
    return [token.replace('"', "") for token in _TOKEN.findall(filter)]


def replaced(filter: str, subjects: tuple[str, ...], *terms: str) -> str:
    """Return a filter with terms instead of those about some subjects, as `shape` or `flag`."""
    kept = [
        token
        for token in _TOKEN.findall(filter)
        if not ((found := _SUBJECT.match(token.replace('"', ""))) and found[1] in subjects)
    ]
    return " ".join([*kept, *terms])


def _quoted(text: str) -> str:
    return '"' + text.replace('"', "") + '"' if re.search(r'[\s"]', text) else text


def picks(known: filters.Vocabulary, filter: str) -> list[dict[str, Any]]:
    """Return the choices next to the filter, each with the filter that it leads to."""
    usual = ("shape", "layout")
    names = [name for name, one in known.conditions.items() if len(one.texts) > 1]
    names.sort(key=lambda name: usual.index(name) if name in usual else len(usual))
    offered = [
        (name, f"{name}=", list(known.conditions[name].texts)) for name in names if name != "axis"
    ][:3]
    if len(known.datasets) > 1:
        offered.insert(0, ("dataset", "dataset:", list(known.datasets)))
    if known.flags:
        offered.append(("flag", "flag:", list(known.flags)))
    now = tokens(filter)
    return [
        {
            "name": name,
            "label": "state" if name == "is" else name,
            "chosen": any(token.startswith(before) for token in now),
            "none": replaced(filter, (name,)),
            "options": [
                (value, replaced(filter, (name,), before + _quoted(value)), before + value in now)
                for value in values
            ],
        }
        for name, before, values in [*offered, ("is", "is:", list(STATES))]
    ]


# --- coverage -------------------------------------------------------------------------------------


def covered(
    context: ProjectContext, given: Mapping[str, str], link: Callable[..., str]
) -> dict[str, Any]:
    """Return the coverage as it is drawn: a plane of configurations, a table of shapes."""
    filter = given["filter"]
    axes = filters.coverage_axes(context.store, given["x"], given["y"])
    # What a cell selects does not empty the rest of the picture.
    rest = replaced(filter, (*axes, "shape", "layout"))
    found = filters.coverage(context.store, filters.view_of(rest), *axes)

    def cell(
        number: int, most: int, subjects: tuple[str, ...], bounds: list[str]
    ) -> dict[str, Any]:
        here = {bound.replace('"', "") for bound in bounds} <= {*tokens(filter)}
        return {
            "number": number,
            "share": (number / most) ** 0.5,
            "here": here,
            "href": link(filter=replaced(filter, subjects, *([] if here else bounds))),
        }

    left, top, width, height = PLANE
    x, y = found.x, found.y
    across, up = width / len(x.centres), height / len(y.centres)
    most = _largest(found.number)
    places = [
        {
            **cell(found.number[i][j], most, (x.name, y.name), [*_within(x, i), *_within(y, j)]),
            "x": left + i * across,
            "y": top + (len(y.centres) - 1 - j) * up,
            "words": f"{values.several(found.number[i][j], 'experiment')} at "
            f"{_titled(x.name)} {_value(x, i)}, {_titled(y.name)} {_value(y, j)}",
        }
        for i, j in product(range(len(x.centres)), range(len(y.centres)))
        if found.number[i][j]
    ]
    largest = _largest(found.table)
    return {
        "axes": [(name, _titled(name)) for name in found.axes],
        "x": x.name,
        "y": y.name,
        "places": places,
        "width": max(1.0, across - 1.0),
        "height": max(1.0, up - 1.0),
        "reached": len(x.centres) * len(y.centres) <= 900,
        "x_ticks": [(left + (k + 0.5) * across, text) for k, text in _ticks(x)],
        "y_ticks": [(top + (len(y.centres) - k - 0.5) * up + 4, text) for k, text in _ticks(y)],
        "x_title": _titled(x.name, unit=True),
        "y_title": _titled(y.name, unit=True),
        "total": sum(one["number"] for one in places),
        "without": found.without,
        "shapes": found.shapes,
        "table": [
            (layout, [
                cell(found.table[i][j], largest, ("shape", "layout"),
                     [f"shape={_quoted(shape)}", f"layout={_quoted(layout)}"])
                for i, shape in enumerate(found.shapes)
            ])
            for j, layout in enumerate(found.layouts)
        ],
    }  # fmt: skip


def _largest(rows: Sequence[Sequence[int]]) -> int:
    return max((n for row in rows for n in row), default=1) or 1


def _within(axis: filters.CoverageAxis, k: int) -> list[str]:
    low, high = axis.edges[k] - HALF_DIGIT, axis.edges[k + 1] + HALF_DIGIT
    return [f"{axis.name}>={round(low, 8) + 0.0!r}", f"{axis.name}<{round(high, 8) + 0.0!r}"]


def _titled(name: str, unit: bool = False) -> str:
    stem, _, shown = values.condition(name, 1.0)
    return f"{stem} [{shown}]" if unit and shown else stem


def _value(axis: filters.CoverageAxis, k: int) -> str:
    _, value, unit = values.condition(axis.name, float(f"{axis.centres[k]:.3g}"))
    return f"{value} {unit}".strip()


def _ticks(axis: filters.CoverageAxis) -> list[tuple[int, str]]:
    """Return at most six places with their values, evenly."""
    n = len(axis.centres)
    every = max(1, -(-n // MAX_TICKS))
    return [(k, _value(axis, k).split(" ")[0]) for k in range(0, n, every)]
