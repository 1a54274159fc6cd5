"""Import of tables that are dropped on a page, with their scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from fastapi import APIRouter
from pydantic import AfterValidator, BaseModel, Field

from fixel.web.api._values import RequestBody
from fixel.workflows.project.importing import import_texts

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

MAX_TEXT: Final = 1_900_000  # characters of a table; requests are limited to 2 MB


def _writable(text: str) -> str:
    """Reject text that no file can store."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ValueError("text that a file can hold") from None
    return text


FileText = Annotated[str, AfterValidator(_writable)]


class TableIn(RequestBody):
    """The text of a CSV table, and of the scene file it belongs to."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9_][A-Za-z0-9_ .()+-]{0,99}\.csv$", description="of the table's file"
    )
    table: FileText = Field(max_length=MAX_TEXT)
    scene: FileText | None = Field(None, max_length=MAX_TEXT, description="scene file, as YAML")
    angle_unit: str | None = Field(
        None, pattern="^(rad|deg)$", description="of the angles, whatever the header has"
    )
    dry_run: bool = Field(False, description="read only, store nothing")


class ImportedOut(BaseModel):
    """Result of reading a table, and of storing it."""

    understood: list[str]
    has_scene: bool
    template: str | None = Field(description="scene file to be filled in, where there is no scene")
    stored: bool
    known: bool = Field(description="stored before, and left as it is")


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/import`."""
    found = APIRouter(tags=["experiments"])

    @found.post("/import", summary="Import a CSV table with its scene")
    def imported(asked: TableIn) -> ImportedOut:
        done = import_texts(
            desk.store,
            asked.name,
            asked.table,
            asked.scene,
            angle_unit=asked.angle_unit,
            dry_run=asked.dry_run,
        )
        return ImportedOut(
            understood=list(done.understood),
            has_scene=done.template is None,
            template=done.template,
            stored=done.new,
            known=done.known,
        )

    return found
