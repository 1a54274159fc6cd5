"""Page that documents the API for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from fastapi import Request

from fixel.web.app import API, Page

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

METHODS: Final = ("get", "post", "put", "patch", "delete")


def pages(desk: ProjectContext) -> list[Page]:
    """Page `/api`."""
    operations: list[dict[str, str]] = []

    def fill(request: Request) -> dict[str, Any]:
        if not operations:  # read when everything is mounted
            operations.extend(_operations(request))
        return {"operations": operations, "base": str(request.base_url).rstrip("/") + API}

    return [Page(path="/api", title="API", template="api.html", fill=fill, place=90)]


def _operations(request: Request) -> list[dict[str, str]]:
    mounted: Any = next(route for route in request.app.routes if route.path == API)
    described = mounted.app.openapi()["paths"]
    return [
        {
            "method": method.upper(),
            "path": API + path,
            "summary": entry.get("summary", ""),
            "tag": (entry.get("tags") or ["other"])[0],
            "parameters": ", ".join(p["name"] for p in entry.get("parameters", [])),
        }
        for path, entries in described.items()
        for method, entry in entries.items()
        if method in METHODS
    ]
