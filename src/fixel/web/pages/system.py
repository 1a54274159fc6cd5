"""Page of the installation: versions, self-test, database, disk, backups."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

from fastapi import Request

from fixel.web.api.system import system_out
from fixel.web.app import Page

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext


def pages(desk: ProjectContext) -> list[Page]:
    """Page `/system`."""

    def fill(_: Request) -> dict[str, Any]:
        known = system_out(desk)
        disk, cores = known.disk, known.machine["cores"]
        return {
            "known": known,
            "cores": f"{cores} core{'s' if cores != 1 else ''}",
            "threads": known.machine["threads"],
            "cache": bytes_text(known.cache.size_bytes),
            "database": bytes_text(known.database.size_bytes),
            "media": bytes_text(disk.media_bytes),
            "free": bytes_text(disk.free_bytes),
            "total": bytes_text(disk.total_bytes),
            "used_percent": 100.0 * (1.0 - disk.free_bytes / max(1, disk.total_bytes)),
            "folder": shlex.quote(disk.folder),
        }

    return [Page(path="/system", title="System", template="system.html", fill=fill, place=70)]


def bytes_text(size: int | None) -> str:
    """Format a size in decimal units, as `bytes` of units.js does."""
    if size is None:
        return "on a server"
    value = float(size)
    for unit in ("byte", "kB", "MB", "GB"):
        if value < 1000.0:
            return f"{value:.3g} {unit}" if unit != "byte" else f"{size} byte"
        value /= 1000.0
    return f"{value:.3g} TB"
