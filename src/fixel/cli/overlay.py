"""`fixel overlay SCENE`: outlines of where everything should lie, on the live picture."""

import sys
from contextlib import suppress
from itertools import islice
from math import degrees, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder, argument, option, with_options
from fixel.cli.screen import (
    command_line,
    command_of,
    notify,
    paragraphs,
    print_answer,
    table,
    wrote,
)
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.testbed.frame_source import FrameSource
    from fixel.vision.marks import Rig
    from fixel.workflows.acquisition.overlay import Look, Overlay, Tolerance

NOT_IN_PLACE = 4
WAKING = 5  # pictures that are skipped: a camera that was just switched on sends dark ones


RigName = Annotated[
    str,
    typer.Option(
        help="Rig file with camera and markers, or name of an example rig.", metavar="RIG"
    ),
]


@with_options
def overlay(
    *,
    rig: RigName,
    scene: Path | None = argument(
        None,
        "Scene file, YAML or JSON.",
        metavar="SCENE",
        exists=True,
        dir_okay=False,
        show_default=False,
    ),
    camera: str = option(
        "0",
        "Camera (0, /dev/video0, http://...), video file or folder of a recording.",
        metavar="SOURCE",
    ),
    experiment: str | None = option(
        None, "Stored experiment, instead of a scene file.", metavar="KEY"
    ),
    project: ProjectFolder = Path(),
    tolerance_mm: float | None = option(
        None, "Largest allowed position error of a part [mm].", show_default="the rig's"
    ),
    tolerance_deg: float | None = option(
        None, "Largest allowed angle error of a part [deg].", show_default="the rig's"
    ),
    port: int | None = option(
        None,
        "Port of the page; it is served to this machine only.",
        min=1,
        max=65535,
        show_default="any free one",
    ),
    once: bool = option(
        False,
        "Check once and write a picture; exit code 0 if all parts are in place, 4 if not.",
        "--once",
    ),
    output: Path = option(Path("overlay.png"), "Picture to write with --once: .png."),
    as_json: AsJson = False,
) -> None:
    """Show planned poses on the live picture, and their errors."""
    from fixel.workflows.acquisition.overlay import Overlay, scene_of

    picture = output if once else None
    bench = _bench(rig, picture)
    placed = scene_of(scene, experiment, project)
    looks = Overlay(bench, placed, _tolerance(bench, tolerance_mm, tolerance_deg))
    heading = f"{experiment or (scene.name if scene else '')} on {bench.name}"
    look = _look(looks, camera, picture, heading, port, show=not as_json)
    setting = ["--camera", camera, "--rig", rig] + (["--scene", str(scene)] if scene else [])
    files = {"picture": str(output)} if once else {}
    print_answer(
        as_json,
        lambda: {**look.summary(), "files": files},
        lambda: _lines(look, setting, picture),
    )
    if once and not look.placed:
        raise typer.Exit(NOT_IN_PLACE)


def _bench(rig: str, picture: Path | None) -> "Rig":
    """Load a rig, after a check of the file to write."""
    from fixel.drawing.chart import refuse_ending
    from fixel.formats.rig_file import rig_of
    from fixel.io.atomic import refuse_unwritable

    if picture is not None:
        refuse_ending(picture, (".png",), "picture")
        refuse_unwritable(picture)
    return rig_of(rig)


def _tolerance(bench: "Rig", mm: float | None, deg: float | None) -> "Tolerance":
    """Return the tolerance; where none is given, that of the rig."""
    from fixel.workflows.acquisition.overlay import Tolerance

    return Tolerance(
        distance=bench.position_tolerance if mm is None else 1e-3 * mm,
        angle=bench.angle_tolerance if deg is None else radians(deg),
    )


def _look(
    looks: "Overlay",
    camera: str,
    picture: Path | None,
    heading: str,
    port: int | None,
    *,
    show: bool,
) -> "Look":
    """Look once and write a picture, or show the overlay in a browser."""
    from fixel.testbed.open_source import source_of

    size, once = looks.rig.camera.lens.image_size, picture is not None
    with source_of(camera, size=size, as_fast_as_possible=once) as source:
        if picture is not None:
            return _once(looks, source, picture)
        return _live(looks, source, heading, port, show=show)


def _lines(look: "Look", setting: list[str], picture: Path | None) -> list[str]:
    """A few lines of text: the verdict, the errors, the file, the next command."""
    # After a part has been moved, the same command.
    record = command_of("record", *setting, "--out", "recording")
    return paragraphs(
        [look.sentence],
        _errors(look),
        [*look.problems, *look.remarks],
        wrote([picture]),
        [f"Next: {record if look.placed else command_line()}"],
    )


def _errors(look: "Look") -> list[str]:
    rows = []
    for part in look.checked:
        if part.error is None:
            rows.append((part.name, "-", "-", "-", f"not seen: {part.reason}"))
        else:
            rows.append((part.name, *look.words(part), "in place" if part.within else "off"))
    allowed = look.tolerance
    return [
        *table(("measured - planned", "x [mm]", "y [mm]", "angle [deg]", "verdict"), rows),
        f"tolerance: {1e3 * allowed.distance:.3g} mm, {degrees(allowed.angle):.3g} deg",
    ]


def _once(looks: "Overlay", source: "FrameSource", output: Path) -> "Look":
    from fixel.workflows.acquisition.overlay import frames_of, look_once, write_picture

    stream = source.open()
    frames = islice(frames_of(source, stream.live), WAKING if stream.live else 0, None)
    picture, look = look_once(looks, frames)
    write_picture(output, looks.drawn(picture, look, words=True))
    return look


def _live(
    looks: "Overlay", source: "FrameSource", heading: str, port: int | None, *, show: bool
) -> "Look":
    """Show the overlay in a browser until the pictures end, or Ctrl-C."""
    from fixel.web import require_server
    from fixel.workflows.acquisition.overlay import frames_of, watch

    require_server()
    from fixel.web.live import LiveView
    from fixel.web.overlay_page import overlay_page
    from fixel.web.serve import WebServer

    view = LiveView()
    look: Look | None = None
    stream = source.open()

    def end(reason: str) -> None:
        notify(f"The camera stopped: {reason}.")
        if look is not None:
            view.show(None, look.summary() | {"problems": [f"The camera stopped: {reason}"]})

    with WebServer([overlay_page(view, heading)], port=port) as server:
        notify(f"Open {server.link}\nStop with Ctrl-C.")
        with suppress(KeyboardInterrupt):
            for look in watch(looks, frames_of(source, stream.live, end), view.show):
                if show and sys.stderr.isatty():
                    print(f"\r{look.sentence:<60.60}", end="", file=sys.stderr, flush=True)
    if look is None:
        raise InvalidInput("--camera", found="no picture", expected="a camera that sends pictures")
    return look
