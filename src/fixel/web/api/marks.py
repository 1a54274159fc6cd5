"""Flags, notes and deletions of many experiments at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from fastapi import APIRouter
from pydantic import BaseModel, Field

from fixel.model import Flag
from fixel.web.api._values import Id, RequestBody, Text

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

MAX_MARKED: Final = 20_000  # in one request


class _MarkBody(RequestBody):
    ids: list[Id] = Field(min_length=1, max_length=MAX_MARKED)


class MarkRequest(_MarkBody):
    """Which experiments."""


class FlagIn(_MarkBody):
    """A flag for experiments."""

    name: Text = Field(max_length=100, description="a-z, 0-9 and dashes")
    detail: Text = Field(default="", max_length=2000)
    fault: bool = Field(default=True, description="whether analyses leave them out")


class UnflagIn(_MarkBody):
    """A flag to take off."""

    name: Text = Field(max_length=100)


class NoteIn(_MarkBody):
    """A note on experiments."""

    text: Text = Field(min_length=1, max_length=10_000)


class ChangedOut(BaseModel):
    """Experiments or notes that a request changed: to undo it, change these and no others."""

    changed: list[int]


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/experiments/flag` etc.; `changed` lists what has to be changed back to undo."""
    found = APIRouter(tags=["marks"])
    store = desk.store

    @found.post("/experiments/flag", summary="Add a flag to experiments")
    def flag(asked: FlagIn) -> ChangedOut:
        made = Flag(asked.name, asked.detail, asked.fault)
        return ChangedOut(changed=store.flag_all(asked.ids, made))

    @found.post("/experiments/unflag", summary="Take a flag off experiments")
    def unflag(asked: UnflagIn) -> ChangedOut:
        return ChangedOut(changed=store.unflag_all(asked.ids, asked.name))

    @found.post("/experiments/delete", summary="Leave experiments out of everything")
    def delete(asked: MarkRequest) -> ChangedOut:
        return ChangedOut(changed=store.delete_all(asked.ids))

    @found.post("/experiments/undelete", summary="Take deletions of experiments back")
    def undelete(asked: MarkRequest) -> ChangedOut:
        return ChangedOut(changed=store.delete_all(asked.ids, back=True))

    @found.post("/experiments/note", summary="Write a note beside experiments")
    def note(asked: NoteIn) -> ChangedOut:
        """`changed` are the ids of the notes."""
        return ChangedOut(changed=store.annotate(asked.ids, asked.text))

    @found.post("/notes/delete", summary="Delete notes, by their ids")
    def delete_notes(asked: MarkRequest) -> ChangedOut:
        return ChangedOut(changed=store.delete_notes(asked.ids))

    @found.post("/notes/undelete", summary="Take deletions of notes back, by their ids")
    def undelete_notes(asked: MarkRequest) -> ChangedOut:
        return ChangedOut(changed=store.delete_notes(asked.ids, back=True))

    return found
