"""The page *Bench*: start a campaign, and perform it."""

from __future__ import annotations

import json
from typing import Any, Literal

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse

from fixel.database.project import SETTINGS
from fixel.errors import FixelError, InvalidInput
from fixel.web.context import ProjectContext
from fixel.web.pages.run import filled_form, texts_of
from fixel.web.values import RequestBody
from fixel.workflows.bench.campaign import campaigns
from fixel.workflows.bench.run import BENCH

PATH = "/bench"


class BenchWish(RequestBody):
    """Wish of a page, such as a push or a stop."""

    do: Literal["push", "stop", "place", "skip", "again", "end", "accept", "repeat"]
    row: str = ""


def bench_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/bench`, or `/bench?new=1` after a campaign: its status, or the form of a new one."""
    session = context.bench
    new = "query_string" in request.scope and request.query_params.get("new")
    if session.loop is not None and (session.running or not new):
        report = json.loads(session.view.report)
        if report:
            report["problems"] += [session.trouble] if session.trouble else []
            heading = f"Bench: {report['campaign']}"
            return {"report": report, "heading": heading, "running": session.running}
    return _form(context, BENCH.usual_texts)


def start(
    context: ProjectContext, request: Request, fields: dict[str, list[str]]
) -> str | dict[str, Any]:
    """Start the campaign of a posted form."""
    chosen, texts = "".join(fields.pop("plan", [])), fields
    try:
        if chosen not in ("", *_plans(context)):
            raise InvalidInput("plan", found=chosen, expected="a plan in the project's folder")
        texts = {name: texts_of(BENCH, name, own) for name, own in fields.items()}
        asked = BENCH.from_texts(texts)
        plan = {"plan": context.project.folder / chosen} if chosen else {}
        opened = BENCH.function(context.project, **BENCH.arguments(asked) | plan)
        context.bench.start(opened, by="page")
    except FixelError as error:
        return _form(context, texts, error, chosen)
    return PATH


def _plans(context: ProjectContext) -> list[str]:
    """Return the names of the files in the project's folder that may be plans."""
    files = [own for kind in ("*.yaml", "*.csv") for own in context.project.folder.glob(kind)]
    return sorted(own.name for own in files if own.name not in (SETTINGS, "scene.yaml"))


def _form(
    context: ProjectContext,
    texts: dict[str, list[str]],
    error: FixelError | None = None,
    chosen: str = "",
) -> dict[str, Any]:
    return filled_form(context, BENCH, texts, error) | {
        "report": None,
        "campaigns": campaigns(context.project.folder),
        "plans": _plans(context),
        "chosen": chosen,
    }


def bench_router(context: ProjectContext) -> APIRouter:
    """Return the routes of the live page: its picture, its status and its wishes."""
    router: APIRouter = context.bench.view.router()

    @router.post("/act")
    def act(wish: BenchWish) -> JSONResponse:
        context.bench.ask(wish.do, wish.row)
        return JSONResponse({"asked": wish.do})

    @router.post("/alive")
    def alive() -> JSONResponse:
        context.bench.alive()
        return JSONResponse({})

    return router
