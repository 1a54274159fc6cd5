"""`fixel camera`: calibrate, import, place and check a camera; print boards and tags."""

import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from fixel.cli.camera_text import (
    coefficient_lines,
    corner_lines,
    lens_lines,
    misfit_lines,
    place_lines,
    remark_lines,
    verdict_lines,
    view_lines,
)
from fixel.cli.options import AsJson, argument, option, required, with_options
from fixel.cli.screen import counting_bar, paragraphs, print_answer, wrote
from fixel.errors import InvalidInput

THESIS_HEIGHTS = (0.0, 25.4)  # [mm] plate, upper face of the object

app = typer.Typer(
    help="Calibrate, import, place and check a camera; print boards and tags.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

BoardOption = Annotated[
    str | None,
    typer.Option(
        help="charuco:7x5:30mm:22mm (squares, size, size of tags) or checkerboard:9x6:25mm "
        "(inner corners, size of squares).",
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
    typer.Option(help="Map of errors at the first height: .png, .svg or .pdf.", metavar="FILE"),
]
Paper = Annotated[str, typer.Option(help="a4, a3, a2 or letter.")]
CameraFile = Annotated[
    Path, typer.Argument(help="Camera file.", metavar="CAMERA", exists=True, dir_okay=False)
]


@app.command("calibrate")
@with_options
def calibrate(
    *,
    pictures: list[Path] = required(
        "Pictures of a board, folders of them, or a video.", metavar="PICTURES...", exists=True
    ),
    board: BoardOption = None,
    out: Path = option(Path("camera.yaml"), "Camera file to write."),
    coefficients: int | None = option(
        None,
        "Number of distortion coefficients: 0, 1, 2, 4, 5 or 8.",
        show_default="5, 8 where pictures left out need them, 4 for fewer than 8 pictures",
    ),
    fisheye: bool = option(False, "For lenses wider than about 120 degrees.", "--fisheye"),
    as_json: AsJson = False,
) -> None:
    """Calibrate a lens from 10 to 20 pictures of a board."""
    from fixel.workflows.acquisition.camera.calibrate import calibrate as run

    if board is None:
        raise InvalidInput(
            "--board",
            found=None,
            expected="the board in the pictures: charuco:7x5:30mm:22mm or checkerboard:9x6:25mm",
            hint="to print one: fixel camera board",
        )
    with counting_bar() as bar:
        answer = run(pictures, board, out, coefficients=coefficients, fisheye=fisheye, progress=bar)
    _show(
        as_json,
        answer.summary(),
        [lens_lines(answer), view_lines(answer), coefficient_lines(answer) + corner_lines(answer)],
        [out],
        f"fixel camera place {_quoted(out)} PICTURE --rig RIG, a picture of the plate with its "
        f"tags; or --board {board}, with the board flat on it",
    )


@app.command("import")
@with_options
def import_(
    *,
    file: Path = required(
        "Calib_Results.m or .mat, OpenCV's storage, Kalibr's camchain, ROS's camera_info.",
        exists=True,
        dir_okay=False,
    ),
    out: Path = option(Path("camera.yaml"), "Camera file to write."),
    format: str = option("auto", "auto, matlab, opencv, kalibr or ros."),
    size: str | None = option(
        None, "Size of your pictures, 1280x720; a file for another size is refused.", metavar="WxH"
    ),
    which: str = option("", "Camera to read from a Kalibr file of several.", metavar="cam0"),
    unit: str = option("mm", "Unit of lengths in a MATLAB file: mm, cm or m."),
    as_json: AsJson = False,
) -> None:
    """Take over a camera that another program calibrated."""
    from fixel.workflows.acquisition.camera.calibrate import bring_in

    units = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
    if unit not in units:
        raise InvalidInput("--unit", found=repr(unit), expected="mm, cm or m")
    answer = bring_in(file, out, format=format, size=_size(size), which=which, unit=units[unit])
    placed = answer.camera.camera is not None
    _show(
        as_json,
        answer.summary(),
        [lens_lines(answer), remark_lines(answer)],
        [out],
        f"fixel camera check {_quoted(out)}"
        if placed
        else f"fixel camera place {_quoted(out)} PICTURE --board charuco:7x5:30mm:22mm",
    )


@app.command("export")
def export(
    camera: CameraFile,
    out: Annotated[Path, typer.Option(help="File to write.", metavar="FILE")],
    format: Annotated[str, typer.Option(help="opencv or ros.")] = "opencv",
    as_json: AsJson = False,
) -> None:
    """Write a lens as OpenCV or ROS has it."""
    from fixel.workflows.acquisition.camera.calibrate import export as run

    answer = run(camera, out, format)
    _show(as_json, answer.summary(), [lens_lines(answer)], [out], "")


@app.command("place")
@with_options
def place(
    *,
    camera: CameraFile,
    picture: Path = required(
        "Picture of the plate, or a video whose first frame is taken.",
        metavar="PICTURE",
        exists=True,
    ),
    board: BoardOption = None,
    at: str = option(
        "0,0,0",
        "Where the board's lower left corner lies in the world: x, y [mm], angle [deg].",
        metavar="X,Y,ANGLE",
    ),
    thickness_mm: float = option(0.0, "Thickness of the board [mm].", min=0.0),
    rig: str | None = option(
        None, "Rig whose tags are on the plate; used before a board.", metavar="RIG"
    ),
    out: Path | None = option(None, "Camera file to write.", show_default="CAMERA-placed"),
    height_mm: Heights = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Find where a camera is above the plate, and how right places on it are."""
    from fixel.workflows.acquisition.camera.calibrate import place as run

    target = out or camera.with_name(f"{camera.stem}-placed.yaml")
    answer = run(
        camera,
        picture,
        target,
        board=board,
        at=_pose(at),
        thickness=thickness_mm / 1e3,
        rig=rig,
        heights=_heights(height_mm),
        plot=plot,
    )
    _show(
        as_json,
        answer.summary(),
        [place_lines(answer), misfit_lines(answer), verdict_lines(answer), remark_lines(answer)],
        [target, plot],
        f"name {target.name} as the camera of a rig file, then fixel camera check RIG --video FILE",
    )


@app.command("check")
def check(
    camera: Annotated[
        str,
        typer.Argument(help="Camera file, rig file, or name of an example rig.", metavar="CAMERA"),
    ],
    video: Annotated[
        Path | None,
        typer.Option(
            help="Video or picture of the bench: is its size right, is the camera where it was?",
            metavar="FILE",
            exists=True,
        ),
    ] = None,
    height_mm: Heights = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Report how right places on the plate are, and whether the camera is still where it was."""
    from fixel.workflows.acquisition.camera.check import check as run

    found = run(camera, video=video, heights=_heights(height_mm), plot=plot)
    tags = [
        f"tag {number} of the plate is {1e3 * off:.2f} mm from its place"
        for number, off in found.tags.items()
    ]
    _show(
        as_json,
        found.summary(),
        [
            lens_lines(found.answer),
            place_lines(found.answer),
            [f"pixels and directions agree both ways to {found.round_trip:.1g} px"],
            verdict_lines(found.answer),
            remark_lines(found.answer),
            tags,
            [f"PROBLEM: {problem}" for problem in found.problems],
        ],
        [plot],
        "" if not found.problems else f"fixel camera place {_quoted(camera)} PICTURE",
    )
    if found.problems:
        raise typer.Exit(1)


@app.command("board")
def board_(
    board: Annotated[
        str, typer.Argument(help="As for calibrate.", metavar="BOARD")
    ] = "charuco:7x5:30mm:22mm",
    out: Annotated[Path, typer.Option(help="Print to write: .pdf or .png.", metavar="FILE")] = Path(
        "board.pdf"
    ),
    paper: Paper = "a4",
    as_json: AsJson = False,
) -> None:
    """A board to print, true to scale."""
    from fixel.workflows.acquisition.camera.prints import print_board

    answer = print_board(board, out, paper)
    _show(
        as_json,
        answer.summary(),
        [["Print at 100 %, measure the ruler, glue it to something flat."]],
        [out],
        f"fixel camera calibrate PICTURES... --board {answer.what}",
    )


@app.command("tags")
@with_options
def tags(
    *,
    rig: str | None = argument(
        None, "Rig whose tags to print.", metavar="RIG", show_default="none"
    ),
    ids: str | None = option(None, "Numbers, instead of a rig: 0-9.", metavar="FIRST-LAST"),
    size_mm: float = option(30.0, "Side of the black square [mm]."),
    family: str = option("apriltag-36h11", "apriltag-36h11, aruco-4x4-50 or aruco-5x5-100."),
    out: Path = option(Path("tags.pdf"), "Print to write: .pdf or .png."),
    paper: Paper = "a4",
    as_json: AsJson = False,
) -> None:
    """Tags to print, true to scale: those of a rig, or some numbers."""
    from fixel.workflows.acquisition.camera.prints import print_rig_tags, print_tags

    if (rig is None) == (ids is None):
        raise InvalidInput(
            "tags", found="both" if rig else "neither", expected="either a RIG or --ids 0-9"
        )
    if rig is not None:
        answer = print_rig_tags(rig, out, paper)
    else:
        first, last = _range(str(ids))
        answer = print_tags(first, last, size_mm / 1e3, family, out, paper)
    _show(
        as_json,
        answer.summary(),
        [
            [
                f"{answer.tags} tags on {answer.sheets} sheet{'s' if answer.sheets > 1 else ''}. "
                "Print at 100 %, measure the ruler, leave the white around each tag."
            ]
        ],
        [out],
        f"fixel camera place CAMERA PICTURE --rig {_quoted(rig)}" if rig else "",
    )


def _show(
    as_json: bool,
    content: dict[str, Any],
    blocks: Sequence[list[str]],
    files: Sequence[Path | None],
    after: str,
) -> None:
    """Print one JSON object, or blocks of lines, files and the next command."""
    following = [f"Next: {after}"] if after else []
    print_answer(as_json, lambda: content, lambda: paragraphs(*blocks, wrote(files), following))


def _quoted(path: Path | str) -> str:
    return shlex.quote(str(path))


def _heights(typed: list[float] | None) -> tuple[float, ...]:
    """Return heights above the plate [m]; those of the thesis by default."""
    return tuple(mm / 1e3 for mm in (typed or THESIS_HEIGHTS))


def _pose(text: str) -> tuple[float, float, float]:
    """Parse `X,Y,ANGLE` in mm and degrees to metres and radians."""
    try:
        x, y, angle = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(
            "--at", found=repr(text), expected="x and y [mm] and an angle [deg]: 0,0,0"
        ) from None
    return x / 1e3, y / 1e3, math.radians(angle)


def _size(text: str | None) -> tuple[int, int] | None:
    """Parse `1280x720` to width and height [px]."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not found:
        raise InvalidInput("--size", found=repr(text), expected="width and height [px]: 1280x720")
    return int(found[1]), int(found[2])


def _range(text: str) -> tuple[int, int]:
    """Parse `0-9` to the first and the last number."""
    found = re.fullmatch(r"(\d{1,4})(?:-(\d{1,4}))?", text)
    if not found:
        raise InvalidInput("--ids", found=repr(text), expected="numbers such as 0-9")
    return int(found[1]), int(found[2] or found[1])
