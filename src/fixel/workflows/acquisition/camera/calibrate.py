"""Calibrate, import, export, place and check cameras; print boards and tags."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.drawing.chart import draw_chart, require_file
from fixel.drawing.prints import PRINT_ENDINGS, PrintSheet, board_sheet, save_sheets, tag_sheets
from fixel.errors import InvalidInput, counted
from fixel.formats.camera_import import import_camera
from fixel.formats.camera_opencv import save_opencv, save_ros
from fixel.formats.recording import RIG_FILE
from fixel.formats.rig_file import EXAMPLES, load_camera, markers_of, rig_of, save_camera
from fixel.formats.video_file import ENDINGS, open_video
from fixel.io.atomic import refuse_unwritable, usable, written_whole
from fixel.io.document import read_document
from fixel.typing import ProgressCallback
from fixel.vision.calibrate_lens import calibrate_lens, find_boards
from fixel.vision.camera import MeasuredCamera
from fixel.vision.frame import Picture, opencv
from fixel.vision.lens import Lens
from fixel.vision.marks import Board, Rig, Tag, board_of
from fixel.vision.place_camera import Placement, place_by_board, place_by_tags
from fixel.vision.tracking.checks import moved_limit
from fixel.vision.tracking.tags import find_tags, tag_corners
from fixel.workflows.acquisition.camera.answer import (
    CameraAnswer,
    CameraCheck,
    PlaceAccuracy,
    mm,
    verdict,
)

CAMERA_ENDINGS = (".yaml", ".yml")
MOVED: Final = 5e-4  # [m] allowed offset of a plate tag, in addition to the camera's errors
ROUND_TRIP: Final = 1e-6  # [px]


def calibrate(
    paths: Sequence[Path],
    board: str,
    output: Path,
    *,
    coefficients: int | None = None,
    fisheye: bool = False,
    progress: ProgressCallback | None = None,
) -> CameraAnswer:
    """Calibrate a lens from pictures of a board (see `board_of`), and save the camera to `output`.

    Paths are pictures, folders of them, or videos; other options are those of `calibrate_lens`.
    `progress` is called with the number of pictures done, their total, and the picture's name.
    """
    wanted = board_of(board)
    require_file(output, CAMERA_ENDINGS, "camera")
    files = files_of(paths)
    done = count(1)

    def one(name: str) -> None:
        if progress:
            progress(min(next(done), len(files)), len(files), name)

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
    require_file(output, CAMERA_ENDINGS, "camera")
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
    at: Sequence[float] = (0.0, 0.0, 0.0),
    thickness: float = 0.0,
    rig: str | None = None,
    heights: Sequence[float] = (0.0,),
    plot: Path | None = None,
) -> CameraAnswer:
    """Find the pose of a camera above the plate, and save the camera with its pose.

    Tags of a rig on the plate are used if two or more of them are seen, otherwise the board, which
    lies with its lower left corner `at` a pose of the world [m, m, rad] and its upper face
    `thickness` above the plate [m]. The rig is by default `rig.yaml` next to the camera file or the
    picture, if there is one. The accuracy is reported at `heights` above the plate [m].
    """
    if rig is None:
        beside = [folder / RIG_FILE for folder in (path.parent, picture.parent)]
        rig = next((str(file) for file in beside if _has_plate(file)), None)
    if board is None and rig is None:
        raise InvalidInput("place", found="neither", expected="--board or --rig, or both")
    require_file(output, CAMERA_ENDINGS, "camera")
    require_file(plot)
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
    at: Sequence[float],
    thickness: float,
    rig: str | None,
) -> tuple[Placement, tuple[str, ...]]:
    """Place a camera by the plate's tags if they are seen, else by the board; add a remark."""
    why_not = "no rig with tags on the plate was named (--rig)"
    if rig is not None:
        try:
            _, _, tags = markers_of(rig)
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
    from fixel.drawing.tracking import camera_error_chart

    if plot is None or not verdicts:
        return None
    chart = camera_error_chart(verdicts[0].errors, measured.lens.image_size, measured.seen)
    draw_chart(chart, plot)
    return plot


