"""Pages of calibrations: the list, a new one, a running one, a stored one."""

from __future__ import annotations

import re
import shlex
from typing import TYPE_CHECKING, Any

from fastapi import Request

from fixel.errors import InvalidInput
from fixel.web.app import Page
from fixel.web.pages.experiment import Fact, number_in
from fixel.web.views.calibration_progress import Watch
from fixel.workflows.calibration.result import SEARCHED

if TYPE_CHECKING:
    from fixel.model.records import CalibrationRecord
    from fixel.web.project import ProjectContext

IDS = re.compile(r"[1-9][0-9]{0,9}(,[1-9][0-9]{0,9})*", re.ASCII)
HIDDEN = (  # shown elsewhere
    "how", "job", "nominal_error", "error_unit", "seconds", "ended", SEARCHED,
)  # fmt: skip


def pages(desk: ProjectContext) -> list[Page]:
    """Pages `/calibrations` and below."""
    watch = Watch(desk.project)

    def one(request: Request) -> dict[str, Any]:
        number = number_in(request, "calibration", "the list shows what there is")
        record = desk.store.calibration(number)
        return {
            "title": record.name,
            "number": number,
            "name": record.name,
            "method": method(record),
            "provenance": provenance(record),
            "command": record.provenance.command,
        }

    def running(request: Request) -> dict[str, Any]:
        name = str(request.path_params["name"])
        watch.folder(name)
        return {"title": name, "name": name}

    def new(request: Request) -> dict[str, Any]:
        asked = request.query_params
        ids = asked.get("experiments", "")
        if ids and not IDS.fullmatch(ids):
            raise InvalidInput("experiments", found=repr(ids), expected="ids with commas between")
        return {"filter": asked.get("filter", ""), "experiments": ids}

    context = {"folder": shlex.quote(str(desk.folder))}
    return [
        Page(
            path="/calibrations",
            title="Calibrations",
            template="calibrations.html",
            context=context,
            place=30,
        ),
        Page(
            path="/calibrations/new",
            title="Calibrate",
            template="calibrate.html",
            fill=new,
            listed=False,
        ),
        Page(
            path="/calibrations/running/{name}",
            title="Calibration",
            template="calibrating.html",
            fill=running,
            listed=False,
        ),
        Page(
            path="/calibrations/{number}",
            title="Calibration",
            template="calibration.html",
            fill=one,
            listed=False,
        ),
    ]


def method(record: CalibrationRecord) -> list[Fact]:
    """Facts on the method of a calibration."""
    found = [
        Fact(name.replace("_", " ").replace(".", ": "), _word(value))
        for name, value in record.method.items()
        if name not in HIDDEN and name != "error.angle_scale"
    ]
    scale = record.method.get("error.angle_scale")
    if isinstance(scale, float | int):
        found.append(Fact("a radian counts as", f"{1e3 * scale:g}", "mm"))
    return found


def provenance(record: CalibrationRecord) -> list[Fact]:
    """Facts on the origin of a calibration."""
    origin, seconds = record.provenance, record.method.get("seconds")
    took = f"{seconds:.3g}" if isinstance(seconds, float | int) else ""
    given = (
        ("stored", f"{origin.created[:10]} {origin.created[11:16]} UTC", ""),
        ("by fixel", origin.version, ""),
        ("took", took, "s"),
        ("job", str(record.method.get("job", "")), ""),
        ("seed", "" if origin.seed is None else str(origin.seed), ""),
        ("command", origin.command, ""),
    )
    return [Fact(name, value, unit) for name, value, unit in given if value]


def _word(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:g}"
