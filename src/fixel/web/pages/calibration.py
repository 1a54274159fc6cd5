"""Pages of calibrations: a new one, a running one, a stored one."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from fastapi import Request

from fixel.web.api.calibration import MAX_LISTED, calibrations
from fixel.web.pages.experiment import Fact, number_in
from fixel.web.values import rms, short
from fixel.web.views.calibration_views import PLOTS, LiveProgress, StoredCalibration, engine_of
from fixel.workflows.calibration.report import CAPTIONS

if TYPE_CHECKING:
    from fixel.web.context import ProjectContext

GRAPH = (54.0, 640.0, 220.0)  # left, width, height of the graph of errors [px]
DOTS = 2000  # evaluations that the graph shows one by one
CONTINUES = "Finished evaluations are saved; Resume continues from there."
STOPPED = {
    "lost": f"The process of this calibration ended unexpectedly. {CONTINUES}",
    **dict.fromkeys(("cancelled", "stopped"), f"Stopped. {CONTINUES}"),
}


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
    one = context.calibration_detail(number)
    ids = [sibling.id for sibling in one.siblings]
    place = ids.index(number) if number in ids else 0
    return {
        "title": record.name,
        "number": number,
        "one": one,
        "analysis": one.analysis,
        "engine": engine_of(record),
        "facts": [Fact(name, value) for name, value in one.facts.items()],
        "errors": [
            row.model_copy(update={k: rms(getattr(row, k), one.unit) for k in ("before", "after")})
            for row in one.residuals
        ],
        "plots": plots_of(one),
        "previous": ids[place - 1] if place else None,
        "next": next(iter(ids[place + 1 :]), None),
    }


def plots_of(one: StoredCalibration) -> list[tuple[str, str]]:
    """Return the kinds of plots of a calibration with their captions."""
    shown = zip(PLOTS, (one.objective is not None, one.starts, one.curves), strict=True)
    return [(kind, CAPTIONS[kind]) for kind, has in shown if one.complete and has]


def running_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill the page of a running calibration."""
    name = str(request.path_params["name"])
    live = context.calibrations.look(context.calibrations.folder(name))
    return {
        "title": name,
        "name": name,
        "live": live,
        "reason": STOPPED.get(live.state, live.reason),
        "graph": _graph(live),
    }


def _graph(live: LiveProgress) -> dict[str, Any] | None:
    """Return the errors of a running calibration as they are drawn, on a logarithmic axis."""
    errors = live.objective or [one.after for one in live.singles]
    values = np.array([rms(error, live.unit) or math.nan for error in errors])
    start = rms(live.start, live.unit) if live.objective else None
    known = np.append(values[np.isfinite(values)], start or [])
    if not len(known):
        return None
    low, high = np.log10(known.min()) - 0.05, np.log10(known.max()) + 0.05
    left, width, height = GRAPH

    def down(value: float) -> float:
        return 8.0 + height * float((high - np.log10(value)) / (high - low))

    across = left + width * (np.arange(len(values)) + 0.5) / max(20, len(values))
    shown = [k for k in range(0, len(values), 1 + len(values) // DOTS) if np.isfinite(values[k])]
    best = np.nan_to_num(np.fmin.accumulate(values), nan=np.inf)
    steps = np.flatnonzero(best < np.append(np.inf, best[:-1]))
    corners = [(float(across[k]), down(best[k])) for k in steps]
    line = "".join(f"H{x:.1f}V{y:.1f}" for x, y in corners)
    decades = range(math.floor(low), math.ceil(high) + 1)
    ticks = [m * 10.0**k for k in decades for m in (1, 2, 5) if low < np.log10(m) + k < high]
    return {
        "dots": "".join(f"M{across[k]:.1f} {down(values[k]):.1f}h0" for k in shown),
        "line": f"M{corners[0][0]:.1f} {corners[0][1]:.1f}{line}H{across[-1]:.1f}"
        if live.objective and corners
        else "",
        "start": None if start is None else down(start),
        "ticks": [(down(value), short(value)) for value in ticks],
    }  # fmt: skip