def board_text(board: Board) -> str:
    """Format a board as it is typed on the command line."""
    mm = f"{1e3 * board.square:g}mm"
    if board.marker is None:
        return f"checkerboard:{board.columns - 1}x{board.rows - 1}:{mm}"
    return f"charuco:{board.columns}x{board.rows}:{mm}:{1e3 * board.marker:g}mm"


def check(
    name: str,
    *,
    video: Path | None = None,
    heights: Sequence[float] = (0.0,),
    plot: Path | None = None,
) -> CameraCheck:
    """Check a camera, or that of a rig, against itself and against a video or picture.

    Its size is compared; its first frame shows whether the tags of a rig's plate are where they
    belong. The accuracy is reported at `heights` above the plate [m].
    """
    require_file(plot)
    measured, rig = _camera_of(name)
    problems: list[str] = []
    tags: dict[int, float] = {}
    if video is not None:
        picture = first_picture(video)
        measured.lens.for_pictures_of((picture.shape[1], picture.shape[0]))
        if rig is not None and rig.plate:
            tags = _tags_off(rig, picture)
            problems += _moved(rig, tags)
    trip = round_trip(measured.lens)
    if not trip < ROUND_TRIP:
        problems.append(
            f"the round trip from pixels to directions and back has an error of {trip:.1g} px"
        )
    placed = measured.camera is not None
    verdicts = tuple(verdict(measured, height) for height in heights) if placed else ()
    remarks = () if placed else ("it has not been placed above a plate yet",)
    answer = CameraAnswer(
        camera=measured,
        verdicts=verdicts,
        remarks=remarks,
        plot=draw_errors(measured, verdicts, plot),
    )
    return CameraCheck(answer, trip, tags, tuple(problems))


def round_trip(lens: Lens, columns: int = 65, rows: int = 37) -> float:
    """Largest error from pixels to directions and back, on a grid over the picture [px]."""
    width, height = lens.image_size
    u, v = np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows)
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    return float(np.abs(lens.pixel(lens.direction(pixels)) - pixels).max())


def _camera_of(name: str) -> tuple[MeasuredCamera, Rig | None]:
    if name not in EXAMPLES:
        raw = read_document(Path(name))
        if not (isinstance(raw, dict) and "fixel_rig" in raw):
            return load_camera(name), None
    rig = rig_of(name)
    return rig.measured or MeasuredCamera(lens=rig.camera.lens, camera=rig.camera), rig


def _tags_off(rig: Rig, picture: Any) -> dict[int, float]:
    off = {}
    for index, pixels in find_tags(picture, rig.plate).items():
        tag = rig.plate[index]
        seen = rig.camera.on_plane(pixels, tag.height)
        off[tag.id] = float(np.hypot(*(seen - tag_corners(tag)).T).max())
    return off


def _moved(rig: Rig, tags: dict[int, float]) -> list[str]:
    if not tags:
        raise InvalidInput(
            "picture",
            found="none of the tags on the plate",
            expected="tags " + ", ".join(str(tag.id) for tag in rig.plate),
            hint="check that the picture shows the bench of the rig",
        )
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


