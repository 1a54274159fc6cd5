"""Calibrate, import, export, place and check cameras as requests state; print boards and tags."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any, Final

from fixel.drawing.chart import require_file
from fixel.drawing.prints import board_sheet, save_sheets, tag_sheets
from fixel.drawing.tracking import camera_error_chart
from fixel.errors import InvalidInput, check_name
from fixel.formats.camera_import import import_camera
from fixel.formats.camera_opencv import save_opencv, save_ros
from fixel.formats.recording import RIG_FILE
from fixel.formats.rig_file import camera_of, has_plate, load_camera, markers_of, save_camera
from fixel.formats.video_file import files_of, first_picture, pictures_of
from fixel.io.atomic import refuse_unwritable
from fixel.model.fields import pose_of
from fixel.progress import ProgressOption, show_progress
from fixel.vision.calibrate_lens import calibrate_lens, find_boards, lens_names
from fixel.vision.camera import MeasuredCamera
from fixel.vision.frame import Picture, size_of
from fixel.vision.marks import Rig, Tag, board_of
from fixel.vision.place_camera import Placement, place_by_board, place_by_tags
from fixel.vision.plane_errors import PlaneErrors, mm, plane_errors
from fixel.vision.tracking.checks import moved_limit, tags_off
from fixel.workflows.acquisition.camera.report import CameraAnswer, PrintAnswer

CAMERA_ENDINGS: Final = (".yaml", ".yml")
MOVED: Final = 5e-4  # [m] allowed offset of a plate tag, in addition to the camera's errors
ROUND_TRIP: Final = 1e-6  # [px]
MAX_TAGS = 500


def calibrated(asked: Any, progress: ProgressOption) -> CameraAnswer:
    """Calibrate a lens from pictures of a board, and save the camera."""
    wanted = board_of(asked.board)
    require_file(asked.out, CAMERA_ENDINGS, "camera")
    lens_names(asked.coefficients, asked.fisheye)  # refused before pictures are read
    files = files_of(asked.pictures)
    done = count(1)
    with show_progress(progress, stage="reading pictures") as report:

        def one(name: str) -> None:
            report(min(next(done), len(files)), len(files), name)

        views, dropped = find_boards(pictures_of(files), wanted, one)
    found = calibrate_lens(views, dropped, coefficients=asked.coefficients, fisheye=asked.fisheye)
    save_camera(found.camera, asked.out)
    remark = "place it by tags on the plate (--rig RIG) or by the board flat on it (--board BOARD)"
    return CameraAnswer(found.camera, asked.out, calibration=found, remarks=(remark,))


def imported(asked: Any) -> CameraAnswer:
    """Import a camera of another program, and save it as fixel's own."""
    file, out = asked.file, asked.out
    require_file(out, CAMERA_ENDINGS, "camera")
    if out.resolve() == file.resolve():
        raise InvalidInput(str(out), found="the input file", expected="another file to write")
    size, unit = size_of(asked.size), {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[asked.unit]
    camera, remarks = import_camera(file, asked.format, size=size, which=asked.which, unit=unit)
    save_camera(camera, out)
    return CameraAnswer(camera, out, remarks=remarks)


def exported(asked: Any) -> CameraAnswer:
    """Export the lens of a camera to the format of OpenCV or ROS."""
    camera = load_camera(asked.camera)
    refuse_unwritable(asked.out)
    writers = {"opencv": save_opencv, "ros": save_ros}
    check_name("format", asked.format, writers)
    writers[asked.format](camera.lens, asked.out)
    return CameraAnswer(camera, asked.out)


def placed(asked: Any) -> CameraAnswer:
    """Find the pose of a camera above the plate, and save the camera with its pose."""
    path, pose = asked.camera, pose_of(asked.at, "at").tolist()
    measured = load_camera(path)
    out = asked.out or path.with_name(f"{path.stem}-placed.yaml")
    rigs = [folder / RIG_FILE for folder in (path.parent, asked.picture.parent)]
    rig = asked.rig or next((str(file) for file in rigs if has_plate(file)), None)
    if asked.board is None and rig is None:
        raise InvalidInput("place", found="neither", expected="--board or --rig, or both")
    require_file(out, CAMERA_ENDINGS, "camera")
    require_file(asked.plot)
    seen = first_picture(asked.picture)
    found, remark = _place(measured, seen, asked.board, pose, asked.thickness, rig)
    save_camera(found.camera, out)
    return CameraAnswer(
        found.camera,
        out,
        placement=found,
        verdicts=_accuracy(found.camera, asked.height, asked.plot),
        remarks=(remark, f"name {out.name} as the camera of a rig file"),
        plot=asked.plot,
    )


def _place(
    measured: MeasuredCamera,
    seen: Picture,
    board: str | None,
    at: Sequence[float],
    thickness: float,
    rig: str | None,
) -> tuple[Placement, str]:
    """Place a camera by the plate's tags if they are seen, else by the board; return a remark.

    The board lies with its lower left corner `at` a pose of the world [m, m, rad] and its upper
    face `thickness` above the plate [m].
    """
    why_not = "no rig with tags on the plate was named (--rig)"
    if rig is not None:
        try:
            _, _, tags = markers_of(rig)
            if not tags:
                raise InvalidInput(
                    rig, found="no tags on the plate", expected="a rig with plate tags, or --board"
                )
            found = place_by_tags(measured, seen, tags)
            return found, f"placed by the tags on the plate of {rig}"
        except InvalidInput as problem:
            if board is None:
                raise
            why_not = f"placing by its tags failed: {problem.found}"
    found = place_by_board(measured, seen, board_of(str(board)), pose=at, height=thickness)
    return found, (
        f"placed by the board; {why_not}. Tags in the corners of the plate give higher accuracy "
        "in the corners of the picture than a board in its middle"
    )


def _accuracy(
    measured: MeasuredCamera, heights: Sequence[float], plot: Path | None
) -> tuple[PlaneErrors, ...]:
    """Compute the accuracy at heights above the plate [m]; draw a map of it for the first one."""
    found = tuple(plane_errors(measured, height) for height in heights)
    if plot is not None and found:
        camera_error_chart(found[0]).save(plot)
    return found


def checked(asked: Any) -> CameraAnswer:
    """Check a camera, or that of a rig, against itself and against a video or picture.

    Its size is compared; its first frame shows whether the tags of a rig's plate are where they
    belong.
    """
    require_file(asked.plot)
    measured, rig = camera_of(asked.camera)
    problems: list[str] = []
    tags: dict[int, float] = {}
    if asked.video is not None:
        picture = first_picture(asked.video)
        measured.lens.for_pictures_of((picture.shape[1], picture.shape[0]))
        if rig is not None and rig.plate:
            tags = tags_off(rig, picture)
            problems += _moved(rig, tags)
    trip = measured.lens.round_trip()
    if not trip < ROUND_TRIP:
        problems.append(
            f"the round trip from pixels to directions and back has an error of {trip:.1g} px"
        )
    placed = measured.camera is not None
    return CameraAnswer(
        camera=measured,
        verdicts=_accuracy(measured, asked.height, asked.plot) if placed else (),
        remarks=() if placed else ("it has not been placed above a plate yet",),
        plot=asked.plot if placed else None,
        round_trip=trip,
        tags=tags,
        problems=tuple(problems),
    )


def _moved(rig: Rig, tags: dict[int, float]) -> list[str]:
    if not tags:
        expected = "tags " + ", ".join(str(tag.id) for tag in rig.plate)
        found, hint = "none of the tags on the plate", "check that the picture shows the bench"
        raise InvalidInput("picture", found=found, expected=expected, hint=hint)
    limits = {tag.id: moved_limit(rig, tag, MOVED) for tag in rig.plate}
    far = {number: off for number, off in tags.items() if off > limits[number]}
    if not far:
        return []
    worst = max(far, key=lambda number: far[number] / limits[number])
    return [
        f"tag {worst} on the plate is {mm(far[worst])} from its nominal position; {len(far)} of "
        f"{len(tags)} tags are off by more than the uncertainty of the calibration "
        f"({mm(limits[worst])}): the camera or the plate was moved"
    ]


def printed_board(asked: Any) -> PrintAnswer:
    """Save a board as a PDF or PNG."""
    board = board_of(asked.board)
    save_sheets((board_sheet(board, board.text, asked.paper),), asked.out)
    return PrintAnswer(asked.out, 1, board.text)


def printed_tags(asked: Any) -> PrintAnswer:
    """Save all tags of a rig, each with its part, or numbered tags as a PDF or PNG."""
    rig, ids = asked.rig, asked.ids
    if (rig is None) == (ids is None):
        found = "a rig and --ids" if rig else "neither a rig nor --ids"
        raise InvalidInput("tags", found=found, expected="one of them")
    if rig is None:
        title, tags = f"{asked.family}, {1e3 * asked.size:g} mm", _numbered(asked)
    else:
        title, parts, plate = markers_of(rig)
        every = {name: part.marks for name, part in parts.items()} | {"plate": plate}
        tags = [(own, name) for name, marks in every.items() for own in marks if type(own) is Tag]
        if not tags:
            raise InvalidInput(rig, found="no tags", expected="a rig with tags", hint="thesis-tags")
    sheets = tag_sheets(tags, asked.paper, title)
    save_sheets(sheets, asked.out)
    return PrintAnswer(asked.out, len(sheets), title, len(tags))


def _numbered(asked: Any) -> list[tuple[Tag, str]]:
    """Return the tags of a range of numbers such as `0-9`."""
    found = re.fullmatch(r"(\d{1,4})(?:-(\d{1,4}))?", asked.ids)
    first, last = (int(found[1]), int(found[2] or found[1])) if found else (0, -1)
    if not first <= last < first + MAX_TAGS:
        expected = f"a number, or a range of at most {MAX_TAGS} such as 0-9"
        raise InvalidInput("ids", found=repr(asked.ids), expected=expected)
    own = {"size": asked.size, "height": 0.0, "family": asked.family}
    return [(Tag(id=k, **own), "") for k in range(first, last + 1)]
