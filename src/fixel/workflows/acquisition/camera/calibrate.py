"""Calibrate, import, export and place cameras, and compute the accuracy of places."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fixel.drawing.chart import PICTURE_ENDINGS, draw_chart, refuse_ending
from fixel.errors import InvalidInput
from fixel.formats.camera_file import load_camera, save_camera
from fixel.formats.camera_import import import_camera
from fixel.formats.camera_opencv import save_opencv, save_ros
from fixel.formats.rig_file import plate_of
from fixel.io.atomic import refuse_unwritable, written_whole
from fixel.io.document import read_document
from fixel.typing import ProgressCallback
from fixel.vision.boards import Board, board_of
from fixel.vision.calibrate_lens import calibrate_lens, find_boards
from fixel.vision.camera import MeasuredCamera
from fixel.vision.frame import Picture
from fixel.vision.place_camera import Placement, place_by_board, place_by_tags
from fixel.workflows.acquisition.camera.answer import CameraAnswer, PlaceAccuracy, verdict
from fixel.workflows.acquisition.camera.pictures import files_of, first_picture, pictures_of

RIG_FILE = "rig.yaml"
CAMERA_ENDINGS = (".yaml", ".yml")


def calibrate(
    paths: Sequence[Path],
    board: str,
    output: Path,
    *,
    coefficients: int | None = None,
    fisheye: bool = False,
    progress: ProgressCallback | None = None,
) -> CameraAnswer:
    """Calibrate a lens from pictures of a board, and save the camera.

    Parameters
    ----------
    paths : sequence of Path
        Pictures, folders of them, or videos.
    board : str
        See `board_of`.
    output : Path
        Camera file to write.
    coefficients, fisheye
        See `calibrate_lens`.
    progress : callable, optional
        Called with the number of pictures done, their total, and the picture's name.
    """
    wanted = board_of(board)
    _check_output(output)
    files = files_of(paths)
    done = 0

    def one(name: str) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(min(done, len(files)), len(files), name)

    views, dropped = find_boards(pictures_of(files), wanted, one)
    found = calibrate_lens(views, dropped, coefficients=coefficients, fisheye=fisheye)
    save_camera(found.camera, output)
    return CameraAnswer(camera=found.camera, file=output, calibration=found)


def bring_in(
    path: Path,
    output: Path,
    *,
    format: str = "auto",
    size: tuple[int, int] | None = None,
    which: str = "",
    unit: float = 1e-3,
) -> CameraAnswer:
    """Import a camera of another program and save it as fixel's own; see `import_camera`."""
    _check_output(output)
    if output.resolve() == path.resolve():
        raise InvalidInput(str(output), found="the input file", expected="another file to write")
    found = import_camera(path, format, size=size, which=which, unit=unit)
    save_camera(found.camera, output)
    return CameraAnswer(camera=found.camera, file=output, remarks=found.remarks)


def export(path: Path, output: Path, format: str) -> CameraAnswer:
    """Export the lens of a camera to the format of OpenCV or ROS."""
    camera = load_camera(path)
    refuse_unwritable(output)
    writers = {"opencv": save_opencv, "ros": save_ros}
    if format not in writers:
        raise InvalidInput("format", found=repr(format), expected=", ".join(writers))
    writers[format](camera.lens, output)
    return CameraAnswer(camera=camera, file=output)


def place(
    path: Path,
    picture: Path,
    output: Path,
    *,
    board: str | None = None,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    thickness: float = 0.0,
    rig: str | None = None,
    heights: Sequence[float] = (0.0,),
    plot: Path | None = None,
) -> CameraAnswer:
    """Find the pose of a camera above the plate, and save the camera with its pose.

    Parameters
    ----------
    path : Path
        The camera file.
    picture : Path
        Picture of the plate, or a video whose first frame is used.
    board : str, optional
        Board that lies on the plate, its lower left corner `at` a pose of the world [m, m, rad],
        its upper face `thickness` above the plate [m].
    rig : str, optional
        Rig with tags on the plate. They are used if two or more of them are seen, otherwise the
        board. Defaults to `rig.yaml` next to the camera file or the picture, if there is one.
    heights : sequence of float
        Heights above the plate at which to report the accuracy [m].
    plot : Path, optional
        File for a chart of the accuracy: `.png`, `.svg` or `.pdf`.
    """
    if rig is None:
        beside = [folder / RIG_FILE for folder in (path.parent, picture.parent)]
        rig = next((str(file) for file in beside if _has_plate(file)), None)
    if board is None and rig is None:
        raise InvalidInput("place", found="neither", expected="--board or --rig, or both")
    _check_output(output)
    check_plot(plot)
    measured = load_camera(path)
    seen = first_picture(picture)
    found, remarks = _place(measured, seen, board, at, thickness, rig)
    save_camera(found.camera, output)
    verdicts = tuple(verdict(found.camera, height) for height in heights)
    return CameraAnswer(
        camera=found.camera,
        file=output,
        placement=found,
        verdicts=verdicts,
        remarks=remarks,
        plot=draw_errors(found.camera, verdicts, plot),
    )


def _place(
    measured: MeasuredCamera,
    seen: Picture,
    board: str | None,
    at: tuple[float, float, float],
    thickness: float,
    rig: str | None,
) -> tuple[Placement, tuple[str, ...]]:
    """Place a camera by the plate's tags if they are seen, else by the board; add a remark."""
    why_not = "no rig with tags on the plate was named (--rig)"
    if rig is not None:
        try:
            tags = plate_of(rig)
            if not tags:
                raise InvalidInput(
                    rig, found="no tags on the plate", expected="a rig with plate tags, or --board"
                )
            found = place_by_tags(measured, seen, tags)
            return found, (f"placed by the tags on the plate of {rig}",)
        except InvalidInput as problem:
            if board is None:
                raise
            why_not = f"placing by its tags failed: {problem.found}"
    found = place_by_board(measured, seen, board_of(str(board)), pose=at, height=thickness)
    return found, (
        f"placed by the board; {why_not}. Tags in the corners of the plate give higher accuracy "
        "in the corners of the picture than a board in its middle",
    )


def _has_plate(file: Path) -> bool:
    """Whether a rig file exists and has tags on its plate; its camera file is not read."""
    if not file.is_file():
        return False
    raw = read_document(file)
    return isinstance(raw, dict) and bool(raw.get("plate"))


def draw_errors(
    measured: MeasuredCamera, verdicts: Sequence[PlaceAccuracy], plot: Path | None
) -> Path | None:
    """Draw the map of errors at the first height, if a file is given."""
    from fixel.drawing.camera import camera_error_chart

    if plot is None or not verdicts:
        return None
    chart = camera_error_chart(verdicts[0].errors, measured.lens.image_size, measured.seen)
    with written_whole(plot) as unfinished:
        draw_chart(chart, unfinished)
    return plot


def board_text(board: Board) -> str:
    """Format a board as it is typed on the command line."""
    mm = f"{1e3 * board.square:g}mm"
    if board.marker is None:
        return f"checkerboard:{board.columns - 1}x{board.rows - 1}:{mm}"
    return f"charuco:{board.columns}x{board.rows}:{mm}:{1e3 * board.marker:g}mm"


def _check_output(output: Path) -> None:
    refuse_ending(output, CAMERA_ENDINGS, "camera")
    refuse_unwritable(output)


def check_plot(plot: Path | None) -> None:
    """Reject a figure file that cannot be written, before any work."""
    if plot is not None:
        refuse_ending(plot, PICTURE_ENDINGS, "picture")
        refuse_unwritable(plot)
