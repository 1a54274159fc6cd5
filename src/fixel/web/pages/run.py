"""Pages that every capability has: its form, its jobs and its results."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import degrees
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np
from fastapi import Request
from pydantic import BaseModel

from fixel.calibration.known_pushes import PARTS, SURFACES
from fixel.capability.capability import Capability, named
from fixel.capability.options import Option
from fixel.errors import FixelError, InvalidInput, NotStored
from fixel.jobs import folder as files
from fixel.model.selection import ExperimentQuery
from fixel.trust import check_named
from fixel.web.api.analyses import trials_of
from fixel.web.context import ProjectContext
from fixel.web.problems import problem_of
from fixel.web.views import job_list
from fixel.workflows import capabilities, jobs
from fixel.workflows.analysis import find_analysis, load_with_errors
from fixel.workflows.jobs import JobStatus

OFFERED: Final = 300  # names in the list of experiments
LOG_LINES: Final = 200
# Pages of jobs that show more than the progress of their chunks.
PROGRESS: Final = {"calibrate": "/calibrations/running"}
FORMS: Final[Mapping[str, Capability]] = {
    name: one
    for name, one in capabilities.CAPABILITIES.items()
    if one.on_project and not any(o.required and not o.on_page for o in one.options.values())
}


@dataclass
class FormField:
    """Field of a form."""

    option: Option
    texts: list[str] = field(default_factory=list)  # that are filled in
    error: str = ""  # reason why they were refused
    offered: list[str] = field(default_factory=list)  # texts of a list

    @property
    def form(self) -> str:
        """Form of the input: `choice`, `lines` or `text`."""
        if self.option.many or self.option.door.content:
            return "lines"
        return "choice" if self.option.choices else "text"


# --- forms ----------------------------------------------------------------------------------------


def plan_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/plan?experiment=KEY`: the form of a plan, with a stage for its goal."""
    capability = FORMS["plan"]
    texts = capability.usual_texts
    if key := request.query_params.get("experiment", ""):
        texts["experiment"] = [key]
    found = filled_form(context, capability, texts) | {
        "scene": None,
        "size": 0.0,
        "degrees": degrees(1),
    }
    offered = _offered(context)["experiment"]
    if not offered:
        return found
    try:
        scene = context.store.experiment(context.store.find(key or offered[0])).scene
        if scene is None or len(scene.bodies) != 1:
            raise InvalidInput("experiment", found="no scene with one part", expected="one part")
    except FixelError as problem:
        return found | {"trouble": str(problem)}
    size = 1e3 * float(np.hypot(*scene.bodies[0].shape.outline.T).max())
    return found | {"scene": scene, "size": size}


