"""`fixel camera`: calibrate, import, place and check a camera; print boards and tags."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from fixel.cli.camera_options import heights_of, pose_of, quoted, range_of, size_of
from fixel.cli.camera_text import (
    coefficient_lines,
    corner_lines,
    lens_lines,
    misfit_lines,
    place_lines,
    remark_lines,
    show,
    verdict_lines,
    view_lines,
)
from fixel.cli.options import AsJson
from fixel.errors import InvalidInput

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
        help="Above the plate, for which to say how right places are; may be repeated.",
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
def calibrate(
    pictures: Annotated[
        list[Path],
        typer.Argument(
            help="Pictures of a board, folders of them, or a video.",
            metavar="PICTURES...",
            exists=True,
        ),
    ],
    board: BoardOption = None,
    out: Annotated[Path, typer.Option(help="Camera file to write.", metavar="FILE")] = Path(
        "camera.yaml"
    ),
    coefficients: Annotated[
        int | None,
        typer.Option(
            help="Number of distortion coefficients: 0, 1, 2, 4, 5 or 8.",
            show_default="5, 8 where pictures left out need them, 4 for fewer than 8 pictures",
        ),
    ] = None,
    fisheye: Annotated[
        bool, typer.Option("--fisheye", help="For lenses wider than about 120 degrees.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Calibrate a lens from 10 to 20 pictures of a board."""
    from fixel.cli.screen import counting_bar
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
    show(
        answer.summary(),
        [
            lens_lines(answer),
            view_lines(answer),
            coefficient_lines(answer) + corner_lines(answer),
        ],
        [out],
        f"fixel camera place {quoted(out)} PICTURE --rig RIG, a picture of the plate with its "
        f"tags; or --board {board}, with the board flat on it",
        as_json,
    )


@app.command("import")
def import_(
    file: Annotated[
        Path,
        typer.Argument(
            help="Calib_Results.m or .mat, OpenCV's storage, Kalibr's camchain, ROS's camera_info.",
            metavar="FILE",
            exists=True,
            dir_okay=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Camera file to write.", metavar="FILE")] = Path(
        "camera.yaml"
    ),
    format: Annotated[str, typer.Option(help="auto, matlab, opencv, kalibr or ros.")] = "auto",
    size: Annotated[
        str | None,
        typer.Option(
            help="Of your pictures, 1280x720: refused if the file is for others.", metavar="WxH"
        ),
    ] = None,
    which: Annotated[
        str, typer.Option(help="Of several cameras in a Kalibr file.", metavar="cam0")
    ] = "",
    unit: Annotated[str, typer.Option(help="Of lengths in a MATLAB file: mm, cm or m.")] = "mm",
    as_json: AsJson = False,
) -> None:
    """Take over a camera that another program calibrated."""
    from fixel.workflows.acquisition.camera.calibrate import bring_in

    units = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
    if unit not in units:
        raise InvalidInput("--unit", found=repr(unit), expected="mm, cm or m")
    answer = bring_in(file, out, format=format, size=size_of(size), which=which, unit=units[unit])
    placed = answer.camera.camera is not None
    show(
        answer.summary(),
        [lens_lines(answer), remark_lines(answer)],
        [out],
        f"fixel camera check {quoted(out)}"
        if placed
        else f"fixel camera place {quoted(out)} PICTURE --board charuco:7x5:30mm:22mm",
        as_json,
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
    show(answer.summary(), [lens_lines(answer)], [out], "", as_json)


@app.command("place")
def place(
    camera: CameraFile,
    picture: Annotated[
        Path,
        typer.Argument(
            help="Picture of the plate, or a video whose first frame is taken.",
            metavar="PICTURE",
            exists=True,
        ),
    ],
    board: BoardOption = None,
    at: Annotated[
        str,
        typer.Option(
            help="Where the board's lower left corner lies in the world: x, y [mm], angle [deg].",
            metavar="X,Y,ANGLE",
        ),
    ] = "0,0,0",
    thickness_mm: Annotated[
        float, typer.Option(help="Of the board, above the plate [mm].", min=0.0)
    ] = 0.0,
    rig: Annotated[
        str | None,
        typer.Option(help="Rig whose tags are on the plate; used before a board.", metavar="RIG"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Camera file to write.", metavar="FILE", show_default="CAMERA-placed"),
    ] = None,
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
        at=pose_of(at),
        thickness=thickness_mm / 1e3,
        rig=rig,
        heights=heights_of(height_mm),
        plot=plot,
    )
    show(
        answer.summary(),
        [
            place_lines(answer),
            misfit_lines(answer),
            verdict_lines(answer),
            remark_lines(answer),
        ],
        [target, plot],
        f"name {target.name} as the camera of a rig file, then fixel camera check RIG --video FILE",
        as_json,
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

    found = run(camera, video=video, heights=heights_of(height_mm), plot=plot)
    tags = [
        f"tag {number} of the plate is {1e3 * off:.2f} mm from its place"
        for number, off in found.tags.items()
    ]
    trip = [f"pixels and directions agree both ways to {found.round_trip:.1g} px"]
    problems = [f"PROBLEM: {problem}" for problem in found.problems]
    show(
        found.summary(),
        [
            lens_lines(found.answer),
            place_lines(found.answer),
            trip,
            verdict_lines(found.answer),
            remark_lines(found.answer),
            tags,
            problems,
        ],
        [plot],
        "" if not found.problems else f"fixel camera place {quoted(camera)} PICTURE",
        as_json,
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
    show(
        answer.summary(),
        [["Print at 100 %, measure the ruler, glue it to something flat."]],
        [out],
        f"fixel camera calibrate PICTURES... --board {answer.what}",
        as_json,
    )


@app.command("tags")
def tags(
    rig: Annotated[
        str | None,
        typer.Argument(help="Rig whose tags to print.", metavar="RIG", show_default="none"),
    ] = None,
    ids: Annotated[
        str | None, typer.Option(help="Numbers, in place of a rig: 0-9.", metavar="FIRST-LAST")
    ] = None,
    size_mm: Annotated[float, typer.Option(help="Side of the black square [mm].")] = 30.0,
    family: Annotated[
        str, typer.Option(help="apriltag-36h11, aruco-4x4-50 or aruco-5x5-100.")
    ] = "apriltag-36h11",
    out: Annotated[Path, typer.Option(help="Print to write: .pdf or .png.", metavar="FILE")] = Path(
        "tags.pdf"
    ),
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
        first, last = range_of(str(ids))
        answer = print_tags(first, last, size_mm / 1e3, family, out, paper)
    show(
        answer.summary(),
        [
            [
                f"{answer.tags} tags on {answer.sheets} sheet{'s' if answer.sheets > 1 else ''}. "
                "Print at 100 %, measure the ruler, leave the white around each tag."
            ]
        ],
        [out],
        f"fixel camera place CAMERA PICTURE --rig {shlex.quote(rig)}" if rig else "",
        as_json,
    )
