"""Errors as documents for programs: place, found value, expected values, hint."""

from __future__ import annotations

import reprlib
import threading
from typing import Any, Final

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from fixel import errors

OUR_MISTAKE = "Internal error of fixel. The terminal in which the server runs shows the details."
UNPROCESSABLE = 422
ABSENT = 404
CONFLICT = 409
_STATUS: Final[dict[type[errors.FixelError], int]] = {
    errors.NotStored: ABSENT,
    errors.DatasetMissing: ABSENT,
    errors.StoreRefused: CONFLICT,
    errors.JobRefused: CONFLICT,
}
GENERATES: Final = threading.Lock()  # the documentation of an API; not safe in several threads


class Refusal(BaseModel):
    """Why a request was refused."""

    status: int = Field(description="HTTP status from 400 to 499; 500 for an internal error")
    sentence: str = Field(description="complete message as one sentence")
    where: str | None = Field(default=None, description="field or record that is invalid")
    found: str | int | float | None = Field(default=None, description="value that was found")
    expected: str | None = Field(default=None, description="description of allowed values")
    hint: str | None = Field(default=None, description="advice")


def problem_of(error: errors.FixelError) -> Refusal:
    """Convert an error that fixel raises on purpose to its document."""
    codes = (code for kind, code in _STATUS.items() if isinstance(error, kind))
    places = (getattr(error, name, None) for name in ("what", "folder", "reason"))
    stated: Any = {"where": next(filter(None, places), None), **error.details}
    return Refusal(status=next(codes, UNPROCESSABLE), sentence=str(error), **stated)


def answer_errors(api: FastAPI) -> None:
    """Answer every failure of an API with a `Refusal`."""

    @api.exception_handler(errors.FixelError)
    def refused(_: Request, error: errors.FixelError) -> JSONResponse:
        return answer(problem_of(error))

    @api.exception_handler(RequestValidationError)
    def invalid(_: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        no_json = first["type"] == "json_invalid"
        if no_json or (len(first["loc"]) == 1 and first["type"] != "value_error"):
            found = reprlib.repr(first.get("input"))
            if no_json:
                found = f"an error at character {first['loc'][1]} ({first['ctx']['error'].lower()})"
            json = "a JSON object, sent with Content-Type: application/json"
            return answer(problem_of(errors.InvalidInput("body", found=found, expected=json)))
        return answer(problem_of(errors.refused_value(error)))

    @api.exception_handler(OSError)
    def of_the_machine(_: Request, error: OSError) -> JSONResponse:
        failure = errors.machine_failure(error)
        if failure is None:
            raise error
        return answer(problem_of(failure))

    @api.exception_handler(Exception)
    def unforeseen(_: Request, error: Exception) -> JSONResponse:
        return answer(Refusal(status=500, sentence=OUR_MISTAKE))

    @api.exception_handler(HTTPException)
    def other(_: Request, error: HTTPException) -> JSONResponse:
        return answer(
            Refusal(status=error.status_code, sentence=str(error.detail)), dict(error.headers or {})
        )


def refuse_unknown_query(request: Request) -> None:
    """Raise `InvalidInput` for a parameter in the address that the route does not document."""
    if not request.query_params:
        return
    with GENERATES:
        paths = request.app.openapi()["paths"]
    route = paths[request.scope["route"].path][request.method.lower()]
    known = [one["name"] for one in route.get("parameters", ()) if one["in"] == "query"]
    for name in request.query_params:
        if not known:
            raise errors.InvalidInput("query", found=name, expected="no parameters")
        if name not in known:
            raise errors.unknown_name("query", name, known)


def answer(problem: Refusal, headers: dict[str, str] | None = None) -> JSONResponse:
    """Return a problem as a JSON response."""
    return JSONResponse(problem.model_dump(), status_code=problem.status, headers=headers)
