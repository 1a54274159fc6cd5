"""Pages of calibrations: a new one, a running one, a stored one."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, NamedTuple

from fastapi import Request

from fixel.errors import InvalidInput
from fixel.web.api.calibration import MAX_LISTED, calibrations
from fixel.web.pages.experiment import Fact, number_in
from fixel.web.views.calibration_detail import StoredCalibration, engine_of
from fixel.workflows.calibration.result import SEARCHED

if TYPE_CHECKING:
    from fixel.model.records import CalibrationRecord
    from fixel.web.context import ProjectContext

LISTED = 100  # calibrations, unless more are asked for
IDS = re.compile(r"[1-9][0-9]{0,9}(,[1-9][0-9]{0,9})*", re.ASCII)
HIDDEN = (  # shown elsewhere
    "how", "job", "nominal_error", "error_unit", "seconds", "ended", SEARCHED,
)  # fmt: skip


def list_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/calibrations?limit=`."""
    limit = request.query_params.get("limit", "")
    return {
        "found": calibrations(context, min(MAX_LISTED, int(limit)) if limit.isdecimal() else 100)
    }


def stored_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill the page of a stored calibration."""
    number = number_in(request, "calibration", "the page Calibrations lists all")
    record = context.store.calibration(number)
    one, analysis = context.calibration_detail(number)
    ids = [sibling.id for sibling in one.siblings]
    place = ids.index(number) if number in ids else 0
    return {
        "title": record.name,
        "number": number,
        "one": one,
        "analysis": analysis,
        "engine": engine_of(record),
        "method": method(record),
        "provenance": provenance(record),
        "errors": errors_of(one),
        "previous": ids[place - 1] if place else None,
        "next": next(iter(ids[place + 1 :]), None),
    }


class ErrorRow(NamedTuple):
    """Errors of an experiment before and after the calibration [mm]; None if unknown."""

    id: int
    key: str
    before: float | None
    after: float | None


def errors_of(one: StoredCalibration) -> list[ErrorRow]:
    """Return the errors of all experiments, the largest first."""

    def rms(error: float | None) -> float | None:
        if error is None or not math.isfinite(error):
            return None
        return math.sqrt(error) if one.unit == "mm^2" else error

    return [ErrorRow(r.id, r.key, rms(r.before), rms(r.after)) for r in one.residuals]


def running_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill the page of a running calibration."""
    name = str(request.path_params["name"])
    context.calibrations.folder(name)
    return {"title": name, "name": name}


def form_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill the page on which a calibration is begun."""
    wanted = request.query_params
    ids = wanted.get("experiments", "")
    if ids and not IDS.fullmatch(ids):
        raise InvalidInput("experiments", found=repr(ids), expected="ids separated by commas")
    return {"filter": wanted.get("filter", ""), "experiments": ids}


def method(record: CalibrationRecord) -> list[Fact]:
    """Facts on the method of a calibration."""
    found = [
        Fact(name.replace("_", " ").replace(".", ": "), _word(value))
        for name, value in record.method.items()
        if name not in HIDDEN and name != "error.angle_scale"
    ]
    scale = record.method.get("error.angle_scale")
    if isinstance(scale, float | int):
        found.append(Fact("weight of angles", f"{1e3 * scale:g}", "mm/rad"))
    return found


def provenance(record: CalibrationRecord) -> list[Fact]:
    """Facts on the origin of a calibration."""
    origin, seconds = record.provenance, record.method.get("seconds")
    took = f"{seconds:.3g}" if isinstance(seconds, float | int) else ""
    given = (
        ("stored", f"{origin.created[:10]} {origin.created[11:16]} UTC", ""),
        ("fixel version", origin.version, ""),
        ("took", took, "s"),
        ("job", str(record.method.get("job", "")), ""),
        ("seed", "" if origin.seed is None else str(origin.seed), ""),
        ("command", origin.command, ""),
    )
    return [Fact(name, value, unit) for name, value, unit in given if value]


def _word(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:g}"
