"""All pages of a project, and what the simple ones show.

`Page.place` orders the navigation: Experiments 10, Compare 20, Calibrations 30, Domain 40,
Next pushes 45, Plan 47, Simulate 50, Bench 52, Results 55, Jobs 60, System 70, API 90.
"""

from __future__ import annotations

import shlex
from threading import Thread
from typing import Any, Final

from fastapi import Request

from fixel.domain.claim import COLOURS
from fixel.errors import FixelError
from fixel.model.selection import ExperimentQuery
from fixel.web.api.system import system_status
from fixel.web.app import API, Page
from fixel.web.context import ProjectContext
from fixel.web.pages import bench, calibration, experiment, run
from fixel.web.pages.compare import OFFERED, compare_page
from fixel.web.pages.listing import experiments_page
from fixel.web.views import scene_editor
from fixel.web.views.domain_views import MAP_KEY, shown_map
from fixel.workflows.analysis import load_with_errors

FIRST: Final = "grasp"  # example that is shown first
METHODS: Final = ("get", "post", "put", "patch", "delete")


def project_pages(context: ProjectContext) -> list[Page]:
    """Return all pages, in the order of the navigation."""
    folder = {"folder": shlex.quote(str(context.folder))}

    def page(
        path: str,
        title: str,
        template: str,
        fill: Any,
        take: Any = None,
        place: int = 0,
        **more: Any,
    ) -> Page:
        """Return a page that a function fills, and that another takes the form of."""
        return Page(
            path=path,
            title=title,
            template=f"{template}.html",
            context=folder,
            place=place,
            listed=place > 0,
            fill=lambda *request: fill(context.here, *request),
            post=take and (lambda *request: take(context.here, *request)),
            **more,
        )

    live = {"router": bench.bench_router(context), "views": (context.bench.view,)}
    return [
        page("/experiments", "Experiments", "experiments", experiments_page, place=10),
        page("/compare", "Compare", "compare", compare_page, place=20),
        page("/calibrations", "Calibrations", "calibrations", calibration.list_page, place=30),
        page("/domain", "Domain", "domain", domain_page, place=40),
        page("/run/next", "Next pushes", "run", run.form_page, run.start, place=45),
        page("/plan", "Plan", "plan", run.plan_page, place=47),
        page("/simulate", "Simulate", "simulate", simulate_page, place=50),
        page(bench.PATH, "Bench", "bench", bench.bench_page, bench.start, place=52, **live),
        page("/results", "Results", "results", run.results_page, place=55),
        page("/jobs", "Jobs", "jobs", run.jobs_page, place=60),
        page("/system", "System", "system", system_page, place=70),
        page("/api", "API", "api", api_page, place=90),
        page(
            "/calibrations/running/{name}", "Calibration", "calibrating", calibration.running_page
        ),
        page("/calibrations/{number}", "Calibration", "calibration", calibration.stored_page),
        page("/experiments/{number}", "Experiment", "experiment", experiment.experiment_page),
        page("/results/{name}", "Result", "result", run.result_page),
        page("/run/{name}", "Run", "run", run.form_page, run.start),
        page("/jobs/{name}", "Job", "job", run.job_page, run.steer),
    ]


def domain_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/domain?map=NAME&threshold=&level=&confidence=&cell=`; by default the newest map."""
    maps, unreadable = load_with_errors(context.project, "domain")
    wanted = request.query_params.get("map", "")
    chosen = next((one for one in maps if one.folder.name == wanted), maps[0] if maps else None)
    found: dict[str, Any] = {
        "maps": maps,
        "chosen": chosen,
        "drawn": None,
        "key": MAP_KEY,
        "signs": dict(zip(COLOURS, (sign for _, sign, _ in MAP_KEY), strict=True)),
        "unreadable": [str(problem) for problem in unreadable],
        "trouble": "",
    }
    if chosen is not None:
        try:
            view = context.domain(chosen.folder.name, chosen.analysis.created)
            found |= shown_map(view, request.query_params, context.folder)
        except FixelError as problem:
            found["trouble"] = str(problem)
    return found


def simulate_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/simulate`, `/simulate?experiment=KEY`, `/simulate?example=NAME`."""
    # A simulation is likely to follow: its process should be ready by then.
    Thread(target=scene_editor.get_ready, name="fixel-simulation-worker", daemon=True).start()
    key = request.query_params.get("experiment", "")
    listed = context.store.experiments(ExperimentQuery(limit=OFFERED)).rows
    return {
        "examples": scene_editor.examples(),
        "example": request.query_params.get("example", FIRST),
        "number": context.store.find(key) if key else "",
        "key": key,
        "keys": [row.key for row in listed],
        "most_bytes": scene_editor.MAX_TEXT,
    }


def system_page(context: ProjectContext, _: Request) -> dict[str, Any]:
    """Fill `/system`."""
    known = system_status(context.project)
    disk = known.disk
    return {
        "known": known,
        "tested": context.newest.get("self-test"),
        "checked": context.newest.get("check"),
        "used_percent": 100.0 * (1.0 - disk.free_bytes / max(1, disk.total_bytes)),
    }


def api_page(_: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/api`, the documentation of the API for programs."""
    mounted: Any = next(route for route in request.app.routes if getattr(route, "path", "") == API)
    operations = [
        {
            "method": method.upper(),
            "path": API + path,
            "summary": entry.get("summary", ""),
            "tag": (entry.get("tags") or ["other"])[0],
            "parameters": ", ".join(p["name"] for p in entry.get("parameters", [])),
        }
        for path, entries in mounted.app.openapi()["paths"].items()
        for method, entry in entries.items()
        if method in METHODS
    ]
    return {"operations": operations, "base": str(request.base_url).rstrip("/") + API}
