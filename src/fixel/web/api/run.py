"""Capabilities: their options, and jobs that run them."""

from __future__ import annotations

import json
from typing import Any

from fastapi import APIRouter

from fixel.web.api.jobs import JobDetail, one
from fixel.web.context import Context
from fixel.web.pages.run import FORMS, begin, form_of

router = APIRouter(prefix="/run", tags=["capabilities"])


@router.get("", summary="List capabilities with the JSON schemas of their requests")
def capabilities() -> dict[str, dict[str, Any]]:
    return {name: own.model.model_json_schema() for name, own in FORMS.items()}


@router.post("/{name}", summary="Run a capability as a job; its result is an analysis")
def start(context: Context, name: str, request: dict[str, Any]) -> JobDetail:
    own = form_of(name)
    return one(context, begin(context, own, own.from_json(json.dumps(request))).name)