PHOTO_ENDINGS: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
VIDEO_ENDINGS: Final = (*ENDINGS, ".nut")  # of a recording too
FROM_VIDEO: Final = 40  # frames used of a video
MAX_BYTES: Final = 200_000_000


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return files, and those of folders sorted by name; raise unless pictures or videos."""
    known = (*PHOTO_ENDINGS, *VIDEO_ENDINGS)
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in known)
            if not inside:
                raise InvalidInput(
                    str(path), found="a folder without pictures", expected="files such as .png"
                )
            files += inside
        elif path.suffix.lower() not in known:
            raise InvalidInput(
                str(path), found=f"the ending {path.suffix!r}", expected=", ".join(known)
            )
        else:
            files.append(path)
    return files


def pictures_of(files: Sequence[Path]) -> Iterator[tuple[str, Picture]]:
    """Yield every picture with its name; of a video, frames spread over its length."""
    for file in files:
        if file.suffix.lower() in VIDEO_ENDINGS:
            yield from _frames_of(file)
        else:
            yield file.name, read_picture(file)


def first_picture(path: Path) -> Picture:
    """Load a picture, or the first frame of a video."""
    (file,) = files_of([path])[:1]
    if file.suffix.lower() in VIDEO_ENDINGS:
        for frame in open_video(file).frames():
            return frame.picture
        raise InvalidInput(str(path), found="no frames", expected="a video with pictures")
    return read_picture(file)


def read_picture(path: Path) -> Picture:
    """Load a picture as the sensor recorded it, without the rotation noted in its file."""
    cv2 = opencv()
    with usable(path, "a picture"):
        if path.stat().st_size > MAX_BYTES:
            raise InvalidInput(str(path), found="more than 200 MB", expected="a picture")
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        picture: Picture | None = cv2.imdecode(data, flags) if len(data) else None
    except cv2.error:
        picture = None
    if picture is None:
        raise InvalidInput(
            str(path), found="a file that is not a picture", expected="a file such as .png or .jpg"
        )
    return picture


def _frames_of(file: Path) -> Iterator[tuple[str, Picture]]:
    video = open_video(file)
    every = max(1, (video.n_frames or sum(1 for _ in video.frames())) // FROM_VIDEO)
    for number, frame in enumerate(video.frames()):
        if number % every == 0:
            yield f"{file.name} at {frame.time:.2f} s", frame.picture


MAX_TAGS = 500


class PrintAnswer(NamedTuple):
    """Result of printing boards or tags into a file."""

    file: Path
    sheets: int
    what: str
    tags: int = 0  # number of tags, 0 for a board

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {**self._asdict(), "file": str(self.file)}

    def blocks(self) -> list[list[str]]:
        """Return paragraphs of text for people."""
        if not self.tags:
            return [
                ["Print at 100 %, check the length of the ruler, glue the sheet to a flat plate."]
            ]
        return [
            [
                f"{counted(self.tags, 'tag')} on {counted(self.sheets, 'sheet')}. "
                "Print at 100 %, check the ruler, leave the white border around each tag."
            ]
        ]


def print_board(text: str, output: Path, paper: str) -> PrintAnswer:
    """Save a board as a PDF or PNG."""
    board = board_of(text)
    name = board_text(board)
    _save((board_sheet(board, name, paper),), output)
    return PrintAnswer(output, 1, name)


def print_rig_tags(rig: str, output: Path, paper: str) -> PrintAnswer:
    """Print all tags of a rig, each with the part it belongs to."""
    title, parts, plate = markers_of(rig)
    tags = [
        (mark, name) for name, part in parts.items() for mark in part.marks if isinstance(mark, Tag)
    ]
    tags += [(tag, "plate") for tag in plate]
    if not tags:
        raise InvalidInput(rig, found="no tags", expected="a rig with tags", hint="thesis-tags")
    return _print_tags(tags, output, paper, title)


def print_tags(
    first: int, last: int, size: float, family: str, output: Path, paper: str
) -> PrintAnswer:
    """Print tags with numbers from `first` to `last`, all of one size [m]."""
    if not 0 <= first <= last or last - first >= MAX_TAGS:
        raise InvalidInput(
            "ids", found=f"{first}-{last}", expected=f"a range of at most {MAX_TAGS}: 0-9"
        )
    tags = [(Tag(id=k, size=size, height=0.0, family=family), "") for k in range(first, last + 1)]
    return _print_tags(tags, output, paper, f"{family}, {1e3 * size:g} mm")


def _print_tags(tags: list[tuple[Tag, str]], output: Path, paper: str, title: str) -> PrintAnswer:
    sheets = tag_sheets(tags, paper, title)
    _save(sheets, output)
    return PrintAnswer(output, len(sheets), title, len(tags))


def _save(sheets: tuple[PrintSheet, ...], output: Path) -> None:
    require_file(output, PRINT_ENDINGS, "print")
    with written_whole(output) as unfinished:
        save_sheets(sheets, unfinished)