def form_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/run/NAME?from=RESULT`, with the defaults or the request of a stored result.

    Options may be in the address, as in `?experiments=6&experiments=7`.
    """
    capability = form_of(request.url.path)
    texts = capability.usual_texts
    for name in texts.keys() & request.query_params.keys():
        texts[name] = texts_of(capability, name, request.query_params.getlist(name))
    if source := request.query_params.get("from", ""):
        kept = find_analysis(context.project, source)
        if kept.analysis.kind == capability.name and kept.analysis.request:
            texts = capability.texts(capability.from_json(json.dumps(kept.analysis.request)))
    return filled_form(context, capability, texts)


def start(
    context: ProjectContext, request: Request, fields: dict[str, list[str]]
) -> str | dict[str, Any]:
    """Start the job of a posted form; return the path of its page, or the form with errors."""
    capability, texts = form_of(request.url.path), fields
    try:
        texts = {name: texts_of(capability, name, own) for name, own in fields.items()}
        folder = begin(context, capability, capability.from_texts(texts))
    except FixelError as error:
        return filled_form(context, capability, texts, error)
    return f"{PROGRESS.get(capability.name, '/jobs')}/{quote(folder.name)}"


def begin(context: ProjectContext, capability: Capability, asked: BaseModel) -> Path:
    """Start the job of a request that came from a browser or a program; return its folder.

    Raise `InvalidInput` for a program that the user has not permitted or a file of the server, and
    `JobRefused` if too many jobs are running.
    """
    for name, option in capability.options.items():
        value = getattr(asked, name)
        if value and option.door.program:
            try:
                check_named(value)
            except InvalidInput as problem:
                raise problem.at(name) from None
        if not option.on_page and value != option.default:
            raise InvalidInput(name, found="this option", expected="only options of the page")
        if option.door.content and value and not str(value).startswith("{"):
            raise InvalidInput(name, found="no object", expected="the content of a file in JSON")
    with job_list.job_slot(context.project.folder):
        return capabilities.begin(capability, asked, context.project)


def texts_of(capability: Capability, name: str, texts: list[str]) -> list[str]:
    """Return the texts of a posted field, of which a list has one on each line.

    A field that the form does not have raises `InvalidInput`.
    """
    option = capability.shown.get(name)
    if option is None or not option.on_page:
        raise InvalidInput("form", found=f"a field {name}", expected="the fields of the page")
    lines = [line for text in texts for line in (text.splitlines() if option.many else [text])]
    return [line.strip() for line in lines if line.strip()]


def filled_form(
    context: ProjectContext,
    capability: Capability,
    texts: Mapping[str, list[str]],
    error: FixelError | None = None,
) -> dict[str, Any]:
    """Return the fields of a form with their texts, and where an error belongs."""
    offered = _offered(context)
    shown = [
        FormField(o, texts.get(name, []), offered=offered.get(name, []))
        for name, o in capability.shown.items()
        if o.on_page
    ]
    status, trouble = 200, ""
    if error is not None:
        status = problem_of(error).status
        own: FixelError = error
        where = ""
        if isinstance(error, InvalidInput):
            own, where = named(error, capability.labels()), error.where.partition(" ")[0]
        at = next((f for f in shown if where in (f.option.name, f.option.name.split(".")[0])), None)
        if at is None:
            trouble = str(own)
        else:
            at.error = str(own)
    return {
        "title": capability.heading,
        "about": getattr(capability.present, "about", tuple)(),
        "capability": capability,
        "fields": [own for own in shown if own.option.place or own.option.required],
        "options": [own for own in shown if not (own.option.place or own.option.required)],
        "trouble": trouble,
        "opened": any(own.error for own in shown if not own.option.place),
        "status": status,
    }


def _offered(context: ProjectContext) -> dict[str, list[str]]:
    """Return what the project has for options by their names."""
    known = context.store.conditions()

    def values(names: tuple[str, ...]) -> list[str]:
        counts = {name: sum(known[name].texts.values()) for name in names if name in known}
        most = max(counts, key=lambda name: counts[name], default="")
        return sorted(known[most].texts) if most else []

    rows = context.store.experiments(ExperimentQuery(limit=OFFERED)).rows
    keys = [row.key for row in rows]
    return {"experiment": keys, "part": values(PARTS), "surface": values(SURFACES)}


def form_of(path: str) -> Capability:
    """Return the capability that a path names, if a page can start it."""
    name = path.rpartition("/")[2]
    if name not in FORMS:
        raise NotStored(f"form {name!r}", hint="the page Results lists all")
    return FORMS[name]


# --- results --------------------------------------------------------------------------------------


def results_page(context: ProjectContext, _: Request) -> dict[str, Any]:
    """Fill `/results`, the list of stored results and of forms."""
    every, unreadable = load_with_errors(context.project)
    return {
        "results": [(one.folder.name, one.analysis) for one in every],
        "unreadable": [str(problem) for problem in unreadable],
        "forms": list(FORMS.values()),
    }


def result_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/results/NAME`."""
    kept = find_analysis(context.project, request.path_params["name"])
    analysis = kept.analysis
    return {
        "title": analysis.title,
        "name": kept.folder.name,
        "analysis": analysis,
        "again": analysis.kind if analysis.kind in FORMS and analysis.request else "",
        "place": shlex.quote(str(kept.folder)),
        "trials": trials_of(kept.folder) if analysis.kind == "plan" else [],
    }


# --- jobs -----------------------------------------------------------------------------------------


def jobs_page(context: ProjectContext, _: Request) -> dict[str, Any]:
    """Fill `/jobs`."""
    every = jobs.jobs_in(context.project.folder)
    return {"jobs": every, "running": sum(job.can_cancel and not job.can_resume for job in every)}


def job_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/jobs/NAME`."""
    job = job_list.job_named(context.project.folder, request.path_params["name"])
    readable = job.state != jobs.UNREADABLE
    return {
        "title": job.name,
        "job": job,
        "workers": job_list.workers(job) if readable else [],
        "log": job_list.log_tail(job, LOG_LINES),
        "result": _result_of(job),
        "trouble": "",
    }


def steer(
    context: ProjectContext, request: Request, fields: dict[str, list[str]]
) -> str | dict[str, Any]:
    """Cancel or resume a job; return the path of its page, or the page with the reason."""
    job = job_list.job_named(context.project.folder, request.path_params["name"])
    try:
        if fields.get("do") == ["cancel"]:
            jobs.cancel(Path(job.folder))
        else:
            with job_list.job_slot(context.project.folder):
                job_list.resume(job)
    except FixelError as error:
        problem = problem_of(error)
        more = {"trouble": problem.sentence, "status": problem.status}
        return job_page(context, request) | more
    return f"/jobs/{quote(job.name)}"


def _result_of(job: JobStatus) -> str:
    """Name of the analysis that a job has stored; empty if it stores none."""
    if job.state != "done" or jobs.capability_of(Path(job.folder)) in ("", *PROGRESS):
        return ""
    return (Path(job.folder) / files.RESULT).read_text(errors="replace")
