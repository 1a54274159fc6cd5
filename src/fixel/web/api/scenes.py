"""Scenes that are made on a page, and simulated within limits."""

from __future__ import annotations

import asyncio
import json
import threading
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import APIRouter, HTTPException, Path, Request
from pydantic import AfterValidator, BaseModel, Field

from fixel.jobs.worker_process import CallCancellation
from fixel.web.api._values import Number, RequestBody, Text
from fixel.web.api.motion import StoryOut
from fixel.web.views import scene_editor

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

NOBODY_WAITS = 499  # HTTP status of nginx for a closed connection
GLANCE = 0.05  # [s] between two checks whether the browser still waits


def _writable(scene: dict[str, Any]) -> dict[str, Any]:
    """Reject what no file can store, before an error message is made of it."""
    try:
        json.dumps(scene, ensure_ascii=False).encode()
    except (UnicodeEncodeError, RecursionError):
        raise ValueError("text and levels that a scene file can hold") from None
    return scene


class SceneIn(RequestBody):
    """A scene, as the keys of a scene file."""

    scene: Annotated[dict[str, Any], AfterValidator(_writable)] = Field(
        description="as in a scene file: fixel scene files are the same"
    )


class FileIn(RequestBody):
    """The text of a scene file."""

    text: Text = Field(max_length=scene_editor.MAX_TEXT)
    is_json: bool = Field(False, description="JSON; else YAML")


class SceneOut(BaseModel):
    """A scene that was checked."""

    scene: dict[str, Any]


class ExampleOut(BaseModel):
    """A scene that comes with fixel."""

    name: str
    sentence: str


class TextOut(BaseModel):
    """A scene file."""

    text: str = Field(description="YAML")


class SceneMotionOut(BaseModel):
    """Result of simulating a scene."""

    story: StoryOut
    summary: dict[str, Any] = Field(description="as `fixel simulate --json` answers")


ExampleName = Annotated[str, Path(pattern=r"^[a-z0-9_]{1,40}$")]


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/scenes` and `/simulate`."""
    found = APIRouter(tags=["scenes"])

    @found.get("/scenes/examples", summary="Scenes that come with fixel")
    def examples() -> list[ExampleOut]:
        return [ExampleOut(name=name, sentence=text) for name, text in scene_editor.examples()]

    @found.get("/scenes/examples/{name}", summary="One of them")
    def example(name: ExampleName) -> SceneOut:
        return SceneOut(scene=scene_editor.example(name))

    @found.get("/experiments/{number}/scene", summary="The scene of an experiment")
    def of_experiment(number: Number) -> SceneOut:
        return SceneOut(scene=scene_editor.scene_of_experiment(desk.store.experiment(number)))

    @found.post("/scenes/read", summary="Read the text of a scene file")
    def read(file: FileIn) -> SceneOut:
        return SceneOut(scene=scene_editor.read_scene(file.text, json=file.is_json))

    @found.post("/scenes/check", summary="Say what is wrong with a scene", status_code=204)
    def check(wanted: SceneIn) -> None:
        scene_editor.check_scene(wanted.scene)

    @found.post("/scenes/write", summary="A scene as the text of a scene file")
    def write(wanted: SceneIn) -> TextOut:
        return TextOut(text=scene_editor.write_scene(wanted.scene))

    @found.post(
        "/simulate",
        summary="Simulate a scene",
        description=f"Within {scene_editor.LIMIT:g} s of computing, {scene_editor.MOST_STEPS} "
        f"steps and {scene_editor.MAX_DURATION:g} s of simulated time. "
        "Ends when the connection does.",
    )
    async def simulate(wanted: SceneIn, request: Request) -> SceneMotionOut:
        gone = threading.Event()
        watch = asyncio.create_task(_watch(request, gone))
        try:
            answer = await asyncio.to_thread(_simulated, wanted.scene, gone)
        finally:  # also when the server ends
            gone.set()
            watch.cancel()
        return answer

    return found


def _simulated(scene: dict[str, Any], gone: threading.Event) -> SceneMotionOut:
    scene_editor.check_scene(scene)  # an invalid scene needs no other process
    try:
        answer: scene_editor.SceneMotion = scene_editor.beside().call(scene, gone.is_set)
    except CallCancellation:
        raise HTTPException(NOBODY_WAITS, "Nobody waits for this any more.") from None
    return SceneMotionOut(story=StoryOut.of(answer.story), summary=answer.summary)


async def _watch(request: Request, gone: threading.Event) -> None:
    while not await request.is_disconnected():
        await asyncio.sleep(GLANCE)
    gone.set()
