"""Scenes that are made on a page, and simulated within limits."""

from __future__ import annotations

import asyncio
import threading
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Path, Request
from pydantic import AfterValidator, Field

from fixel.calibration.target import scene_of
from fixel.formats import SceneFile
from fixel.formats.scene_file import scene_dict
from fixel.io.document import yaml_text
from fixel.jobs.worker_process import CallCancellation
from fixel.web.context import Context
from fixel.web.values import Id, RequestBody, Text, storable
from fixel.web.views import scene_editor
from fixel.web.views.scene_editor import SceneExample, SceneMotion

CLIENT_CLOSED = 499  # HTTP status of nginx for a closed connection
GLANCE = 0.05  # [s] between two checks whether the browser still waits
ExampleName = Annotated[str, Path(pattern=r"^[a-z0-9_]{1,40}$")]

router = APIRouter(tags=["scenes"])


class SceneRequest(RequestBody):
    """A scene, as the keys of a scene file."""

    scene: Annotated[dict[str, Any], AfterValidator(storable)] = Field(
        description="scene with the keys of a scene file"
    )


class SceneFileRequest(RequestBody):
    """The text of a scene file."""

    text: Text = Field(max_length=scene_editor.MAX_TEXT)
    is_json: bool = Field(False, description="whether the text is JSON instead of YAML")


SceneAnswer = dict[Literal["scene"], dict[str, Any]]  # a scene that was checked


@router.get("/scenes/examples", summary="List example scenes")
def examples() -> list[SceneExample]:
    return scene_editor.examples()


@router.get("/scenes/examples/{name}", summary="Get an example scene")
def example(name: ExampleName) -> SceneAnswer:
    return {"scene": scene_editor.example(name)}


@router.get("/experiments/{number}/scene", summary="Get the scene of an experiment")
def scene_of_experiment(context: Context, number: Id) -> SceneAnswer:
    scene = scene_of(context.store.experiment(number))
    return {"scene": scene_dict(SceneFile(scene=scene))}


@router.post("/scenes/read", summary="Parse the text of a scene file")
def read(file: SceneFileRequest) -> SceneAnswer:
    return {"scene": scene_editor.read_scene(file.text, json=file.is_json)}


@router.post("/scenes/check", summary="Check a scene", status_code=204)
def check(wanted: SceneRequest) -> None:
    scene_editor.check_scene(wanted.scene)


@router.post("/scenes/write", summary="Write a scene as the text of a scene file")
def write(wanted: SceneRequest) -> dict[Literal["text"], str]:
    return {"text": yaml_text(scene_dict(scene_editor.check_scene(wanted.scene)))}


@router.post(
    "/simulate",
    summary="Simulate a scene",
    description=f"Limits are {scene_editor.LIMIT:g} s of computing, {scene_editor.MAX_STEPS} "
    f"steps and {scene_editor.MAX_DURATION:g} s of simulated time. The simulation "
    "stops if the connection is closed.",
)
async def simulate(wanted: SceneRequest, request: Request) -> SceneMotion:
    gone = threading.Event()
    watch = asyncio.create_task(_watch(request, gone))
    try:
        answer = await asyncio.to_thread(_simulated, wanted.scene, gone)
    finally:  # also when the server ends
        gone.set()
        watch.cancel()
    return answer


def _simulated(scene: dict[str, Any], gone: threading.Event) -> SceneMotion:
    scene_editor.check_scene(scene)  # an invalid scene needs no other process
    try:
        answer: SceneMotion = scene_editor.simulation_worker().call(scene, gone.is_set)
    except CallCancellation:
        raise HTTPException(CLIENT_CLOSED, "The connection was closed.") from None
    return answer


async def _watch(request: Request, gone: threading.Event) -> None:
    while not await request.is_disconnected():
        await asyncio.sleep(GLANCE)
    gone.set()
