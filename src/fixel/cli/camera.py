"""`fixel camera`: calibrate, import, place and check a camera; print boards and tags."""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from fixel.cli.options import AsJson, argument, option, required, with_options
from fixel.cli.screen import paragraphs, print_answer, wrote
from fixel.errors import InvalidInput
from fixel.progress import show_progress

THESIS_HEIGHTS = (0.0, 25.4)  # [mm] plate, upper face of the object

app = typer.Typer(
    help="Calibrate, place and check a camera; print boards and tags.", no_args_is_help=True
)

BoardOption = Annotated[
    str | None,
    typer.Option(
        help="Calibration board: charuco:7x5:30mm:22mm (squares, their size, size of the tags) or "
        "checkerboard:9x6:25mm (inner corners, size of the squares).",
        metavar="BOARD",
    ),
]
Heights = Annotated[
    list[float] | None,
    typer.Option(
        "--height-mm",
        help="Height above the plate for which the accuracy is reported; may be repeated.",
        show_default="0 and 25.4",
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option(
        help="Draw a map of the position error at the first height: .png, .svg or .pdf.",
        metavar="FILE",
    ),
]
Paper = Annotated[str, typer.Option(help="Paper size: a4, a3, a2 or letter.")]
CameraFile = Annotated[
    Path, typer.Argument(help="Camera file.", metavar="CAMERA", exists=True, dir_okay=False)
]


@app.command("calibrate")
@with_options
def calibrate(
    *,
    pictures: list[Path] = required(
        "Pictures of a board, folders of pictures, or a video.", metavar="PICTURES...", exists=True
    ),
    board: BoardOption = None,
    out: Path = option(Path("camera.yaml"), "Camera file to write."),
    coefficients: int | None = option(
        None,
        "Number of distortion coefficients: 0, 1, 2, 4, 5 or 8.",
        show_default="5; 8 if cross-validation needs them; 4 for fewer than 8 pictures",
    ),
    fisheye: bool = option(
        False, "Use the fisheye model, for lenses wider than about 120 degrees.", "--fisheye"
    ),
    as_json: AsJson = False,
) -> None:
    """Calibrate a lens from 10 to 20 pictures of a board."""
    from fixel.workflows.acquisition.camera.calibrate import calibrate as run

    if board is None:
        expected = "the board in the pictures: charuco:7x5:30mm:22mm or checkerboard:9x6:25mm"
        raise InvalidInput(
            "--board", found=None, expected=expected, hint="to print one: fixel camera board"
        )
    with show_progress() as bar:
        answer = run(pictures, board, out, coefficients=coefficients, fisheye=fisheye, progress=bar)
    after = (
        f"fixel camera place {_quoted(out)} PICTURE --rig RIG with a picture of the plate and its "
        f"tags; or --board {board} with the board flat on the plate"
    )
    _show(as_json, answer, [out], after)


@app.command("import")
@with_options
def import_(
    *,
    file: Path = required(
        "Calib_Results.m or .mat, OpenCV storage, Kalibr camchain or ROS camera_info.",
        exists=True,
        dir_okay=False,
    ),
    out: Path = option(Path("camera.yaml"), "Camera file to write."),
    format: str = option("auto", "Format: auto, matlab, opencv, kalibr or ros."),
    size: str | None = option(
        None,
        "Size of your pictures, such as 1280x720; a file for another size is rejected.",
        metavar="WxH",
    ),
    which: str = option(
        "", "Camera to read from a Kalibr file with several cameras, such as cam0.", metavar="NAME"
    ),
    unit: str = option("mm", "Unit of lengths in a MATLAB file: mm, cm or m."),
    as_json: AsJson = False,
) -> None:
    """Import a camera that another program calibrated."""
    from fixel.workflows.acquisition.camera.calibrate import bring_in

    units = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
    if unit not in units:
        raise InvalidInput("--unit", found=repr(unit), expected="mm, cm or m")
    answer = bring_in(
        file, out, format=format, size=picture_size(size), which=which, unit=units[unit]
    )
    placed = answer.camera.camera is not None
    after = "check {}" if placed else "place {} PICTURE --board charuco:7x5:30mm:22mm"
    _show(as_json, answer, [out], f"fixel camera {after.format(_quoted(out))}")


@app.command("export")
@with_options
def export(
    *,
    camera: CameraFile,
    out: Annotated[Path, typer.Option(help="File to write.", metavar="FILE")],
    format: str = option("opencv", "Format: opencv or ros."),
    as_json: AsJson = False,
) -> None:
    """Write a lens as an OpenCV or ROS file."""
    from fixel.workflows.acquisition.camera.calibrate import export as run

    _show(as_json, run(camera, out, format), [out], "")


@app.command("place")
@with_options
def place(
    *,
    camera: CameraFile,
    picture: Path = required(
        "Picture of the plate, or a video, of which the first frame is used.",
        metavar="PICTURE",
        exists=True,
    ),
    board: BoardOption = None,
    at: str = option(
        "0,0,0",
        "Pose of the board's lower left corner in the world: x, y [mm], angle [deg].",
        metavar="X,Y,ANGLE",
    ),
    thickness_mm: float = option(0.0, "Thickness of the board [mm].", min=0.0),
    rig: str | None = option(
        None, "Rig whose tags are on the plate; takes precedence over --board.", metavar="RIG"
    ),
    out: Path | None = option(None, "Camera file to write.", show_default="CAMERA-placed"),
    height_mm: Heights = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Compute the pose of a camera above the plate.

    It also reports the accuracy of positions on the plate.
    """
    from fixel.model.fields import pose_of
    from fixel.workflows.acquisition.camera.calibrate import place as run

    target = out or camera.with_name(f"{camera.stem}-placed.yaml")
    answer = run(
        camera,
        picture,
        target,
        board=board,
        at=pose_of(at, "--at").tolist(),
        thickness=thickness_mm / 1e3,
        rig=rig,
        heights=_heights(height_mm),
        plot=plot,
    )
    after = "as the camera of a rig file, then fixel camera check RIG --video FILE"
    _show(as_json, answer, [target, plot], f"name {target.name} {after}")


@app.command("check")
@with_options
def check(
    *,
    camera: str = required("Camera file, rig file, or name of an example rig.", metavar="CAMERA"),
    video: Path | None = option(
        None,
        "Video or picture of the bench, to check its size and the pose of the camera.",
        exists=True,
    ),
    height_mm: Heights = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Report whether a camera has moved, and its accuracy."""
    from fixel.workflows.acquisition.camera.calibrate import check as run

    found = run(camera, video=video, heights=_heights(height_mm), plot=plot)
    record = f"record --camera 0 --out FOLDER --rig {_quoted(camera)}"
    after = f"camera place {_quoted(camera)} PICTURE" if found.problems else record
    _show(as_json, found, [plot], f"fixel {after}")
    if found.problems:
        raise typer.Exit(1)


@app.command("board")
@with_options
def board_(
    *,
    board: str = argument(
        "charuco:7x5:30mm:22mm", "Board, as for fixel camera calibrate.", metavar="BOARD"
    ),
    out: Path = option(Path("board.pdf"), "File to print: .pdf or .png."),
    paper: Paper = "a4",
    as_json: AsJson = False,
) -> None:
    """Write a calibration board to print, true to scale."""
    from fixel.workflows.acquisition.camera.calibrate import print_board

    answer = print_board(board, out, paper)
    _show(as_json, answer, [out], f"fixel camera calibrate PICTURES... --board {answer.what}")


@app.command("tags")
@with_options
def tags(
    *,
    rig: str | None = argument(
        None, "Rig whose tags are printed.", metavar="RIG", show_default="none"
    ),
    ids: str | None = option(
        None, "Range of tag numbers, instead of a rig: 0-9.", metavar="FIRST-LAST"
    ),
    size_mm: float = option(30.0, "Side of the black square [mm]."),
    family: str = option(
        "apriltag-36h11", "Tag family: apriltag-36h11, aruco-4x4-50 or aruco-5x5-100."
    ),
    out: Path = option(Path("tags.pdf"), "File to print: .pdf or .png."),
    paper: Paper = "a4",
    as_json: AsJson = False,
) -> None:
    """Write tags to print, true to scale.

    Write all tags of a rig, or a range of numbers.
    """
    from fixel.workflows.acquisition.camera.calibrate import print_rig_tags, print_tags

    if (rig is None) == (ids is None):
        found, expected = "a rig and --ids" if rig else "neither a rig nor --ids", "one of them"
        raise InvalidInput("tags", found=found, expected=expected)
    if rig is not None:
        answer = print_rig_tags(rig, out, paper)
    else:
        first, last = _range(str(ids))
        answer = print_tags(first, last, size_mm / 1e3, family, out, paper)
    after = f"--rig {_quoted(rig)}" if rig else "--rig RIG, with the tags in the rig file"
    _show(as_json, answer, [out], f"fixel camera place CAMERA PICTURE {after}")


def _show(as_json: bool, answer: Any, files: Sequence[Path | None], after: str) -> None:
    """Print one JSON object, or paragraphs, files and the next command."""
    following = [f"Next: {after}"] if after else []
    print_answer(
        as_json, answer.summary, lambda: paragraphs(*answer.blocks(), wrote(files), following)
    )


def _quoted(path: Path | str) -> str:
    return shlex.quote(str(path))


def _heights(typed: list[float] | None) -> tuple[float, ...]:
    """Return heights above the plate [m]; those of the thesis by default."""
    return tuple(mm / 1e3 for mm in (typed or THESIS_HEIGHTS))


def picture_size(text: str | None) -> tuple[int, int] | None:
    """Parse `1280x720` to width and height [px]."""
    if text is None:
        return None
    found = re.fullmatch(r"([1-9]\d{0,4})[xX×]([1-9]\d{0,4})", text.strip())
    if not found:
        raise InvalidInput("--size", found=repr(text), expected="WIDTHxHEIGHT, such as 1280x720")
    return int(found[1]), int(found[2])


def _range(text: str) -> tuple[int, int]:
    """Parse `0-9` to the first and the last number."""
    found = re.fullmatch(r"(\d{1,4})(?:-(\d{1,4}))?", text)
    if not found:
        raise InvalidInput("--ids", found=repr(text), expected="numbers such as 0-9")
    return int(found[1]), int(found[2] or found[1])
