"""Changes of experiments: flags, notes and deletions of many at once, and imports of tables."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from fastapi import APIRouter
from pydantic import AfterValidator, Field

from fixel.datasets.table import CsvTable
from fixel.model import Flag
from fixel.web.context import Context
from fixel.web.values import Answer, Id, RequestBody, Text, storable
from fixel.workflows.project.importing import import_texts

MAX_MARKED: Final = 20_000  # in one request
MAX_TEXT: Final = 1_900_000  # characters of a table; requests are limited to 2 MB

router = APIRouter()


FileText = Annotated[str, AfterValidator(storable)]
# Experiments or notes that a request changed: to undo it, change these and no others.
Changed = dict[Literal["changed"], list[int]]


class MarkRequest(RequestBody):
    """Ids of the experiments to mark."""

    ids: list[Id] = Field(min_length=1, max_length=MAX_MARKED)


class FlagRequest(MarkRequest):
    """A flag for experiments."""

    name: Text = Field(max_length=100, description="name of the flag: a-z, 0-9 and dashes")
    detail: Text = Field(default="", max_length=2000)
    fault: bool = Field(default=True, description="whether analyses skip flagged experiments")


class UnflagRequest(MarkRequest):
    """A flag to take off."""

    name: Text = Field(max_length=100)


class NoteRequest(MarkRequest):
    """A note on experiments."""

    text: Text = Field(min_length=1, max_length=10_000)


class TableRequest(RequestBody):
    """The text of a CSV table, and of the scene file it belongs to."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9_][A-Za-z0-9_ .()+-]{0,99}\.csv$",
        description="name of the file of the table",
    )
    table: FileText = Field(max_length=MAX_TEXT)
    scene: FileText | None = Field(None, max_length=MAX_TEXT, description="scene file, as YAML")
    angle_unit: Text | None = Field(None, description=CsvTable.options["angle_unit"])
    split_by: Text | None = Field(None, description=CsvTable.options["split_by"])
    dry_run: bool = Field(False, description="whether to read only and store nothing")


class TableResult(Answer):
    """Result of reading a table, and of storing its experiments."""

    understood: list[str]
    skipped: list[str] = Field(description="experiments of the table that cannot be read, and why")
    has_scene: bool
    template: str | None = Field(description="template of a scene file, if none was given")
    stored: int = Field(description="number of experiments that were stored")
    known: int = Field(description="number that were stored before, and are unchanged")
    replaced: int = Field(description="number that replace an earlier one of the same name")


@router.post("/experiments/flag", summary="Add a flag to experiments", tags=["marks"])
def flag(context: Context, wanted: FlagRequest) -> Changed:
    made = Flag(wanted.name, wanted.detail, wanted.fault)
    return {"changed": context.store.flag(wanted.ids, made)}


@router.post("/experiments/unflag", summary="Remove a flag from experiments", tags=["marks"])
def unflag(context: Context, wanted: UnflagRequest) -> Changed:
    return {"changed": context.store.unflag(wanted.ids, wanted.name)}


@router.post("/experiments/delete", summary="Delete experiments", tags=["marks"])
def delete(context: Context, wanted: MarkRequest) -> Changed:
    return {"changed": context.store.delete(wanted.ids)}


@router.post("/experiments/undelete", summary="Restore deleted experiments", tags=["marks"])
def undelete(context: Context, wanted: MarkRequest) -> Changed:
    return {"changed": context.store.delete(wanted.ids, back=True)}


@router.post("/experiments/note", summary="Add a note to experiments", tags=["marks"])
def note(context: Context, wanted: NoteRequest) -> Changed:
    """`changed` are the ids of the notes."""
    return {"changed": context.store.annotate(wanted.ids, wanted.text)}


@router.post("/notes/delete", summary="Delete notes, by their ids", tags=["marks"])
def delete_notes(context: Context, wanted: MarkRequest) -> Changed:
    return {"changed": context.store.delete_notes(wanted.ids)}


@router.post("/notes/undelete", summary="Restore deleted notes, by their ids", tags=["marks"])
def undelete_notes(context: Context, wanted: MarkRequest) -> Changed:
    return {"changed": context.store.delete_notes(wanted.ids, back=True)}


@router.post("/import", summary="Import a CSV table with its scene", tags=["experiments"])
def import_table(context: Context, wanted: TableRequest) -> TableResult:
    options = wanted.model_dump(include={"angle_unit", "split_by"}, exclude_none=True)
    file = wanted.name, wanted.table, wanted.scene
    plan, template, done = import_texts(
        context.store, *file, options=options, dry_run=wanted.dry_run
    )
    return TableResult(
        understood=list(plan.understood),
        skipped=list(plan.skipped),
        has_scene=template is None,
        template=template,
        stored=done.new,
        known=done.known,
        replaced=done.replaced,
    )
